"""Sequences of Boreas: a Velodyne Alpha Prime, a camera, and poses of the LiDAR."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.base import CameraStream, LidarStream
from docdepth.datasets.cloud import Cloud, cloud_from_fields, packed
from docdepth.datasets.cloud_files import MICROSECOND, stamped_lidar
from docdepth.datasets.files import is_there, read_numbers
from docdepth.datasets.format import Format
from docdepth.datasets.kitti_files import image_files, image_size
from docdepth.datasets.pose_tables import poses_of_angles, read_table_poses
from docdepth.datasets.recording import Recording
from docdepth.datasets.settings import RecordingSettings, read_settings, transform
from docdepth.datasets.times import times_of_names
from docdepth.errors import CalibrationError
from docdepth.geometry.camera import Camera
from docdepth.geometry.se3 import inverse

_ROWS = packed(x="f4", y="f4", z="f4", intensity="f4", ring="f4", time="f4")
_SIZE = (2448, 2048)  # pixels of the rectified images
_RESTORE = "download calib of the sequence again"
# The LiDAR stands turned on the roof, by 45 degrees in most sequences. Applanix' frame, to which it
# is calibrated, has x to the right and y ahead.
_T_AHEAD_APPLANIX = np.array([[0.0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])


def turned(T_lidar_theirs: NDArray[np.float64], rows: NDArray[Any], where: str) -> Cloud:
    """The points of a sweep, x ahead."""
    cloud = cloud_from_fields(rows, where)
    points = cloud.points.astype(np.float64) @ T_lidar_theirs[:3, :3].T
    return replace(cloud, points=points.astype(np.float32))


def _open(path: Path, image_size: tuple[int, int] | None) -> Recording:
    """Sweeps stamped at their middle, with times of points; the LiDAR is turned to x ahead."""
    settings = read_settings(path, RecordingSettings, {"motion_compensated": False})
    T = _T_AHEAD_APPLANIX @ _transform(path / "calib" / "T_applanix_lidar.txt")
    T[:3, 3] = 0
    lidar = stamped_lidar("lidar", path / "lidar", MICROSECOND, _ROWS, partial(turned, T))
    cameras = {}
    if is_there(path / "calib" / "P_camera.txt"):
        cameras["camera"] = _camera(path, lidar.stream, image_size or _SIZE, inverse(T))
    poses = read_table_poses(
        path / "applanix" / "lidar_poses.csv", (12,), "download applanix of the sequence again",
        lidar.stream.times, lambda rows: _poses_enu(rows) @ inverse(T), MICROSECOND,
    )  # fmt: skip
    return Recording("boreas", path, [lidar], cameras, poses, settings)


def _poses_enu(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Boreas' roll, pitch and heading are those of the rotation from the world to the LiDAR."""
    poses = poses_of_angles(rows[:, :3], rows[:, 6:9])
    poses[:, :3, :3] = poses[:, :3, :3].transpose(0, 2, 1)
    return poses


def _camera(
    path: Path, lidar: LidarStream, size: tuple[int, int], T_theirs_lidar: NDArray[np.float64]
) -> CameraStream:
    """The rectified camera; without images it fires with the sweeps."""
    calib = path / "calib"
    K = np.array(read_numbers(calib / "P_camera.txt", _RESTORE), np.float64)
    if K.size not in (12, 16):
        raise CalibrationError(f"{calib / 'P_camera.txt'} must be a matrix of 3 x 4; {_RESTORE}")
    images = image_files(path / "camera")
    return CameraStream(
        "camera",
        Camera(K.reshape(-1, 4)[:3, :3], *(image_size(images) or size)),
        _transform(calib / "T_camera_lidar.txt") @ T_theirs_lidar,
        times_of_names(images, MICROSECOND, "names of images are stamps")
        if images
        else lidar.times,
        [image.stem for image in images] or lidar.names,
        images,
    )


def _transform(file: Path) -> NDArray[np.float64]:
    return transform(read_numbers(file, _RESTORE), str(file))


def _recognises(path: Path) -> bool:
    return (path / "calib" / "T_applanix_lidar.txt").is_file() and (path / "lidar").is_dir()


FORMAT = Format(
    "boreas",
    "a sequence boreas-YYYY-MM-DD-HH-MM with lidar/*.bin, calib and applanix/lidar_poses.csv",
    _recognises,
    _open,
    experimental=True,
)
