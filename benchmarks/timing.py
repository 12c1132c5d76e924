"""Timing of functions that take turns, so that a slow moment of the machine hits all of them."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Mapping

Clock = Callable[[], float]


def seconds(work: Callable[[], object], clock: Clock = time.perf_counter) -> float:
    """Duration of one call [s]."""
    start = clock()
    work()
    return clock() - start


def interleaved(
    jobs: Mapping[str, Callable[[], object]],
    repeat: int,
    clocks: Mapping[str, Clock] | None = None,
) -> dict[str, float]:
    """Median duration of each job [s]; jobs take turns ``repeat`` times.

    Parameters
    ----------
    jobs : mapping of str to callable
    repeat : int
        Calls of each job.
    clocks : mapping of str to callable, optional
        Clock of each job; wall time by default.
    """
    clocks = clocks or {}
    spent: dict[str, list[float]] = {name: [] for name in jobs}
    for _ in range(repeat):
        for name, work in jobs.items():
            spent[name].append(seconds(work, clocks.get(name, time.perf_counter)))
    return {name: statistics.median(times) for name, times in spent.items()}
