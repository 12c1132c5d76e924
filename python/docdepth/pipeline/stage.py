"""A stage of a run: what its results are made of, which files they are, and in which state.

A stage is a value. Its key is a hash of its inputs: a version, parameters, the identity of the
files that it reads, and the key of the stage before it. The record of each file that a stage writes
names this key, so the state of the stage follows from its files alone.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

from docdepth.concurrency import Timer
from docdepth.errors import Finding, log_findings
from docdepth.io.manifest import StageEntry
from docdepth.io.run_folder import RunFolder, stage_key

log = logging.getLogger(__name__)

State = Literal["done", "out of date", "incomplete", "damaged", "missing"]

StageInputs = Mapping[str, object]
"""What the results of a stage are made of, as plain values."""


@dataclass(frozen=True)
class StageState:
    """State of a stage of a run."""

    name: str  # ``odometry``, ``classify`` or ``render CAMERA``
    # ``done``; ``out of date``: made of other parameters or inputs; ``incomplete``: some files are
    # not there; ``damaged``: some files differ from what was written; ``missing``: nothing is there
    state: State
    why: str  # the reason, if it is not done
    # frames, all_frames: sweeps or images that are done, and all of them
    frames: int
    all_frames: int
    size: int = 0  # bytes of its files
    seconds: float = 0.0  # that it took in all, over all commands

    def as_dict(self) -> dict[str, object]:
        """All values by name, ready for JSON."""
        return dict(vars(self))


@dataclass(frozen=True)
class FrameOutputs:
    """The files that a stage writes for one sweep or image."""

    files: Sequence[Path]
    # what the records of these files name beside the key of the stage: the identity of an image
    made_of: Mapping[str, str] = field(default_factory=dict)
    source: str = ""  # file that ``made_of`` identifies, for messages
    index: int = 0  # of the image in its camera


@dataclass(frozen=True)
class Stage:
    """A stage of a run."""

    run: RunFolder
    name: str  # ``odometry``, ``classify``, or ``render CAMERA``
    # what its results are made of. The entry with the name of another stage is the key of that
    inputs: StageInputs
    # of each sweep or image. No files where the run has deleted them since
    frames: Sequence[FrameOutputs]
    once: Sequence[Path] = ()  # files of the stage as a whole
    folders: Sequence[Path] = ()  # where files of this stage that are out of date may lie
    previous: Stage | None = None  # the stage that it reads from
    # what the records of some files of the stage name beside, such as the layers of an image. Files
    # whose records do not name it do not depend on it
    also: Mapping[str, str] = field(default_factory=dict)
    # by input: the reason to give if it has changed; its values are told where there is none
    reasons: Mapping[str, str] = field(default_factory=dict)
    # called when the stage begins: keeps what is known of the files that it reads
    save_inputs: Callable[[], None] = lambda: None

    @cached_property
    def key(self) -> str:
        """Hash of the inputs."""
        return stage_key(self.inputs)

    @cached_property
    def made_of(self) -> dict[str, str]:
        """What the records of its files name."""
        return {self.name.partition(" ")[0]: self.key}

    def left(self) -> list[int]:
        """Frames whose files are missing, damaged or made of something else."""
        return [
            k
            for k, of in enumerate(self.frames)
            if not all(self._agrees(self.run.key(file), of.made_of) for file in of.files)
        ]

    def _agrees(self, key: Mapping[str, str], more: Mapping[str, str] | None = None) -> bool:
        """Whether the record of a file names what the stage is made of now."""
        made_of = {**self.made_of, **(more or {})}
        return made_of.items() <= key.items() and self._is_wanted(key)

    def _is_wanted(self, key: Mapping[str, str]) -> bool:
        return all(key.get(name, value) == value for name, value in self.also.items())

    def is_made_once(self) -> bool:
        """Whether the files of the stage as a whole are whole and up to date."""
        return all(self._agrees(self.run.key(file)) for file in self.once)

    def remove_outdated(self) -> None:
        """Delete files that were made of something else, and of frames that are no more."""
        for folder in self.folders:
            remove_others(self.run, folder, {**self.made_of, **self.also})

    def state(self, verify: bool = False) -> StageState:
        """Compare all files with their records.

        Parameters
        ----------
        verify : bool
            Compare the content of each file with its checksum, not only size and time.
        """
        run, size, done, changed = self.run, 0, list[bool](), list[str]()
        damaged: list[str] = []
        missing: list[str] = []
        unwanted = False
        for outputs in (*self.frames, FrameOutputs(self.once)):
            is_whole = same = True
            for file in outputs.files:
                records = run.records(file.parent)
                state, key = records.state(file.name, verify), records.recorded_key(file.name)
                same &= outputs.made_of.items() <= key.items()
                size += records.size(file.name)
                if state != "whole" or not self._agrees(key):
                    is_whole = False
                    unwanted |= not self._is_wanted(key)
                    name = file.relative_to(run.path).as_posix()
                    (damaged if state == "damaged" else missing).append(name)
            done.append(is_whole and same)
            if is_whole and not same:
                changed.append(outputs.source)
        complete, whole = done.pop(), sum(done)
        entry, all_frames = run.stage(self.name), len(self.frames)
        if all_frames and complete and whole == all_frames:
            deleted = not self.frames[0].files
            found: tuple[State, str] = "done", _WERE_DELETED if deleted else ""
        elif entry.key is None:
            found, whole = ("missing", "it was not made yet"), 0
        elif entry.key != self.key:
            found = "out of date", self._why_outdated()
        elif unwanted:
            found = "out of date", f"other {' and '.join(self.also)} are asked for"
        elif damaged:
            found = "damaged", f"{damaged[0]} differs from what was written"
        elif entry.state == "running":
            found = "incomplete", "it was interrupted"
        elif changed and not missing:
            found = "out of date", f"{len(changed)} images have changed, {changed[0]} first"
        else:
            found = "incomplete", f"{(*missing, 'a file')[0]} is missing"
        return StageState(self.name, *found, whole, all_frames, size, entry.total_seconds)

    def _why_outdated(self) -> str:
        """Which input has changed."""
        before = self.run.stage_inputs(self.name)
        if not before:
            return "what it was made of is not known"
        for name, reason in self.reasons.items():
            if before.get(name) != self.inputs.get(name):
                return reason
        name, was, value = _first_difference(before, self.inputs)
        if self.previous is not None and name == self.previous.name:
            if self.run.stage_inputs(name) in (
                self.previous.inputs,
                before,
            ):  # someone has changed the state
                return f"{name} was made again"
            return f"{name} is out of date: {self.previous._why_outdated()}"
        if name == "version":
            return "an earlier version of docdepth made it"
        return f"{name} was {was}, is {value}"

    @contextmanager
    def working(self) -> Iterator[Profile]:
        """Work on the stage.

        Its inputs are noted when it begins, and its profile when it ends. Findings are kept there,
        and warnings that docdepth logs meanwhile.
        """
        run, before = self.run, self.run.stage(self.name)
        if before.key != self.key:
            before = StageEntry()
        begun = {"state": "running", "key": self.key, "all_frames": len(self.frames)}
        run.manifest.stages[self.name] = before.model_copy(update=begun)
        run.save()
        run.set_stage_inputs(self.name, dict(self.inputs))
        self.save_inputs()
        profile = Profile()
        with recorded_warnings() as warnings:
            try:
                yield profile
            except BaseException:
                run.set_stage(self.name, **profile.entries(before, warnings))
                raise
        run.set_stage(self.name, state="done", **profile.entries(before, warnings))


_WERE_DELETED = "its frames were deleted when all was done (`keep='results'`)"


@dataclass
class Profile:
    """What a stage took."""

    timer: Timer = field(default_factory=Timer)
    frames: int = 0  # frames that this command worked on; an earlier one may have done the others
    share: float = 1.0  # of the timer's seconds, where stages share one
    # further entries of the stage in run.yaml
    more: dict[str, object] = field(default_factory=dict)
    findings: list[Finding] = field(default_factory=list)  # what looks wrong with the results

    def add(self, findings: Iterable[Finding]) -> None:
        """Keep findings of a check, and log them."""
        known = list(findings)
        log_findings(log, known)
        self.findings += known

    def entries(self, before: StageEntry, notices: list[str]) -> dict[str, object]:
        """Entries of the stage in run.yaml, those of earlier commands added."""
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


def remove_others(run: RunFolder, folder: Path, made_of: Mapping[str, str]) -> None:
    """Delete the files of a folder whose records name another key of the same stage."""
    records = run.records(folder)
    for name in records.names():
        recorded = records.recorded_key(name)
        if any(recorded.get(stage, key) != key for stage, key in made_of.items()):
            run.remove(folder / name)
    records.compact()


def _first_difference(
    before: StageInputs, now: StageInputs, path: str = ""
) -> tuple[str, Any, Any]:
    """Dotted name of the first input that differs, and both values."""
    for name in {**before, **now}:
        was, value = before.get(name), now.get(name)
        if was != value:
            dotted = f"{path}{name}"
            if isinstance(was, dict) and isinstance(value, dict):
                return _first_difference(was, value, f"{dotted}.")
            return dotted, was, value
    return "", None, None
