"""What the stages of a run share: their state, their progress and their profile."""

from __future__ import annotations

import resource
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Lock

from docdepth.io.run_folder import RunFolder

Progress = Callable[[str, int, int], None]
"""Called with the stage, how many frames are done and how many there are."""


class Stopwatch:
    """Seconds spent by name, for the profile in run.yaml; threads may share one."""

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
    """Whether the stage was finished with these parameters."""
    state = run.stage(stage)
    return bool(state.get("state") == "done" and state.get("key") == key)


def finish_stage(run: RunFolder, stage: str, watch: Stopwatch, frames: int, **more: object) -> None:
    """Mark a stage as done, with its profile.

    Parameters
    ----------
    frames : int
        Frames that this run of the stage worked on; an earlier one may have done the others.
    more
        Further entries of the stage in run.yaml.
    """
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
    """``progress`` of one stage, called with the frames done and their number."""

    def call(done: int, total: int) -> None:
        if progress:
            progress(stage, done, total)

    return call
