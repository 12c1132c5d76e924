"""Parallel work of a stage: chunks of the drive, by this process, local processes or Dask.

A stage writes its work as a function of a :class:`ChunkContext` and a chunk. This process calls it
with the whole drive as one chunk, or workers call it with parts of the drive. All workers must see
the run folder; this process alone names and records what they write
(:class:`docdepth.io.recorded_folder.RecordedFolder`).
"""

from __future__ import annotations

import itertools
import logging
import math
import multiprocessing
import os
import re
import signal
import socket
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Executor, ProcessPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from multiprocessing.connection import Connection
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from docdepth._core import __version__
from docdepth.concurrency import Timer, map_unordered, thread_count
from docdepth.errors import MissingExtraError, RunError
from docdepth.io.recorded_folder import StagedFile
from docdepth.io.run_folder import RunFolder
from docdepth.pipeline.stage import recorded_warnings

log = logging.getLogger(__name__)

_LONGEST, _SHORTEST = 200.0, 20.0
"""Length of chunks [m]. The surroundings of a border, up to the radius of the coarse key frames,
are processed twice; a worker that dies loses its chunk."""

_PATH_PER_FRAME = 0.5
"""Cost of one frame in metres of path, so that a standing vehicle is split as well [m]."""

_TASKS_PER_WORKER = 2
"""Tasks that each worker has in hand or next. A task holds all that its chunk needs, so those of a
whole drive would fill the memory."""

_ANSWERS_WITHIN = 10.0
"""A scheduler begins to speak as soon as somebody calls [s]."""

_LONGEST_GREETING = 1 << 20  # bytes

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


@dataclass(frozen=True)
class ChunkContext:
    """What the work on a chunk gets."""

    run: RunFolder
    threads: int  # 0 for all cores
    timer: Timer
    # to be called with the number of frames of the chunk that are done
    progress: Callable[[int], None]


ChunkWork = Callable[[ChunkContext, _Item], _Result]
"""Work on a chunk: a function of a module, or a ``partial`` of one, so that it can be pickled."""


class WorkerPool:
    """Who does the work of a run: this process alone, local processes, or a Dask cluster.

    Workers start and end with a ``with`` block.

    Parameters
    ----------
    threads : int
        Of this process, or of all processes of this machine together; 0 for all cores. Of each
        worker of a cluster; 0 for one.
    scheduler : str, optional
        Address of a Dask scheduler, whose workers do the work.

    Attributes
    ----------
    inline : bool
        Whether this process does the work.
    """

    def __init__(self, threads: int = 0, jobs: int = 1, scheduler: str | None = None) -> None:
        self.threads, self.jobs, self.scheduler = threads, jobs, scheduler
        self.inline = scheduler is None and jobs == 1
        self._client: Any = None
        self._executor: Executor | None = None
        self._lifeline: Connection | None = None

    def __enter__(self) -> WorkerPool:
        if self.scheduler is not None:
            self._client = _connect(self.scheduler)
            self._executor = self._client.get_executor(pure=False)
        elif self.jobs > 1:
            context = multiprocessing.get_context("spawn")
            theirs, self._lifeline = context.Pipe(duplex=False)
            self._executor = ProcessPoolExecutor(self.jobs, context, _start_worker, (theirs,))
        return self

    def __exit__(self, kind: type[BaseException] | None, *rest: object) -> None:
        if self._lifeline is not None and kind is not None:
            self._lifeline.close()  # local workers end at once
        if self._executor is not None:
            self._executor.shutdown(wait=self._client is None)
        if self._lifeline is not None:
            self._lifeline.close()
        if self._client is not None:
            self._client.close()
        self._client = self._executor = self._lifeline = None

    @property
    def count(self) -> int:
        """How many chunks are worked on at the same time."""
        if self._client is None:
            return self.jobs
        return max(sum(self._client.nthreads().values()), 1)

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
        if len(items) < 2 or self.inline:
            return [list(items)] if items else []
        measure = arc - arc[0] + _PATH_PER_FRAME * np.arange(len(items))
        count = self.count * math.ceil(measure[-1] / (self.count * _LONGEST))
        count = max(min(count, int(measure[-1] // _SHORTEST)), 1)
        number = (count * measure / (measure[-1] + _PATH_PER_FRAME)).astype(np.int64)
        borders = [0, *(np.flatnonzero(np.diff(number)) + 1).tolist(), len(items)]
        return [list(items[begin:end]) for begin, end in itertools.pairwise(borders)]

    def threads_each(self, tasks: int) -> int:
        """Threads of a worker, where there are so many tasks."""
        if self.scheduler is not None:
            return max(self.threads, 1)
        return max(thread_count(self.threads) // min(self.jobs, max(tasks, 1)), 1)

    def map_frames(
        self,
        run: RunFolder,
        work: ChunkWork[_Item, _Result],
        chunks: Sequence[_Item],
        timer: Timer,
        progress: Callable[[int], None],
        size: Callable[[_Item], int] = len,  # type: ignore[assignment]
    ) -> Iterator[tuple[int, _Result]]:
        """Do the work on each chunk of frames.

        Parameters
        ----------
        work : callable
            See :data:`ChunkWork`.
        timer : Timer
            Takes the seconds of all workers.
        progress : callable
            Called with the number of frames that are done, of all chunks together.
        size : callable
            Number of frames of a chunk.

        Yields
        ------
        number, result
            Of each chunk, as they are done.
        """

        def report(before: int, more: int) -> None:
            progress(before + more)

        done = 0
        if self.inline or (len(chunks) == 1 and self.scheduler is None):
            for number, chunk in enumerate(chunks):
                context = ChunkContext(run, self.threads, timer, partial(report, done))
                yield number, work(context, chunk)
                done += size(chunk)
            return
        run.remove_tree(run.staging)  # of an interrupted command
        task = partial(_work_elsewhere, run, work, self.threads_each(len(chunks)), __version__)
        try:
            for number, out in self.map(task, chunks):
                run.commit(out.files)
                timer.add(out.seconds, out.peak_memory_mb)
                for text in out.warnings:
                    log.warning("%s", text)
                done += size(chunks[number])
                progress(done)
                yield number, out.result
        finally:
            run.remove_tree(run.staging)

    def map(
        self, task: Callable[[_Item], _Result], items: Sequence[_Item]
    ) -> Iterator[tuple[int, _Result]]:
        """Number and result of each item, as the workers are done with them."""
        assert self._executor is not None, "workers start with a with block"
        try:
            yield from map_unordered(self._executor, task, items, _TASKS_PER_WORKER * self.count)
        except BrokenExecutor as error:
            raise RunError(*_HAS_DIED) from error
        except CancelledError as error:
            raise RunError(
                f"the scheduler at {self.scheduler} is gone",
                "start it again and run the same command again; it continues where it stopped",
            ) from error
        except ModuleNotFoundError as error:
            if error.name == "docdepth":
                raise RunError("a worker of the cluster has no docdepth", "install it") from error
            raise
        except Exception as error:
            if type(error).__name__ == "KilledWorker":  # Dask has tried it on several workers
                raise RunError(*_HAS_DIED) from error
            raise


_HAS_DIED = (
    "a worker has died, perhaps because memory ran out",
    "run the same command again, with fewer `jobs` or workers with more memory, and it continues "
    'where it stopped (a script that asks for jobs needs the line if __name__ == "__main__":)',
)


@dataclass(frozen=True)
class _ChunkResult(Generic[_Result]):
    """What a worker returns."""

    result: _Result
    files: list[StagedFile]
    seconds: dict[str, float]
    peak_memory_mb: int
    warnings: list[str]


def _work_elsewhere(
    run: RunFolder, work: ChunkWork[_Item, _Result], threads: int, version: str, chunk: _Item
) -> _ChunkResult[_Result]:
    """Do the work on a chunk in a worker; ``version`` is that of the docdepth that asks for it."""
    if version != __version__:
        raise RunError(
            f"{socket.gethostname()} has docdepth {__version__}, not {version} as where the run "
            "was started",
            "install the same everywhere",
        )
    if not run.state_dir.is_dir():
        raise RunError(
            f"{socket.gethostname()} does not see {run.path}",
            "put the run folder on a disk that all workers share, under the same path",
        )
    timer = Timer()
    with recorded_warnings() as warnings:
        result = work(ChunkContext(run, threads, timer, lambda done: None), chunk)
    return _ChunkResult(result, run.staged or [], timer.seconds, timer.peak_memory_mb(), warnings)


def _start_worker(lifeline: Connection) -> None:
    """Make a local worker end when the process that has started it does."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for that process

    def wait_for_the_end() -> None:
        with suppress(EOFError, OSError):
            lifeline.recv()
        os._exit(1)

    threading.Thread(target=wait_for_the_end, daemon=True).start()


def _connect(address: str) -> Any:
    """Connect to a Dask scheduler."""
    try:
        from distributed import Client
    except ImportError as error:
        raise MissingExtraError(
            f"`scheduler` needs Dask ({error})", "pip install 'docdepth[cluster]'"
        ) from None
    try:
        _hear_from(address)
        client = Client(address, set_as_default=False)
    except Exception as error:  # of Dask, of the network, of what a stranger answers
        raise RunError(
            f"there is no Dask scheduler at {address} ({error})", "start one: dask scheduler"
        ) from None
    if not client.nthreads():
        log.warning("the scheduler at %s has no worker yet; the work waits for one", address)
    return client


def _hear_from(address: str) -> None:
    """Refuse an address at which Dask would wait for ever, or take memory for any greeting.

    A scheduler speaks first: eight bytes tell how many follow.
    """
    place = re.fullmatch(r"(?:tcp://)?\[?([^\]/]+?)\]?:(\d+)", address)
    if place is None:  # of another protocol, or no address: Dask says which
        return
    with socket.create_connection((place[1], int(place[2])), _ANSWERS_WITHIN) as caller:
        length = caller.makefile("rb").read(8)
        if not 8 < int.from_bytes(length, sys.byteorder) < _LONGEST_GREETING:
            raise OSError(f"it answers {length!r}, as no scheduler does")
