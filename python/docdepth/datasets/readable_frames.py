"""Opening recordings some of whose sweeps or images are broken."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TypeVar

from docdepth.errors import DatasetError, DocDepthError

_File = TypeVar("_File")
_Read = TypeVar("_Read")
_tolerant = ContextVar("tolerant", default=False)
_MOST_TRIES = 100  # sweeps or images that are tried in place of a broken one


@contextmanager
def broken_frames_tolerated() -> Iterator[None]:
    """Inside, recordings open though sweeps or images are broken; reading these still fails."""
    token = _tolerant.set(True)
    try:
        yield
    finally:
        _tolerant.reset(token)


def are_broken_frames_tolerated() -> bool:
    """Whether a recording opens though sweeps or images are broken."""
    return _tolerant.get()


@contextmanager
def suggest_skipping() -> Iterator[None]:
    """If a sweep or an image is broken, say how a run leaves it out."""
    try:
        yield
    except DatasetError as error:
        raise DatasetError(error, "or leave it out by `on_error='skip'`", code=error.code) from None


def first_readable(read: Callable[[_File], _Read], files: Sequence[_File]) -> _Read:
    """What ``read`` gives for the first file, or the first whole one where this is tolerated.

    Raises
    ------
    DocDepthError
        The first file cannot be read.
    """
    return next(iter(readable(lambda k: read(files[k]), [0], len(files)).values()))


def readable(read: Callable[[int], _Read], wanted: Iterable[int], count: int) -> dict[int, _Read]:
    """What ``read`` gives for some frames; where broken ones are tolerated, for frames near these.

    Parameters
    ----------
    read : callable
    wanted : iterable of int
    count : int
        Frames that there are.

    Returns
    -------
    dict
        By frame, in order.

    Raises
    ------
    DocDepthError
        A frame cannot be read.
    """
    found: dict[int, _Read] = {}
    for index in wanted:
        around = range(max(index - _MOST_TRIES, 0), min(index + _MOST_TRIES + 1, count))
        near = sorted(around, key=lambda k, index=index: abs(k - index))  # type: ignore[misc]
        for tried, other in enumerate(near):
            if other in found:
                break
            try:
                found[other] = read(other)
                break
            except DocDepthError:
                if not _tolerant.get() or tried + 1 == len(near):
                    raise
    return dict(sorted(found.items()))
