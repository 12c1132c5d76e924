"""Times of images or sweeps from text files, exact to the nanosecond."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from decimal import Decimal, InvalidOperation
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.files import read_lines
from docdepth.datasets.kitti_files import check_increasing, match_rows
from docdepth.errors import DatasetError

_MOST_SECONDS = (1 << 63) // 10**9  # int64 holds 292 years of nanoseconds


def read_times(path: Path) -> NDArray[np.int64]:
    """Read times in nanoseconds, one a line.

    Parameters
    ----------
    path : Path
        Lines of seconds like ``1317000000.123456789``, or dates like
        ``2011-09-26 13:02:25.951199337``.

    Returns
    -------
    ndarray of int64, shape (n,)

    Raises
    ------
    DatasetError
        The file is missing, or a line is not a time.
    """
    return _parse(read_lines(path, "write one time a line, in seconds"), path)


def read_times_of(files: Sequence[Path], table: Path, what: str, remedy: str) -> NDArray[np.int64]:
    """Read the time of each of these files from a table.

    Parameters
    ----------
    files : sequence of Path
        Sweeps or images, in order.
    table : Path
        A line for each file, or for each number that may be in a file's name.
    what : str
        What the table holds, for errors: "times" or "stamps".
    remedy : str
        What to do if the table is missing.

    Returns
    -------
    ndarray of int64, shape (len(files),)
        Nanoseconds, strictly increasing.

    Raises
    ------
    DatasetError
        The table is missing, a line is not a time, a file has no line, or times do not increase.
    """
    stamps = _parse(read_lines(table, remedy), table)
    times: NDArray[np.int64] = stamps[match_rows(files, len(stamps), table, what)]
    check_increasing(times, [file.name for file in files], table)
    return times


def _parse(lines: list[str], path: Path) -> NDArray[np.int64]:
    return np.array([_nanoseconds(line, n, path) for n, line in enumerate(lines, 1)], np.int64)


def _nanoseconds(text: str, line: int, path: Path) -> int:
    """One time; it never passes through a float, which would lose digits."""
    text = text.strip()
    try:
        if ":" in text:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", UserWarning)  # of time zones, which are heeded
                stamp = np.datetime64(text, "ns")
            if np.isnat(stamp):
                raise ValueError
            return int(stamp.astype(np.int64))
        seconds = Decimal(text)
        if not seconds.is_finite() or seconds.adjusted() > 9 or abs(seconds) >= _MOST_SECONDS:
            raise ValueError
        return int((seconds * 1_000_000_000).to_integral_value())
    except (ValueError, InvalidOperation, OverflowError):
        raise DatasetError(
            f"{path}, line {line}: {text!r} is no time; write seconds, or dates like "
            "2011-09-26 13:02:25.951199337"
        ) from None
