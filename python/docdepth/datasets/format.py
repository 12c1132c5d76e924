"""What the registry knows of a recording's format; loaders of other packages bring theirs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from docdepth.datasets.base import Dataset

ENTRY_POINTS = "docdepth.datasets"
"""Group of entry points by which another package brings a :class:`Format`."""


@dataclass(frozen=True)
class Format:
    """A format of recordings.

    Attributes
    ----------
    name : str
        Lower case with underscores; ``--dataset`` takes it, and datasets have it as ``name``.
    expected : str
        What a recording of this format looks like, for messages.
    recognises : callable
        ``recognises(path)`` tells by names of files whether a folder or file is such a recording.
    open : callable
        ``open(path, image_size)`` opens it; ``image_size`` is width and height in pixels, or None.
    found_below : bool
        Whether it is looked for in folders below the one that is given.
    experimental : bool
        Its reader was tried on made-up drives only, never on a real recording.
    """

    name: str
    expected: str
    recognises: Callable[[Path], bool]
    open: Callable[[Path, tuple[int, int] | None], Dataset]
    found_below: bool = True
    experimental: bool = False
