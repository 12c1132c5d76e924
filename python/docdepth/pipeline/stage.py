"""What the stages of a run share: what is done already, how far one is, where its time goes."""

from __future__ import annotations

import resource
import sys
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future
from contextlib import contextmanager
from threading import Lock
from typing import TypeVar

from docdepth.io.run_folder import RunFolder

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")

Progress = Callable[[str, int, int], None]
"""Called with the stage, how many frames are done and how many there are."""


class Stopwatch:
    """Seconds spent by name, for the profile in run.yaml; names may run side by side."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._lock = Lock()
        self._start = time.perf_counter()

    def wall(self) -> float:
        """Seconds since the stage began."""
        return time.perf_counter() - self._start

    @contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        start = time.perf_counter()
        try:
            yield
        finally:
            spent = time.perf_counter() - start
            with self._lock:
                self.seconds[name] = self.seconds.get(name, 0.0) + spent


def stage_is_done(run: RunFolder, stage: str, key: str) -> bool:
    """Has the stage been finished with these parameters?"""
    state = run.stage(stage)
    return bool(state.get("state") == "done" and state.get("key") == key)


def finish_stage(run: RunFolder, stage: str, watch: Stopwatch, frames: int, **more: object) -> None:
    """Mark a stage as done; ``frames`` were worked on in these seconds, others before."""
    before = run.stage(stage)
    kilobytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    peak = kilobytes // 1024 if sys.platform != "darwin" else kilobytes // 1024**2
    run.set_stage(
        stage,
        state="done",
        frames=frames,
        wall_seconds=round(watch.wall(), 3),
        seconds={name: round(s, 3) for name, s in watch.seconds.items()},
        peak_memory_mb=max(peak, before.get("peak_memory_mb", 0)),
        **more,
    )


def progress_callback(progress: Progress | None, stage: str) -> Callable[[int, int], None]:
    """``progress`` for one stage."""

    def tell(done: int, total: int) -> None:
        if progress:
            progress(stage, done, total)

    return tell


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
