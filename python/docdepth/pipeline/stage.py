"""What the stages of a run share: their state, their warnings and their profile."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any

from docdepth.concurrency import Timer
from docdepth.errors import Finding, log_findings
from docdepth.io.manifest import StageEntry
from docdepth.io.run_folder import RunFolder, stage_key

log = logging.getLogger(__name__)


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
    timer : Timer
    frames : int
        Frames that this command worked on; an earlier one may have done the others.
    share : float
        Of the timer's seconds, where stages share one.
    more : dict
        Further entries of the stage in run.yaml.
    findings : list of Finding
        What looks wrong with the results.
    """

    def __init__(self) -> None:
        self.timer, self.frames, self.share = Timer(), 0, 1.0
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
        wall = self.share * self.timer.wall()
        return {
            "frames": self.frames,
            "wall_seconds": round(wall, 3),
            "seconds": {name: round(self.share * s, 3) for name, s in self.timer.seconds.items()},
            "total_frames": before.total_frames + self.frames,
            "total_seconds": round(before.total_seconds + wall, 3),
            "peak_memory_mb": max(self.timer.peak_memory_mb(), before.peak_memory_mb),
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
