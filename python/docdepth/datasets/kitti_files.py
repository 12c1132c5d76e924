"""Files that KITTI's raw and odometry recordings share: sweeps, calibration, images."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from contextlib import nullcontext
from decimal import Decimal
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.base import LidarStream
from docdepth.datasets.cloud import Cloud, FileLidar, foreign_format, packed, read_rows
from docdepth.datasets.files import (
    files_of,
    first_readable,
    read_bytes,
    read_image,
    read_lines,
    suggest_skipping,
)
from docdepth.errors import CalibrationError, DatasetError
from docdepth.geometry.se3 import are_rotations, if_mirrored, nearest_rotation, poses_from, rigid

_ROWS = packed(x="f4", y="f4", z="f4", reflectance="f4")
IMAGES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp", ".pgm", ".ppm")
ASKED = "the image size asked for"
_NUMBER = re.compile(r"([0-9]+(?:\.[0-9]+)?)")
_LEVER_ARM = 10.0  # metres between LiDAR and camera; on a lorry it is five


def find_sweeps(folder: Path) -> tuple[list[Path], list[DatasetError]]:
    """The ``*.bin`` sweeps of a folder in the order of :func:`in_order`, and what is broken.

    The sizes of all are looked at, and the numbers of the first: an error now is better than one an
    hour into the run. Many broken sweeps are one problem.
    """
    files = in_order(files_of(folder, ".bin"))
    if not files:
        raise DatasetError(f"{folder} holds no sweeps (*.bin); unpack the velodyne data there")
    frames = [k for k, file in enumerate(files) if _is_broken(file)]
    whole = next((k for k in range(len(files)) if k not in frames), None)
    if whole is not None:
        _check_format(files[whole], whole)
    if not frames:
        return files, []
    few = suggest_skipping if 2 * len(frames) <= len(files) else nullcontext
    more = f" (and {len(frames) - 1} more sweeps)" if len(frames) > 1 else ""
    broken: list[DatasetError] = []
    try:
        with few():
            _check_format(files[frames[0]], frames[0])
            read_sweep(files[frames[0]], f"{files[frames[0]]} (frame {frames[0]})")
    except DatasetError as error:
        broken.append(DatasetError(f"{error.text}{more}", error.remedy))
        if whole is None:
            raise broken[0] from None
    return files, broken


def lidars_of(
    sweeps: Sequence[Path],
    times: NDArray[np.int64],
    more: Sequence[tuple[Path, NDArray[np.float64]]] = (),
) -> list[FileLidar]:
    """LiDARs that measure together: the first, and folder and ``T_lidar_sensor`` of the others."""
    names = [file.stem for file in sweeps]
    first = sweeps[0].parent
    first = first.parent if first.name == "data" else first  # velodyne_points/data of KITTI raw
    found = [FileLidar(LidarStream(first.name, times, names), list(sweeps), read_sweep)]
    for folder, T in more:
        stream = LidarStream(folder.name, times, names, T)
        found.append(FileLidar(stream, [folder / file.name for file in sweeps], read_sweep))
    return found


def in_order(files: Iterable[Path]) -> list[Path]:
    """Files in order of their names, whose numbers count as such: ``img_2`` before ``img_10``.

    Hidden files are left out.
    """
    shown = [file for file in files if not file.name.startswith(".")]
    return sorted(shown, key=lambda file: (_words_and_numbers(file.stem), file))


def _words_and_numbers(name: str) -> list[str | Decimal]:
    """Words and numbers in turn, so that those of two names can be compared."""
    parts = _NUMBER.split(name)
    return [Decimal(part) if k % 2 else part for k, part in enumerate(parts)]


def read_sweep(file: Path, where: str) -> Cloud:
    """Read all rows of a sweep."""
    rows = read_rows(file, where, _ROWS, "copy the sweep again").view("<f4").reshape(-1, 4)
    return Cloud(rows[:, :3].astype(np.float32), rows[:, 3].astype(np.float32))


def _is_broken(file: Path) -> bool:
    """Whether a file is missing, empty or cut off within a row."""
    try:
        size = file.stat().st_size if file.is_file() else 0
    except OSError:
        size = 0
    return size == 0 or size % _ROWS.itemsize > 0


def _check_format(file: Path, frame: int) -> None:
    """Refuse a sweep whose rows are clearly of another format."""
    other = foreign_format(read_bytes(file, "put the sweep back", f"{file} (frame {frame})"))
    if other:
        raise DatasetError(
            f"{file} (frame {frame}) looks like {other}; docdepth reads x y z reflectance as "
            "4 float32; convert it"
        )


def match_rows(files: Sequence[Path], count: int, table: Path, what: str) -> NDArray[np.int64]:
    """Find the row of a table that belongs to each file.

    A table with as many rows as there are files is in their order. Otherwise files are missing, as
    in some of KITTI's drives, and the number in a file's name is its row.
    """
    if count == len(files):
        return np.arange(count)
    numbers = [int(f.stem) if f.stem.isascii() and f.stem.isdigit() else -1 for f in files]
    lacking = next((k for k, n in enumerate(numbers) if not 0 <= n < count), None)
    if lacking is None:
        return np.array(numbers, dtype=np.int64)
    if count < len(files):
        remedy = "restore the missing lines, or remove the files that have none"
        # Among numbers, it is a copy like "000001 (1).bin" that has none.
        odd = numbers.index(-1) if max(numbers) >= 0 > min(numbers) else count
        lacking = min(odd, max(lacking, count))
    else:
        remedy = "remove the lines of files that are not there, or name files by their line"
    raise DatasetError(
        f"{table} has {count} {what} for {len(files)} files in {files[0].parent}: none for "
        f"{files[lacking].name} (frame {lacking}); {remedy}"
    )


def check_increasing(times: NDArray[np.int64], files: Sequence[str], table: Path) -> None:
    """Refuse times that do not increase; the error names the two frames."""
    backwards = np.flatnonzero(np.diff(times) <= 0)
    if len(backwards):
        k = int(backwards[0])
        raise DatasetError(
            f"{table}: the time of frame {k + 1} ({files[k + 1]}) is not after that of frame {k} "
            f"({files[k]}): {times[k]} and {times[k + 1]} ns; sort the stamps or remove one sweep"
        )


class Calibration:
    """A KITTI calibration file with lines ``NAME: numbers``."""

    def __init__(self, file: Path, remedy: str) -> None:
        self.file = file
        try:
            lines = read_lines(file, remedy)
        except DatasetError as error:
            raise CalibrationError(str(error)) from None
        self._values: dict[str, str] = {}
        for line in lines:
            name, colon, value = (part.strip() for part in line.partition("#")[0].partition(":"))
            if colon and self._values.setdefault(name, value) != value:
                raise CalibrationError(f"{file} has two lines '{name}:'; keep the right one")

    def __contains__(self, name: str) -> bool:
        return name in self._values

    def matrix(self, name: str, *shape: int) -> NDArray[np.float64]:
        """The numbers of one line as an array of the given shape."""
        if name not in self._values:
            raise CalibrationError(f"{self.file} has no line '{name}:'; restore the file")
        try:
            values = np.array(self._values[name].split(), dtype=np.float64)
        except ValueError:
            values = np.zeros(0)
        if values.size != int(np.prod(shape)) or not np.isfinite(values).all():
            raise CalibrationError(
                f"{self.file}: '{name}:' must be {int(np.prod(shape))} finite numbers, "
                f"got '{self._values[name]}'"
            )
        return values.reshape(shape)

    def transform(self, name: str) -> NDArray[np.float64]:
        """The rigid transform (4, 4) of a line with the upper 3x4 of its matrix."""
        matrix = self.matrix(name, 3, 4)
        return self._rigid(name, matrix[:, :3], matrix[:, 3])

    def transform_of(self, rotation: str, translation: str | None = None) -> NDArray[np.float64]:
        """The rigid transform (4, 4) of a line with a rotation and one with a translation."""
        offset = np.zeros(3) if translation is None else self.matrix(translation, 3)
        names = rotation if translation is None else f"{rotation}: and {translation}"
        return self._rigid(names, self.matrix(rotation, 3, 3), offset)

    def _rigid(
        self, names: str, rotation: NDArray[np.float64], translation: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        if not are_rotations(rotation[None])[0]:
            raise CalibrationError(
                f"{self.file}: '{names}:' holds no rotation{if_mirrored(rotation)}; its rows must "
                "have length 1 and be orthogonal and right-handed; restore the file"
            )
        if (distance := float(np.linalg.norm(translation))) > _LEVER_ARM:
            raise CalibrationError(
                f"{self.file}: '{names}:' puts camera and LiDAR {distance:.1f} m apart, more than "
                f"{_LEVER_ARM:g} m; translations are in metres"
            )
        # Printed with few digits a matrix is a rotation only nearly.
        return poses_from([nearest_rotation(rotation)], [translation])[0]


def camera_offset(P: NDArray[np.float64]) -> NDArray[np.float64]:
    """Transform (4, 4) from the reference camera to the camera of a 3x4 projection P = K [I | b].

    The fourth column of P is K b. KITTI's cameras sit beside the reference camera, and b has a
    small z too.
    """
    return rigid(np.eye(3), np.linalg.solve(P[:, :3], P[:, 3]))


def image_files(folder: Path) -> list[Path]:
    """Images of a folder in the order of :func:`in_order`; none if there is no such folder."""
    return in_order(files_of(folder, *IMAGES))


def image_size(files: Sequence[Path]) -> tuple[int, int] | None:
    """Width and height of the first image in pixels; None if there is none."""
    if not files:
        return None
    image = first_readable(read_image, files)
    return image.shape[1], image.shape[0]


def agreed_size(
    whose: str, images: Sequence[Path], claims: Mapping[str, tuple[int, int] | None]
) -> tuple[int, int] | None:
    """Width and height in pixels that images and all claims have which are known."""
    sizes = {**({str(images[0]): image_size(images)} if images else {}), **claims}
    known = [(source, size) for source, size in sizes.items() if size]
    for source, (width, height) in known[1:]:
        first, size = known[0]
        if (width, height) != size:
            raise CalibrationError(
                f"{whose}: {first} is {size[0]} x {size[1]} but {source} is {width} x {height} "
                "pixels; use the calibration of these images",
                "give no `image_size`" if source == ASKED else "",
            )
    return known[0][1] if known else None
