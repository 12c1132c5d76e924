"""The order in which the sweeps of a drive are classified, and by which threads."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Protocol

from docdepth.concurrency import Watch, prefetch, thread_count, unwatched
from docdepth.config import DynamicsParameters
from docdepth.dynamics.classes import Labels
from docdepth.dynamics.look_ahead import LookAhead
from docdepth.dynamics.sweep_classifier import Evidence, MeshedFrame, SweepClassifier
from docdepth.dynamics.tracking import Detections, TakeSweep, TrackedSweep
from docdepth.dynamics.voting import KeyFrame
from docdepth.errors import RunError
from docdepth.geometry.lidar_frame import LidarFrame
from docdepth.geometry.track import Track
from docdepth.geometry.trajectory import Trajectory

_FILE_THREADS = 5
"""Threads that read and write while they add tracks: most of them wait for the disk."""


Told = Callable[[int], None]
"""Called with the number of sweeps that are done."""


class SweepStore(Protocol):
    """Where a drive's sweeps come from and its labels go to: memory, or a run folder.

    All methods but the first four are called from several threads.
    """

    def is_done(self, index: int) -> bool:
        """Whether an earlier run left the labels of this sweep."""
        ...

    def tracked(self) -> Sequence[TrackedSweep] | None:
        """What tracks found in each sweep; None while they are not known."""
        ...

    def keep_tracks(self, find: Callable[[TakeSweep], list[Track]]) -> None:
        """Keep what ``find`` hands over, sweep by sweep, and the tracks that it returns."""
        ...

    def has_evidence(self, index: int) -> bool:
        """Whether an interrupted run left the evidence of this sweep."""
        ...

    def read(self, index: int) -> LidarFrame:
        """A sweep whose classes are ground and static."""
        ...

    def keep(self, index: int, evidence: Evidence, detections: Detections) -> None:
        """Keep what is needed of a sweep when tracks are known."""
        ...

    def evidence(self, index: int) -> Evidence: ...

    def detections(self, index: int) -> Detections: ...

    def write(self, index: int, frame: LidarFrame, labels: Labels) -> None:
        """Take the labels of a sweep."""
        ...


Work = Callable[[SweepClassifier, SweepStore, Sequence[int], Told, int], None]
"""What is done with sweeps: :func:`vote_on`, :func:`add_tracks`. The last argument is threads."""

Share = Callable[[Work, list[int], Told], None]
"""Has work done on sweeps, all in their order or parts of them elsewhere."""


def classify_sweeps(
    store: SweepStore,
    trajectory: Trajectory,
    parameters: DynamicsParameters,
    progress: Callable[[int, int], None] | None = None,
    threads: int = 0,
    watch: Watch = unwatched,
    share: Share | None = None,
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
    share : callable, optional
        Has sweeps worked on by many workers.

    Returns
    -------
    int
        How many sweeps were not classified yet.
    """
    steps, every = SweepClassifier(trajectory, parameters, watch), range(len(trajectory))
    left = [i for i in every if not store.is_done(i)]
    if not left:
        return 0
    tell = progress or (lambda done, total: None)
    each = share or (lambda work, sweeps, told: work(steps, store, sweeps, told, threads))
    tracked = store.tracked()
    # Tracks are made of the evidence of all sweeps. Where they are known, few sweeps are missing.
    needed = every if steps.uses_tracks and tracked is None else left
    without = [i for i in needed if not (steps.uses_tracks and store.has_evidence(i))]
    kept = len(trajectory) - len(without)
    tell(kept, len(trajectory))
    each(vote_on, without, lambda done: tell(kept + done, len(trajectory)))
    if steps.uses_tracks:
        if tracked is None:
            store.keep_tracks(lambda take: steps.track(store.detections, take, threads))
        each(add_tracks, left, lambda done: None)
    return len(left)


def vote_on(
    steps: SweepClassifier, store: SweepStore, sweeps: Sequence[int], told: Told, threads: int
) -> None:
    """Classify sweeps by their own votes."""

    def voters(index: int) -> list[int]:
        keys: list[int] = steps.key_frames[index].tolist()
        return keys

    def classify(
        index: int, made: Future[MeshedFrame], key_frames: list[Future[KeyFrame]]
    ) -> Future[None]:
        meshed = made.result()
        frame = meshed.frame
        votes = steps.vote(index, frame, [key_frame.result() for key_frame in key_frames])
        if not steps.uses_tracks:
            labels = steps.classify(meshed, votes)
            return writers.submit(store.write, index, frame, labels)
        return writers.submit(store.keep, index, *steps.detect(index, meshed, votes))

    # A job takes one thread, since a sweep alone has too little to do for many. Others write, so
    # that workers do not wait for the disk.
    workers = thread_count(threads)
    with ThreadPoolExecutor(2) as writers, ThreadPoolExecutor(workers) as pool:
        ahead = LookAhead(
            pool, workers, sweeps, voters, lambda k: steps.prepare(store.read(k)), steps.key_frame
        )
        working: deque[Future[Future[None]]] = deque()
        for step, index in enumerate(sweeps):
            working.append(pool.submit(classify, index, *ahead.take(step)))
            if len(working) > workers:
                working.popleft().result().result()
            told(step + 1 - len(working))
        while working:
            working.popleft().result().result()
            told(len(sweeps) - len(working))


def add_tracks(
    steps: SweepClassifier, store: SweepStore, sweeps: Sequence[int], told: Told, threads: int
) -> None:
    """Classify objects that move at another time of the drive; the store has its tracks."""
    tracked = store.tracked()
    if tracked is None:
        raise RunError("there are no tracks to add; run the same command again")

    def add(index: int) -> None:
        # The sweep is read once more, since tracks are known when all sweeps have voted and a drive
        # may not fit into memory.
        frame = store.read(index)
        labels = steps.add_tracks(index, frame, store.evidence(index), tracked[index])
        store.write(index, frame, labels)

    with ThreadPoolExecutor(_FILE_THREADS) as pool:
        for done, _ in enumerate(prefetch(pool, add, sweeps, _FILE_THREADS), 1):
            told(done)
