"""PLY files: the scalar properties of their vertices, in every layout that the format knows.

Text and binary, either byte order, elements in any order. Elements before the vertices are skipped,
lists and all; what follows the vertices is not read.
"""

from __future__ import annotations

import os
import struct
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from docdepth.errors import DamagedFileError, RunError
from docdepth.io.atomic import WriteFile, write_atomically
from docdepth.io.untrusted import ArrayError, open_file, parse_numbers

_BYTE_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}

_SCALARS = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4"},
    **{"uint32": "u4", "float": "f4", "double": "f8", "float32": "f4", "float64": "f8"},
}
_NAMES = {
    code: name for name, code in reversed(_SCALARS.items())
}  # the older names, which all read

_TEXT = ("utf-8", "surrogateescape")  # of headers: comments hold names of files, whatever they are
_LONGEST_LINE = 1 << 16  # bytes of a header line: a file without line ends is not read as a whole
_MOST_DIGITS = 18  # of a count: it fits in an int64


class _Damaged(Exception):
    """What is wrong with a file, without its name."""


@dataclass(frozen=True)
class _Property:
    name: str
    scalar: str  # numpy's type code
    count: str | None = None  # type code of the length, where the property is a list


@dataclass
class _Element:
    name: str
    count: int
    properties: list[_Property]

    def dtype(self, byte_order: str) -> np.dtype[Any]:
        """Of a row; refused where a property is a list, or two have one name."""
        lists = [p.name for p in self.properties if p.count]
        if lists:
            raise _Damaged(f"property {lists[0]} of its {self.name} is a list, not a number")
        if not self.properties:
            raise _Damaged(f"its {self.name} has no properties")
        try:
            return np.dtype([(p.name, (byte_order or "<") + p.scalar) for p in self.properties])
        except ValueError as error:
            raise _Damaged(str(error)) from None


@dataclass
class _Header:
    byte_order: str | None
    elements: list[_Element]
    comments: list[str]


def write_vertices(
    path: Path,
    rows: NDArray[Any],
    comments: list[str],
    write_file: WriteFile = write_atomically,
) -> None:
    """Write the rows of a structured array as a little-endian PLY file, whole or not at all.

    Parameters
    ----------
    rows : structured ndarray, shape (n,)
        A field for each property, of 1 to 4 byte integers or 4 or 8 byte floats.
    """
    rows = np.ascontiguousarray(rows.astype(rows.dtype.newbyteorder("<"), copy=False))
    fields = [(name, rows.dtype[name].str[1:]) for name in rows.dtype.names or ()]
    lines = [
        "ply",
        "format binary_little_endian 1.0",
        *(f"comment {' '.join(comment.splitlines())}" for comment in comments),
        f"element vertex {len(rows)}",
        *(f"property {_NAMES[code]} {name}" for name, code in fields),
        "end_header",
    ]
    header = "".join(f"{line}\n" for line in lines).encode(*_TEXT)
    write_file(path, lambda stream: stream.writelines([header, rows.view(np.uint8).data]))


def read_vertices(path: Path) -> tuple[NDArray[Any], list[str]]:
    """Rows of the element ``vertex``, and the comments of the header.

    Returns
    -------
    structured ndarray, shape (n,)
        A field for each property, in the byte order of the machine.
    list of str
    """
    try:
        with open_file(Path(path)) as stream:
            header = _read_header(stream)
            size = os.fstat(stream.fileno()).st_size
            return _read_rows(stream, size, header), header.comments
    except FileNotFoundError:
        raise DamagedFileError(path, "") from None
    except OSError as error:
        raise RunError(f"{path} cannot be read: {error.strerror or error}") from None
    except _Damaged as error:
        raise DamagedFileError(path, str(error)) from None


def read_comments(path: Path) -> list[str]:
    """The comments of a header; none where the file is missing or its header is damaged."""
    try:
        with open_file(Path(path)) as stream:
            return _read_header(stream).comments
    except (OSError, _Damaged):
        return []


def _read_header(stream: BinaryIO) -> _Header:
    if _read_line(stream) != "ply":
        raise _Damaged("it does not begin with 'ply'")
    header = _Header(None, [], [])
    while (line := _read_line(stream)) != "end_header":
        keyword, _, rest = line.partition(" ")
        if keyword == "comment":
            header.comments.append(rest)
        elif keyword == "format":
            words = rest.split()
            if len(words) != 2 or words[0] not in _BYTE_ORDERS or words[1] != "1.0":
                raise _Damaged(f"its format {rest!r} is unknown")
            header.byte_order = _BYTE_ORDERS[words[0]]
        elif keyword == "element":
            header.elements.append(_parse_element(line.split()))
        elif keyword == "property" and header.elements:
            header.elements[-1].properties.append(_parse_property(line.split()))
        elif keyword not in ("obj_info", ""):
            raise _Damaged(f"{line[:60]!r} is no line of a header")
    if header.byte_order is None:
        raise _Damaged("its header names no format")
    return header


def _read_line(stream: BinaryIO) -> str:
    line = stream.readline(_LONGEST_LINE)
    if not line.endswith(b"\n"):
        raise _Damaged("its header has no end")
    text = line.decode(*_TEXT).rstrip("\r\n")
    return text if text.startswith("comment ") else text.strip()


def _parse_element(words: list[str]) -> _Element:
    if len(words) != 3 or not words[2].isascii() or not words[2].isdigit():
        raise _Damaged(f"{' '.join(words)[:60]!r} tells no number of rows")
    if len(words[2]) > _MOST_DIGITS:
        raise _Damaged(f"nothing has {words[2][:20]}... rows")
    return _Element(words[1], int(words[2]), [])


def _parse_property(words: list[str]) -> _Property:
    types = words[1:-1]
    if types[:1] == ["list"]:
        types = types[1:]
        lists = len(types) == 2 and _SCALARS.get(types[0], "f")[0] != "f"
        if lists and types[1] in _SCALARS:
            return _Property(words[-1], _SCALARS[types[1]], _SCALARS[types[0]])
    elif len(types) == 1 and types[0] in _SCALARS:
        return _Property(words[-1], _SCALARS[types[0]])
    raise _Damaged(f"{' '.join(words)[:60]!r} has a type that PLY lacks")


def _read_rows(stream: BinaryIO, size: int, header: _Header) -> NDArray[Any]:
    """Rows of the vertices, from a stream that stands after the header."""
    for element in header.elements:
        if element.name != "vertex":
            _skip(stream, size, element, header.byte_order or "")
        elif header.byte_order:
            dtype = element.dtype(header.byte_order)
            whole = (size - stream.tell()) // dtype.itemsize
            if whole < element.count:  # before memory is taken for rows that are not there
                raise _Damaged(f"{whole} of {element.count} rows are there")
            rows = np.fromfile(stream, dtype, element.count)
            return rows.astype(dtype.newbyteorder("<"), copy=False)
        else:
            return _read_text(stream, size, element)
    raise _Damaged("it has no element 'vertex'")


def _read_text(stream: BinaryIO, size: int, element: _Element) -> NDArray[Any]:
    dtype = element.dtype("")
    columns = len(element.properties)
    # A number and what parts it from the next are two bytes at least.
    if element.count * 2 * columns > size - stream.tell() + 1:
        raise _Damaged(f"it is too short for {element.count} rows")
    words = [line.split() for line in islice(stream, element.count)]
    if len(words) < element.count:
        raise _Damaged(f"{len(words)} of {element.count} rows are there")
    wrong = next((k for k, row in enumerate(words) if len(row) != columns), None)
    if wrong is not None:
        raise _Damaged(f"row {wrong} has {len(words[wrong])} numbers, not {columns}")
    try:
        values = parse_numbers(np.array(words, dtype="S"), "f8").reshape(len(words), columns)
    except ArrayError as error:
        raise _Damaged(f"a row holds what is no number: {error}") from None
    rows = np.empty(len(words), dtype)
    for column, name in zip(values.T, dtype.names or (), strict=True):
        if dtype[name].kind in "iu":
            limits = np.iinfo(dtype[name])
            if not ((column >= limits.min) & (column <= limits.max) & (column % 1 == 0)).all():
                raise _Damaged(f"a value of {name} is no {_NAMES[dtype[name].str[1:]]}")
        with np.errstate(over="ignore"):
            rows[name] = column
    return rows


def _skip(stream: BinaryIO, size: int, element: _Element, byte_order: str) -> None:
    """Pass the rows of an element that is not wanted."""
    if not byte_order:
        skipped = sum(1 for _ in islice(stream, element.count))
        if skipped < element.count:
            raise _Damaged(f"{skipped} of {element.count} rows of its {element.name} are there")
        return
    sizes = [np.dtype(p.count or p.scalar).itemsize for p in element.properties]
    if stream.tell() + element.count * sum(sizes) > size:
        raise _Damaged(f"it is too short for {element.count} rows of its {element.name}")
    if not any(p.count for p in element.properties):
        stream.seek(element.count * sum(sizes), os.SEEK_CUR)
        return
    for _ in range(element.count):
        for one in element.properties:
            length = 1
            if one.count:
                length = _read_number(stream, byte_order, one.count)
            stream.seek(length * np.dtype(one.scalar).itemsize, os.SEEK_CUR)
    if stream.tell() > size:
        raise _Damaged(f"it ends within its {element.name}")


def _read_number(stream: BinaryIO, byte_order: str, code: str) -> int:
    number = np.dtype(code)
    data = stream.read(number.itemsize)
    if len(data) < number.itemsize:
        raise _Damaged("it ends within a list")
    value: int = struct.unpack(byte_order + number.char, data)[0]
    if value < 0:
        raise _Damaged(f"a list has {value} entries")
    return value
