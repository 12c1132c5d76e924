"""Classify a drive: votes and classes of every sweep, then tracks (paper IV-B and IV-C)."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from docdepth.concurrency import Watch, prefetch, thread_count, unwatched
from docdepth.config import DynamicsParameters, Parameters
from docdepth.dynamics.look_ahead import LookAhead
from docdepth.dynamics.sweep_classifier import (
    Evidence,
    InputSweep,
    Labels,
    PreparedSweep,
    SweepClassifier,
)
from docdepth.dynamics.tracking import Detections
from docdepth.dynamics.voting import KeyFrame
from docdepth.errors import InputError
from docdepth.geometry.points import DeskewedSweep, points_of, rig_of
from docdepth.geometry.trajectory import Trajectory
from docdepth.ground.growing import grow_ground

_FILE_THREADS = 5
"""Threads that read and write while they add tracks: most of them wait for the disk."""


class SweepStore(Protocol):
    """Where a drive's sweeps come from and its labels go to: memory, or a run folder.

    All methods but the first two are called from several threads.
    """

    def is_classified(self, index: int) -> bool:
        """Whether an earlier run left the evidence of this sweep, or its labels without tracks."""
        ...

    def has_votes(self, index: int) -> bool:
        """Whether the sweep comes with votes."""
        ...

    def read(self, index: int) -> InputSweep: ...

    def keep(self, index: int, evidence: Evidence, detections: Detections) -> None:
        """Keep what is needed of a sweep when tracks are known."""
        ...

    def evidence(self, index: int) -> Evidence: ...

    def detections(self, index: int) -> Detections: ...

    def write(self, index: int, sweep: InputSweep, labels: Labels) -> None:
        """Take the labels of a sweep."""
        ...


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
        self.labels: dict[int, Labels] = {}

    def is_classified(self, index: int) -> bool:
        return False

    def has_votes(self, index: int) -> bool:
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


def classify_sweeps(
    store: SweepStore,
    trajectory: Trajectory,
    parameters: DynamicsParameters,
    progress: Callable[[int, int], None] | None = None,
    threads: int = 0,
    watch: Watch = unwatched,
) -> int:
    """Classify the sweeps of a store that are not classified yet.

    Parameters
    ----------
    store : SweepStore
    trajectory : Trajectory
        One pose a sweep.
    parameters : DynamicsParameters
    progress : callable, optional
        Called with the sweeps done and their number.
    threads : int
        0 for all cores.
    watch : callable, optional
        Takes the times of the steps.

    Returns
    -------
    int
        How many sweeps were not classified yet.
    """
    steps = SweepClassifier(trajectory, parameters, watch)
    left = [i for i in range(len(trajectory)) if not store.is_classified(i)]
    _vote(steps, store, left, len(trajectory), progress or (lambda done, total: None), threads)
    if steps.uses_tracks:
        _add_tracks(steps, store, len(trajectory), threads)
    return len(left)


def _vote(
    steps: SweepClassifier,
    store: SweepStore,
    left: list[int],
    total: int,
    progress: Callable[[int, int], None],
    threads: int,
) -> None:
    """Classify sweeps by their own votes."""
    with_votes = {index for index in left if store.has_votes(index)}

    def voters(index: int) -> list[int]:
        return [] if index in with_votes else steps.key_frames[index].tolist()

    def classify(
        index: int, made: Future[PreparedSweep], key_frames: list[Future[KeyFrame]]
    ) -> Future[None]:
        prepared = made.result()
        sweep = prepared.sweep
        votes = sweep.votes if index in with_votes else None
        if votes is None:
            votes = steps.vote(index, sweep, [frame.result() for frame in key_frames])
        if not steps.uses_tracks:
            labels = steps.classify(prepared, votes)
            return writers.submit(store.write, index, sweep, labels)
        return writers.submit(store.keep, index, *steps.detect(index, prepared, votes))

    progress(total - len(left), total)
    # A job takes one thread, since a sweep alone has too little to do for many. Others write, so
    # that workers do not wait for the disk.
    workers = thread_count(threads)
    with ThreadPoolExecutor(2) as writers, ThreadPoolExecutor(workers) as pool:
        ahead = LookAhead(
            pool, workers, left, voters, lambda k: steps.prepare(store.read(k)), steps.key_frame
        )
        working: deque[Future[Future[None]]] = deque()
        for step, index in enumerate(left):
            working.append(pool.submit(classify, index, *ahead.take(step)))
            if len(working) > workers:
                working.popleft().result().result()
            progress(total - len(left) + step + 1 - len(working), total)
        while working:
            working.popleft().result().result()
            progress(total - len(working), total)


def _add_tracks(steps: SweepClassifier, store: SweepStore, total: int, threads: int) -> None:
    """Classify objects that move at another time of the drive."""

    def add(index: int) -> None:
        # The sweep is read once more, since tracks are known when all sweeps have voted and a drive
        # may not fit into memory.
        sweep = store.read(index)
        labels = steps.add_tracks(index, sweep, store.evidence(index), results[index])
        store.write(index, sweep, labels)

    with ThreadPoolExecutor(_FILE_THREADS) as pool:
        results = steps.track(list(pool.map(store.detections, range(total))), threads)
        for _ in prefetch(pool, add, range(total), _FILE_THREADS):
            pass
