"""One sweep of one LiDAR as a file or message holds it, and what reads them.

Which format the rows of a file have is told from its numbers alone. docdepth reads ``x y z
reflectance`` as 4 float32. Read so, a file of another format is a cloud of garbage. Columns of a
table have values of their own: heights spread less than distances, reflectances are not negative.
Cut into rows of a wrong length, every column holds a mixture of all and they look alike. That holds
for any sensor and any order of the rows.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.base import LidarStream
from docdepth.datasets.files import library_errors, read_bytes
from docdepth.datasets.point_times import FIELD_NAMES as TIME_NAMES
from docdepth.errors import DatasetError

INTENSITY_NAMES = ("intensity", "i", "reflectivity", "reflectance", "remission", "signal")
RING_NAMES = ("ring", "channel", "laser_number", "laser_id", "line", "beam")

_FEWEST_POINTS = 200  # fewer tell nothing
_MOST_VALUES = 400_000  # of a file; more take time and tell no more
_ALIKE = 0.1  # of columns in rows of a wrong length; recorded sweeps stay below 0.04
_DISTINCT = 0.25  # of columns in rows of the right length; recorded sweeps have 0.37 and more
_PLAUSIBLE = (1e-7, 1e5)  # magnitude of a number that is a coordinate or a reflectance
_DOUBLES = 0.99  # share of plausible numbers in a file of float64, read as such
_NO_FLOATS = 0.9  # and read as float32: the low halves of doubles are random bits
_MOST_ROUNDED = 0.05  # metres between neighbouring numbers; depth and labels need centimetres

_NAMES = {
    3: "3 float32 a point (x y z)",
    4: "4 float32 a point (KITTI)",
    5: "5 float32 a point (nuScenes)",
    6: "6 float32 a point",
    7: "7 float32 a point",
}


@dataclass(frozen=True)
class Cloud:
    """The points of one LiDAR, a row for each row of the file."""

    # (N, 3): Metres. Doubles are kept until points of the world are brought to the LiDAR frame
    points: NDArray[Any]
    intensity: NDArray[np.float32] | None = None  # (N,)
    ring: NDArray[np.uint16] | None = None  # (N,)
    times: NDArray[Any] | None = None  # (N,): As recorded, in any unit


class LidarReader(Protocol):
    """Reads the sweeps of one LiDAR, in any order and from any thread."""

    @property
    def stream(self) -> LidarStream: ...

    def read(self, index: int) -> Cloud:
        """Own sweep ``index``; errors name file and frame."""
        ...

    def files(self, index: int) -> list[Path]:
        """The files that ``read(index)`` reads."""
        ...


@dataclass(frozen=True)
class FileLidar:
    """A LiDAR whose sweeps are a file each."""

    stream: LidarStream
    sweeps: list[Path]
    # ``read_file(file, where)`` reads a sweep; ``where`` names file and frame in errors. A function
    # of a module, so that datasets can be sent to other processes
    read_file: Callable[[Path, str], Cloud]

    def read(self, index: int) -> Cloud:
        """Own sweep ``index``."""
        where = f"{self.sweeps[index]} (frame {index})"
        with library_errors(where, "copy the sweep again"):
            return self.read_file(self.sweeps[index], where)

    def files(self, index: int) -> list[Path]:
        """The file of own sweep ``index``."""
        return [self.sweeps[index]]


def packed(**fields: str) -> np.dtype[Any]:
    """Rows of these fields without gaps, little endian: ``packed(x="f4", ring="u2")``."""
    return np.dtype([(name, f"<{kind}") for name, kind in fields.items()])


def read_rows(file: Path, where: str, rows: np.dtype[Any], remedy: str) -> NDArray[Any]:
    """Rows of fixed fields, which a file is full of."""
    content = read_bytes(file, remedy, where)
    if not content:
        raise DatasetError(f"{where} is empty; {remedy}")
    if len(content) % rows.itemsize:
        raise DatasetError(
            f"{where} has {len(content)} bytes, which is not a multiple of {rows.itemsize} "
            f"({' '.join(rows.names or ())}): it is truncated or has other columns; {remedy}"
        )
    return np.frombuffer(content, rows)


def rows_of(columns: Mapping[str, NDArray[Any]]) -> NDArray[Any]:
    """Rows with a field for each column."""
    types = [(name, column.dtype) for name, column in columns.items()]
    rows = np.empty(len(next(iter(columns.values()), ())), types)
    for name, column in columns.items():
        rows[name] = column
    return rows


def joined_columns(columns: Sequence[NDArray[Any] | None]) -> NDArray[Any] | None:
    """One column of several; None unless all are there."""
    present = [column for column in columns if column is not None]
    return np.concatenate(present) if len(present) == len(columns) else None


def cloud_from_fields(rows: NDArray[Any], where: str) -> Cloud:
    """A cloud from rows with named fields x, y and z; ``where`` names file and frame.

    Intensity, ring and time have any of their usual names.
    """
    # CloudCompare writes scalar_ before the names of what are no coordinates.
    names = {name.lower().removeprefix("scalar_"): name for name in rows.dtype.names or ()}
    lacking = [axis for axis in "xyz" if axis not in names]
    if lacking:
        raise DatasetError(
            f"{where} has no field {lacking[0]}, only {', '.join(names) or 'none'}; points need "
            "x, y and z in metres; rename its fields, or say columns of a text in docdepth.yaml"
        )
    xyz = [rows[names[axis]] for axis in "xyz"]
    if any(column.ndim != 1 for column in xyz):
        raise DatasetError(
            f"{where} has several values of x, y or z in a row; write one point a row"
        )
    if strange := [str(column.dtype) for column in xyz if column.dtype.kind not in "fiu"]:
        raise DatasetError(
            f"{where} holds x, y and z as {strange[0]}; write them as numbers in metres"
        )
    doubles = any(column.dtype.itemsize > 4 for column in xyz)
    points = np.stack([np.asarray(c, np.float64 if doubles else np.float32) for c in xyz], axis=-1)
    _check_rounding(points, where)
    # Drivers find ever new names; values that are no times of a sweep are refused later.
    alike = [name for name in names if "time" in name or "stamp" in name]
    intensity = _first(rows, names, INTENSITY_NAMES)
    ring = _first(rows, names, RING_NAMES)
    return Cloud(
        np.ascontiguousarray(points),
        None if intensity is None else np.ascontiguousarray(intensity, np.float32),
        None if ring is None else rings(ring),
        _times(rows, names, (*TIME_NAMES, *alike)),
    )


def _check_rounding(points: NDArray[Any], where: str) -> None:
    """Refuse coordinates of a map that were rounded when they were written as float32."""
    if points.dtype != np.float32:
        return
    # Of most points: returns that are none may hold any number.
    some = points[:: max(1, len(points) // _FEWEST_POINTS)]
    some = some[np.isfinite(some).all(axis=1)]
    rounded = float(np.spacing(np.median(np.abs(some), axis=0)).max()) if len(some) else 0.0
    if rounded > _MOST_ROUNDED:
        raise DatasetError(
            f"{where}: coordinates are rounded to {rounded:g} m: float32 has no more digits so far "
            "from the origin; write them as float64, or from an origin near the drive"
        )


def _first(rows: NDArray[Any], names: dict[str, str], wanted: Sequence[str]) -> NDArray[Any] | None:
    """The first of the wanted fields that is there."""
    found = next((names[name] for name in wanted if name in names), None)
    return None if found is None or rows[found].ndim != 1 else np.ascontiguousarray(rows[found])


def _times(rows: NDArray[Any], names: dict[str, str], wanted: Sequence[str]) -> NDArray[Any] | None:
    """The first field of times that changes: drivers also keep one that they never fill."""
    found = [times for n in wanted if (times := _first(rows, names, [n])) is not None]
    return next((times for times in found if (times != times[:1]).any()), next(iter(found), None))


def rings(values: NDArray[Any]) -> NDArray[np.uint16]:
    """Numbers of lasers, which some drivers give as floats, NaN where nothing returned."""
    whole = np.nan_to_num(values, nan=0, posinf=0, neginf=0) if values.dtype.kind == "f" else values
    return np.clip(whole, 0, 0xFFFF).astype(np.uint16)


def foreign_format(content: bytes, columns: int = 4) -> str | None:
    """The format of the content of a sweep file that is not so many float32 a point.

    For example ``5 float32 a point (nuScenes)``; None for the right format, and where no other
    format clearly fits better.
    """
    floats = np.frombuffer(content, "<f4", len(content) // 4)
    if len(floats) < 4 * _FEWEST_POINTS:
        return None
    doubles = np.frombuffer(content, "<f8", len(content) // 8)
    if _plausible(floats) < _NO_FLOATS:
        if _plausible(floats.byteswap()) > _DOUBLES:
            return "float32 of the other byte order (big-endian)"
        if len(content) % 8 == 0 and _plausible(doubles) > _DOUBLES:
            for values, names in ((4, "x y z reflectance"), (3, "x y z")):
                if len(doubles) % values == 0 and _distinction(doubles, values) > _DISTINCT:
                    return f"{values} float64 a point ({names})"
            return "float64"
    if not np.isfinite(floats).all() or _distinction(floats, columns) > _ALIKE:
        return None
    fits = {c: _distinction(floats, c) for c in _NAMES if c != columns and len(floats) % c == 0}
    if fits.get(6, 0) > _DISTINCT:
        fits.pop(3, None)  # rows of six are distinct in threes, but not the other way round
    best = max(fits, key=lambda columns: fits[columns], default=0)
    return _NAMES[best] if best and fits[best] > _DISTINCT else None


def _plausible(values: NDArray[np.floating]) -> float:
    """Share of numbers that may be coordinates or reflectances; NaN is no return."""
    magnitude = np.abs(values[~np.isnan(values)])
    good = (magnitude == 0) | ((magnitude > _PLAUSIBLE[0]) & (magnitude < _PLAUSIBLE[1]))
    return float(good.mean()) if len(good) else 0.0


def _distinction(values: NDArray[np.floating], columns: int) -> float:
    """How much columns differ when the values are cut into rows: 0 alike, 1 without overlap.

    Of an even number of columns those half a row apart are compared, as these are alike also where
    the true number shares a factor with it. Otherwise x and y are compared with z.
    """
    rows = min(len(values), _MOST_VALUES) // columns
    table = values[: rows * columns].reshape(rows, columns)
    half = columns // 2
    pairs = [(0, 2), (1, 2)] if columns % 2 else [(j, j + half) for j in range(half)]
    return max(_distance(table[:, a], table[:, b]) for a, b in pairs)


def _distance(a: NDArray[np.floating], b: NDArray[np.floating]) -> float:
    """Largest difference of the two distributions (Kolmogorov and Smirnov)."""
    a, b = np.sort(a), np.sort(b)
    values = np.concatenate([a, b])
    share_a = np.searchsorted(a, values, "right") / len(a)
    share_b = np.searchsorted(b, values, "right") / len(b)
    return float(np.abs(share_a - share_b).max())
