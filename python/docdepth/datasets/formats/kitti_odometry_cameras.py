"""Cameras of KITTI odometry sequences: calibration, image sizes, times, distortion."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets import kitti_files
from docdepth.datasets.base import CameraStream
from docdepth.datasets.files import is_there, read_lines
from docdepth.datasets.kitti_files import Calibration
from docdepth.datasets.times import image_times
from docdepth.errors import CalibrationError, Collector, DatasetError
from docdepth.geometry.camera import camera_of

log = logging.getLogger(__name__)

REMEDY = (
    "unpack the 'calibration files' of the odometry benchmark over the sequence; a recording of "
    "your own is described in docdepth.yaml, with sweeps: velodyne"
)
"""What to do where ``calib.txt`` or ``times.txt`` is missing or incomplete."""


def read_cameras(
    sequence: Path,
    sweeps: list[Path],
    sweep_times: NDArray[np.int64],
    calibration: Calibration,
    T_camera0_lidar: NDArray[np.float64],
    image_size: tuple[int, int] | None,
) -> dict[str, CameraStream]:
    """The cameras ``image_0`` to ``image_3`` that ``calib.txt`` has a projection of.

    ``T_camera0_lidar`` (4, 4) takes LiDAR points to the rectified reference camera. Cameras without
    times of their own fire with the sweeps. ``image_size`` is width and height that the caller
    gives, pixels.
    """
    folders = {n: sequence / f"image_{n}" for n in range(4) if f"P{n}" in calibration}
    if not folders:
        raise CalibrationError(f"{calibration.file} has no camera (P0 to P3); {REMEDY}")
    problems = Collector()
    images = {n: kitti_files.image_files(folder) for n, folder in folders.items()}
    sizes: dict[int, tuple[int, int] | None] = dict.fromkeys(folders)
    for n, folder in folders.items():
        with problems.collected():
            sizes[n] = _image_size(folder, images[n], image_size)
    # Rectified together, the images of all cameras have one size.
    common = None if image_size else next((size for size in sizes.values() if size), None)
    streams: dict[str, CameraStream] = {}
    guessed: list[str] = []
    for n, folder in folders.items():
        with problems.collected():
            P = calibration.matrix(f"P{n}", 3, 4)
            size = sizes[n] or common
            if size is None:
                size = (round(2 * P[0, 2]), round(2 * P[1, 2]))
                guessed.append(f"{folder.name} {size[0]}x{size[1]}")
            table = folder / "times.txt"
            if images[n] and not is_there(table):
                table = sequence / "times.txt"
            times, names = image_times(table, images[n], sweeps, sweep_times, REMEDY)
            streams[folder.name] = CameraStream(
                name=folder.name,
                camera=camera_of(P[:, :3], size, f"{calibration.file}: P{n}"),
                T_camera_lidar=kitti_files.camera_offset(P) @ T_camera0_lidar,
                times=times,
                names=names,
                images=images[n],
                distortion=_distortion(folder / "distortion.txt"),
            )
    problems.raise_errors()
    if guessed:
        log.warning(
            "%s: image sizes guessed from the principal points (%s); "
            "give the size by `image_size`, for example 1242x375, or put the images there",
            sequence, ", ".join(guessed),
        )  # fmt: skip
    return streams


def _distortion(file: Path) -> NDArray[np.float64] | None:
    """Coefficients in OpenCV's order; None without a file."""
    if not is_there(file):
        return None
    try:
        words = " ".join(read_lines(file, "write k1 k2 p1 p2 [k3 ...]")).split()
        return np.array(words, dtype=np.float64)
    except ValueError as error:
        raise CalibrationError(f"{file} must be numbers, k1 k2 p1 p2 [k3 ...]: {error}") from None


def _image_size(
    folder: Path, images: list[Path], asked: tuple[int, int] | None
) -> tuple[int, int] | None:
    """Size of the images from themselves, ``size.txt`` or the caller; None if unknown."""
    source, told = folder / "size.txt", None
    if not images and is_there(source):
        words = " ".join(read_lines(source, "write width and height in pixels")).split()
        if len(words) != 2 or not all(word.isdigit() for word in words):
            raise DatasetError(f"{source} must be two numbers, width and height in pixels")
        told = int(words[0]), int(words[1])
    claims = {str(source): told, kitti_files.ASKED: asked}
    return kitti_files.agreed_size(folder.name, images, claims)
