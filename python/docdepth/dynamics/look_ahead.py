"""Sweeps and key frames made a little before they are needed, and dropped after their last use."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Executor, Future

from docdepth.dynamics.sweep_classifier import MeshedFrame
from docdepth.dynamics.voting import KeyFrame


class LookAhead:
    """A window over the drive that holds what the next sweeps need.

    Workers take jobs in the order in which they were submitted. A job that another one needs is
    always submitted first, so no worker waits for a job that waits for a worker; and it is
    submitted some sweeps before, so workers seldom wait at all. Memory is bounded by the window and
    the radius of the key frames, not by the length of the drive.

    Parameters
    ----------
    pool : Executor
    workers : int
        Threads of the pool; the window is so many sweeps long, and two.
    order : sequence of int
        The sweeps in the order in which they will be taken.
    voters : callable
        The key frames of a sweep; none for a sweep whose votes are kept.
    prepare : callable
        Reads and prepares a sweep.
    key_frame : callable
        Makes a key frame of a prepared sweep.
    """

    def __init__(
        self,
        pool: Executor,
        workers: int,
        order: Sequence[int],
        voters: Callable[[int], list[int]],
        prepare: Callable[[int], MeshedFrame],
        key_frame: Callable[[MeshedFrame], KeyFrame],
    ) -> None:
        self._pool, self._workers, self._order, self._voters = pool, workers, order, voters
        self._prepare, self._key_frame = prepare, key_frame
        self._sweeps: dict[int, Future[MeshedFrame]] = {}
        self._key_frames: dict[int, Future[KeyFrame]] = {}

    def take(self, step: int) -> tuple[Future[MeshedFrame], list[Future[KeyFrame]]]:
        """The sweep at a place of the order, and its key frames; call it for each in turn."""
        index, ahead = self._order[step], self._order[step : step + self._workers + 2]
        soon, later = self._voters_of(ahead[: self._workers + 1]), self._voters_of(ahead)
        self._key_frames = {k: made for k, made in self._key_frames.items() if k in soon}
        wanted = later - self._key_frames.keys()
        self._sweeps = {k: s for k, s in self._sweeps.items() if k >= index or k in wanted}
        for k in sorted({*ahead, *later} - self._sweeps.keys() - self._key_frames.keys()):
            self._sweeps[k] = self._pool.submit(self._prepare, k)
        for k in sorted(soon - self._key_frames.keys()):
            self._key_frames[k] = self._pool.submit(self._make, self._sweeps[k])
        return self._sweeps[index], [self._key_frames[k] for k in self._voters(index)]

    def _voters_of(self, sweeps: Iterable[int]) -> set[int]:
        return {k for index in sweeps for k in self._voters(index)}

    def _make(self, sweep: Future[MeshedFrame]) -> KeyFrame:
        return self._key_frame(sweep.result())
