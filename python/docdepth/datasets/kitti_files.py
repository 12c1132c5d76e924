"""Files that KITTI's raw and odometry recordings share: sweeps, labels, calibration, images."""

from __future__ import annotations

import re
import stat
from collections.abc import Iterable, Iterator, Sequence
from contextlib import nullcontext, suppress
from decimal import Decimal
from functools import cached_property, partial
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from docdepth.datasets import kitti_lidar
from docdepth.datasets.base import DatasetRepr, LidarStream
from docdepth.datasets.files import (
    is_there,
    read_bytes,
    read_image,
    read_lines,
    settings_file,
    unreadable,
)
from docdepth.datasets.point_format import foreign_format
from docdepth.datasets.readable_frames import (
    are_broken_frames_tolerated,
    first_readable,
    readable,
    suggest_skipping,
)
from docdepth.errors import CalibrationError, Collector, DatasetError
from docdepth.geometry.se3 import are_rotations, nearest_rotation, poses_from

_POINT_BYTES = 16  # x y z reflectance, float32
_NUMBER = re.compile(r"([0-9]+(?:\.[0-9]+)?)")
_LEVER_ARM = 10.0  # metres between LiDAR and camera; on a lorry it is five


def find_sweeps(folder: Path, problems: Collector) -> list[Path]:
    """The ``*.bin`` sweeps of a folder in the order of :func:`in_order`.

    Broken sweeps are added to the problems: an error now is better than one an hour into the run.
    Many of a kind are one problem.
    """
    files = in_order(folder.glob("*.bin"))
    with problems.collected():
        if not files:
            raise DatasetError(f"{folder} holds no sweeps (*.bin); unpack the velodyne data there")
    if are_broken_frames_tolerated():
        if files:
            with problems.collected():
                readable(lambda k: _check_sweep(files[k], k), [0], len(files))
        return files
    sizes = np.array([_file_size(file) for file in files], np.int64)
    kinds = (sizes < 0, sizes == 0, (sizes > 0) & (sizes % _POINT_BYTES > 0))
    for frames in (np.flatnonzero(kind).tolist() for kind in kinds):
        few = suggest_skipping if 2 * len(frames) <= len(files) else nullcontext
        with problems.collected(), few():
            if frames:
                first = frames[0]
                error = _bad_size(files[first], first, int(sizes[first]))
                raise _with_more(error, len(frames) - 1)
    if not problems.errors:
        with problems.collected():
            _check_format(files[0], 0)
    return files


def lidars(
    sweeps: Sequence[Path],
    times: NDArray[np.int64],
    more: Sequence[tuple[Path, NDArray[np.float64]]] = (),
) -> dict[str, LidarStream]:
    """LiDARs that measure together: the first, and folder and ``T_lidar_sensor`` of the others."""
    names = [file.stem for file in sweeps]
    first = sweeps[0].parent if sweeps else Path("velodyne")
    if first.name == "data":  # velodyne_points/data of KITTI raw
        first = first.parent
    every = [(first, np.eye(4)), *more]
    return {folder.name: LidarStream(folder.name, times, names, T) for folder, T in every}


def in_order(files: Iterable[Path]) -> list[Path]:
    """Files in order of their names, whose numbers count as such: ``img_2`` before ``img_10``.

    Hidden files are left out: other systems put ``._000000.bin`` beside each file that they copy.
    """
    shown = [file for file in files if not file.name.startswith(".")]
    return sorted(shown, key=lambda file: (_words_and_numbers(file.stem), file))


def _words_and_numbers(name: str) -> list[str | Decimal]:
    """Words and numbers in turn, so that those of two names can be compared."""
    parts = _NUMBER.split(name)
    return [Decimal(part) if k % 2 else part for k, part in enumerate(parts)]


def _is_number(text: str) -> bool:
    return text.isascii() and text.isdigit()


def read_sweep(file: Path, frame: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Read all rows of a sweep: points (N, 3) in metres and intensities (N,), float32."""
    if not file.exists() and not file.is_symlink():
        raise DatasetError(f"{file} (frame {frame}) has gone; put the sweep back")
    content = read_bytes(file, "put the sweep back")
    if not content or len(content) % _POINT_BYTES:
        raise _bad_size(file, frame, len(content))
    rows = np.frombuffer(content, "<f4").reshape(-1, 4)
    return rows[:, :3].astype(np.float32), rows[:, 3].astype(np.float32)


def _check_sweep(file: Path, frame: int) -> None:
    read_sweep(file, frame)
    _check_format(file, frame)


def _file_size(file: Path) -> int:
    """Bytes of a file; negative if there is none."""
    try:
        status = file.stat()
    except OSError:
        return -1
    return status.st_size if stat.S_ISREG(status.st_mode) else -1


def _bad_size(file: Path, frame: int, size: int) -> DatasetError:
    if size < 0:
        return unreadable(file, "put the sweep back")
    if size == 0:
        return DatasetError(f"{file} (frame {frame}) is empty; copy the sweep again or remove it")
    try:
        _check_format(file, frame)
    except DatasetError as error:
        return error
    return DatasetError(
        f"{file} (frame {frame}) has {size} bytes, which is not a multiple of {_POINT_BYTES} "
        "(x y z reflectance): it is truncated or no KITTI sweep; copy it again"
    )


def _check_format(file: Path, frame: int) -> None:
    """Refuse a sweep whose rows are clearly of another format."""
    other = foreign_format(read_bytes(file, "put the sweep back"))
    if other:
        raise DatasetError(
            f"{file} (frame {frame}) looks like {other}; docdepth reads x y z reflectance as "
            "4 float32; convert it"
        )


def _with_more(error: DatasetError, more: int) -> DatasetError:
    return DatasetError(f"{error} (and {more} more sweeps)") if more else error


def read_labels(file: Path, sweeps: Sequence[Path], frame: int) -> NDArray[np.uint32] | None:
    """SemanticKITTI labels, uint32 (N,), of a sweep of one or more LiDARs; None without a file."""
    if not is_there(file):
        return None
    content = read_bytes(file, "copy the labels again")
    size = len(content)
    points = sum(sweep.stat().st_size // _POINT_BYTES for sweep in sweeps)
    if size != 4 * points:
        raise DatasetError(
            f"{file} (frame {frame}) has {size} bytes for a sweep of {points} points; "
            "labels are one uint32 for each point, in the order of the sweep"
        )
    return np.frombuffer(content, "<u4").astype(np.uint32)


def match_rows(files: Sequence[Path], count: int, table: Path, what: str) -> NDArray[np.int64]:
    """Find the row of a table that belongs to each file.

    A table with as many rows as there are files is in their order. Otherwise files are missing, as
    in some of KITTI's drives, and the number in a file's name is its row.

    Raises
    ------
    DatasetError
        A file has no row.
    """
    if count == len(files):
        return np.arange(count)
    numbers = [int(f.stem) if _is_number(f.stem) else -1 for f in files]
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
    """A KITTI calibration file with lines ``NAME: numbers``.

    Raises
    ------
    CalibrationError
        The file is missing or not a text file.
    """

    def __init__(self, file: Path, remedy: str) -> None:
        self.file = file
        try:
            lines = read_lines(file, remedy)
        except DatasetError as error:
            raise CalibrationError(str(error)) from None
        self._values: dict[str, str] = {}
        for line in lines:
            name, colon, value = line.partition(":")
            if colon:
                self._values[name.strip()] = value

    def __contains__(self, name: str) -> bool:
        return name in self._values

    def matrix(self, name: str, *shape: int) -> NDArray[np.float64]:
        """The numbers of one line as an array of the given shape.

        Raises
        ------
        CalibrationError
            The line is missing, or does not have that many finite numbers.
        """
        if name not in self._values:
            raise CalibrationError(f"{self.file} has no line '{name}:'; restore the file")
        try:
            values = np.array(self._values[name].split(), dtype=np.float64)
        except ValueError:
            values = np.zeros(0)
        if values.size != int(np.prod(shape)) or not np.isfinite(values).all():
            raise CalibrationError(
                f"{self.file}: '{name}:' must be {int(np.prod(shape))} finite numbers, "
                f"got '{self._values[name].strip()}'"
            )
        return values.reshape(shape)

    def transform(self, name: str) -> NDArray[np.float64]:
        """The rigid transform (4, 4) of a line with the upper 3x4 of its matrix.

        Raises
        ------
        CalibrationError
            The line is missing, holds no rotation, or a lever arm that no vehicle has.
        """
        matrix = self.matrix(name, 3, 4)
        return self._rigid(name, matrix[:, :3], matrix[:, 3])

    def transform_of(self, rotation: str, translation: str | None = None) -> NDArray[np.float64]:
        """The rigid transform (4, 4) of a line with a rotation and one with a translation.

        Raises
        ------
        CalibrationError
            As for :meth:`transform`.
        """
        offset = np.zeros(3) if translation is None else self.matrix(translation, 3)
        names = rotation if translation is None else f"{rotation}: and {translation}"
        return self._rigid(names, self.matrix(rotation, 3, 3), offset)

    def _rigid(
        self, names: str, rotation: NDArray[np.float64], translation: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        if not are_rotations(rotation[None])[0]:
            raise CalibrationError(
                f"{self.file}: '{names}:' holds no rotation: its rows must have length 1 and be "
                "orthogonal and right-handed; restore the file"
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
    result = np.eye(4)
    result[:3, 3] = np.linalg.solve(P[:, :3], P[:, 3])
    return result


def image_files(folder: Path) -> list[Path]:
    """Images of a folder in the order of :func:`in_order`; none if there is no such folder."""
    return in_order(f for f in folder.glob("*") if f.suffix.lower() in (".png", ".jpg", ".jpeg"))


def image_size(files: Sequence[Path]) -> tuple[int, int]:
    """Width and height of the first image in pixels."""
    image = first_readable(partial(read_image, flags=cv2.IMREAD_UNCHANGED), files)
    return image.shape[1], image.shape[0]


class KittiSweeps(DatasetRepr):
    """What raw drives and sequences share: sweeps ``*.bin`` and labels beside them."""

    path: Path
    _sweeps: list[Path]
    _ego_boxes: list[list[float]]

    def __len__(self) -> int:
        return len(self._sweeps)

    def sweep_files(self, index: int) -> list[Path]:
        """All files of sweep ``index``, and the one that masks some of it."""
        masks = [settings_file(self.path)] if self._ego_boxes else []
        return self._lidar_files(index) + masks

    def labels(self, index: int) -> NDArray[np.uint32] | None:
        """Labels of every point of sweep ``index``; None without a file."""
        file = self.path / "labels" / f"{self._sweeps[index].stem}.label"
        return read_labels(file, self._lidar_files(index), index)

    def _lidar_files(self, index: int) -> list[Path]:
        return [self._sweeps[index]]

    @cached_property
    def _is_kitti_lidar(self) -> bool:
        return kitti_lidar.is_kitti_lidar(self._readable_points())

    def _readable_points(self) -> Iterator[NDArray[np.float32]]:
        for k, file in enumerate(self._sweeps):
            with suppress(DatasetError):
                yield read_sweep(file, k)[0]
