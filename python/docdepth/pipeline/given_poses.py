"""Poses that a user brings: a file of the LiDAR's or of a camera's, or the recording's own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from docdepth.config import OdometryParameters
from docdepth.datasets import Dataset, FrameRange, full_recording
from docdepth.datasets.files import FILE
from docdepth.datasets.formats.cloud_folder import CloudFolder
from docdepth.datasets.pose_tables import read_poses_at
from docdepth.datasets.sensor_pose import LevelledRecording
from docdepth.errors import DatasetError, OdometryError
from docdepth.geometry.se3 import inverse
from docdepth.io.inputs import OWN_POSES, camera_and_file
from docdepth.io.poses import pose_times, read_poses
from docdepth.odometry.pose_checks import misfit, move_upwards
from docdepth.pipeline.cameras import as_recorded, place_for_poses

_WRONG, _TIMES = 0.1, 3.0
"""Sweeps lie this far from those before them [m], and this many times as far as by the other
meaning, if poses are of a camera. Median of right poses: 0.003 to 0.08 m."""

_WAY, _SHORTEST_WAY, _MOST_APART = 0.7, 0.2, 20
"""Metres between sweeps that tell of which frame their points are, at least, and sweeps from one to
the other at most: alignment begins at points within a metre."""


def file_of_poses(poses: str) -> Path | None:
    """The file of ``RunInputs.poses``; None for the recording's own."""
    return None if poses == OWN_POSES else Path(camera_and_file(poses)[1])


def read_given_poses(entry: str, recording: Dataset) -> NDArray[np.float64]:
    """Poses ``T_world_lidar`` (n, 4, 4) of every sweep of a recording, or of a part of one.

    ``entry`` is ``RunInputs.poses``.
    """
    if entry == OWN_POSES:
        if recording.poses is None:
            raise DatasetError(
                f"{recording.path} has no poses of its own",
                "give a file by `poses=FILE`, or leave `poses` out to have them estimated",
            )
        return recording.poses
    whole = full_recording(recording)
    camera, file = camera_and_file(entry)
    of_part = _are_of_part(Path(file), recording, len(whole))
    poses = read_poses_at(Path(file), recording.times if of_part else whole.times)
    if camera:
        poses = _of_lidar(poses, camera, whole)
    elif isinstance(whole, LevelledRecording):
        poses = poses @ inverse(whole.T_level_lidar)
    if isinstance(recording, FrameRange) and len(poses) == len(whole):
        return poses[recording.indices]
    return poses


def _are_of_part(file: Path, recording: Dataset, whole: int) -> bool:
    """Whether a file has the poses of a range of sweeps alone, as a run of it writes them.

    Where sweeps amid the range are left out, only the ``whole`` recording, or times, tell which
    pose is whose.
    """
    if not isinstance(recording, FrameRange):
        return False
    indices, count = recording.indices, len(read_poses(file))
    if count == len(indices):
        return bool(indices[-1] - indices[0] + 1 == len(indices))
    return count != whole and pose_times(file) is not None


def refuse_poses_of_a_camera(
    entry: str, recording: Dataset, poses: NDArray[np.float64], parameters: OdometryParameters
) -> None:
    """Refuse a file of camera poses, as KITTI's are, that is given as one of LiDAR poses.

    Some sweeps are aligned with those before, starting from either meaning.
    """
    of_lidar = entry != OWN_POSES and not camera_and_file(entry)[0]
    if not of_lidar or not recording.cameras or not move_upwards(poses):
        return
    name = sorted(recording.cameras, key=lambda n: n not in ("image_00", "image_0"))[0]
    meanings = poses, _of_lidar(poses, name, recording)
    times = recording.times
    off = [misfit(lambda k: recording.sweep(k).points, p, times, parameters) for p in meanings]
    if off[0] is not None and off[1] is not None and off[0] > max(_WRONG, _TIMES * off[1]):
        raise OdometryError(
            f"{entry} holds poses of a camera: as those of the LiDAR, sweeps lie {off[0]:.2f} m "
            f"from those before them, as those of {name} {off[1]:.2f} m",
            f"say which camera: `poses={f'{name}:{entry}'!r}`",
            code="poses-of-camera",
        )


def refuse_points_of_another_frame(recording: Dataset, parameters: OdometryParameters) -> None:
    """Refuse points that are said to be in the world and are of the LiDAR, or the reverse.

    On tens of metres the middle of the points tells it when a recording is opened. On less, some
    sweeps are aligned with those before, starting from either meaning.
    """
    folder = as_recorded(recording)
    if not isinstance(folder, CloudFolder) or folder.poses is None or len(folder) < 5:
        return
    poses, positions = folder.poses, folder.poses[:, :3, 3]
    ways = [
        float(np.median(np.linalg.norm(positions[k:] - positions[:-k], axis=1)))
        for k in range(1, min(len(folder) - 2, _MOST_APART))
    ]
    apart = 1 + next((k for k, way in enumerate(ways) if way > _WAY), len(ways) - 1)
    way = ways[apart - 1]
    if way < _SHORTEST_WAY:
        return
    T, other = (poses, "lidar") if folder.frame == "world" else (inverse(poses), "world")

    def moved(k: int) -> NDArray[np.float32]:
        points = folder.sweep(k).points @ T[k, :3, :3].T + T[k, :3, 3]
        return points.astype(np.float32)

    asked = ((lambda k: folder.sweep(k).points), moved)
    off = [misfit(points, poses, folder.times, parameters, apart) for points in asked]
    if off[0] is not None and off[1] is not None and off[0] > max(way / 3, _TIMES * off[1]):
        raise DatasetError(
            f"{folder.path}: the points are not in the frame {folder.frame!r}: so, sweeps lie "
            f"{off[0]:.2f} m from those before them, and in the frame {other!r} {off[1]:.2f} m",
            f"say frame: {other} in {folder.path / FILE}",
        )


def _of_lidar(poses: NDArray[np.float64], camera: str, recording: Dataset) -> NDArray[np.float64]:
    """Poses of the LiDAR from those of a camera; identity stays identity."""
    if camera not in recording.cameras:
        known = ", ".join(recording.cameras) or "none"
        raise DatasetError(
            f"`poses={camera + ':...'!r}`: {recording.path} has no camera {camera!r}; it has "
            f"{known}"
        )
    T = place_for_poses(recording, camera)
    of_lidar: NDArray[np.float64] = inverse(T) @ poses @ T
    return of_lidar
