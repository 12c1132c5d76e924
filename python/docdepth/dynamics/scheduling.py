"""The order in which the sweeps of a drive are classified, and by which threads."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Protocol

from docdepth.concurrency import Watch, prefetch, thread_count, unwatched
from docdepth.config import DynamicsParameters
from docdepth.dynamics.classes import Labels
from docdepth.dynamics.look_ahead import LookAhead
from docdepth.dynamics.sweep_classifier import Evidence, InputSweep, PreparedSweep, SweepClassifier
from docdepth.dynamics.tracking import Detections, TakeSweep, Tracking
from docdepth.dynamics.voting import KeyFrame
from docdepth.geometry.track import Track
from docdepth.geometry.trajectory import Trajectory

_FILE_THREADS = 5
"""Threads that read and write while they add tracks: most of them wait for the disk."""


class SweepStore(Protocol):
    """Where a drive's sweeps come from and its labels go to: memory, or a run folder.

    All methods but the first four are called from several threads.
    """

    def is_done(self, index: int) -> bool:
        """Whether an earlier run left the labels of this sweep."""
        ...

    def tracks(self) -> Tracking | None:
        """What an earlier run found of tracks; None if there are none."""
        ...

    def keep_tracks(self, find: Callable[[TakeSweep], list[Track]]) -> Tracking:
        """Keep what ``find`` hands over, sweep by sweep, and the tracks that it returns."""
        ...

    def has_evidence(self, index: int) -> bool:
        """Whether an interrupted run left the evidence of this sweep."""
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
    steps, every = SweepClassifier(trajectory, parameters, watch), range(len(trajectory))
    left = [i for i in every if not store.is_done(i)]
    if not left:
        return 0
    told = progress or (lambda done, total: None)
    if not steps.uses_tracks:
        _vote(steps, store, left, len(trajectory), told, threads)
        return len(left)
    tracks = store.tracks()
    # Tracks are made of the evidence of all sweeps. Where they are known, few sweeps are missing.
    needed = every if tracks is None else left
    without = [i for i in needed if not store.has_evidence(i)]
    _vote(steps, store, without, len(trajectory), told, threads)
    _add_tracks(steps, store, left, tracks, threads)
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

    def voters(index: int) -> list[int]:
        keys: list[int] = steps.key_frames[index].tolist()
        return keys

    def classify(
        index: int, made: Future[PreparedSweep], key_frames: list[Future[KeyFrame]]
    ) -> Future[None]:
        prepared = made.result()
        sweep = prepared.sweep
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


def _add_tracks(
    steps: SweepClassifier,
    store: SweepStore,
    left: list[int],
    tracks: Tracking | None,
    threads: int,
) -> None:
    """Classify objects that move at another time of the drive."""

    def add(index: int) -> None:
        # The sweep is read once more, since tracks are known when all sweeps have voted and a drive
        # may not fit into memory.
        sweep = store.read(index)
        labels = steps.add_tracks(index, sweep, store.evidence(index), results.sweeps[index])
        store.write(index, sweep, labels)

    with ThreadPoolExecutor(_FILE_THREADS) as pool:
        if tracks is None:
            tracks = store.keep_tracks(lambda take: steps.track(store.detections, take, threads))
        results = tracks
        for _ in prefetch(pool, add, left, _FILE_THREADS):
            pass
