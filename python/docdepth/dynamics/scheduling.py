"""The order in which the sweeps of a drive are classified, and by which threads."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from typing import Protocol

from docdepth.concurrency import Progress, Timer, null_progress, prefetch, thread_count
from docdepth.config import DynamicsParameters
from docdepth.dynamics.classes import Labels
from docdepth.dynamics.sweep_classifier import Evidence, MeshedFrame, SweepClassifier
from docdepth.dynamics.tracking import Detections, TakeSweep, TrackedSweep
from docdepth.dynamics.voting import KeyFrame
from docdepth.errors import RunError
from docdepth.geometry.lidar_frame import LidarFrame
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

    def tracked(self) -> Sequence[TrackedSweep] | None:
        """What tracks found in each sweep; None while they are not known."""
        ...

    def store_tracks(self, find: Callable[[TakeSweep], list[Track]]) -> None:
        """Store what ``find`` hands over, sweep by sweep, and the tracks that it returns."""
        ...

    def has_evidence(self, index: int) -> bool:
        """Whether an interrupted run left the evidence of this sweep."""
        ...

    def read(self, index: int) -> LidarFrame:
        """A sweep whose classes are ground and static."""
        ...

    def store_detections(self, index: int, evidence: Evidence, detections: Detections) -> None:
        """Store what is needed of a sweep when tracks are known."""
        ...

    def evidence(self, index: int) -> Evidence: ...

    def detections(self, index: int) -> Detections: ...

    def write(self, index: int, frame: LidarFrame, labels: Labels) -> None:
        """Take the labels of a sweep."""
        ...


SweepWork = Callable[[SweepClassifier, SweepStore, Sequence[int], Callable[[int], None], int], None]
"""What is done with sweeps: :func:`vote_on`, :func:`label_by_tracks`. The last arguments are to be
called with the number of sweeps that are done, and threads."""

MapChunks = Callable[[SweepWork, list[int], Callable[[int], None]], None]
"""Does work on sweeps in chunks, and calls the last argument with the number that are done."""


def classify_sweeps(
    store: SweepStore,
    trajectory: Trajectory,
    parameters: DynamicsParameters,
    progress: Progress | None = None,
    threads: int = 0,
    timer: Timer | None = None,
    map_chunks: MapChunks | None = None,
) -> int:
    """Classify the sweeps of a store that are not classified yet.

    Parameters
    ----------
    store : SweepStore
    trajectory : Trajectory
        One pose a sweep.
    parameters : DynamicsParameters
    progress : callable, optional
        Called with ``"classify"``, the sweeps done and their number.
    threads : int
        0 for all cores.
    timer : Timer, optional
        Takes the times of the steps.
    map_chunks : callable, optional
        Shares sweeps among workers.

    Returns
    -------
    int
        How many sweeps were not classified yet.
    """
    classifier, count = SweepClassifier(trajectory, parameters, timer), len(trajectory)
    left = [i for i in range(count) if not store.is_done(i)]
    if not left:
        return 0
    report = progress or null_progress
    each = map_chunks or (lambda work, sweeps, done: work(classifier, store, sweeps, done, threads))
    tracked = store.tracked()
    # Tracks are made of the evidence of all sweeps. Where they are known, few sweeps are missing.
    needed = list(range(count)) if classifier.uses_tracks and tracked is None else left
    without = [i for i in needed if not (classifier.uses_tracks and store.has_evidence(i))]
    kept = count - len(without)
    report("classify", kept, count)
    each(vote_on, without, lambda done: report("classify", kept + done, count))
    if classifier.uses_tracks:
        if tracked is None:
            store.store_tracks(lambda take: classifier.track(store.detections, take, threads))
        each(label_by_tracks, left, lambda done: None)
    return len(left)


def vote_on(
    classifier: SweepClassifier,
    store: SweepStore,
    sweeps: Sequence[int],
    progress: Callable[[int], None],
    threads: int,
) -> None:
    """Classify sweeps by their own votes."""

    def classify(
        needed: tuple[int, Future[MeshedFrame], list[Future[KeyFrame]]],
    ) -> Future[None]:
        index, meshed, key_frames = needed[0], needed[1].result(), needed[2]
        frame = meshed.frame
        votes = classifier.vote(index, frame, [key_frame.result() for key_frame in key_frames])
        if not classifier.uses_tracks:
            labels = classifier.classify(meshed, votes)
            return writers.submit(store.write, index, frame, labels)
        return writers.submit(
            store.store_detections, index, *classifier.detect(index, meshed, votes)
        )

    # A job takes one thread, since a sweep alone has too little to do for many. Others write, so
    # that workers do not wait for the disk.
    workers = thread_count(threads)
    with ThreadPoolExecutor(2) as writers, ThreadPoolExecutor(workers) as pool:
        needed = _look_ahead(pool, workers, classifier, store, sweeps)
        for done, written in enumerate(prefetch(pool, classify, needed, workers), 1):
            written.result()
            progress(done)


def _look_ahead(
    pool: Executor,
    workers: int,
    classifier: SweepClassifier,
    store: SweepStore,
    order: Sequence[int],
) -> Iterator[tuple[int, Future[MeshedFrame], list[Future[KeyFrame]]]]:
    """Each sweep with its key frames, made a little before and dropped after their last use.

    Workers take jobs in the order in which they were submitted. A job that another one needs is
    always submitted first, so no worker waits for a job that waits for a worker; and it is
    submitted some sweeps before, so workers seldom wait at all. Memory is bounded by this window
    and the radius of the key frames, not by the length of the drive.
    """
    sweeps: dict[int, Future[MeshedFrame]] = {}
    key_frames: dict[int, Future[KeyFrame]] = {}

    def voters(indices: Sequence[int]) -> set[int]:
        return {k for index in indices for k in classifier.key_frames[index].tolist()}

    def make_key_frame(sweep: Future[MeshedFrame]) -> KeyFrame:
        return classifier.key_frame(sweep.result())

    for step, index in enumerate(order):
        ahead = order[step : step + workers + 2]
        soon, later = voters(ahead[: workers + 1]), voters(ahead)
        key_frames = {k: made for k, made in key_frames.items() if k in soon}
        wanted = later - key_frames.keys()
        sweeps = {k: sweep for k, sweep in sweeps.items() if k >= index or k in wanted}
        for k in sorted({*ahead, *later} - sweeps.keys() - key_frames.keys()):
            sweeps[k] = pool.submit(lambda k: classifier.prepare(store.read(k)), k)
        for k in sorted(soon - key_frames.keys()):
            key_frames[k] = pool.submit(make_key_frame, sweeps[k])
        yield index, sweeps[index], [key_frames[k] for k in classifier.key_frames[index].tolist()]


def label_by_tracks(
    classifier: SweepClassifier,
    store: SweepStore,
    sweeps: Sequence[int],
    progress: Callable[[int], None],
    threads: int,
) -> None:
    """Classify objects that move at another time of the drive; the store has its tracks."""
    tracked = store.tracked()
    if tracked is None:
        raise RunError("there are no tracks to add; run the same command again")

    def add(index: int) -> None:
        # The sweep is read once more, since tracks are known when all sweeps have voted and a drive
        # may not fit into memory.
        frame = store.read(index)
        labels = classifier.label_by_tracks(index, frame, store.evidence(index), tracked[index])
        store.write(index, frame, labels)

    with ThreadPoolExecutor(_FILE_THREADS) as pool:
        for done, _ in enumerate(prefetch(pool, add, sweeps, _FILE_THREADS), 1):
            progress(done)
