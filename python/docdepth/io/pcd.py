"""Point clouds of the Point Cloud Library (``.pcd``), versions 0.6 and 0.7."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth.errors import MissingExtraError
from docdepth.io.atomic import write_atomically

_TYPES = {
    "F": {4: "<f4", 8: "<f8"},
    "U": {1: "u1", 2: "<u2", 4: "<u4", 8: "<u8"},
    "I": {1: "i1", 2: "<i2", 4: "<i4", 8: "<i8"},
}
_MOST_LINES = 100  # of a header
_MOST_VALUES = 1 << 12  # of a field of one point, and fields
_MOST_PACKED = 300  # times as large as its compressed bytes; LZF packs 264 bytes into 3


class PcdError(ValueError):
    """What is wrong with a PCD file, without its name."""


@dataclass(frozen=True)
class PcdHeader:
    """The header of a PCD file.

    Attributes
    ----------
    fields : list of (str, str, int)
        Name, type in numpy's letters, and values a point; 0 values are padding.
    count : int
        Points.
    viewpoint : ndarray of float64, shape (7,)
        Where the sensor was: tx ty tz qw qx qy qz.
    data : str
        ``ascii``, ``binary`` or ``binary_compressed``.
    size : int
        Bytes of the header.
    """

    fields: list[tuple[str, str, int]]
    count: int
    viewpoint: NDArray[np.float64]
    data: str
    size: int

    def dtype(self, align: bool = False) -> np.dtype[Any]:
        """Of a row; padding has no field."""
        shapes = [(name, kind, (n,)) if n > 1 else (name, kind) for name, kind, n in self.fields]
        kept = [shape for shape, (_, _, n) in zip(shapes, self.fields, strict=True) if n]
        return np.dtype(kept, align=align)


def read_pcd(path: Path) -> tuple[NDArray[Any], PcdHeader]:
    """Rows and header of a PCD file.

    Parameters
    ----------
    path : Path

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
    content = path.read_bytes()
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
    path : Path
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
    write_atomically(path, lambda stream: stream.write(content))


def read_pcd_header(path: Path) -> PcdHeader:
    """The header alone.

    Raises
    ------
    PcdError
        The file is no PCD file.
    """
    with path.open("rb") as stream:
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
    kinds = [_TYPES[t][int(s)] for t, s in zip(entries["TYPE"], entries["SIZE"], strict=True)]
    unique = [name if names.count(name) == 1 else f"{name}{k}" for k, name in enumerate(names)]
    shape = [int(entries[key][0]) for key in ("WIDTH", "HEIGHT") if key in entries]
    count = int(entries["POINTS"][0]) if "POINTS" in entries else int(np.prod(shape))
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
    dtype = header.dtype()
    columns = sum(n for _, _, n in header.fields)
    words = np.array(body.split())
    if len(words) != header.count * columns:
        raise PcdError(f"holds {len(words)} numbers for {header.count} points of {columns}")
    rows = np.empty(header.count, dtype)
    table = words.reshape(header.count, columns)
    begin = 0
    for name, kind, n in header.fields:
        try:
            if n:
                part = table[:, begin] if n == 1 else table[:, begin : begin + n]
                rows[name] = part.astype(kind)
        except (ValueError, OverflowError) as error:
            raise PcdError(f"holds a value of {name} that is no number ({error})") from None
        begin += n
    return rows


def _read_binary(body: bytes, header: PcdHeader) -> NDArray[Any]:
    dtype = header.dtype()
    if any(n == 0 for _, _, n in header.fields) and header.count:
        # Written from a C struct: fields lie on their natural alignment, and rows may be longer.
        dtype = header.dtype(align=True)
        step = len(body) // header.count
        if len(body) % header.count == 0 and step > dtype.itemsize:
            offsets = [dtype.fields[name][1] for name in dtype.names or ()]  # type: ignore[index]
            formats = [dtype[name] for name in dtype.names or ()]
            dtype = np.dtype(
                {"names": list(dtype.names or ()), "formats": formats, "offsets": offsets,
                 "itemsize": step}
            )  # fmt: skip
    if len(body) < header.count * dtype.itemsize:
        raise PcdError(
            f"is truncated: it holds {len(body) // dtype.itemsize} of {header.count} points"
        )
    return np.frombuffer(body, dtype, header.count).copy()


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
    dtype = header.dtype()
    if len(body) < 8 + packed or whole < header.count * dtype.itemsize:
        raise PcdError(f"is truncated: {len(body) - 8} of {packed} bytes are there")
    if whole > _MOST_PACKED * packed:  # before memory is taken
        raise PcdError(f"is damaged: {packed} bytes cannot hold {whole}")
    try:
        unpacked = lzf.decompress(body[8 : 8 + packed], whole) if packed else b""
    except ValueError:
        unpacked = None
    if unpacked is None or len(unpacked) != whole:
        raise PcdError("is damaged: it cannot be decompressed")
    rows = np.empty(header.count, dtype)
    begin = 0
    for name, kind, n in header.fields:
        values = np.frombuffer(unpacked, kind, header.count * n, begin)
        begin += values.nbytes
        if n:
            rows[name] = values if n == 1 else values.reshape(header.count, n)
    return rows
