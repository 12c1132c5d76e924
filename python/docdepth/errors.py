"""Errors and findings of docdepth: what is wrong, where, and what to do.

The class tells whose fault it is, as each docstring here says: whatever is missing, damaged or
contradicts itself raises the error of its kind. Docstrings of internal functions do not repeat it.

A remedy is a sentence. What it names of Python stands in backticks, as in ``leave it out by
`on_error='skip'```; the command line says it as an option or a command.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

NOTE = 25
"""Level of logging of what is unusual, but no problem: between INFO and WARNING."""


class DocDepthError(Exception):
    """Base class of all errors that docdepth raises.

    Parameters
    ----------
    text : str
        What is wrong: it names the file, the frame and the value.
    remedy : str
        What to do.
    code : str
        Kind of problem, for programs; that of the class if absent.
    """

    code = "error"

    def __init__(self, text: object = "", remedy: str = "", *, code: str = "") -> None:
        super().__init__(str(text))
        self.text, self.remedy = str(text), remedy
        self.code = code or type(self).code

    def __str__(self) -> str:
        return _sentence(self.text, self.remedy)

    def __reduce__(self) -> tuple[Any, ...]:
        # Of a worker's error another process makes a copy. Exception would call __init__ with the
        # message, which some classes below make themselves.
        return _copy, (type(self), self.args, vars(self))


def _copy(
    kind: type[DocDepthError], args: tuple[Any, ...], rest: dict[str, object]
) -> DocDepthError:
    error = kind.__new__(kind, *args)
    vars(error).update(rest)
    return error


def _sentence(text: str, remedy: str) -> str:
    if not text.endswith("?"):
        return "; ".join(part for part in (text, remedy) if part)
    return f"{text} {remedy[:1].upper()}{remedy[1:]}".rstrip()


class InputError(DocDepthError, ValueError):
    """An array has the wrong shape, dtype or content."""

    code = "input"


class DatasetError(DocDepthError):
    """A recording on disk is missing, truncated or inconsistent."""

    code = "dataset"


class CalibrationError(DocDepthError):
    """A camera or extrinsic calibration is missing or does not fit."""

    code = "calibration"


class ConfigError(DocDepthError):
    """A parameter is unknown or out of its range."""

    code = "config"


class OdometryError(DocDepthError):
    """Poses could not be computed or do not fit the sweeps."""

    code = "odometry"


class RunError(DocDepthError):
    """A run folder cannot be used as it is."""

    code = "run"


class DamagedFileError(RunError):
    """A file of a run is missing or damaged.

    Parameters
    ----------
    what : str
        What is wrong with it; empty if it is missing.
    """

    code = "damaged-file"

    def __init__(self, path: Path, what: str) -> None:
        found = f"is damaged ({what})" if what else "is missing"
        super().__init__(f"{path} {found}", "`docdepth.run(..., RUN)` makes it again")
        self.path, self.what = path, what


class BackendError(DocDepthError):
    """A renderer is unknown or cannot be used on this machine."""

    code = "renderer"


class MissingExtraError(DocDepthError, ImportError):
    """An optional dependency is not installed."""

    code = "missing-extra"


@dataclass(frozen=True)
class Finding:
    """Something that a check found in inputs or results.

    Attributes
    ----------
    code : str
        Kind of problem, for programs.
    subject : str
        What it is about: a camera, a recording, a file; empty where the text names it.
    text : str
        What is wrong with it, with values.
    remedy : str
        What to do.
    severity : {"error", "warning", "note"}
        With an error a run would fail or give nothing of use. A note is unusual, but no problem.
    """

    code: str
    subject: str
    text: str
    remedy: str = ""
    severity: Literal["error", "warning", "note"] = "warning"

    @classmethod
    def of(cls, error: DocDepthError) -> Finding:
        """What an error tells."""
        return cls(error.code, "", error.text, error.remedy, "error")

    def __str__(self) -> str:
        sentence = _sentence(self.text, self.remedy)
        return f"{self.subject}: {sentence}" if self.subject else sentence


class SeveralProblems(DatasetError, CalibrationError):
    """Several problems of the inputs, told together."""

    code = "several"

    def __init__(self, errors: Sequence[DocDepthError]) -> None:
        self.errors = list(errors)
        lines = "".join(f"\n  {error}" for error in self.errors)
        super().__init__(f"{len(self.errors)} problems:{lines}")


@contextmanager
def collect_errors(errors: list[DocDepthError]) -> Iterator[None]:
    """Add an error that is raised inside to others, unless it is known, and go on.

    So all problems of the inputs are told together.
    """
    try:
        yield
    except DocDepthError as error:
        known = {str(other) for other in errors}
        errors += [e for e in single_errors(error) if str(e) not in known]


def single_errors(error: DocDepthError) -> list[DocDepthError]:
    """The errors that one is made of."""
    return error.errors if isinstance(error, SeveralProblems) else [error]


def raise_together(errors: Iterable[DocDepthError]) -> None:
    """Raise errors: one as it is, several as :class:`SeveralProblems`; none if there are none."""
    known = list(errors)
    if len(known) == 1:
        raise known[0]
    if known:
        raise SeveralProblems(known)


@contextmanager
def collect_findings(findings: list[Finding]) -> Iterator[None]:
    """Add an error that is raised inside to findings, and go on."""
    try:
        yield
    except DocDepthError as error:
        findings += map(Finding.of, single_errors(error))


def in_order(findings: Iterable[Finding]) -> list[Finding]:
    """Findings, each once: errors first, then warnings, then notes."""
    order = ("error", "warning", "note")
    return list(dict.fromkeys(sorted(findings, key=lambda found: order.index(found.severity))))


def raise_findings(findings: Iterable[Finding]) -> None:
    """Raise the errors among findings, all in one message."""
    errors = (found for found in findings if found.severity == "error")
    raise_together(
        DatasetError(replace(one, remedy=""), one.remedy, code=one.code) for one in errors
    )


def log_findings(log: logging.Logger, findings: Iterable[Finding]) -> None:
    """Log each as a warning, or as a note."""
    for found in findings:
        log.log(NOTE if found.severity == "note" else logging.WARNING, "%s", found)
