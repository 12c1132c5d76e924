"""Times of images or sweeps: from text files or from names of files, exact to the nanosecond."""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence
from decimal import Decimal, InvalidOperation
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.files import is_there, read_lines
from docdepth.datasets.kitti_files import check_increasing, match_rows
from docdepth.errors import DatasetError

_MOST_SECONDS = (1 << 63) // 10**9  # int64 holds 292 years of nanoseconds
_UNITS = {19: 1, 16: 10**3, 13: 10**6, 10: 10**9}
"""Nanoseconds of one count, by the digits of a time since 1970."""
_SECONDS = re.compile(r"(?<!\d)([1-9]\d{9})[._](\d{1,9})$")
_PLAIN = re.compile(r"[-+]?[0-9.]+(?:[eE][-+]?[0-9]+)?")
TABLES = ("times.txt", "timestamps.txt")
"""Where times stand if nothing else is said."""


def read_times(path: Path) -> NDArray[np.int64]:
    """Read times (n,) in nanoseconds, one a line.

    Lines are seconds like ``1317000000.123456789``, dates like ``2011-09-26 13:02:25.951199337``,
    or 19, 16 or 13 digits: nanoseconds, microseconds or milliseconds since 1970.
    """
    lines = _numbered_lines(path, "write one time a line, in seconds")
    return np.array([_nanoseconds(text, n, path) for n, text in lines if text], np.int64)


def read_times_of(files: Sequence[Path], table: Path, what: str, remedy: str) -> NDArray[np.int64]:
    """Read the time of each of these files, in order, from a table; nanoseconds.

    It has a line for each file, or for each number that may be in a file's name. Blank lines do not
    count, or stand for a file that was lost. ``what`` it holds, "times" or "stamps", and the
    ``remedy`` if it is missing are for errors. Times increase strictly.
    """
    lines = _numbered_lines(table, remedy)
    written = [line for line in lines if line[1]]
    if len(written) == len(files):
        lines = written
    known = {n: _nanoseconds(text, n, table) for n, text in written}
    rows = match_rows(files, len(lines), table, what)
    lost = [n for n, text in (lines[row] for row in rows) if not text]
    if lost:
        raise DatasetError(f"{table}, line {lost[0]}: there is no time; {remedy}")
    times: NDArray[np.int64] = np.array([known[lines[row][0]] for row in rows], np.int64)
    check_increasing(times, [file.name for file in files], table)
    return times


def image_times(
    table: Path,
    images: Sequence[Path],
    sweeps: Sequence[Path],
    sweep_times: NDArray[np.int64],
    remedy: str,
) -> tuple[NDArray[np.int64], list[str]]:
    """Nanoseconds and names of images by a table; of the sweeps where there are none of both."""
    what = "stamps" if table.stem == "timestamps" else "times"
    if not images and not is_there(table):
        return sweep_times, [sweep.stem for sweep in sweeps]
    digits = 10 if what == "stamps" else 6
    files = images or [Path(f"{k:0{digits}d}") for k in range(len(read_lines(table, remedy)))]
    return read_times_of(files, table, what, remedy), [file.stem for file in files]


def _numbered_lines(path: Path, remedy: str) -> list[tuple[int, str]]:
    """The lines of a text file with their numbers, blank ones as well; comments begin with #."""
    lines = [(n, line.strip()) for n, line in enumerate(read_lines(path, remedy), 1)]
    return [(n, text.partition("#")[0].rstrip()) for n, text in lines if not text.startswith("#")]


def _nanoseconds(text: str, line: int, path: Path) -> int:
    """One time; it never passes through a float, which would lose digits."""
    try:
        if ":" in text:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", UserWarning)  # of time zones, which are heeded
                stamp = np.datetime64(text, "ns")
            if np.isnat(stamp):
                raise ValueError
            return int(stamp.astype(np.int64))
        if not _PLAIN.fullmatch(text):  # Decimal takes 0_1, too
            raise ValueError
        seconds = Decimal(text)
        if text.isascii() and text.isdigit() and len(text) in _UNITS:
            seconds *= Decimal(_UNITS[len(text)]) / 10**9
        if not seconds.is_finite() or seconds.adjusted() > 9 or abs(seconds) >= _MOST_SECONDS:
            raise ValueError
        return int((seconds * 1_000_000_000).to_integral_value())
    except (ValueError, InvalidOperation, OverflowError):
        raise DatasetError(
            f"{path}, line {line}: {text!r} is no time; write one time a line and nothing else, "
            "seconds or dates like 2011-09-26 13:02:25.951199337"
        ) from None


def times_of_files(
    files: Sequence[Path], table: str | None, folder: Path, remedy: str
) -> NDArray[np.int64]:
    """Nanoseconds of each file, in order and strictly increasing.

    ``table``, relative to ``folder``, has a line for each, or is ``names``. If it is left out, a
    table beside the files or their folder is taken, else their names. ``remedy`` is what to do
    where nothing tells the times.
    """
    if table not in (None, "names"):
        return read_times_of(files, folder / str(table), "times", remedy)
    if table is None:
        near = files[0].parent
        places = [near / name for name in TABLES]
        places += [near.parent / name for name in TABLES if near != folder]
        for place in places:
            if is_there(place):
                return read_times_of(files, place, "times", remedy)
    digits = _digits_of_fractions(files)
    stamps = [time_of_name(file.stem, digits) for file in files]
    times = np.array([stamp for stamp in stamps if stamp is not None], np.int64)
    if len(times) < len(files):
        name = next(file.name for file, stamp in zip(files, stamps, strict=True) if stamp is None)
        raise DatasetError(f"{files[0].parent}: nothing tells the time of {name}; {remedy}")
    check_increasing(times, [file.name for file in files], files[0].parent)
    return times


def times_of_names(files: Sequence[Path], unit: int, remedy: str) -> NDArray[np.int64]:
    """Nanoseconds of files whose names are numbers of ``unit`` nanoseconds."""
    for file in files:
        if not (file.stem.isascii() and file.stem.isdigit()):
            raise DatasetError(f"{file}: the name is no number; {remedy}")
    times = np.array([int(file.stem) for file in files], np.int64) * unit
    if files:
        check_increasing(times, [file.name for file in files], files[0].parent)
    return times


def _digits_of_fractions(files: Sequence[Path]) -> int:
    """Digits behind the ``_`` of names: 3 or 6 if all have so many, else 9."""
    parts = [_SECONDS.search(file.stem) for file in files]
    digits = {len(found[2]) if found and "_" in found[0] else 0 for found in parts}
    return digits.pop() if len(files) > 1 and digits in ({3}, {6}) else 9


def time_of_name(stem: str, digits: int = 9) -> int | None:
    """Nanoseconds since 1970 in a name: a whole number, or seconds and a fraction.

    ``1673400678101968885``, ``1547131046260961``, ``1583836591.18`` and
    ``cloud_1583836591_182590976`` are understood. A number that begins with 0 only counts. What
    follows ``_`` are nanoseconds, as ROS writes them without leading zeros, or of 6 ``digits``
    microseconds, of 3 milliseconds.
    """
    parts = _SECONDS.search(stem)
    if parts:
        fraction = parts[2].ljust(9, "0") if "." in parts[0] else parts[2] + "0" * (9 - digits)
        return int(parts[1]) * 10**9 + int(fraction)
    whole = re.search(r"(?<!\d)([1-9]\d+)$", stem)
    unit = _UNITS.get(len(whole[1])) if whole else None
    return int(whole[1]) * unit if whole and unit else None
