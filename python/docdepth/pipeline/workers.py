"""Many workers: the work of a stage is cut into chunks of the drive, which processes share.

The work is written once, as a function of a :class:`Worker` and a chunk. Without other workers it
is called here, with the whole drive as one chunk. Else processes of this machine or of a Dask
cluster call it, through the interface of :class:`concurrent.futures.Executor`. They read the run
folder, which lies where all of them see it, and what they write is named and recorded here
(:class:`docdepth.io.recorded_folder.RecordedFolder`).
"""

from __future__ import annotations

import itertools
import logging
import math
import multiprocessing
import os
import signal
import socket
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    wait,
)
from concurrent.futures.process import ProcessPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from multiprocessing.connection import Connection
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from docdepth._core import __version__
from docdepth.concurrency import thread_count
from docdepth.errors import ConfigError, MissingExtraError, RunError
from docdepth.io.recorded_folder import HandedFile
from docdepth.io.run_folder import RunFolder
from docdepth.pipeline.stage import Stopwatch, recorded_warnings

log = logging.getLogger(__name__)

_LONGEST, _SHORTEST = 200.0, 20.0
"""Chunks [m]. What their borders need of both sides, up to the radius of the coarse key frames, is
made twice; what a worker has in hand is lost with it."""

_A_SWEEP = 0.5
"""So much path a sweep or image counts beside that of the vehicle, which may stand [m]."""

_TASKS_AHEAD = 2
"""Tasks that each worker has in hand or next."""

_VAIN = 3
"""So often workers may die without that any chunk gets done."""

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


@dataclass(frozen=True)
class Worker:
    """What the work on a chunk gets.

    Attributes
    ----------
    run : RunFolder
    threads : int
        0 for all cores.
    watch : Stopwatch
    told : callable
        To be called with the number of frames of the chunk that are done.
    """

    run: RunFolder
    threads: int
    watch: Stopwatch
    told: Callable[[int], None]


Work = Callable[[Worker, _Item], _Result]
"""Work on a chunk. It is a function of a module, or a ``partial`` of one: it can be pickled."""


class Workers:
    """Who does the work: this process alone, others of this machine, or those of a Dask cluster.

    Others begin and end with a ``with`` block.

    Parameters
    ----------
    threads : int
        Of this process, or of all processes of this machine together; 0 for all cores. Of each
        worker of a cluster; 0 for one.
    jobs : int
        Processes of this machine; 1 for this one alone.
    scheduler : str, optional
        Address of a Dask scheduler, whose workers do the work.

    Raises
    ------
    ConfigError
        Both jobs and a scheduler are given.
    """

    def __init__(self, threads: int = 0, jobs: int = 1, scheduler: str | None = None) -> None:
        if jobs < 1 or (scheduler is not None and jobs > 1):
            raise ConfigError(
                f"jobs is {jobs}: give a number from 1 on"
                if jobs < 1
                else "--jobs is for this machine, --scheduler for a cluster: give one of them"
            )
        self.threads, self.jobs, self._scheduler = threads, jobs, scheduler
        self._client: Any = None
        self._pool: Executor | None = None
        self._lifeline: Connection | None = None

    def __enter__(self) -> Workers:
        if self._scheduler is not None:
            self._client = _client(self._scheduler)
        return self

    def __exit__(self, kind: type[BaseException] | None, *rest: object) -> None:
        self._end_pool(at_once=kind is not None)
        if self._client is not None:
            self._client.close()

    @property
    def count(self) -> int:
        """How many chunks are worked on at the same time."""
        if self._client is None:
            return self.jobs
        return max(sum(self._client.nthreads().values()), 1)

    @property
    def are_elsewhere(self) -> bool:
        """Whether other processes do the work."""
        return self._scheduler is not None or self.jobs > 1

    def cut(self, items: Sequence[_Item], arc: NDArray[np.float64]) -> list[list[_Item]]:
        """Cut sweeps or images into chunks of about the same path length.

        Results do not depend on where a drive is cut: each frame is made of the same others.

        Parameters
        ----------
        items : sequence
            In order of time.
        arc : ndarray of float64, shape (n,)
            Path length at each, ascending [m].

        Returns
        -------
        list of list
            One chunk where this process works alone.
        """
        if len(items) < 2 or not self.are_elsewhere:
            return [list(items)] if items else []
        measure = arc - arc[0] + _A_SWEEP * np.arange(len(items))
        count = self.count * math.ceil(measure[-1] / (self.count * _LONGEST))
        count = max(min(count, int(measure[-1] // _SHORTEST)), 1)
        number = (count * measure / (measure[-1] + _A_SWEEP)).astype(np.int64)
        borders = [0, *(np.flatnonzero(np.diff(number)) + 1).tolist(), len(items)]
        return [list(items[begin:end]) for begin, end in itertools.pairwise(borders)]

    def each(
        self,
        run: RunFolder,
        work: Work[_Item, _Result],
        chunks: Sequence[_Item],
        watch: Stopwatch,
        told: Callable[[int], None],
        size: Callable[[_Item], int] = len,  # type: ignore[assignment]
    ) -> Iterator[tuple[int, _Result]]:
        """Have some work done on each chunk.

        Parameters
        ----------
        run : RunFolder
        work : callable
            See :data:`Work`.
        chunks : sequence
        watch : Stopwatch
            Takes the seconds of all workers.
        told : callable
            Called with the number of frames that are done, of all chunks together.
        size : callable
            Number of frames of a chunk.

        Yields
        ------
        number, result
            Of each chunk, as they get done.
        """

        def tell(before: int, more: int) -> None:
            told(before + more)

        done = 0
        alone = len(chunks) == 1 and self._scheduler is None
        if alone or not self.are_elsewhere:
            for number, chunk in enumerate(chunks):
                yield number, work(Worker(run, self.threads, watch, partial(tell, done)), chunk)
                done += size(chunk)
            return
        run.remove_tree(run.parts)  # what dead workers left
        threads = self.threads_each(len(chunks))
        tasks = [_Task(run, work, chunk, threads) for chunk in chunks]
        try:
            for number, out in self.results(tasks):
                run.take(out.files)
                watch.add(out.seconds, out.peak_memory_mb)
                for text in out.warnings:
                    log.warning("%s", text)
                done += size(chunks[number])
                told(done)
                yield number, out.result
        finally:
            run.remove_tree(run.parts)

    def threads_each(self, chunks: int) -> int:
        """Threads of a worker, where there are so many chunks."""
        if self._client is not None:
            return max(self.threads, 1)
        return max(thread_count(self.threads) // min(self.jobs, max(chunks, 1)), 1)

    def results(self, tasks: Sequence[Callable[[], _Result]]) -> Iterator[tuple[int, _Result]]:
        """Number and result of each task, as they get done.

        A task whose worker dies is done again by another one.

        Raises
        ------
        RunError
            Workers die again and again, or the scheduler is gone.
        """
        left, vain = dict(enumerate(tasks)), 0
        while left:
            before, queue = len(left), deque(left.items())
            futures: dict[Future[_Result], int] = {}
            try:
                while queue or futures:
                    self._hand_over(queue, futures)
                    for future in wait(futures, return_when=FIRST_COMPLETED).done:
                        number = futures.pop(future)
                        try:
                            result = future.result()
                        except BrokenExecutor:
                            continue
                        except Exception as error:
                            self._explain(error)
                            raise
                        del left[number]
                        yield number, result
            finally:
                for future in futures:
                    future.cancel()
            if left:
                vain = vain + 1 if len(left) == before else 0
                self._end_pool(at_once=True)
                if vain == _VAIN:
                    raise RunError(_DIE_AGAIN)
                log.warning("a worker has died; what it had in hand is done again by another one")

    def _hand_over(
        self,
        queue: deque[tuple[int, Callable[[], _Result]]],
        futures: dict[Future[_Result], int],
    ) -> None:
        """Give workers the next tasks, as many as they need to have no pause.

        A task holds all that its chunk needs, so those of a whole drive would fill the memory.
        """
        most = _TASKS_AHEAD * self.count
        try:
            while queue and len(futures) < most:
                futures[self._executor().submit(queue[0][1])] = queue[0][0]
                queue.popleft()
        except BrokenExecutor:
            queue.clear()  # new workers do the rest

    def _explain(self, error: Exception) -> None:
        """Raise what an error of Dask's own means.

        Raises
        ------
        RunError
        """
        if isinstance(error, CancelledError):
            raise RunError(
                f"the scheduler at {self._scheduler} is gone; start it again and run the same "
                "command again; it continues where it stopped"
            ) from error
        if type(error).__name__ == "KilledWorker":
            raise RunError(_DIE_AGAIN) from error
        if isinstance(error, ModuleNotFoundError) and error.name == "docdepth":
            raise RunError("a worker of the cluster has no docdepth; install it there") from error

    def _executor(self) -> Executor:
        if self._pool is None and self._client is not None:
            self._pool = self._client.get_executor(pure=False)
        elif self._pool is None:
            context = multiprocessing.get_context("spawn")
            theirs, self._lifeline = context.Pipe(duplex=False)
            self._pool = ProcessPoolExecutor(self.jobs, context, _begin, (theirs,))
        return self._pool

    def _end_pool(self, at_once: bool) -> None:
        pool, lifeline = self._pool, self._lifeline
        self._pool = self._lifeline = None
        if lifeline is not None and at_once:
            lifeline.close()
        if pool is not None:
            pool.shutdown(wait=self._client is None)
        if lifeline is not None:
            lifeline.close()


_DIE_AGAIN = (
    "workers die again and again before they are done: they may need more memory than there is, so "
    "give fewer --jobs, or workers with more memory; a script that calls docdepth.run with jobs "
    'needs the line if __name__ == "__main__":'
)


@dataclass(frozen=True)
class _Done(Generic[_Result]):
    """What a worker hands over."""

    result: _Result
    files: list[HandedFile]
    seconds: dict[str, float]
    peak_memory_mb: int
    warnings: list[str]


@dataclass(frozen=True)
class _Task(Generic[_Item, _Result]):
    """Work on a chunk, as it travels to a worker."""

    run: RunFolder
    work: Work[_Item, _Result]
    chunk: _Item
    threads: int
    version: str = __version__

    @property
    def __name__(self) -> str:
        """For the dashboard."""
        return str(getattr(self.work, "__name__", None) or self.work.func.__name__).strip("_")  # type: ignore[attr-defined]

    def __call__(self) -> _Done[_Result]:
        if self.version != __version__:
            raise RunError(
                f"{socket.gethostname()} has docdepth {__version__}, not {self.version} as where "
                "the run was started; install the same everywhere"
            )
        if not self.run.notes.is_dir():
            raise RunError(
                f"{socket.gethostname()} does not see {self.run.path}; the run folder must lie on "
                "a disk that all workers share, under the same path"
            )
        watch = Stopwatch()
        with recorded_warnings() as warnings:
            worker = Worker(self.run, self.threads, watch, lambda done: None)
            result = self.work(worker, self.chunk)
        files = self.run.handed or []
        return _Done(result, files, watch.seconds, watch.peak_memory_mb(), warnings)


def _begin(lifeline: Connection) -> None:
    """A process of this machine begins: it ends when the one that started it does."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for that one

    def wait_for_the_end() -> None:
        with suppress(EOFError, OSError):
            lifeline.recv()
        os._exit(1)

    threading.Thread(target=wait_for_the_end, daemon=True).start()


def _client(address: str) -> Any:
    """A client of a Dask scheduler.

    Raises
    ------
    MissingExtraError
        Dask is not installed.
    RunError
        There is no scheduler at the address.
    """
    try:
        from distributed import Client
    except ImportError as error:
        raise MissingExtraError(
            f"--scheduler needs Dask ({error}): pip install 'docdepth[cluster]'"
        ) from None
    try:
        client = Client(address, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise RunError(
            f"there is no Dask scheduler at {address} ({error}); start one: dask scheduler"
        ) from None
    if not client.nthreads():
        log.warning("the scheduler at %s has no worker yet; the work waits for one", address)
    return client
