"""Classify the points of a drive in memory (paper IV)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from docdepth.config import Parameters
from docdepth.dynamics.classes import Labels
from docdepth.dynamics.scheduling import classify_sweeps
from docdepth.dynamics.sweep_classifier import Evidence, InputSweep
from docdepth.dynamics.tracking import Detections, TakeSweep, TrackedSweep, Tracking
from docdepth.errors import InputError
from docdepth.geometry.points import DeskewedSweep, points_of, rig_of
from docdepth.geometry.track import Track
from docdepth.geometry.trajectory import Trajectory
from docdepth.ground.growing import grow_ground


def classify_drive(
    sweeps: Sequence[DeskewedSweep | NDArray[np.float32]],
    trajectory: Trajectory,
    parameters: Parameters | None = None,
    ground: Sequence[NDArray[np.bool_]] | None = None,
    progress: Callable[[str, int, int], None] | None = None,
    threads: int = 0,
) -> list[Labels]:
    """Classify the points of a drive: ground, static or dynamic.

    Parameters
    ----------
    sweeps : sequence of Sweep, or of ndarray of float32, shape (N_i, 3)
        Deskewed, LiDAR frame, metres. Items are taken from several threads, and several times.
    trajectory : Trajectory
        One pose a sweep.
    parameters : Parameters, optional
        Its ``ground`` and ``dynamics`` are used.
    ground : sequence of ndarray of bool, shape (N_i,), optional
        Ground labels of each sweep; grown when not given.
    progress : callable, optional
        Called with the step (``ground``, ``classify``), the sweeps done and their number.
    threads : int
        0 for all cores. The labels do not depend on it.

    Returns
    -------
    list of Labels
        One for each sweep.

    Raises
    ------
    InputError
        The numbers of sweeps, poses and ground labels differ, or an array is wrong.
    """
    p = parameters or Parameters()
    if ground is None:
        ground = grow_ground(sweeps, trajectory, p, threads, progress)
    if not len(sweeps) == len(trajectory) == len(ground):
        raise InputError(
            f"{len(sweeps)} sweeps, {len(trajectory)} poses and {len(ground)} ground labels do not "
            "belong to the same drive; give one of each a sweep"
        )
    store = _Memory(sweeps, ground)
    told = None if progress is None else partial(progress, "classify")
    classify_sweeps(store, trajectory, p.dynamics, told, threads)
    return [store.labels[i] for i in range(len(sweeps))]


class _Memory:
    """A drive in memory."""

    def __init__(
        self,
        sweeps: Sequence[DeskewedSweep | NDArray[np.float32]],
        ground: Sequence[NDArray[np.bool_]],
    ) -> None:
        self._sweeps, self._ground = sweeps, ground
        self._kept: dict[int, tuple[Evidence, Detections]] = {}
        self._tracks: Tracking | None = None
        self.labels: dict[int, Labels] = {}

    def is_done(self, index: int) -> bool:
        return False

    def tracks(self) -> Tracking | None:
        return self._tracks

    def keep_tracks(self, find: Callable[[TakeSweep], list[Track]]) -> None:
        sweeps: list[TrackedSweep] = []
        tracks = find(sweeps.append)
        self._tracks = Tracking(sweeps, tracks)

    def has_evidence(self, index: int) -> bool:
        return False

    def read(self, index: int) -> InputSweep:
        sweep = self._sweeps[index]
        return InputSweep(points_of(sweep), self._ground[index], rig_of(sweep))

    def keep(self, index: int, evidence: Evidence, detections: Detections) -> None:
        self._kept[index] = evidence, detections

    def evidence(self, index: int) -> Evidence:
        return self._kept[index][0]

    def detections(self, index: int) -> Detections:
        return self._kept[index][1]

    def write(self, index: int, sweep: InputSweep, labels: Labels) -> None:
        self.labels[index] = labels
