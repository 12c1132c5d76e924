"""What the stages of a run share: their state, their progress and their profile."""

from __future__ import annotations

import logging
import re
import resource
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Lock
from typing import Any

from docdepth.errors import Finding, log_findings
from docdepth.io.manifest import StageEntry
from docdepth.io.run_folder import RunFolder, stage_key

log = logging.getLogger(__name__)

Progress = Callable[[str, int, int], None]
"""Called with the stage, how many frames are done and how many there are."""


class Stopwatch:
    """Seconds spent by name, for the profile in run.yaml; threads may share one."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._lock, self._most_elsewhere = Lock(), 0
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
            self.add({name: time.perf_counter() - start})

    def add(self, seconds: dict[str, float], peak_memory_mb: int = 0) -> None:
        """Count what was spent here, or by a worker in another process."""
        with self._lock:
            for name, spent in seconds.items():
                self.seconds[name] = self.seconds.get(name, 0.0) + spent
            self._most_elsewhere = max(self._most_elsewhere, peak_memory_mb)

    def peak_memory_mb(self) -> int:
        """The most memory of this process so far, or of a worker that was added."""
        return max(_peak_memory() >> 20, self._most_elsewhere)


def _peak_memory() -> int:
    """The most memory of this process so far, in bytes."""
    # Into ru_maxrss Linux counts what the caller held before it started this program; a sandbox
    # may have nothing else.
    status = Path("/proc/self/status")
    found = re.search(r"VmHWM:\s+(\d+) kB", status.read_text()) if status.is_file() else None
    if found:
        return int(found[1]) << 10
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return most if sys.platform == "darwin" else most << 10


@contextmanager
def stage(run: RunFolder, name: str, parts: dict[str, Any], all_frames: int) -> Iterator[Profile]:
    """A stage of a run that has something to do.

    Its parameters, and what else it is made of, are noted in run.yaml when it begins. When it ends,
    so is its profile. Findings are kept there, and notices that docdepth logs meanwhile.

    Parameters
    ----------
    run : RunFolder
    name : str
    parts : dict
        What the stage's results are made of; see :mod:`docdepth.pipeline.graph`.
    all_frames : int
        Sweeps or images of the stage.
    """
    before = run.stage(name)
    key = stage_key(parts)
    if before.key != key:
        before = StageEntry()
    begun = {"state": "running", "key": key, "all_frames": all_frames}
    run.manifest.stages[name] = before.model_copy(update=begun)
    run.save()
    run.set_made_of(name, parts)
    profile = Profile()
    with recorded_warnings() as warnings:
        try:
            yield profile
        except BaseException:
            run.set_stage(name, **profile.state(before, warnings))
            raise
    run.set_stage(name, state="done", **profile.state(before, warnings))


class Profile:
    """What a stage took.

    Attributes
    ----------
    watch : Stopwatch
    frames : int
        Frames that this command worked on; an earlier one may have done the others.
    share : float
        Of the watch's seconds, where stages share one.
    more : dict
        Further entries of the stage in run.yaml.
    findings : list of Finding
        What looks wrong with the results.
    """

    def __init__(self) -> None:
        self.watch, self.frames, self.share = Stopwatch(), 0, 1.0
        self.more: dict[str, object] = {}
        self.findings: list[Finding] = []

    def add(self, findings: Iterable[Finding]) -> None:
        """Keep findings of a check, and log them."""
        known = list(findings)
        log_findings(log, known)
        self.findings += known

    def state(self, before: StageEntry, notices: list[str]) -> dict[str, Any]:
        """Entries of the stage, those of earlier commands added."""
        found = map(str, self.findings)
        wall = self.share * self.watch.wall()
        return {
            "frames": self.frames,
            "wall_seconds": round(wall, 3),
            "seconds": {name: round(self.share * s, 3) for name, s in self.watch.seconds.items()},
            "total_frames": before.total_frames + self.frames,
            "total_seconds": round(before.total_seconds + wall, 3),
            "peak_memory_mb": max(self.watch.peak_memory_mb(), before.peak_memory_mb),
            "warnings": list(dict.fromkeys([*before.warnings, *found, *notices])),
            **self.more,
        }


@contextmanager
def recorded_warnings() -> Iterator[list[str]]:
    """The warnings that docdepth logs meanwhile."""
    found: list[str] = []
    handler = logging.Handler(logging.WARNING)
    handler.emit = lambda record: found.append(record.getMessage())  # type: ignore[method-assign]
    logger = logging.getLogger("docdepth")
    logger.addHandler(handler)
    try:
        yield found
    finally:
        logger.removeHandler(handler)


def is_outdated(made_of: dict[str, str], key: dict[str, str]) -> bool:
    """Whether the record of a file names another key of the same stage."""
    return any(made_of.get(stage, value) != value for stage, value in key.items())


def progress_callback(progress: Progress | None, stage: str) -> Callable[[int, int], None]:
    """``progress`` of one stage, called with the frames done and their number."""

    def call(done: int, total: int) -> None:
        if progress:
            progress(stage, done, total)

    return call
