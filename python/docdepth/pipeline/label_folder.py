"""A folder of labels that another method, or another run, has made."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth.errors import DatasetError
from docdepth.geometry.lidar_frame import LidarFrame
from docdepth.geometry.trajectory import Trajectory
from docdepth.io.frames import read_trajectory
from docdepth.io.labels import SUFFIXES, label_file, read_classes
from docdepth.io.tracks import TRACKS, cut_tracks

log = logging.getLogger(__name__)

_SAME_POSE = 1e-3
"""Metres, and entries of rotations: tracks fit poses that differ by less."""


class LabelFolder:
    """A folder of labels, ``NAME.label``, ``NAME.npy`` or ``NAME.pcd`` for each sweep.

    Parameters
    ----------
    folder : Path
        The folder, or its parent with a folder ``labels``: a run, or a sequence of SemanticKITTI;
        or with a folder ``pcd``: a sequence of DynamicMap_Benchmark.
    """

    def __init__(self, folder: Path) -> None:
        if not folder.is_dir():
            what = "not a folder" if folder.exists() else "not there"
            raise DatasetError(f"{folder} is {what}; `labels` names a folder of label files")
        below = (folder / name for name in ("labels", "pcd"))
        self.folder = next((f for f in below if f.is_dir()), folder)
        if not self.label_files():
            raise DatasetError(f"{self.folder} holds no .label, .npy or .pcd file")

    def label_files(self) -> list[Path]:
        """All its labels, by name."""
        return sorted(p for p in self.folder.iterdir() if p.suffix in SUFFIXES)

    def files(self) -> list[Path]:
        """All that is read: labels, tracks, and the poses that these belong to."""
        beside = (self._tracks, self._trajectory) if self._has_tracks() else ()
        return [*self.label_files(), *beside]

    def check(self, names: Sequence[str]) -> None:
        """Refuse a folder that lacks the labels of a sweep, or counts other sweeps."""
        files = {label_file(self.folder, name, frame) for frame, name in enumerate(names)}
        counted = any(file.stem not in names for file in files)
        if counted and (count := len(list(self.folder.glob("*.pcd")))) != len(names):
            raise DatasetError(
                f"{self.folder} has {count} PCD files, which are counted and not named as the "
                f"sweeps, for {len(names)} sweeps; name them as the sweeps"
            )

    def check_count(
        self, name: str, frame: int, points: int | None, returns: Callable[[], NDArray[Any]]
    ) -> None:
        """Refuse labels that are missing, damaged or of another number of points.

        ``points`` are the rows of the sweep; nothing is refused where they are not known.
        ``returns`` gives the rows that are usable, where labels are of these alone.
        """
        file = label_file(self.folder, name, frame)
        if points is not None:
            read_classes(file, points, frame, returns)

    def classified(self, record: LidarFrame, frame: int) -> LidarFrame:
        """A frame with the classes given, and without votes."""
        file = label_file(self.folder, record.name, frame)
        classid, instance = read_classes(file, record.input_points, frame, lambda: record.index)
        return replace(
            record,
            classid=classid[record.index],
            instance=None if instance is None else instance[record.index],
            votes_static=None,
            votes_dynamic=None,
        )

    def tracks(self, trajectory: Trajectory) -> bytes | None:
        """The tracks of a run whose labels these are, at the times of a trajectory.

        None where there are none, or where they belong to other poses.
        """
        if not self._has_tracks():
            return None
        theirs, _ = read_trajectory(self._trajectory)
        if not _fits(trajectory, theirs):
            log.warning(
                "%s are of other poses than this run has and are not used: moving objects are "
                "drawn from the nearest sweep alone; give these poses, too: `poses=%r`",
                self._tracks, str(self._trajectory),
            )  # fmt: skip
            return None
        return cut_tracks(self._tracks, trajectory.times)

    @property
    def _tracks(self) -> Path:
        return self.folder.parent / TRACKS

    @property
    def _trajectory(self) -> Path:
        return self.folder.parent / "traj_odometry.ply"

    def _has_tracks(self) -> bool:
        return self._tracks.is_file() and self._trajectory.is_file()


def _fits(ours: Trajectory, theirs: Trajectory) -> bool:
    """Whether both have the same poses at the times of ours."""
    rows = np.searchsorted(theirs.times, ours.times).clip(max=len(theirs) - 1)
    if not np.array_equal(theirs.times[rows], ours.times):
        return False
    return bool(np.abs(theirs.poses[rows] - ours.poses).max() < _SAME_POSE)
