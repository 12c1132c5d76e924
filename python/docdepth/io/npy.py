"""Arrays in files of numpy, NPY and NPZ, that others may have written or damaged."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Collection
from math import prod
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

_LONGEST_HEADER = 10_000  # bytes
_MOST_PACKED = 1100  # times as large as its compressed bytes; deflate packs 1032 into one


class ArrayError(ValueError):
    """What is wrong with a file of arrays, without its name."""


def read_array(file: Path) -> NDArray[Any]:
    """The array of an NPY file.

    Raises
    ------
    ArrayError
        The file is no NPY file, damaged, or holds objects of Python.
    OSError
        It cannot be opened.
    """
    with file.open("rb") as stream:
        return read_next_array(stream, file.stat().st_size)


def read_arrays(file: Path, names: Collection[str] | None = None) -> dict[str, NDArray[Any]]:
    """The arrays of an NPZ file by name: all, or those of ``names`` that it has.

    Raises
    ------
    ArrayError, OSError
        As for :func:`read_array`.
    """
    with file.open("rb") as stream:
        try:
            with zipfile.ZipFile(stream) as archive:
                entries = {e.filename.removesuffix(".npy"): e for e in archive.infolist()}
                wanted = entries if names is None else [name for name in names if name in entries]
                return {name: _of_archive(archive, entries[name]) for name in wanted}
        except ArrayError:
            raise
        # A damaged archive fails in many ways: of structures, of compression, of passwords.
        except Exception as error:
            raise ArrayError(f"{error}" or type(error).__name__) from None


def _of_archive(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> NDArray[Any]:
    if entry.file_size > _MOST_PACKED * entry.compress_size:
        raise ArrayError(f"{entry.compress_size} bytes cannot hold {entry.file_size}")
    with archive.open(entry) as stream:
        array = read_next_array(stream, entry.file_size)  # type: ignore[arg-type]
        if stream.read(1):  # to its end, where the checksum is compared
            raise ArrayError(f"{entry.filename} is longer than its array")
        return array


class _Header(NamedTuple):
    shape: tuple[int, ...]
    fortran: bool
    dtype: np.dtype[Any]
    entries: int

    @property
    def size(self) -> int:
        """Bytes of the data behind the header."""
        return self.entries * self.dtype.itemsize


def read_next_array(stream: BinaryIO, size: int) -> NDArray[Any]:
    """The next array of a stream of which ``size`` bytes are left.

    Memory is taken only for bytes that are there.

    Raises
    ------
    ArrayError
        As for :func:`read_array`.
    """
    header = _read_header(stream, size)
    data = stream.read(header.size)
    if len(data) < header.size:
        raise ArrayError(f"{len(data)} of {header.size} bytes are there")
    try:
        if header.size:
            array = np.frombuffer(bytearray(data), header.dtype, header.entries)
        else:
            array = np.empty(header.entries, header.dtype)
        return array.reshape(header.shape, order="F" if header.fortran else "C")
    except (ValueError, OverflowError) as error:
        raise ArrayError(str(error)) from None


def skip_next_array(stream: BinaryIO, size: int) -> None:
    """Go behind the next array of a stream of which ``size`` bytes are left.

    Raises
    ------
    ArrayError
        As for :func:`read_array`.
    """
    stream.seek(_read_header(stream, size).size, io.SEEK_CUR)


def _read_header(stream: BinaryIO, size: int) -> _Header:
    try:
        version = npy.read_magic(stream)
        read_header = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}
        if version not in read_header:
            raise ValueError(f"version {version} of the format")
        shape, fortran, dtype = read_header[version](stream, max_header_size=_LONGEST_HEADER)
    except Exception as error:  # of structures, of Python's syntax, of encodings
        raise ArrayError(f"its header is damaged: {error or type(error).__name__}") from None
    if dtype.hasobject:
        raise ArrayError("it holds objects of Python, which docdepth does not load")
    if any(n < 0 for n in shape) or not _is_sound(dtype):
        raise ArrayError(f"its shape is {shape} of {dtype}")
    header = _Header(shape, fortran, dtype, prod(shape))
    if header.size > size:
        raise ArrayError(f"its header tells of {header.size} bytes, the file has {size}")
    return header


def _is_sound(dtype: np.dtype[Any]) -> bool:
    """Whether the fields of a row lie within it: numpy adds their sizes in 32 bits."""
    size = dtype.itemsize
    if size <= 0:
        return False
    for kind, offset, *_ in (dtype.fields or {}).values():
        if offset < 0 or offset + kind.itemsize > size or not _is_sound(kind):
            return False
    return True
