"""Files of one sweep each: PCD, PLY, BIN, NPY, LAS, LAZ and text."""

from __future__ import annotations

import io
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.base import LidarStream
from docdepth.datasets.cloud import (
    Cloud,
    FileLidar,
    cloud_from_fields,
    foreign_format,
    read_rows,
    rows_of,
)
from docdepth.datasets.files import extra, files_of, library_errors, unreadable
from docdepth.datasets.kitti_files import in_order
from docdepth.datasets.text_clouds import read_table
from docdepth.datasets.times import times_of_names
from docdepth.errors import DamagedFileError, DatasetError, InputError, RunError
from docdepth.geometry.se3 import poses_from, quaternion_to_matrix
from docdepth.io.pcd import PcdError, read_pcd, read_pcd_header
from docdepth.io.ply import read_vertices
from docdepth.io.untrusted import MOST_PACKED, ArrayError, open_file, read_array, read_file

NANOSECOND, MICROSECOND = 1, 1000
_RECORD = 54  # bytes at least of a record with a variable length (VLR) of a LAS file
_LAS_HEADER = 227  # bytes of the shortest
_POINT_SIZES = (20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67)  # bytes of point formats 0 to 10
_BEGINNING, _OF_NUMBERS = 64, b"0123456789+-.,;eE \t\r\n"  # bytes of a file; those of a text
KITTI_COLUMNS = ("x", "y", "z", "intensity")


@dataclass(frozen=True)
class RowFormat:
    """What the rows of a file without names are, of BIN, NPY or text."""

    # names of the values of a point, ``_`` for those that mean nothing; None: not said
    said: tuple[str, ...] | None = None
    dtype: str = "float32"  # of each value in a BIN file, in numpy's words

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the values of a point."""
        return self.said or KITTI_COLUMNS


def read_cloud(file: Path, where: str, rows: RowFormat) -> Cloud:
    """Read the sweep of a file, which ``where`` names in errors.

    ``rows`` is of files that do not tell it themselves.
    """
    try:
        with _of_pcd(file, where):
            return READERS[_kind(file)](file, where, rows)
    except DamagedFileError as error:
        found = f"is damaged ({error.what})" if error.what else "is missing"
        raise DatasetError(f"{where} {found}; copy the sweep again") from None
    except RunError as error:
        raise DatasetError(f"{where}: {error}") from None


def _kind(file: Path) -> str:
    """The suffix that goes with how a file begins, else its own: people rename files."""
    with open_file(file) as stream:
        start = stream.read(8)
    fitting = (kind for begin, kind in _BEGINNINGS.items() if start.startswith(begin))
    return next(fitting, file.suffix.lower())


def read_viewpoint(file: Path, frame: int) -> NDArray[np.float64]:
    """The pose (4, 4) in the header of a PCD file."""
    where = f"{file} (frame {frame})"
    with _of_pcd(file, where):
        position, (w, x, y, z) = np.split(read_pcd_header(file).viewpoint, [3])
    try:
        return poses_from([quaternion_to_matrix([x, y, z, w])], [position])[0]
    except InputError:
        raise DatasetError(
            f"{where}: VIEWPOINT is no pose; it is tx ty tz qw qx qy qz with a quaternion of "
            "length 1"
        ) from None


@contextmanager
def _of_pcd(file: Path, where: str) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise unreadable(file, "put the sweep back", error, where) from None
    except PcdError as error:
        raise DatasetError(f"{where} {error}; copy the sweep again") from None


def _read_pcd(file: Path, where: str, rows: RowFormat) -> Cloud:
    return cloud_from_fields(read_pcd(file)[0], where)


def _read_ply(file: Path, where: str, rows: RowFormat) -> Cloud:
    return cloud_from_fields(read_vertices(file)[0], where)


def _read_bin(file: Path, where: str, rows: RowFormat) -> Cloud:
    content = read_file(file)
    if content and not content[:_BEGINNING].strip(_OF_NUMBERS):
        return _read_text(file, where, rows)
    step = np.dtype(rows.dtype).itemsize * len(rows.columns)
    if not content:
        raise DatasetError(f"{where} is empty; copy it again")
    if len(content) % step:
        raise DatasetError(
            f"{where} has {len(content)} bytes, which is not a multiple of {step} "
            f"({' '.join(rows.columns)} as {rows.dtype}); copy it again, or say columns and dtype "
            "in docdepth.yaml"
        )
    count = len(rows.columns)
    other = foreign_format(content, count) if np.dtype(rows.dtype) == np.float32 else None
    if other:
        raise DatasetError(
            f"{where} looks like {other}, not like {' '.join(rows.columns)} as {count} float32; "
            "say columns in docdepth.yaml"
        )
    table = np.frombuffer(content, np.dtype(rows.dtype).newbyteorder("<"))
    return cloud_from_fields(_named(table.reshape(-1, len(rows.columns)), rows, where), where)


def _read_npy(file: Path, where: str, rows: RowFormat) -> Cloud:
    try:
        table = read_array(file)
    except ArrayError as error:
        raise DatasetError(f"{where} is no array of numpy ({error}); copy it again") from None
    if table.dtype.names:
        return cloud_from_fields(table.ravel(), where)
    if table.ndim > 2:  # points lie in a grid of lasers and angles
        table = table.reshape(-1, table.shape[-1])
    return cloud_from_fields(_named(table, rows, where), where)


def _read_text(file: Path, where: str, rows: RowFormat) -> Cloud:
    names, table = read_table(file, where)
    if names is not None and not rows.said:
        if twice := next((name for name in names if name != "_" and names.count(name) > 1), None):
            raise DatasetError(f"{where} has two columns {twice}; say columns in docdepth.yaml")
        rows = RowFormat(tuple(names))
    return cloud_from_fields(_named(table, rows, where), where)


def _named(table: NDArray[Any], rows: RowFormat, where: str) -> NDArray[Any]:
    """Rows with a field for each column."""
    columns = rows.columns
    if table.ndim == 2 and table.shape[1] == 3 and not rows.said:
        columns = columns[:3]
    if table.ndim != 2 or table.shape[1] != len(columns):
        raise DatasetError(
            f"{where} has shape {table.shape}, not (points, {len(columns)}) with the columns "
            f"{' '.join(columns)}; say columns in docdepth.yaml, or write a point a row"
        )
    return rows_of({name: table[:, k] for k, name in enumerate(columns) if name != "_"})


def _read_las(file: Path, where: str, rows: RowFormat) -> Cloud:
    laspy = extra("laspy", "LAS and LAZ files need laspy and lazrs", "clouds")
    content = read_file(file)
    _check_las(content, where)
    # lazrs ends the process where it gets no memory for the chunks that a file tells of.
    if content[104:105] >= b"\x80" and _chunks(content) > len(content):
        raise DatasetError(f"{where} tells of more chunks than it has bytes; copy it again")
    # laspy goes through as many records as the header tells of, also after the end.
    if int.from_bytes(content[100:104], "little") * _RECORD > len(content):
        raise DatasetError(f"{where} tells of more records than it has bytes; copy it again")
    reason = "its records or points end early, or are none"
    with library_errors(where, "copy it again", reason), laspy.open(io.BytesIO(content)) as reader:
        header = reader.header
        room = len(content) - header.offset_to_point_data
        most = room * (MOST_PACKED if header.are_points_compressed else 1)
        if header.point_count * header.point_format.size > most:  # laspy takes memory for them
            raise DatasetError(
                f"{where} tells of {header.point_count} points, for which it has too few bytes; "
                "copy it again"
            )
        scales, offsets = header.scales, header.offsets
        if not ((scales > 0) & np.isfinite(scales + offsets)).all():
            raise DatasetError(
                f"{where}: its scales are {scales.tolist()}, its offsets {offsets.tolist()}; write "
                "it again"
            )
        las = reader.read()
    columns: dict[str, NDArray[Any]] = {axis: np.asarray(las[axis], "f8") for axis in "xyz"}
    columns["intensity"] = np.asarray(las.intensity, "f4")
    if "gps_time" in las.point_format.dimension_names:
        columns["gps_time"] = np.asarray(las.gps_time, "f8")
    for name in las.point_format.extra_dimension_names:
        columns[name.lower()] = np.asarray(las[name])
    return cloud_from_fields(rows_of(columns), where)


def _check_las(content: bytes, where: str) -> None:
    """Refuse a header of which laspy tells in its own words."""
    if content[:4] != b"LASF":
        raise DatasetError(
            f"{where} does not begin with LASF, so it is no LAS or LAZ; copy it again"
        )
    if len(content) < _LAS_HEADER:
        raise DatasetError(
            f"{where} has {len(content)} bytes, fewer than the header of a LAS; copy it again"
        )
    version, point = (content[24], content[25]), content[104] & 0x3F
    (size,) = struct.unpack_from("<H", content, 105)
    if version[0] != 1 or version[1] > 4 or point >= len(_POINT_SIZES):
        raise DatasetError(
            f"{where} is LAS {version[0]}.{version[1]} of point format {point}; write LAS 1.2 to "
            "1.4 of point format 0 to 10"
        )
    if size < _POINT_SIZES[point]:
        raise DatasetError(
            f"{where}: its points have {size} bytes, those of point format {point} "
            f"{_POINT_SIZES[point]}; write it again"
        )


def _chunks(content: bytes) -> int:
    """Number of chunks in the table of a LAZ file, whose place stands before the first point."""
    try:
        (points,) = struct.unpack_from("<I", content, 96)
        (table,) = struct.unpack_from("<q", content, points)
        if table == -1:  # of a writer that could not go back
            (table,) = struct.unpack_from("<q", content, len(content) - 8)
        return int(struct.unpack_from("<II", content, table)[1])
    except struct.error:
        return 0  # which laspy tells


READERS: dict[str, Callable[[Path, str, RowFormat], Cloud]] = {
    ".pcd": _read_pcd,
    ".ply": _read_ply,
    ".bin": _read_bin,
    ".npy": _read_npy,
    ".las": _read_las,
    ".laz": _read_las,
    ".csv": _read_text,
    ".txt": _read_text,
    ".xyz": _read_text,
    ".asc": _read_text,
}
"""A reader for each suffix in small letters."""

TEXTS = {suffix for suffix, reader in READERS.items() if reader is _read_text}
"""Suffixes of files that may hold anything else as well."""

_BEGINNINGS = {
    b"# .PCD": ".pcd",
    b"VERSION ": ".pcd",
    b"ply\n": ".ply",
    b"ply\r": ".ply",
    b"\x93NUMPY": ".npy",
    b"LASF": ".las",
}


def stamped_lidar(
    name: str,
    folder: Path,
    unit: int,
    rows: np.dtype[Any],
    cloud: Callable[[NDArray[Any], str], Cloud] = cloud_from_fields,
) -> FileLidar:
    """The LiDAR of a folder of ``STAMP.bin``, whose stamps count ``unit`` nanoseconds."""
    sweeps = in_order(files_of(folder, ".bin"))
    if not sweeps:
        raise DatasetError(f"{folder} holds no sweeps (*.bin); unpack them there")
    times = times_of_names(sweeps, unit, "names of sweeps are stamps; remove what is none")
    stream = LidarStream(name, times, [sweep.stem for sweep in sweeps])
    return FileLidar(stream, sweeps, partial(read_stamped, rows=rows, cloud=cloud))


def read_stamped(
    file: Path,
    where: str,
    rows: np.dtype[Any],
    cloud: Callable[[NDArray[Any], str], Cloud],
) -> Cloud:
    """A cloud of the rows of a file."""
    return cloud(read_rows(file, where, rows, "copy the sweep again"), where)
