"""What parallel work shares: threads, bounded queues, progress and times.

Wherever a function takes ``threads``, 0 is all cores, and its result does not depend on them.
"""

from __future__ import annotations

import itertools
import os
import re
import resource
import sys
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from contextlib import contextmanager
from pathlib import Path
from threading import Lock
from typing import Protocol, SupportsIndex, TypeVar, runtime_checkable

from docdepth.errors import InputError

MOST_THREADS = 256
"""Limit on threads: with many thousands a machine stands still."""

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


@runtime_checkable
class Progress(Protocol):
    """Called with a stage, how many of its frames are done, and how many there are."""

    def __call__(self, stage: str, done: int, total: int, /) -> None: ...


def null_progress(stage: str, done: int, total: int, /) -> None:
    """Ignore progress."""


class Timer:
    """Seconds spent by name: ``with timer("vote"): ...``. Threads may share one."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._lock, self._peak_elsewhere = Lock(), 0
        self._start = time.perf_counter()

    @contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        start = time.perf_counter()
        try:
            yield
        finally:
            self.add({name: time.perf_counter() - start})

    def add(self, seconds: dict[str, float], peak_memory_mb: int = 0) -> None:
        """Add what this process, or a worker in another one, has spent."""
        with self._lock:
            for name, spent in seconds.items():
                self.seconds[name] = self.seconds.get(name, 0.0) + spent
            self._peak_elsewhere = max(self._peak_elsewhere, peak_memory_mb)

    def wall(self) -> float:
        """Seconds since the timer was made."""
        return time.perf_counter() - self._start

    def peak_memory_mb(self) -> int:
        """Peak memory of this process so far, or of a worker that was added."""
        return max(_peak_memory() >> 20, self._peak_elsewhere)


def _peak_memory() -> int:
    """Peak memory of this process so far, in bytes."""
    # On Linux ru_maxrss includes what the caller held before it started this program; a sandbox
    # may have nothing else.
    status = Path("/proc/self/status")
    found = re.search(r"VmHWM:\s+(\d+) kB", status.read_text()) if status.is_file() else None
    if found:
        return int(found[1]) << 10
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return most if sys.platform == "darwin" else most << 10


def thread_count(threads: int) -> int:
    """``threads`` itself, or the number of cores that this process may use when it is 0."""
    if not isinstance(threads, SupportsIndex) or not 0 <= threads.__index__() <= MOST_THREADS:
        raise InputError(f"threads is {threads!r}: 0 (all cores) to {MOST_THREADS}")
    if threads:
        return threads.__index__()
    return len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1


def prefetch(
    executor: Executor, make: Callable[[_Item], _Result], items: Iterable[_Item], count: int = 2
) -> Iterator[_Result]:
    """Results in order, of which at most ``count`` are made before they are asked for."""
    waiting: deque[Future[_Result]] = deque()
    for item in items:
        waiting.append(executor.submit(make, item))
        if len(waiting) > count:
            yield waiting.popleft().result()
    while waiting:
        yield waiting.popleft().result()


def map_unordered(
    executor: Executor, make: Callable[[_Item], _Result], items: Iterable[_Item], count: int
) -> Iterator[tuple[int, _Result]]:
    """Number and result of each item, as they are done; at most ``count`` are submitted at once."""
    queue, futures = enumerate(items), dict[Future[_Result], int]()
    try:
        while True:
            for number, item in itertools.islice(queue, count - len(futures)):
                futures[executor.submit(make, item)] = number
            if not futures:
                return
            for future in wait(futures, return_when=FIRST_COMPLETED).done:
                yield futures.pop(future), future.result()
    finally:
        for future in futures:
            future.cancel()
