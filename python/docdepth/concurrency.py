"""Threads: how many there are, work that is done ahead of its use, and where its time goes."""

from __future__ import annotations

import os
import sys
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future
from contextlib import AbstractContextManager, nullcontext
from typing import TypeVar

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")

Watch = Callable[[str], AbstractContextManager[None]]
"""``with watch("vote"):`` adds the seconds of its block to those of that name."""


def unwatched(name: str) -> AbstractContextManager[None]:
    """A watch for callers that ask for no times."""
    return nullcontext()


def thread_count(threads: int) -> int:
    """``threads`` itself, or the number of cores that this process may use when it is 0."""
    if threads > 0:
        return threads
    return len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1


def prefetch(
    pool: Executor, make: Callable[[_Item], _Result], items: Iterable[_Item], count: int = 2
) -> Iterator[_Result]:
    """``map`` that makes no more than ``count`` results before they are asked for."""
    waiting: deque[Future[_Result]] = deque()
    for item in items:
        waiting.append(pool.submit(make, item))
        if len(waiting) > count:
            yield waiting.popleft().result()
    while waiting:
        yield waiting.popleft().result()
