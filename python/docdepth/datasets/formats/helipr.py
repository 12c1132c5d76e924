"""Sequences of HeLiPR: four unlike LiDARs on one vehicle, each a recording of its own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.format import Format
from docdepth.datasets.pose_tables import pose_of, poses_at, read_pose_table
from docdepth.datasets.settings import read_settings
from docdepth.datasets.stamped_files import NANOSECOND, packed, stamped_lidar
from docdepth.datasets.yaml_cameras import CameraRecordingSettings, LidarRecording

_AEVA = packed(x="f4", y="f4", z="f4", reflectivity="f4", velocity="f4", offset_ns="i4", line="u1")
_ROWS = {
    "Ouster": packed(
        x="f4", y="f4", z="f4", intensity="f4", t="u4", reflectivity="u2", ring="u2", ambient="u2"
    ),
    "Velodyne": packed(x="f4", y="f4", z="f4", intensity="f4", ring="u2", time="f4"),
    "Avia": packed(
        x="f4", y="f4", z="f4", reflectivity="u1", tag="u1", line="u1", offset_time="u4"
    ),
    "Aeva": _AEVA,
}
# Aeva's files of later sessions have one number more. Reflectivity is in all of them.
_LAST_SHORT_AEVA = 1691936557946849179
_LATER_AEVA = np.dtype([*_AEVA.descr, ("raw_intensity", "<f4")])


class HeLiPR(LidarRecording):
    """One LiDAR of a sequence of HeLiPR.

    Parameters
    ----------
    path : Path
        ``SEQUENCE/LiDAR/NAME`` with ``STAMP.bin``; NAME is Ouster, Velodyne, Avia or Aeva. Poses
        are those of ``SEQUENCE/LiDAR_GT``, if there are any.
    image_size : (int, int), optional
        Width and height of cameras that ``docdepth.yaml`` describes without images.
    """

    def __init__(self, path: Path, image_size: tuple[int, int] | None = None) -> None:
        settings, file = read_settings(path, CameraRecordingSettings, {"motion_compensated": False})
        name = path.absolute().name
        lidar = stamped_lidar(name.lower(), path, NANOSECOND, _ROWS[name])
        if name == "Aeva" and lidar.stream.times[0] > _LAST_SHORT_AEVA:
            lidar = stamped_lidar(name.lower(), path, NANOSECOND, _LATER_AEVA)
        poses = _poses(path.absolute().parent.parent / "LiDAR_GT", name, lidar.stream.times)
        super().__init__("helipr", path, lidar, poses, settings, file, image_size)


def _poses(folder: Path, name: str, times: NDArray[np.int64]) -> NDArray[np.float64] | None:
    """Poses of this LiDAR, in the frame of all sequences if there are such."""
    files = sorted(folder.glob(f"*{name}_gt.txt"), key=lambda f: ("global" not in f.name, f.name))
    if not files:
        return None
    stamps, rows = read_pose_table(files[0], (7,), "download LiDAR_GT of HeLiPR again")
    poses = [
        pose_of([row[6], *row[3:6]], row[:3], f"{files[0]}, {stamp}")
        for stamp, row in zip(stamps.tolist(), rows.tolist(), strict=True)
    ]
    return poses_at(stamps, np.stack(poses), times, files[0])


def _recognises(path: Path) -> bool:
    whole = path.absolute()
    return whole.name in _ROWS and whole.parent.name == "LiDAR" and any(path.glob("*.bin"))


FORMAT = Format(
    "helipr",
    "a LiDAR of a sequence of HeLiPR, such as SEQUENCE/LiDAR/Ouster with *.bin",
    _recognises,
    HeLiPR,
    experimental=True,
)
