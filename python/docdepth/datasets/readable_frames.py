"""Opening recordings some of whose sweeps or images are broken."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import TypeVar

from docdepth.errors import DatasetError, DocDepthError

_File = TypeVar("_File")
_Read = TypeVar("_Read")
_MOST_TRIES = 100  # sweeps or images that are tried in place of a broken one


@contextmanager
def suggest_skipping() -> Iterator[None]:
    """If a sweep or an image is broken, say how a run leaves it out."""
    try:
        yield
    except DatasetError as error:
        raise DatasetError(error, "or leave it out by `on_error='skip'`", code=error.code) from None


def first_readable(read: Callable[[_File], _Read], files: Sequence[_File]) -> _Read:
    """What ``read`` gives for the first whole file; the error of the first if none is."""
    return next(iter(readable(lambda k: read(files[k]), [0], len(files)).values()))


def readable(
    read: Callable[[int], _Read],
    wanted: Iterable[int],
    count: int,
    broken: list[DocDepthError] | None = None,
) -> dict[int, _Read]:
    """What ``read`` gives for frames that are ``wanted``, or for frames near those that are broken.

    Of ``count`` frames; by frame, in order. ``broken`` gets the errors of those that were wanted.
    If none around one of them can be read, its error is raised.
    """
    found: dict[int, _Read] = {}
    for index in wanted:
        around = range(max(index - _MOST_TRIES, 0), min(index + _MOST_TRIES + 1, count))
        problem: DocDepthError | None = None
        for _, other in sorted((abs(k - index), k) for k in around):
            if other in found:
                break
            try:
                found[other] = read(other)
                break
            except DocDepthError as error:
                problem = problem or error
        else:
            if problem is not None:
                raise problem
        if problem is not None and broken is not None:
            broken.append(problem)
    return dict(sorted(found.items()))
