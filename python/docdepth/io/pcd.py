"""Point clouds of the Point Cloud Library (``.pcd``), versions 0.6 and 0.7."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth.errors import MissingExtraError
from docdepth.io.atomic import write_atomically
from docdepth.io.untrusted import ArrayError, open_file, parse_numbers, read_file

_TYPES = {
    "F": {4: "<f4", 8: "<f8"},
    "U": {1: "u1", 2: "<u2", 4: "<u4", 8: "<u8"},
    "I": {1: "i1", 2: "<i2", 4: "<i4", 8: "<i8"},
}
_MOST_LINES = 100  # of a header
_MOST_VALUES = 1 << 12  # of a field of one point, and fields
_MOST_ZEROS = 4096  # bytes behind the data
_MOST_PACKED = 300  # times as large as its compressed bytes; LZF packs 264 bytes into 3


class PcdError(ValueError):
    """What is wrong with a PCD file, without its name."""


@dataclass(frozen=True)
class PcdHeader:
    """The header of a PCD file."""

    # name, type in numpy's letters, and values a point. Fields named ``_``, or of 0 values, are
    # padding
    fields: list[tuple[str, str, int]]
    count: int  # of points
    viewpoint: NDArray[np.float64]  # (7,): where the sensor was: tx ty tz qw qx qy qz
    data: str  # ``ascii``, ``binary`` or ``binary_compressed``
    size: int  # bytes of the header

    @property
    def named(self) -> list[tuple[str, str, int]]:
        """Fields that are no padding."""
        return [(name, kind, n) for name, kind, n in self.fields if n and name != "_"]

    def dtype(self, size: int | None = None) -> np.dtype[Any]:
        """Of the named fields of a row of ``size`` bytes; of these fields alone if absent."""
        names = [name for name, _, _ in self.named]
        formats = [kind if n == 1 else (kind, (n,)) for _, kind, n in self.named]
        if size is None:
            return np.dtype(list(zip(names, formats, strict=True)))
        offsets = _offsets(self.fields, size)
        layout = {"names": names, "formats": formats, "offsets": offsets, "itemsize": size}
        return np.dtype(layout)  # type: ignore[call-overload]

    @property
    def packed_size(self) -> int:
        """Bytes of a row by its header."""
        return sum(np.dtype(kind).itemsize * n for _, kind, n in self.fields)


def _offsets(fields: list[tuple[str, str, int]], size: int) -> list[int]:
    """Where the named fields of a row of ``size`` bytes begin.

    By the format they lie one behind the other, with the padding between them. But padding comes
    from C structs, and is often wrong. PCL takes the size of a field for that of the field before
    it; others write 0 for all. So where padding leaves a field unaligned, these are tried in turn.
    """
    plain, by_pcl, by_compiler = list[int](), list[int](), list[int]()
    end = end_by_pcl = end_by_compiler = before = 0
    padding: int | None = None
    for name, kind, n in fields:
        width = np.dtype(kind).itemsize
        if n == 0 or name == "_":
            padding = n * width
        else:
            plain.append(end)
            if padding is not None and by_pcl:
                end_by_pcl = by_pcl[-1] + before * width + padding
            by_pcl.append(end_by_pcl)
            by_compiler.append(-(-end_by_compiler // width) * width)
            end_by_pcl = by_pcl[-1] + n * width
            end_by_compiler = by_compiler[-1] + n * width
            before, padding = n, None
        end += n * width
    named = [(np.dtype(kind).itemsize, n) for name, kind, n in fields if n and name != "_"]
    if len(named) < len(fields):
        for offsets in (plain, by_pcl, by_compiler):
            ends = [begin + width * n for begin, (width, n) in zip(offsets, named, strict=True)]
            apart = all(a <= b for a, b in zip(ends, [*offsets[1:], size], strict=True))
            if apart and not any(b % w for b, (w, _) in zip(offsets, named, strict=True)):
                return offsets
    return plain


def read_pcd(path: Path) -> tuple[NDArray[Any], PcdHeader]:
    """Rows and header of a PCD file.

    Returns
    -------
    structured ndarray, shape (n,)
        A field for each field of the file.
    PcdHeader

    Raises
    ------
    PcdError
        The file is no PCD file or damaged.
    MissingExtraError
        It is compressed, and the library that decompresses it is missing.
    """
    content = read_file(path)
    header = _parse_header(content)
    body = content[header.size :]
    if header.data == "ascii":
        return _read_text(body, header), header
    if header.data == "binary":
        return _read_binary(body, header), header
    return _read_compressed(body, header), header


def write_pcd(
    path: Path,
    points: NDArray[np.float32],
    intensity: NDArray[np.float32],
    viewpoint: NDArray[np.float64],
) -> None:
    """Write points with an intensity, binary.

    Parameters
    ----------
    points : ndarray of float32, shape (N, 3)
    intensity : ndarray of float32, shape (N,)
    viewpoint : ndarray of float64, shape (7,)
        Where the sensor was: tx ty tz qw qx qy qz.
    """
    rows = np.column_stack([points, intensity]).astype("<f4")
    lines = (
        "# .PCD v0.7 - Point Cloud Data file format", "VERSION 0.7", "FIELDS x y z intensity",
        "SIZE 4 4 4 4", "TYPE F F F F", "COUNT 1 1 1 1", f"WIDTH {len(rows)}", "HEIGHT 1",
        f"VIEWPOINT {' '.join(f'{value:.12g}' for value in viewpoint)}",
        f"POINTS {len(rows)}", "DATA binary", "",
    )  # fmt: skip
    content = "\n".join(lines).encode() + rows.tobytes()
    write_atomically(path, content)


def read_pcd_header(path: Path) -> PcdHeader:
    """The header alone."""
    with open_file(path) as stream:
        return _parse_header(stream.read(1 << 14))


def _parse_header(content: bytes) -> PcdHeader:
    entries: dict[str, list[str]] = {}
    position = 0
    for _ in range(_MOST_LINES):
        end = content.find(b"\n", position)
        if end < 0:
            break
        words = content[position:end].decode("latin-1").split("#")[0].split()
        position = end + 1
        if words:
            entries[words[0].upper()] = words[1:]
        if words and words[0].upper() == "DATA":
            break
    if not {"FIELDS", "SIZE", "TYPE", "DATA"} <= entries.keys():
        raise PcdError("has no header of a PCD file (FIELDS, SIZE, TYPE, DATA)")
    try:
        return _header_of(entries, position)
    except (KeyError, IndexError, ValueError) as error:
        raise PcdError(f"has a header that contradicts itself ({error})") from None


def _header_of(entries: dict[str, list[str]], size: int) -> PcdHeader:
    names = entries["FIELDS"]
    counts = [int(n) for n in entries.get("COUNT", ["1"] * len(names))]
    kinds = [
        _TYPES[kind.upper()][int(width)]
        for kind, width in zip(entries["TYPE"], entries["SIZE"], strict=True)
    ]
    unique = [
        name if name == "_" or names.count(name) == 1 else f"{name}{k}"
        for k, name in enumerate(names)
    ]
    shape = [int(entries[key][0]) for key in ("WIDTH", "HEIGHT") if key in entries]
    count = int(entries["POINTS"][0]) if "POINTS" in entries else math.prod(shape)
    if len(shape) == 2 and math.prod(shape) != count:
        raise ValueError(f"WIDTH {shape[0]}, HEIGHT {shape[1]}, POINTS {count}")
    viewpoint = np.array(entries.get("VIEWPOINT", ["0", "0", "0", "1", "0", "0", "0"]), np.float64)
    data = entries["DATA"][0].lower()
    if viewpoint.shape != (7,) or count < 0:
        raise ValueError("VIEWPOINT or POINTS")
    if min(counts, default=0) < 0 or max(counts, default=0) > _MOST_VALUES or not any(counts):
        raise ValueError(f"COUNT {entries.get('COUNT', [])}")
    if len(names) > _MOST_VALUES:
        raise ValueError(f"{len(names)} FIELDS")
    if data not in ("ascii", "binary", "binary_compressed"):
        raise ValueError(f"DATA {data}")
    return PcdHeader(list(zip(unique, kinds, counts, strict=True)), count, viewpoint, data, size)


def _read_text(body: bytes, header: PcdHeader) -> NDArray[Any]:
    # PCL names padding in the header, and writes none.
    columns = [sum(n for _, _, n in fields) for fields in (header.fields, header.named)]
    lines = [words for line in body.split(b"\n") if (words := line.split())]
    if len(lines) != header.count:
        raise PcdError(f"holds {len(lines)} of {header.count} points")
    fields = header.named if lines and len(lines[0]) == columns[1] else header.fields
    wanted = sum(n for _, _, n in fields)
    for k, words in enumerate(lines):
        if len(words) != wanted:
            raise PcdError(f"holds {len(words)} values for point {k}, not {wanted}")
    rows = np.empty(header.count, header.dtype())
    table = np.array(lines).reshape(header.count, wanted)
    begin = 0
    for name, kind, n in fields:
        try:
            if name in (rows.dtype.names or ()):
                part = table[:, begin] if n == 1 else table[:, begin : begin + n]
                rows[name] = parse_numbers(part, kind)
        except ArrayError as error:
            raise PcdError(f"holds a value of {name} that is no number ({error})") from None
        begin += n
    return rows


def _read_binary(body: bytes, header: PcdHeader) -> NDArray[Any]:
    count, size = header.count, header.packed_size
    untold = count and any(n == 0 for _, _, n in header.fields)
    if untold and body[count * size :].strip(b"\0"):
        size = len(body) // count  # of a C struct whose padding the header does not tell
    if len(body) < count * size:
        raise PcdError(f"is truncated: it holds {len(body) // size} of {count} points")
    rest = body[count * size :]
    if len(rest) > _MOST_ZEROS or rest.strip(b"\0\r\n"):
        raise PcdError(f"holds {len(rest)} bytes more than its {count} points")
    return np.frombuffer(body, header.dtype(size), count).copy()


def _read_compressed(body: bytes, header: PcdHeader) -> NDArray[Any]:
    """Compressed by LZF, one field after the other."""
    try:
        import lzf
    except ImportError:
        raise MissingExtraError(
            "compressed PCD files need python-neo-lzf: pip install 'docdepth[clouds]'"
        ) from None
    if len(body) < 8:
        raise PcdError("is truncated")
    packed, whole = struct.unpack_from("<II", body)
    if len(body) < 8 + packed or whole < header.count * header.packed_size:
        raise PcdError(f"is truncated: {len(body) - 8} of {packed} bytes are there")
    if whole > _MOST_PACKED * packed:  # before memory is taken
        raise PcdError(f"is damaged: {packed} bytes cannot hold {whole}")
    try:
        unpacked = lzf.decompress(body[8 : 8 + packed], whole) if packed else b""
    except ValueError:  # pypcd4 stores what does not become smaller as it is
        unpacked = body[8 : 8 + packed] if packed == whole else None
    if unpacked is None or len(unpacked) != whole:
        raise PcdError("is damaged: it cannot be decompressed")
    rows = np.empty(header.count, header.dtype())
    begin = 0
    for name, kind, n in header.fields:
        values = np.frombuffer(unpacked, kind, header.count * n, begin)
        begin += values.nbytes
        if name in (rows.dtype.names or ()):
            rows[name] = values if n == 1 else values.reshape(header.count, n)
    return rows
