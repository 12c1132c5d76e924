"""Poses of KITTI raw from its GPS and IMU: ``oxts/data``."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.files import is_there, read_lines
from docdepth.datasets.kitti_files import Calibration, in_order
from docdepth.datasets.pose_tables import continue_ends, poses_at, poses_of_angles
from docdepth.datasets.times import read_times_of
from docdepth.errors import DatasetError
from docdepth.geometry.se3 import inverse

log = logging.getLogger(__name__)

_RADIUS = 6378137.0  # metres, of the sphere of KITTI's Mercator projection
_REMEDY = "unpack the 'synced+rectified data' of the drive again, or remove the folder oxts"


def read_oxts(drive: Path, times: NDArray[np.int64]) -> NDArray[np.float64] | None:
    """Poses of the LiDAR at the times of the sweeps.

    The world is east, north, up from the place of the first packet. Packets have their own times:
    poses are interpolated, and continued to sweeps a little before the first packet.

    Parameters
    ----------
    drive : Path
        ``DATE/DATE_drive_NNNN_sync``; ``DATE/calib_imu_to_velo.txt`` tells where the IMU sits.
    times : ndarray of int64, shape (n,)
        Nanoseconds of the sweeps.

    Returns
    -------
    ndarray of float64, shape (n, 4, 4), or None
        ``T_world_lidar``, NaN where it is not known. None without packets or that calibration.

    Raises
    ------
    DatasetError, CalibrationError
        A file is damaged or contradicts another one.
    """
    files = in_order((drive / "oxts" / "data").glob("*.txt"))
    if not files:
        return None
    calibration = drive.parent / "calib_imu_to_velo.txt"
    if not is_there(calibration):
        log.warning(
            "%s: the poses in oxts are not used, since %s is not there; unpack the 'calibration' "
            "archive of that date beside its drives", drive, calibration,
        )  # fmt: skip
        return None
    T_lidar_imu = Calibration(calibration, "unpack it again").transform_of("R", "T")
    stamps = read_times_of(files, drive / "oxts" / "timestamps.txt", "stamps", _REMEDY)
    rows = np.array([_read_packet(file, k) for k, file in enumerate(files)])
    poses = poses_of_angles(_mercator(rows[:, :3]), rows[:, 3:]) @ inverse(T_lidar_imu)
    return continue_ends(poses_at(stamps, poses, times, drive / "oxts"), stamps, poses, times)


def _read_packet(file: Path, frame: int) -> list[float]:
    """Latitude, longitude (degrees), altitude (metres), roll, pitch and yaw (radians)."""
    words = " ".join(read_lines(file, _REMEDY)).split()
    try:
        numbers = [float(word) for word in words[:6]]
    except ValueError:
        numbers = []
    if len(numbers) < 6 or not np.isfinite(numbers).all() or abs(numbers[0]) >= 90:
        raise DatasetError(
            f"{file} (frame {frame}) does not begin with latitude, longitude, altitude, roll, "
            f"pitch and yaw; {_REMEDY}"
        )
    return numbers


def _mercator(places: NDArray[np.float64]) -> NDArray[np.float64]:
    """Metres east, north and up of the first place, by the projection of KITTI's devkit."""
    latitude, longitude = np.radians(places[:, 0]), np.radians(places[:, 1])
    scale = _RADIUS * np.cos(latitude[0])  # so that metres are true at the first place
    north = np.log(np.tan(np.pi / 4 + latitude / 2))
    found = np.stack([scale * longitude, scale * north, places[:, 2]], axis=1)
    return np.asarray(found - found[0])
