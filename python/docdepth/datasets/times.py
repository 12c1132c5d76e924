"""Times of images or sweeps from a text file."""

from __future__ import annotations

from decimal import Decimal, InvalidOperation
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.kitti_files import lines_of
from docdepth.errors import DatasetError


def read_times(path: Path) -> NDArray[np.int64]:
    """Times in nanoseconds, one a line: seconds, or dates as KITTI writes them.

    Parameters
    ----------
    path : Path
        Lines like ``1317000000.123456789`` or ``2011-09-26 13:02:25.951199337``.

    Returns
    -------
    ndarray of int64, shape (n,)

    Raises
    ------
    DatasetError
        The file is missing, or a line is no time.
    """
    lines = lines_of(path, "write one time a line, in seconds")
    return np.array([nanoseconds(line, n, path) for n, line in enumerate(lines, 1)], np.int64)


def nanoseconds(text: str, line: int, path: Path) -> int:
    """One time, exact: it never passes through a float."""
    text = text.strip()
    try:
        if ":" in text:
            stamp = np.datetime64(text, "ns")
            if np.isnat(stamp):
                raise ValueError
            return int(stamp.astype(np.int64))
        return int((Decimal(text) * 1_000_000_000).to_integral_value())
    except (ValueError, InvalidOperation, OverflowError):
        raise DatasetError(
            f"{path}, line {line}: {text!r} is no time; write seconds, or dates like "
            "2011-09-26 13:02:25.951199337"
        ) from None
