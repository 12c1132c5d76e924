"""Pairs of images and sweeps on disk: which belong together, and the points of a sweep."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets import kitti_lidar
from docdepth.datasets.files import read_bytes
from docdepth.datasets.point_format import foreign_format
from docdepth.errors import DatasetError, RunError
from docdepth.io.ply import read_vertices

Floats = NDArray[np.float64]

IMAGES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")
SWEEPS = (".pcd", ".ply", ".npy", ".bin")

_NEAREST = 0.3  # metres; nearer returns are of the sensor itself, or zeros for no return
_REMEDY = "copy the sweep again"


@dataclass(frozen=True)
class BoardSweep:
    """The usable returns of one sweep.

    Attributes
    ----------
    points : ndarray of float64, shape (N, 3)
        LiDAR frame [m].
    origins : ndarray of float64, shape (N, 3)
        Where the ray of each return begins, LiDAR frame [m].
    """

    points: Floats
    origins: Floats

    @cached_property
    def ranges(self) -> Floats:
        """Distance of each return from the origin, shape (N,) [m]."""
        return np.asarray(np.linalg.norm(self.points, axis=1))

    @cached_property
    def directions(self) -> Floats:
        """Unit vector from the origin to each return, shape (N, 3)."""
        return np.asarray(self.points / self.ranges[:, None])

    def around(self, place: Floats, radius: float) -> BoardSweep:
        """The returns whose line of sight passes a place (3,) at less than ``radius`` [m]."""
        away = float(np.linalg.norm(place))
        if away <= radius:
            return self
        rows = self.directions @ (place / away) > np.sqrt(1.0 - (radius / away) ** 2)
        return BoardSweep(self.points[rows], self.origins[rows])


@dataclass(frozen=True)
class Pair:
    """An image and a sweep of the same still board."""

    image: Path
    sweep: Path

    @property
    def name(self) -> str:
        return self.image.stem


def find_pairs(images: Path, sweeps: Path) -> list[Pair]:
    """Pair the images and the sweeps of two folders in order of their names.

    Parameters
    ----------
    images, sweeps : Path
        A folder each, or a pattern of names in one, such as ``pcd/*_full.pcd``.

    Raises
    ------
    DatasetError
        A folder is empty, the numbers of files differ, or the names hold other numbers.
    """
    seen, swept = _files(images, IMAGES, "images"), _files(sweeps, SWEEPS, "sweeps")
    numbers = [[_number(file) for file in files] for files in (seen, swept)]
    told = (
        all(None not in found and len(set(found)) == len(found) for found in numbers)
        and len(seen) + len(swept) > 2
    )
    if told:
        alone = [f for f, n in zip(seen, numbers[0], strict=True) if n not in numbers[1]]
        alone += [f for f, n in zip(swept, numbers[1], strict=True) if n not in numbers[0]]
        if alone:
            names = ", ".join(file.name for file in alone[:4])
            more = f" and {len(alone) - 4} more" if len(alone) > 4 else ""
            raise DatasetError(
                f"{names}{more} of {images} and {sweeps} have no partner of the same number; "
                "remove them, or give files that belong together the same number"
            )
    if len(seen) != len(swept):
        raise DatasetError(
            f"{images} has {len(seen)} images and {sweeps} {len(swept)} sweeps; they are paired in "
            "order of their names, so there must be one sweep for each image"
        )
    return [Pair(image, sweep) for image, sweep in zip(seen, swept, strict=True)]


def read_board_sweep(file: Path) -> BoardSweep:
    """The usable returns of a sweep: PCD (text), PLY, NPY, or BIN as KITTI has it.

    The rays of KITTI's LiDAR begin at its lasers, those of any other at the origin.

    Raises
    ------
    DatasetError
        The file cannot be read.
    """
    points = _READERS[file.suffix.lower()](file)
    if points.ndim != 2 or points.shape[1] < 3:
        raise DatasetError(f"{file} has shape {points.shape}, not (N, 3) or more; {_REMEDY}")
    points = points[:, :3].astype(np.float64)
    with np.errstate(invalid="ignore"):
        usable = np.isfinite(points).all(axis=1) & (np.linalg.norm(points, axis=1) > _NEAREST)
    points = points[usable]
    if not len(points):
        raise DatasetError(f"{file} holds no point farther than {_NEAREST} m; {_REMEDY}")
    return BoardSweep(points, ray_origins(points))


def ray_origins(points: Floats) -> Floats:
    """Where the rays of points (N, 3) begin: at KITTI's lasers if they are of it, else at zero."""
    origins = np.zeros_like(points)
    single = points.astype(np.float32)
    if not kitti_lidar.is_kitti_lidar([single]):
        return origins
    rig = kitti_lidar.sensor_rig(single)
    origins[:, 2] = rig.T_lidar_sensor[rig.index, 2, 3]
    along = points[:, :2] / np.maximum(np.linalg.norm(points[:, :2], axis=1), _NEAREST)[:, None]
    lateral = rig.lateral_offset[rig.index]
    origins[:, 0], origins[:, 1] = -lateral * along[:, 1], lateral * along[:, 0]
    return origins


def _files(place: Path, suffixes: tuple[str, ...], what: str) -> list[Path]:
    """Files of a folder or a pattern, in order of the numbers in their names."""
    found = place.iterdir() if place.is_dir() else place.parent.glob(place.name)
    shown = (f for f in found if f.suffix.lower() in suffixes and not f.name.startswith("."))
    files = sorted(shown, key=lambda file: (_numbers(file), file.name))
    if not files:
        raise DatasetError(
            f"{place} holds no {what} ({', '.join(suffixes)}); give a folder, or a pattern in "
            "quotation marks"
        )
    return files


def _numbers(file: Path) -> list[int]:
    return [int(digits) for digits in re.findall(r"\d+", file.stem)]


def _number(file: Path) -> int | None:
    """The only number in a name; None if there is none or several."""
    numbers = _numbers(file)
    return numbers[0] if len(numbers) == 1 else None


def _read_bin(file: Path) -> Floats:
    content = read_bytes(file, _REMEDY)
    foreign = foreign_format(content)
    if len(content) % 16 or foreign:
        raise DatasetError(
            f"{file} is not x y z reflectance as 4 float32 a point"
            f"{f', it looks like {foreign}' if foreign else ''}; convert it to NPY or PCD"
        )
    return np.frombuffer(content, "<f4").reshape(-1, 4)


def _read_npy(file: Path) -> Floats:
    try:
        return np.asarray(np.load(file, allow_pickle=False))
    except (OSError, ValueError) as error:
        raise DatasetError(f"{file} is not a readable array ({error}); {_REMEDY}") from None


def _read_ply(file: Path) -> Floats:
    try:
        rows = read_vertices(file)[0]
        return np.stack([rows[axis] for axis in "xyz"], axis=1)
    except (RunError, ValueError) as error:
        raise DatasetError(f"{file} is not a PLY of points with x, y and z ({error})") from None


def _read_pcd(file: Path) -> Floats:
    """A PCD of text. Others go through the loaders of point clouds."""
    header, marker, rows = read_bytes(file, _REMEDY).partition(b"DATA ascii")
    fields = re.search(rb"^FIELDS (.*)$", header, re.MULTILINE)
    if not marker or fields is None:
        raise DatasetError(f"{file} is not a PCD of text (DATA ascii); convert it to PCD text, PLY")
    names = fields[1].split()
    try:
        table = np.array(rows.split(), np.float64).reshape(-1, len(names))
        return table[:, [names.index(axis) for axis in (b"x", b"y", b"z")]]
    except ValueError as error:
        raise DatasetError(f"{file} is damaged ({error}); {_REMEDY}") from None


_READERS = {".pcd": _read_pcd, ".npy": _read_npy, ".ply": _read_ply, ".bin": _read_bin}
