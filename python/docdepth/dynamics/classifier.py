"""Classify the points of a drive in memory (paper IV)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

import docdepth._core as _core
from docdepth.concurrency import Progress, null_progress, thread_count
from docdepth.config import Parameters, checked_parameters
from docdepth.datasets.point_times import sweep_seconds
from docdepth.dynamics.classes import DriveLabels, Labels
from docdepth.dynamics.sweep_classifier import Evidence, SweepClassifier
from docdepth.dynamics.tracking import TrackedSweep, track_objects
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
        Called with the step (``ground``, ``classify``, ``track``), the sweeps done and their
        number.
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
    p, threads = checked_parameters(parameters), thread_count(threads)
    Trajectory.check(trajectory, sweeps)
    if ground is None:
        ground = grow_ground(sweeps, trajectory, p, threads, progress)
    if len(ground) != len(sweeps):
        raise InputError(f"{len(sweeps)} sweeps need as many ground labels, got {len(ground)}")
    store, every = _Memory(sweeps, ground, sweep_seconds(trajectory.times)), range(len(sweeps))
    tell = progress or null_progress
    classifier = SweepClassifier(trajectory, p.dynamics)
    tell("classify", 0, len(every))
    classifier.vote_on(store, every, lambda done: tell("classify", done, len(every)), threads)
    tracks: list[Track] = []
    if classifier.uses_tracks:
        tracked: list[TrackedSweep] = []
        tracks = track_objects(
            store.detections.__getitem__,
            trajectory,
            tracked.append,
            threads,
            lambda done: tell("track", done, len(every)),
        )
        classifier.label_by_tracks(store, tracked, every, lambda done: None)
    labels = DriveLabels(store.labels[i] for i in every)
    labels.tracks = tracks
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
        self._evidence: dict[int, Evidence] = {}
        self.detections: dict[int, _core.Detections] = {}
        self.labels: dict[int, Labels] = {}

    def read(self, index: int) -> LidarFrame:
        frame = lidar_frame(self._sweeps[index], self._period)
        points, ground = check_sweep(frame.points, self._ground[index])
        rows = np.arange(len(points), dtype=np.uint32)  # of the sweep as it was given
        return replace(frame, index=rows).with_ground(ground).select(usable_points(points))

    def store_evidence(self, index: int, evidence: Evidence, detections: _core.Detections) -> None:
        self._evidence[index], self.detections[index] = evidence, detections

    def evidence(self, index: int) -> Evidence:
        return self._evidence[index]

    def write(self, index: int, frame: LidarFrame, labels: Labels) -> None:
        rows, count = frame.index, len(self._ground[index])
        votes, instance = labels.votes, labels.instance
        self.labels[index] = Labels(
            spread(labels.classid, rows, count, STATIC),
            Votes(spread(votes.static, rows, count), spread(votes.dynamic, rows, count)),
            None if instance is None else spread(instance, rows, count),
        )
