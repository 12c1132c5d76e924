"""Sessions of NCLT, the North Campus long-term data set: a robot with a Velodyne HDL-32E."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.cloud import Cloud, packed
from docdepth.datasets.cloud_files import MICROSECOND, stamped_lidar
from docdepth.datasets.files import files_of, is_there
from docdepth.datasets.format import Format
from docdepth.datasets.pose_tables import poses_of_angles, read_table_poses
from docdepth.datasets.recording import Recording
from docdepth.datasets.settings import read_settings
from docdepth.datasets.yaml_cameras import CameraRecordingSettings, yaml_recording
from docdepth.geometry.se3 import inverse, transform_points

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
    points = transform_points(T, body)
    return Cloud(
        points.astype(np.float32),
        rows["intensity"].astype(np.float32),
        rows["laser"].astype(np.uint16),
    )


def _open(path: Path, image_size: tuple[int, int] | None) -> Recording:
    """``velodyne_sync/STAMP.bin``, compensated for the motion of the robot.

    ``groundtruth_DATE.csv`` is looked for in the session, beside it, and in ``ground_truth`` there.
    """
    settings = read_settings(path, CameraRecordingSettings, {"motion_compensated": True})
    lidar = stamped_lidar("velodyne", path / "velodyne_sync", MICROSECOND, _ROWS, lifted)
    whole = path.absolute()
    near = (whole, whole.parent, whole / "ground_truth", whole.parent / "ground_truth")
    files = [folder / f"groundtruth_{whole.name}.csv" for folder in near]
    poses = read_table_poses(
        next(filter(is_there, files), files[0]),
        (6,), "download the ground truth of NCLT again", lidar.stream.times,
        lambda rows: _T_WORLD_THEIRS @ poses_of_angles(rows[:, :3], rows[:, 3:]) @ _T_BODY_LIDAR,
        MICROSECOND,
    )  # fmt: skip
    return yaml_recording("nclt", path, [lidar], poses, settings, image_size)


FORMAT = Format(
    "nclt",
    "a session DATE of NCLT with velodyne_sync/*.bin",
    lambda path: bool(files_of(path / "velodyne_sync", ".bin")),
    _open,
    experimental=True,
)
