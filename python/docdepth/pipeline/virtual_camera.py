"""Virtual cameras: any pinhole camera, mounted on the LiDAR of a run."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.base import CameraStream
from docdepth.datasets.times import read_times
from docdepth.errors import CalibrationError, ConfigError
from docdepth.geometry.camera import Camera
from docdepth.geometry.ground_plane import level_turn
from docdepth.geometry.se3 import inverse, poses_from, quaternion_to_matrix
from docdepth.io.manifest import VirtualCamera
from docdepth.io.run_folder import RunFolder
from docdepth.pipeline.resources import check_image_size

FORWARD = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Rotation from camera axes to LiDAR axes when the camera looks along the LiDAR's x axis."""


def virtual_camera(pose: str, K: str, size: str, times: Path | None = None) -> VirtualCamera:
    """Describe a camera that moves with the LiDAR, as run.yaml holds it.

    Parameters
    ----------
    pose : str
        ``T_lidar_camera`` as :func:`parse_pose` reads it.
    K : str
        ``fx,fy,cx,cy`` in pixels.
    size : str
        ``WIDTHxHEIGHT`` in pixels.
    times : Path, optional
        A file with the time of each image in seconds, one per line; the times of the sweeps if
        absent.

    Returns
    -------
    VirtualCamera

    Raises
    ------
    ConfigError, CalibrationError
        A value cannot be read.
    """
    pixels = parse_size(size)
    if pixels is None:
        raise ConfigError("`size` is missing; write WIDTHxHEIGHT, for example 1280x720")
    check_image_size(*pixels, "`size`")
    fx, fy, cx, cy = _numbers("K", K, 4, "fx,fy,cx,cy")
    return VirtualCamera(
        T_lidar_camera=parse_pose(pose).tolist(),
        K=[[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]],
        size=pixels,
        times=None if times is None else times.resolve(),
    )


def virtual_stream(
    name: str,
    described: VirtualCamera,
    sweep_times: NDArray[np.int64],
    up: tuple[float, float, float] | None = None,
) -> CameraStream:
    """The virtual camera that :func:`virtual_camera` described.

    Parameters
    ----------
    name : str
    described : VirtualCamera
    sweep_times : ndarray of int64, shape (n,)
        Nanoseconds.
    up : (float, float, float), optional
        Of the frame in which it was described, where the run's own was turned
        (:class:`~docdepth.datasets.up_axis.LevelledRecording`).
    """
    camera = Camera(np.array(described.K), *described.size)
    T_camera_lidar = inverse(np.array(described.T_lidar_camera))
    if up is not None:
        T_camera_lidar[:3, :3] = T_camera_lidar[:3, :3] @ level_turn(up).T
    if described.times is None:
        names = [f"{i:06d}" for i in range(len(sweep_times))]
        return CameraStream(name, camera, T_camera_lidar, sweep_times, names)
    times = read_times(described.times)
    return CameraStream(
        name, camera, T_camera_lidar, times, [f"{i:010d}" for i in range(len(times))]
    )


def check_name(run: RunFolder, name: str) -> None:
    """Refuse a name for a virtual camera that is no folder or that a camera of the recording has.

    Raises
    ------
    ConfigError
    """
    # A name with a dot could be that of a file of the first camera: 000000.png, depth.json.
    if not name or set(name) & set("./\\\0"):
        raise ConfigError(f"`{name=}` cannot be a folder name; use letters and digits")
    if name in run.cameras and run.cameras[name].virtual is None:
        raise ConfigError(f"`{name=}`: the run has a camera of this name; choose another name")


def parse_size(text: str | None) -> tuple[int, int] | None:
    """Width and height in pixels from ``1242x375``.

    Raises
    ------
    CalibrationError
        The text is not a size.
    """
    if not text:
        return None
    width, _, height = text.partition("x")
    if not (width.isdigit() and height.isdigit()):
        raise CalibrationError(f"size {text!r}: write WIDTHxHEIGHT, for example 1242x375")
    return int(width), int(height)


def parse_pose(text: str) -> NDArray[np.float64]:
    """Read the pose ``T_lidar_camera`` of a camera in the LiDAR frame (x forward, y left, z up).

    Parameters
    ----------
    text : str
        Numbers separated by blanks or commas, or the path of a file with them: ``x y z`` of a
        camera that looks along the LiDAR's x axis; ``x y z qx qy qz qw`` with the rotation from
        camera axes (x right, y down, z forward) to LiDAR axes; or a 3x4 or 4x4 matrix, row by row,
        that transforms camera points to the LiDAR frame.

    Returns
    -------
    ndarray of float64, shape (4, 4)

    Raises
    ------
    CalibrationError
        The text has another form, or its rotation is not one.
    """
    file = Path(text)
    content = file.read_text(encoding="utf-8") if len(text) < 256 and file.is_file() else text
    try:
        values = np.array(content.replace(",", " ").split(), dtype=np.float64)
    except ValueError:
        values = np.zeros(0)
    rotation, position = FORWARD, values[:3]
    if values.size == 7 and np.linalg.norm(values[3:]) > 0:
        rotation = quaternion_to_matrix(values[3:] / np.linalg.norm(values[3:]))
    elif values.size in (12, 16):
        matrix = values.reshape(-1, 4)
        rotation, position = matrix[:3, :3], matrix[:3, 3]
    elif values.size != 3:
        rotation = np.zeros((3, 3))
    turned = np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-3)
    if not np.isfinite(values).all() or not turned or np.linalg.det(rotation) < 0:
        raise CalibrationError(
            f"`pose={text!r}`: write x,y,z or x,y,z,qx,qy,qz,qw or a file with a 4x4 matrix; it is "
            "the pose of the camera in the LiDAR frame and must be rigid"
        )
    u, _, vt = np.linalg.svd(rotation)
    return poses_from([u @ vt], position[None])[0]


def _numbers(argument: str, text: str, count: int, pattern: str) -> list[float]:
    try:
        values = [float(word) for word in text.split(",")]
    except ValueError:
        values = []
    if len(values) != count:
        raise ConfigError(f"`{argument}={text!r}`: write {pattern}")
    return values
