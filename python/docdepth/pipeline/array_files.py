"""Files in the notes of a run that hold arrays one after the other; any of them is read alone."""

from __future__ import annotations

import io
from collections.abc import Iterable
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from docdepth.errors import DamagedFileError
from docdepth.io.npy import ArrayError, read_next_array, skip_next_array
from docdepth.io.run_folder import RunFolder

Offsets = NDArray[np.int64]
"""Where each array of a file begins, in bytes."""


def write_array(stream: BinaryIO, array: NDArray[Any]) -> int:
    """Write an array behind others; the stream needs the method ``write`` only.

    Returns
    -------
    int
        Bytes that were written.
    """
    content = io.BytesIO()
    np.save(content, array)
    stream.write(content.getbuffer())
    return content.tell()


def write_arrays(
    run: RunFolder, path: Path, key: dict[str, str], arrays: Iterable[NDArray[Any]]
) -> None:
    """Write arrays into one file; they may be made while it is written."""

    def write(stream: BinaryIO) -> None:
        for array in arrays:
            write_array(stream, array)

    run.write(path, write, key, sync=False)


def read_arrays(path: Path, count: int, skipped: int = 0, offset: int = 0) -> list[NDArray[Any]]:
    """Read some arrays of a file: ``count`` after ``skipped`` ones, from a byte on.

    Raises
    ------
    DamagedFileError
    """
    try:
        with path.open("rb") as stream:
            size = path.stat().st_size
            stream.seek(offset)
            for _ in range(skipped):
                skip_next_array(stream, size - stream.tell())
            return [read_next_array(stream, size - stream.tell()) for _ in range(count)]
    except (OSError, ArrayError) as error:
        raise DamagedFileError(path, str(error)) from None


def array_offsets(path: Path) -> Offsets:
    """Where the arrays of a file begin.

    Raises
    ------
    DamagedFileError
    """
    offsets = []
    try:
        size = path.stat().st_size
        with path.open("rb") as stream:
            while stream.tell() < size:
                offsets.append(stream.tell())
                skip_next_array(stream, size - stream.tell())
            if stream.tell() != size:
                raise ArrayError("the last array is cut off")
    except (OSError, ArrayError) as error:
        raise DamagedFileError(path, str(error)) from None
    return np.array(offsets, np.int64)
