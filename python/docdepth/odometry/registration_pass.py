"""One pass of odometry over a drive, and its poses on disk."""

from __future__ import annotations

import logging
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from docdepth.config import OdometryParameters
from docdepth.datasets.base import Dataset
from docdepth.io.atomic import npz_bytes, write_atomically
from docdepth.odometry.deskewing import NEIGHBORS, centred_motion
from docdepth.odometry.registration import PreviousPoses, register
from docdepth.odometry.sweeps import DeskewedSweeps

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class RegistrationPass:
    """One pass: every sweep is registered once, deskewed with the poses of the previous pass.

    Attributes
    ----------
    number : int
        From 0. The first pass finds the poses, the others refine them.
    dataset : Dataset
    parameters : OdometryParameters
    file : Path, optional
        Where the poses of the finished pass are kept.
    """

    number: int
    dataset: Dataset
    parameters: OdometryParameters
    file: Path | None

    def run(
        self,
        previous: PreviousPoses | None,
        on_pose: Callable[[int, NDArray[np.float64]], object],
    ) -> NDArray[np.float64]:
        """Poses (n, 4, 4), saved at the end; ``on_pose(k, pose)`` is called after each sweep."""
        count = len(self.dataset)

        def motion(k: int) -> NDArray[np.float64]:
            assert previous is not None
            known = previous(min(k + NEIGHBORS, count - 1))
            of_k: NDArray[np.float64] = centred_motion(known, self.dataset.times, [k])[0]
            return of_k

        sweeps = DeskewedSweeps(self.dataset, None if previous is None else motion)
        poses = np.repeat(np.eye(4)[None], count, axis=0)
        for k, pose in enumerate(register(sweeps, self.parameters, previous)):
            poses[k] = pose
            on_pose(k, pose)
        self._save(poses)
        return poses

    def load(self) -> NDArray[np.float64] | None:
        """Poses of an earlier run, if they are of the same drive and parameters."""
        if self.file is None or not self.file.is_file():
            return None
        try:
            with np.load(self.file) as saved:
                if str(saved["key"]) != self._key():
                    return None
                poses: NDArray[np.float64] = saved["poses"]
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error):
            return None  # damaged: the pass is made again
        log.info("odometry continues after %s", self.file.name)
        return poses

    def _save(self, poses: NDArray[np.float64]) -> None:
        if self.file is None:
            return
        content = npz_bytes(poses=poses, key=np.array(self._key()))
        write_atomically(self.file, lambda stream: stream.write(content))

    def _key(self) -> str:
        settings = self.parameters.model_dump_json(exclude={"passes"})
        return f"{Path(self.dataset.path).resolve()} {len(self.dataset)} {settings}"
