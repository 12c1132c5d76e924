"""Calibration of a camera on disk, in the layout of the official DOC-Depth release."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from docdepth.errors import CalibrationError, InputError
from docdepth.geometry.camera import Camera
from docdepth.geometry.se3 import check_rigid
from docdepth.io.atomic import WriteFile, write_atomically

INTRINSICS = "calib.json"
"""File of K (``mtx``), distortion (``dist``) and image size in pixels (``size``)."""

EXTRINSICS = "calib_lidar_ref_cam.txt"
"""File of ``T_camera_lidar``, four lines of four numbers."""


def write_calibration(
    folder: Path,
    camera: Camera,
    T_camera_lidar: NDArray[np.float64],
    distortion: Sequence[float] = (0.0,) * 5,
    model: str = "pinhole",
    write_file: WriteFile = write_atomically,
) -> None:
    """Write both files.

    Parameters
    ----------
    folder : Path
    camera : Camera
        The rectified camera.
    T_camera_lidar : ndarray of float64, shape (4, 4)
    distortion : sequence of float
        Of the images before they are rectified, in OpenCV's order.
    model : str
        Of the distortion; "fisheye" is that of ``cv2.fisheye``.
    write_file : callable
        Writes each file.

    Raises
    ------
    RunError
        A file cannot be written.
    """
    calibration: dict[str, object] = {
        "mtx": camera.K.tolist(),
        "dist": list(distortion),
        "size": [camera.width, camera.height],
    }
    if model != "pinhole":
        calibration["model"] = model
    intrinsics = json.dumps(calibration, indent=1).encode()
    rows = "\n".join(" ".join(repr(float(v)) for v in row) for row in T_camera_lidar) + "\n"
    write_file(folder / INTRINSICS, lambda stream: stream.write(intrinsics))
    write_file(folder / EXTRINSICS, lambda stream: stream.write(rows.encode()))


def read_calibration(folder: Path, remedy: str) -> tuple[Camera, NDArray[np.float64], list[float]]:
    """Camera, ``T_camera_lidar`` (4, 4) and distortion; ``remedy`` is for files that are missing.

    Without an image size, as in the official release, the principal point is taken for the centre
    of the image.

    Raises
    ------
    CalibrationError
        A file is missing or damaged.
    """
    intrinsic, extrinsic = folder / INTRINSICS, folder / EXTRINSICS
    try:
        calibration = json.loads(intrinsic.read_text())
        K = np.array(calibration["mtx"], dtype=np.float64)
        width, height = calibration.get("size") or np.round(2 * K[:2, 2]).astype(int).tolist()
        distortion = np.ravel(calibration.get("dist") or []).astype(float).tolist()
        T_camera_lidar = np.loadtxt(extrinsic)
    except FileNotFoundError as error:
        raise CalibrationError(f"{error.filename} is missing; {remedy}") from None
    except OSError as error:
        raise CalibrationError(
            f"{error.filename} cannot be read ({error.strerror}); {remedy}"
        ) from None
    except (KeyError, TypeError, ValueError) as error:
        raise CalibrationError(f"{intrinsic} or {extrinsic.name} is damaged: {error}") from None
    if T_camera_lidar.shape != (4, 4):
        raise CalibrationError(f"{extrinsic} must hold a 4x4 matrix")
    try:
        check_rigid(T_camera_lidar[None])
    except InputError:
        raise CalibrationError(
            f"{extrinsic} must hold a rotation and a translation in metres; {remedy}"
        ) from None
    return Camera(K, int(width), int(height)), T_camera_lidar, distortion
