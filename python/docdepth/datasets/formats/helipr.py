"""Sequences of HeLiPR: four unlike LiDARs on one vehicle, each a recording of its own."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from docdepth.datasets.cloud import packed
from docdepth.datasets.cloud_files import NANOSECOND, stamped_lidar
from docdepth.datasets.files import files_of
from docdepth.datasets.format import Format
from docdepth.datasets.pose_tables import pose_of, read_table_poses
from docdepth.datasets.recording import Recording
from docdepth.datasets.settings import read_settings
from docdepth.datasets.yaml_cameras import CameraRecordingSettings, yaml_recording

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


def _open(path: Path, image_size: tuple[int, int] | None) -> Recording:
    """``SEQUENCE/LiDAR/NAME`` with ``STAMP.bin``; poses are those of ``SEQUENCE/LiDAR_GT``."""
    settings = read_settings(path, CameraRecordingSettings, {"motion_compensated": False})
    name = path.absolute().name
    lidar = stamped_lidar(name.lower(), path, NANOSECOND, _ROWS[name])
    if name == "Aeva" and lidar.stream.times[0] > _LAST_SHORT_AEVA:
        lidar = stamped_lidar(name.lower(), path, NANOSECOND, _LATER_AEVA)
    folder, poses = path.absolute().parent.parent / "LiDAR_GT", None
    tables = sorted(folder.glob(f"*{name}_gt.txt"), key=lambda f: ("global" not in f.name, f.name))
    if tables:  # those in the frame of all sequences come first
        poses = read_table_poses(
            tables[0], (7,), "download LiDAR_GT of HeLiPR again", lidar.stream.times,
            lambda rows: np.stack(
                [pose_of([row[6], *row[3:6]], row[:3], str(tables[0])) for row in rows.tolist()]
            ),
        )  # fmt: skip
    return yaml_recording("helipr", path, [lidar], poses, settings, image_size)


def _recognises(path: Path) -> bool:
    whole = path.absolute()
    return whole.name in _ROWS and whole.parent.name == "LiDAR" and bool(files_of(path, ".bin"))


FORMAT = Format(
    "helipr",
    "a LiDAR of a sequence of HeLiPR, such as SEQUENCE/LiDAR/Ouster with *.bin",
    _recognises,
    _open,
    experimental=True,
)
