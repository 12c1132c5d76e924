"""Files that others have written or damaged: regular files alone, and what text and arrays hold.

A pipe would be waited for without end, and a device read without end. Memory is taken for what a
header tells only where the file is large enough.
"""

from __future__ import annotations

import codecs
import errno
import json
import os
import re
import stat
import zipfile
from collections.abc import Collection
from math import prod
from pathlib import Path
from typing import IO, Any, BinaryIO

import numpy as np
import yaml
from numpy.lib import format as npy
from numpy.typing import NDArray

from docdepth._text import UniqueLoader, explain_yaml
from docdepth.errors import DamagedFileError

_MOST_BITS = 1000  # of a whole number; Python does not even print one of 4300 digits
_MOST_VALUES = 10_000_000
"""Limit on values of YAML once its aliases are expanded ("billion laughs")."""

_OF_WINDOWS = re.compile(rb"[-+]?(?:1\.#(?:[QS]NAN|IND|INF)\d*|nan\([^)]*\))", re.IGNORECASE)
_LONGEST_HEADER = 10_000  # bytes
_MOST_BYTES = 4 << 30  # of a file that is read as a whole; a sparse one takes no place on the disk
_MOST_TEXT = 256 << 20  # bytes of a text; times and poses of a year of sweeps have less
MOST_PACKED = 1100  # times as large as its compressed bytes; deflate packs 1032 into one


def open_file(path: Path | str) -> BinaryIO:
    """A regular file, opened to be read.

    Raises
    ------
    OSError
        As for ``open``; or it is a pipe, a device or a socket.
    """
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        mode = os.fstat(descriptor).st_mode
        if stat.S_ISDIR(mode):
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
        if not stat.S_ISREG(mode):
            raise OSError(errno.EINVAL, "it is no regular file", str(path))
        return os.fdopen(descriptor, "rb")
    except BaseException:
        os.close(descriptor)
        raise


def read_file(path: Path | str, most: int = _MOST_BYTES) -> bytes:
    """The content of a regular file.

    Raises
    ------
    OSError
        As for :func:`open_file`; or it has more than ``most`` bytes.
    """
    with open_file(path) as stream:
        if (size := os.fstat(stream.fileno()).st_size) > most:
            gigabytes = f"{size / 1e9:,.1f}".removesuffix(".0")
            raise OSError(errno.EFBIG, f"it has {gigabytes} GB", str(path))
        return stream.read()


def read_text(path: Path | str) -> str:
    """The content of a text file, UTF-8 or UTF-16 with a mark, its ends of lines as ``\\n``.

    Raises
    ------
    OSError
        As for :func:`read_file`; no table of times or poses is larger than 256 MB.
    UnicodeDecodeError
    """
    text = as_utf_8(read_file(path, _MOST_TEXT)).decode()
    return text.replace("\r\n", "\n").replace("\r", "\n")


def as_utf_8(content: bytes) -> bytes:
    """The content of a text file in UTF-8 without a mark.

    Raises
    ------
    UnicodeDecodeError
        It has the mark of UTF-16 and is none.
    """
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):  # PowerShell's
        return content.decode("utf-16").encode()
    return content.removeprefix(codecs.BOM_UTF8)


def parse_yaml(text: str) -> Any:
    """The tree of a YAML text, without objects of Python.

    Raises
    ------
    ValueError
        It is no YAML, a name stands twice, it is too deep, or its aliases repeat too much.
    """
    try:
        tree = yaml.load(text, UniqueLoader)
        if _count(tree, {}) > _MOST_VALUES:
            raise ValueError(f"its aliases repeat more than {_MOST_VALUES} values")
        return tree
    except yaml.YAMLError as error:
        raise ValueError(explain_yaml(error)) from None
    except RecursionError:
        raise ValueError("it is too deep") from None
    except (LookupError, TypeError, AttributeError, ArithmeticError):
        raise ValueError("a tag (!!) does not fit its value") from None


def parse_json(text: str | bytes) -> Any:
    """The tree of a JSON text.

    Raises
    ------
    ValueError
        It is no JSON, or too deep.
    """
    try:
        return json.loads(text)
    except RecursionError:
        raise ValueError("it is too deep") from None


def _count(tree: Any, known: dict[int, int]) -> int:
    """Values of a tree, those of an alias as often as it stands."""
    if isinstance(tree, int) and tree.bit_length() > _MOST_BITS:
        raise ValueError("a whole number has more than 300 digits")
    if not isinstance(tree, (dict, list)):
        return 1
    if id(tree) not in known:
        known[id(tree)] = _MOST_VALUES  # what holds itself has no end
        values = tree.values() if isinstance(tree, dict) else tree
        known[id(tree)] = 1 + sum(_count(value, known) for value in values)
    return known[id(tree)]


class ArrayError(ValueError):
    """What is wrong with a file of arrays, without its name."""


def parse_numbers(words: NDArray[np.bytes_], dtype: str) -> NDArray[Any]:
    """Numbers of a text, each a word; Windows has names of its own for NaN and infinity.

    Raises
    ------
    ArrayError
        A word is no number of this type.
    """
    try:
        return words.astype(dtype)
    except (ValueError, OverflowError):
        pass
    found = np.empty(words.size, dtype)
    for k, word in enumerate(words.ravel().tolist()):
        try:
            found[k] = np.nan if _OF_WINDOWS.fullmatch(word) else np.array(word).astype(dtype)
        except (ValueError, OverflowError):
            comma = ", whose decimals have a comma instead of a point" if b"," in word else ""
            raise ArrayError(f"{word[:60].decode('latin-1')!r}{comma}") from None
    return found.reshape(words.shape)


def read_array(file: Path) -> NDArray[Any]:
    """The array of an NPY file.

    Raises
    ------
    ArrayError
        The file is no NPY file, damaged, or holds objects of Python.
    OSError
        It cannot be opened.
    """
    with open_file(file) as stream:
        return _read(stream, file.stat().st_size)


def read_arrays(file: Path, names: Collection[str] | None = None) -> dict[str, NDArray[Any]]:
    """The arrays of an NPZ file by name: all, or those of ``names`` that it has.

    Raises
    ------
    ArrayError, OSError
        As for :func:`read_array`.
    """
    found = {}
    with open_file(file) as stream:
        try:
            with zipfile.ZipFile(stream) as archive:
                entries = {e.filename.removesuffix(".npy"): e for e in archive.infolist()}
                for name in entries if names is None else [n for n in names if n in entries]:
                    entry = entries[name]
                    if entry.file_size > MOST_PACKED * entry.compress_size:
                        raise ArrayError(
                            f"{entry.compress_size} bytes cannot hold {entry.file_size}"
                        )
                    with archive.open(entry) as part:
                        found[name] = _read(part, entry.file_size)
                        if part.read(1):  # to its end, where the checksum is compared
                            raise ArrayError(f"{entry.filename} is longer than its array")
        except ArrayError:
            raise
        # A damaged archive fails in many ways: of structures, of compression, of passwords.
        except Exception as error:
            raise ArrayError(f"{error}" or type(error).__name__) from None
    return found


def read_kept_arrays(file: Path, *names: str) -> list[NDArray[Any]]:
    """The named arrays of an NPZ file of a run."""
    try:
        found = read_arrays(file, names)
        return [found[name] for name in names]
    except FileNotFoundError:
        raise DamagedFileError(file, "") from None
    except (OSError, ArrayError, KeyError) as error:
        raise DamagedFileError(file, str(error)) from None


def read_layers(file: Path, *names: str) -> dict[str, NDArray[Any]]:
    """Those of the named layers that an image of a run has; none where there is no file."""
    try:
        return read_arrays(file, names)
    except FileNotFoundError:
        return {}
    except (OSError, ArrayError) as error:
        raise DamagedFileError(file, str(error)) from None


def _read(stream: IO[bytes], size: int) -> NDArray[Any]:
    """The array of a stream of ``size`` bytes; memory is taken only for bytes that are there."""
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
    entries = prod(shape)
    wanted = entries * dtype.itemsize
    if wanted > size:
        raise ArrayError(f"its header tells of {wanted} bytes, the file has {size}")
    data = stream.read(wanted)
    if len(data) < wanted:
        raise ArrayError(f"{len(data)} of {wanted} bytes are there")
    try:
        if wanted:
            array = np.frombuffer(bytearray(data), dtype, entries)
        else:
            array = np.empty(entries, dtype)
        return array.reshape(shape, order="F" if fortran else "C")
    except (ValueError, OverflowError) as error:
        raise ArrayError(str(error)) from None


def _is_sound(dtype: np.dtype[Any]) -> bool:
    """Whether the fields of a row lie within it: numpy adds their sizes in 32 bits."""
    size = dtype.itemsize
    if size <= 0:
        return False
    for kind, offset, *_ in (dtype.fields or {}).values():
        if offset < 0 or offset + kind.itemsize > size or not _is_sound(kind):
            return False
    return True
