"""Errors of docdepth. Each message names the file, the frame and the remedy."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any


class DocDepthError(Exception):
    """Base class of all errors that docdepth raises."""

    def __reduce__(self) -> tuple[Any, ...]:
        # Of a worker's error another process makes a copy. Exception would call __init__ with the
        # message, which some classes below make themselves.
        return _copy, (type(self), self.args, vars(self))


def _copy(kind: type[DocDepthError], args: tuple[Any, ...], rest: dict[str, Any]) -> DocDepthError:
    error = kind.__new__(kind, *args)
    vars(error).update(rest)
    return error


class InputError(DocDepthError, ValueError):
    """An array has the wrong shape, dtype or content."""


class DatasetError(DocDepthError):
    """A recording on disk is missing, truncated or inconsistent."""


class CalibrationError(DocDepthError):
    """A camera or extrinsic calibration is missing or does not fit."""


class ConfigError(DocDepthError):
    """A parameter is unknown or out of its range."""


class OdometryError(DocDepthError):
    """Poses could not be computed or do not fit the sweeps."""


class RunError(DocDepthError):
    """A run folder cannot be used as it is."""


class DamagedFileError(RunError):
    """A file of a run is missing or damaged.

    Parameters
    ----------
    path : Path
    what : str
        What is wrong with it; empty if it is missing.
    """

    def __init__(self, path: Path, what: str) -> None:
        found = f"is damaged ({what})" if what else "is missing"
        super().__init__(f"{path} {found}; docdepth run RUN makes it again")
        self.path, self.what = path, what


class BackendError(DocDepthError):
    """A renderer is unknown or cannot be used on this machine."""


class MissingExtraError(DocDepthError, ImportError):
    """An optional dependency is not installed."""


class SeveralProblems(DatasetError, CalibrationError):
    """Several problems of the inputs, told together.

    Attributes
    ----------
    problems : list of str
    """

    def __init__(self, problems: Sequence[str]) -> None:
        self.problems = list(problems)
        lines = "".join(f"\n  {problem}" for problem in self.problems)
        super().__init__(f"{len(self.problems)} problems:{lines}")


class Collector:
    """Goes on after an error, so that all problems of the inputs are told together.

    Attributes
    ----------
    errors : list of DocDepthError
        What was found so far.
    """

    def __init__(self) -> None:
        self.errors: list[DocDepthError] = []

    @contextmanager
    def collected(self) -> Iterator[None]:
        """Keep an error that is raised inside, and go on."""
        try:
            yield
        except DocDepthError as error:
            self.errors.append(error)

    @property
    def problems(self) -> list[str]:
        """All messages, each once."""
        told: dict[str, None] = {}
        for error in self.errors:
            for text in getattr(error, "problems", [str(error)]):
                told.setdefault(text)
        return list(told)

    def raise_errors(self) -> None:
        """Raise what was found: one error as it is, several as one.

        Raises
        ------
        DocDepthError
            Of the class of the only error, else :class:`SeveralProblems`.
        """
        if len(self.problems) == 1:
            raise self.errors[0]
        if self.errors:
            raise SeveralProblems(self.problems)
