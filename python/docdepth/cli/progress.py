"""Progress of a verb: one bar, or lines in a log file, with the time taken and left."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.progress import BarColumn, ProgressColumn, Task, TextColumn
from rich.progress import Progress as Bars
from rich.text import Text

from docdepth.cli.terminal import err, say, volume
from docdepth.concurrency import Progress, null_progress

_COST = {
    "register": 210.0,
    "odometry": 60.0,
    "ground": 150.0,
    "classify": 170.0,
    "track": 20.0,
    "render": 450.0,
    "camera": 50.0,
}
"""Steps of a run in order, each with what a sweep or image takes [ms]. Only their ratio counts; it
is that of an HDL-64 on two cores."""

_PAUSE = 30.0
"""A log file gets a line after so many seconds, or when a tenth more is done."""


class ProgressEstimate:
    """How much is done, and how long the rest takes, from calls of :class:`Progress`.

    The steps of a run are one work, any other step is one by itself. A step that comes again, as
    for the next recording, begins a new work.

    Attributes
    ----------
    share : float
        Of the whole, 0 to 1.
    seconds : float
        Since the work began.
    left : float, optional
        Seconds to its end; None as long as nothing tells.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._steps: tuple[str, ...] = ()
        self._step = ""
        self.share, self.seconds = 0.0, 0.0
        self.left: float | None = None

    def take(self, step: str, done: int, total: int) -> bool:
        """Take what a step tells; whether a new work begins."""
        now, steps = self._clock(), tuple(_COST) if step in _COST else (step,)
        begins = steps != self._steps or steps.index(step) < steps.index(self._step)
        if begins:
            self._steps, self._start = steps, now
            self._before: dict[str, int] = {}
            self._done: dict[str, int] = {}
            self._totals: dict[str, int] = {}
        self._step = step
        self._before.setdefault(step, done)
        self._done[step], self._totals[step] = done, total
        self.seconds = now - self._start
        self._estimate()
        return begins

    def _estimate(self) -> None:
        count = next(iter(self._totals.values()))  # of steps that have not begun
        costs = {one: _COST.get(one, 1.0) for one in self._steps}
        whole = sum(cost * self._totals.get(one, count) for one, cost in costs.items())
        made = sum(costs[one] * (self._done[one] - self._before[one]) for one in self._done)
        later = self._steps[self._steps.index(self._step) + 1 :]
        rest = costs[self._step] * (self._totals[self._step] - self._done[self._step])
        rest += sum(costs[one] * count for one in later)
        self.share = 1 - rest / whole if whole else 1.0
        self.left = self.seconds / made * rest if made else None


@contextmanager
def progress_bars() -> Iterator[Progress]:
    """A bar with the time left for the whole work; lines where output is no terminal."""
    if volume.quiet:
        yield null_progress
        return
    if not err.is_terminal:
        yield progress_lines()
        return
    columns = TextColumn("{task.description:<22}"), BarColumn(), _Times()
    with Bars(*columns, console=err) as bars:
        work = ProgressEstimate()

        def tell(step: str, done: int, total: int) -> None:
            if work.take(step, done, total):
                bars.add_task(step, total=1.0)
            task = bars.tasks[-1]
            text = f"{step} {done}/{total}"
            bars.update(task.id, completed=work.share, description=text, times=_times(work))

        yield tell


class _Times(ProgressColumn):
    """Share, time taken and time left."""

    def render(self, task: Task) -> Text:
        return Text(f"{task.percentage:3.0f} %{task.fields.get('times', '')}")


def _times(work: ProgressEstimate) -> str:
    """``, 0:06, about 0:04 left``; nothing in the first second."""
    if work.seconds < 1:
        return ""
    left = f", about {duration(work.left)} left" if work.left else ""
    return f", {duration(work.seconds)}{left}"


def progress_lines(clock: Callable[[], float] = time.monotonic) -> Progress:
    """For log files: a line with the time taken, and an estimate of what is left."""
    work = ProgressEstimate(clock)
    last_step, last_tenths, last = "", -1, 0.0

    def tell(step: str, done: int, total: int) -> None:
        nonlocal last_step, last_tenths, last
        begins = work.take(step, done, total)
        tenths = int(10 * work.share)
        is_near = tenths == last_tenths and work.seconds - last < _PAUSE
        if is_near and step == last_step and not begins:
            return
        last_step, last_tenths, last = step, tenths, work.seconds
        say(f"{step} {done}/{total}{_times(work)}", to=err)

    return tell


def duration(seconds: float) -> str:
    """Seconds as ``0:07``, ``12:30`` or ``1:02:03``."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"
