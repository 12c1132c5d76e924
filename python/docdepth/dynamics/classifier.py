"""Classify the points of a drive in memory (paper IV)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from docdepth.concurrency import Progress
from docdepth.config import Parameters, given
from docdepth.datasets.point_times import sweep_seconds
from docdepth.dynamics.classes import DriveLabels, Labels
from docdepth.dynamics.scheduling import classify_sweeps
from docdepth.dynamics.sweep_classifier import Evidence
from docdepth.dynamics.tracking import Detections, TakeSweep, TrackedSweep
from docdepth.dynamics.voting import Votes
from docdepth.errors import InputError
from docdepth.geometry.lidar_frame import LidarFrame
from docdepth.geometry.points import STATIC, check_sweep, spread, usable_points
from docdepth.geometry.track import Track
from docdepth.geometry.trajectory import Trajectory
from docdepth.ground.growing import grow_ground
from docdepth.odometry.sweeps import AnySweep, lidar_frame


def classify_drive(
    sweeps: Sequence[AnySweep],
    trajectory: Trajectory,
    parameters: Parameters | None = None,
    ground: Sequence[NDArray[np.bool_]] | None = None,
    progress: Progress | None = None,
    threads: int = 0,
) -> DriveLabels:
    """Classify the points of a drive: ground, static or dynamic.

    Parameters
    ----------
    sweeps : sequence of LidarFrame, of Sweep, or of ndarray of float32, shape (N_i, 3)
        Deskewed, LiDAR frame, metres. Items are taken from several threads, and several times.
        Those of :class:`~docdepth.Odometry`, and a :class:`~docdepth.Sweep`, also say when and from
        where each point was measured, as a run knows it.
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
        One for each sweep, one entry for each row; rows without a usable return, NaN or at the
        origin, are static without votes. Its attribute ``tracks`` holds the objects that move;
        :class:`~docdepth.Scene` uses them.

    Raises
    ------
    InputError
        The numbers of sweeps, poses and ground labels differ, or an array is wrong.
    """
    p = given(parameters)
    Trajectory.check(trajectory, sweeps)
    if ground is None:
        ground = grow_ground(sweeps, trajectory, p, threads, progress)
    if len(ground) != len(sweeps):
        raise InputError(f"{len(sweeps)} sweeps need as many ground labels, got {len(ground)}")
    store = _Memory(sweeps, ground, sweep_seconds(trajectory.times))
    classify_sweeps(store, trajectory, p.dynamics, progress, threads)
    labels = DriveLabels(store.labels[i] for i in range(len(sweeps)))
    labels.tracks = store.tracks
    return labels


class _Memory:
    """A drive in memory."""

    def __init__(
        self,
        sweeps: Sequence[AnySweep],
        ground: Sequence[NDArray[np.bool_]],
        period: np.float32,
    ) -> None:
        self._sweeps, self._ground, self._period = sweeps, ground, period
        self._evidence: dict[int, tuple[Evidence, Detections]] = {}
        self._tracked: list[TrackedSweep] | None = None
        self.tracks: Sequence[Track] = ()
        self.labels: dict[int, Labels] = {}

    def is_done(self, index: int) -> bool:
        return False

    def tracked(self) -> list[TrackedSweep] | None:
        return self._tracked

    def store_tracks(self, find: Callable[[TakeSweep], list[Track]]) -> None:
        self._tracked = []
        self.tracks = find(self._tracked.append)

    def has_evidence(self, index: int) -> bool:
        return False

    def read(self, index: int) -> LidarFrame:
        frame = lidar_frame(self._sweeps[index], self._period)
        points, ground = check_sweep(frame.points, self._ground[index])
        rows = np.arange(len(points), dtype=np.uint32)  # of the sweep as it was given
        return replace(frame, index=rows).with_ground(ground).select(usable_points(points))

    def store_detections(self, index: int, evidence: Evidence, detections: Detections) -> None:
        self._evidence[index] = evidence, detections

    def evidence(self, index: int) -> Evidence:
        return self._evidence[index][0]

    def detections(self, index: int) -> Detections:
        return self._evidence[index][1]

    def write(self, index: int, frame: LidarFrame, labels: Labels) -> None:
        rows, count = frame.index, len(self._ground[index])
        votes, instance = labels.votes, labels.instance
        self.labels[index] = Labels(
            spread(labels.classid, rows, count, STATIC),
            Votes(spread(votes.static, rows, count), spread(votes.dynamic, rows, count)),
            None if instance is None else spread(instance, rows, count),
        )
