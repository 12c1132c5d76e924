"""Sessions of NCLT, the North Campus long-term data set: a robot with a Velodyne HDL-32E."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.cloud import Cloud
from docdepth.datasets.files import is_there
from docdepth.datasets.format import Format
from docdepth.datasets.pose_tables import (
    poses_at,
    poses_of_angles,
    read_pose_table,
    rows_around,
)
from docdepth.datasets.settings import read_settings
from docdepth.datasets.stamped_files import MICROSECOND, packed, stamped_lidar
from docdepth.datasets.yaml_cameras import CameraRecordingSettings, LidarRecording
from docdepth.geometry.se3 import inverse

_ROWS = packed(x="u2", y="u2", z="u2", intensity="u1", laser="u1")
_STEP, _LEAST = 0.005, -100.0  # metres of one count, and of none
# Points are in the frame of the robot's body: x ahead, y to the right, z down. docdepth's LiDAR
# frame has z up, and lies where the LiDAR sits by the data set's calibration.
_T_BODY_LIDAR = np.diag([1.0, -1, -1, 1])
_T_BODY_LIDAR[:3, 3] = 0.002, -0.004, -0.957
_T_WORLD_THEIRS = np.diag([1.0, -1, -1, 1])  # north, east, down to z up


def lifted(rows: NDArray[Any], where: str) -> Cloud:
    """The points of a sweep in metres, z up, as seen from the LiDAR."""
    body = np.stack([rows[axis] for axis in "xyz"], axis=1) * _STEP + _LEAST
    T = inverse(_T_BODY_LIDAR)
    points = body @ T[:3, :3].T + T[:3, 3]
    return Cloud(
        points.astype(np.float32),
        rows["intensity"].astype(np.float32),
        rows["laser"].astype(np.uint16),
    )


class Nclt(LidarRecording):
    """A session of NCLT; its sweeps are compensated for the motion of the robot.

    Parameters
    ----------
    path : Path
        Folder ``DATE`` with ``velodyne_sync/STAMP.bin``. ``groundtruth_DATE.csv`` is looked for in
        it, beside it, and in folders ``ground_truth`` there.
    image_size : (int, int), optional
        Width and height of cameras that ``docdepth.yaml`` describes without images.
    """

    def __init__(self, path: Path, image_size: tuple[int, int] | None = None) -> None:
        settings, file = read_settings(path, CameraRecordingSettings, {"motion_compensated": True})
        lidar = stamped_lidar("velodyne", path / "velodyne_sync", MICROSECOND, _ROWS, lifted)
        poses = _poses(path, lidar.stream.times)
        super().__init__("nclt", path, lidar, poses, settings, file, image_size)


def _poses(path: Path, times: NDArray[np.int64]) -> NDArray[np.float64] | None:
    whole = path.absolute()
    name = f"groundtruth_{whole.name}.csv"
    near = (whole, whole.parent)
    folders = (*near, *(folder / "ground_truth" for folder in near))
    file = next((folder / name for folder in folders if is_there(folder / name)), None)
    if file is None:
        return None
    stamps, rows = read_pose_table(file, (6,), "download the ground truth of NCLT again")
    stamps, rows = rows_around(stamps * MICROSECOND, rows, times)
    T_theirs_body = poses_of_angles(rows[:, :3], rows[:, 3:])
    poses = _T_WORLD_THEIRS @ T_theirs_body @ _T_BODY_LIDAR
    return poses_at(stamps, poses, times, file)


FORMAT = Format(
    "nclt",
    "a session DATE of NCLT with velodyne_sync/*.bin",
    lambda path: any((path / "velodyne_sync").glob("*.bin")),
    Nclt,
    experimental=True,
)
