"""Progress: bars on a terminal, now and then a line in a log file."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bars

from docdepth.cli.terminal import err, volume
from docdepth.concurrency import Progress, null_progress

_PAUSE = 30.0  # a log file gets a line after so many seconds, or when a tenth more is done


@contextmanager
def progress_bars() -> Iterator[Progress]:
    """One progress bar per stage, with the time left; lines where output is no terminal."""
    if volume.quiet:
        yield null_progress
        return
    if not err.is_terminal:
        yield progress_lines()
        return
    columns = (
        TextColumn("{task.description:<12}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(elapsed_when_finished=True),
    )
    with Bars(*columns, console=err) as bars:
        tasks: dict[str, Any] = {}

        def tell(stage: str, done: int, total: int) -> None:
            if stage not in tasks:
                tasks[stage] = bars.add_task(stage, total=total)
            bars.update(tasks[stage], completed=done, total=total)

        yield tell


class progress_lines:
    """For log files: a line with the time taken, and an estimate of what is left.

    Parameters
    ----------
    clock : callable
        Seconds, from any moment on.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._began: dict[str, tuple[float, int]] = {}  # time and frames done at the first call
        self._told: dict[str, tuple[int, float]] = {}  # tenths and time of the last line

    def __call__(self, stage: str, done: int, total: int) -> None:
        now, tenths = self._clock(), 10 * done // max(total, 1)
        start, before = self._began.setdefault(stage, (now, done))
        last_tenths, last = self._told.get(stage, (-1, now))
        if tenths == last_tenths and now - last < _PAUSE:
            return
        self._told[stage] = (tenths, now)
        line = f"{stage} {done}/{total}"
        if now - start >= 1:
            line += f", {duration(now - start)}"
        if before < done < total and now - start >= 1:
            left = (now - start) / (done - before) * (total - done)
            line += f", about {duration(left)} left"
        err.print(line, soft_wrap=True, markup=False)


def duration(seconds: float) -> str:
    """Seconds as ``0:07``, ``12:30`` or ``1:02:03``."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"
