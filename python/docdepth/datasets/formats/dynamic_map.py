"""Sequences of DynamicMap_Benchmark: PCD files in the world, the sensor's pose in VIEWPOINT."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.base import Sweep
from docdepth.datasets.format import Format
from docdepth.datasets.formats.cloud_folder import VIEWPOINT, CloudFolder
from docdepth.errors import DatasetError
from docdepth.geometry.points import MOVING_LABEL, STATIC_LABEL
from docdepth.io.pcd import PcdError, read_pcd_header

# Sweeps are SemanticKITTI's and the like: ten a second, motion compensated.
_USUAL = {
    "sweeps": "pcd",
    "rate": 10,
    "poses": VIEWPOINT,
    "frame": "world",
    "motion_compensated": True,
}


class DynamicMap(CloudFolder):
    """A sequence ``SEQUENCE/pcd/000000.pcd`` of DynamicMap_Benchmark.

    Points are in the world and are brought to the LiDAR frame by VIEWPOINT. Intensity is no
    intensity but the true class, 1 for what moves: :meth:`labels` has it.

    Parameters
    ----------
    path : Path
        The sequence; a ``docdepth.yaml`` as of :class:`~.folder.FolderSettings` may add cameras.
    """

    def __init__(self, path: Path, image_size: tuple[int, int] | None = None) -> None:
        super().__init__(path, image_size, "dynamic_map", _USUAL)

    def sweep(self, index: int) -> Sweep:
        """Sweep ``index`` in the LiDAR frame, without intensity."""
        return replace(super().sweep(index), intensity=None)

    def labels(self, index: int) -> NDArray[np.uint32]:
        """SemanticKITTI labels: 251 for what moves, 9 for the rest."""
        classes = super().sweep(index).intensity
        if classes is None:
            raise DatasetError(
                f"{self.sweep_files(index)[0]} (frame {index}) has no intensity, in which "
                "DynamicMap_Benchmark keeps the classes"
            )
        return np.where(classes == 1, MOVING_LABEL, STATIC_LABEL).astype(np.uint32)


def _recognises(path: Path) -> bool:
    """A folder pcd whose last file has a pose in its header."""
    files = sorted((path / "pcd").glob("*.pcd"))
    try:
        return bool(files) and bool(read_pcd_header(files[-1]).viewpoint[:3].any())
    except (OSError, PcdError):
        return False


FORMAT = Format(
    "dynamic_map",
    "a sequence of DynamicMap_Benchmark with pcd/*.pcd, whose VIEWPOINT is the sensor's pose",
    _recognises,
    DynamicMap,
)
