"""Sequences of MulRan: the sweeps of an Ouster OS1-64, and the vehicle's poses."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.cloud import Cloud, FileLidar, packed
from docdepth.datasets.cloud_files import NANOSECOND, stamped_lidar
from docdepth.datasets.files import files_of
from docdepth.datasets.format import Format
from docdepth.datasets.pose_tables import poses_of_angles, poses_of_matrices, read_table_poses
from docdepth.datasets.recording import Recording
from docdepth.datasets.settings import read_settings
from docdepth.datasets.yaml_cameras import CameraRecordingSettings, yaml_recording
from docdepth.geometry.se3 import inverse

log = logging.getLogger(__name__)

_ROWS = packed(x="f4", y="f4", z="f4", intensity="f4")
_BEAMS, _COLUMNS = 64, 1024  # all of a revolution are in a file, beam by beam in each column
_REVOLUTION = 100_000_000  # ns
# Of MulRan's calibration: the LiDAR, which looks backwards, in the frame of the vehicle.
_T_VEHICLE_THEIRS = poses_of_angles(
    np.array([[1.7042, -0.021, 1.8047]]), np.radians([[0.0001, 0.0003, 179.6654]])
)[0]
_T_LIDAR_THEIRS = np.diag([-1.0, -1, 1, 1])  # docdepth has x ahead


def turned(rows: NDArray[Any], where: str) -> Cloud:
    """The points of a sweep, x ahead, with beams and times if it is whole.

    Times are nanoseconds since the first column. Both follow from the place in the file; a sweep
    that lacks rows has neither.
    """
    points = np.stack([-rows["x"], -rows["y"], rows["z"]], axis=1)
    if len(rows) != _BEAMS * _COLUMNS:
        return Cloud(points, rows["intensity"].copy())
    place = np.arange(len(rows))
    times = place // _BEAMS * (_REVOLUTION // _COLUMNS)
    return Cloud(points, rows["intensity"].copy(), (place % _BEAMS).astype(np.uint16), times)


def _open(path: Path, image_size: tuple[int, int] | None) -> Recording:
    """``sensor_data/Ouster/STAMP.bin`` or ``Ouster/STAMP.bin``, and perhaps ``global_pose.csv``."""
    usual = {"motion_compensated": False, "point_time_unit": "ns"}
    settings = read_settings(path, CameraRecordingSettings, usual)
    lidar = stamped_lidar("ouster", _sweeps(path), NANOSECOND, _ROWS, turned)
    _warn_of_short(lidar)
    file, T = path / "global_pose.csv", _T_VEHICLE_THEIRS @ inverse(_T_LIDAR_THEIRS)
    poses = read_table_poses(
        file, (12,), "copy global_pose.csv of MulRan again", lidar.stream.times,
        lambda rows: poses_of_matrices(rows, file) @ T,
    )  # fmt: skip
    return yaml_recording("mulran", path, [lidar], poses, settings, image_size)


def _warn_of_short(lidar: FileLidar) -> None:
    whole = _BEAMS * _COLUMNS * _ROWS.itemsize
    short = [file for file in lidar.sweeps if file.stat().st_size != whole]
    if short:
        log.warning(
            "%s, and %d more of %d sweeps: not %d x %d rows, so their points have no times and are "
            "not deskewed",
            short[0], len(short) - 1, len(lidar.sweeps), _BEAMS, _COLUMNS,
        )  # fmt: skip


def _sweeps(path: Path) -> Path:
    """Folder of the sweeps."""
    whole = path / "sensor_data" / "Ouster"
    return whole if whole.is_dir() else path / "Ouster"


def _recognises(path: Path) -> bool:
    """Ouster's sweeps alone; HeLiPR has them in a folder LiDAR, beside those of others."""
    return path.name != "LiDAR" and bool(files_of(_sweeps(path), ".bin"))


FORMAT = Format(
    "mulran",
    "a sequence of MulRan with sensor_data/Ouster/*.bin (or Ouster/*.bin) and global_pose.csv",
    _recognises,
    _open,
    experimental=True,
)
