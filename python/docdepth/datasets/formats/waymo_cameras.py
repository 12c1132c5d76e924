"""Cameras of the Waymo Open Dataset: JPEG images within a Parquet file, rolling shutters."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.base import CameraStream, LidarStream
from docdepth.datasets.files import StoredImage
from docdepth.datasets.formats.parquet_rows import ParquetRows
from docdepth.errors import CalibrationError, DatasetError
from docdepth.geometry.camera import Camera
from docdepth.geometry.se3 import if_mirrored, inverse, nearest_rigid, poses_from
from docdepth.io.images import decode_photo

CAMERAS = {1: "FRONT", 2: "FRONT_LEFT", 3: "FRONT_RIGHT", 4: "SIDE_LEFT", 5: "SIDE_RIGHT"}
FRONT = 1
FRAME, CAMERA = "key.frame_timestamp_micros", "key.camera_name"
REMEDY = "download the component of the segment again"

# Waymo's cameras look along x and have z up; ours look along z and have y down.
_T_OPTICAL_THEIRS = poses_from([np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])], [[0, 0, 0]])[0]
_IMAGE = "[CameraImageComponent].image"
_SHUTTER = "[CameraImageComponent].rolling_shutter_params"
_INTRINSIC = "[CameraCalibrationComponent].intrinsic"
_EDGE = 0.5  # Waymo's pixel 0 begins at 0; ours has its centre there


def pose_of_row(numbers: Any, where: str) -> NDArray[np.float64]:
    """A transform (4, 4) of 16 numbers, row by row."""
    values = np.array(numbers.as_py() if hasattr(numbers, "as_py") else numbers, np.float64)
    if values.shape != (16,) or not np.isfinite(values).all():
        raise DatasetError(f"{where} has no transform of 16 numbers; {REMEDY}")
    T = values.reshape(4, 4)
    rigid = nearest_rigid(T)
    if np.abs(rigid - T).max() > 1e-3:
        raise DatasetError(f"{where} is no rotation and translation{if_mirrored(T)}; {REMEDY}")
    return np.asarray(rigid)


def nanoseconds(seconds: Any) -> int:
    """Of a time in seconds, to the microsecond: doubles hold no more."""
    return int(np.rint(float(seconds) * 1e6)) * 1000


def _read_image(rows: ParquetRows, key: tuple[int, int], where: str) -> NDArray[np.uint8]:
    (content,) = rows.read(key, (_IMAGE,), where)
    image = decode_photo(content.as_py() or b"")
    if image is None:
        raise DatasetError(f"{where} is no image; {REMEDY}")
    return np.asarray(image, np.uint8)


def read_cameras(
    calibration: Path, images: Path, T_vehicle_lidar: NDArray[np.float64], lidar: LidarStream
) -> dict[str, CameraStream]:
    """The cameras of a segment; those without images fire with the sweeps.

    The time of an image is that of its middle column or row: halfway between trigger and the end
    of the readout. Without the file ``calibration`` there are no cameras; ``images`` may be
    missing. ``T_vehicle_lidar`` is (4, 4).
    """
    if not calibration.is_file():
        return {}
    rows = ParquetRows(calibration, (CAMERA,), REMEDY)
    taken = ParquetRows(images, (FRAME, CAMERA), REMEDY) if images.is_file() else None
    cameras = {}
    for (number,) in sorted(rows.rows):
        if number not in CAMERAS:
            continue
        name, where = CAMERAS[number], f"{calibration}, {CAMERAS[number]}"
        camera, distortion, T_vehicle_camera = _calibration(rows, number, where)
        stream = _images_of(taken, number) if taken is not None else ([], [], [])
        times, names, files = stream if len(stream[0]) else (lidar.times, lidar.names, [])
        cameras[name] = CameraStream(
            name,
            camera,
            _T_OPTICAL_THEIRS @ inverse(T_vehicle_camera) @ T_vehicle_lidar,
            np.asarray(times, np.int64),
            list(names),
            files,
            distortion,
        )
    return cameras


def _images_of(rows: ParquetRows, number: int) -> tuple[list[int], list[str], list[StoredImage]]:
    """Times, names and images of a camera."""
    times, names, images = [], [], []
    columns = (f"{_SHUTTER}.camera_trigger_time", f"{_SHUTTER}.camera_readout_done_time")
    for frame in sorted(frame for frame, camera in rows.rows if camera == number):
        where = f"{rows.file}, {CAMERAS[number]} of {frame}"
        begin, end = (one.as_py() for one in rows.read((frame, number), columns, where))
        if begin is None or end is None:
            raise DatasetError(f"{where} has no times of its shutter; {REMEDY}")
        times.append(nanoseconds(begin + 0.5 * (end - begin)))
        names.append(str(frame))
        read = partial(_read_image, rows, (frame, number), where)
        images.append(StoredImage(rows.file, f"{CAMERAS[number]}_{frame}.jpg", read))
    return times, names, images


def _calibration(
    rows: ParquetRows, number: int, where: str
) -> tuple[Camera, NDArray[np.float64], NDArray[np.float64]]:
    """Camera, distortion and ``T_vehicle_camera``, whose camera looks along x."""
    names = ("f_u", "f_v", "c_u", "c_v", "k1", "k2", "p1", "p2", "k3")
    prefix = "[CameraCalibrationComponent]"
    columns = tuple(f"{_INTRINSIC}.{name}" for name in names) + (
        f"{prefix}.width", f"{prefix}.height", f"{prefix}.extrinsic.transform",
    )  # fmt: skip
    *numbers, extrinsic = rows.read((number,), columns, where)
    values = [one.as_py() for one in numbers]
    if any(value is None or not np.isfinite(value) for value in values):
        raise CalibrationError(f"{where} lacks intrinsics; {REMEDY}")
    fu, fv, cu, cv, *lens, width, height = values
    K = np.array([[fu, 0, cu - _EDGE], [0, fv, cv - _EDGE], [0, 0, 1]])
    return Camera(K, int(width), int(height)), np.array(lens), pose_of_row(extrinsic, where)
