"""Scenes of nuScenes, from its tables in JSON.

The devkit is not needed. A root holds many scenes; the path of one is ``ROOT/SCENE``, such as
``nuscenes/scene-0061``, though there is no such folder.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.base import CameraStream, LidarStream
from docdepth.datasets.cloud import Cloud, FileLidar, packed, rings
from docdepth.datasets.cloud_files import MICROSECOND, read_stamped
from docdepth.datasets.files import (
    Entry,
    Microseconds,
    PathInside,
    images_if_any,
    one_of,
    read_json,
)
from docdepth.datasets.format import Format
from docdepth.datasets.kitti_files import check_increasing
from docdepth.datasets.pose_tables import pose_of
from docdepth.datasets.recording import Recording
from docdepth.datasets.settings import RecordingSettings, read_settings
from docdepth.errors import CalibrationError, DatasetError
from docdepth.geometry.camera import camera_of
from docdepth.geometry.se3 import inverse

log = logging.getLogger(__name__)

_UNPACK = "unpack the metadata of nuScenes again"
_ROWS = packed(x="f4", y="f4", z="f4", intensity="f4", ring="f4")
# nuScenes' LiDAR has x to the right and y ahead, docdepth x ahead and y to the left.
_T_LIDAR_THEIRS = np.array([[0.0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])


class _Row(Entry):
    token: str


class _Scene(_Row):
    name: str


class _Sample(_Row):
    scene_token: str


class _Sensor(_Row):
    channel: str


class _Pose(_Row):
    rotation: list[float]
    translation: list[float]


class _Place(_Pose):
    sensor_token: str
    camera_intrinsic: list[tuple[float, float, float]]


class _Datum(_Row):
    sample_token: str
    ego_pose_token: str
    calibrated_sensor_token: str
    timestamp: Microseconds
    filename: PathInside
    width: int = 0
    height: int = 0


_Kind = TypeVar("_Kind", bound=_Row)


@dataclass(frozen=True)
class Tables:
    """The tables of a version of nuScenes."""

    folder: Path  # ``ROOT/v1.0-mini`` or the like

    def rows(self, name: str, kind: type[_Kind]) -> list[_Kind]:
        """All rows of a table."""
        return read_json(self.folder / f"{name}.json", _UNPACK, list[kind])  # type: ignore[valid-type]

    def by_token(self, name: str, kind: type[_Kind], tokens: Iterable[str]) -> dict[str, _Kind]:
        """Rows of these tokens."""
        wanted = set(tokens)
        found = {row.token: row for row in self.rows(name, kind) if row.token in wanted}
        lacking = sorted(wanted - found.keys())
        if lacking:
            raise DatasetError(f"{self.folder / name}.json lacks {lacking[0]}; {_UNPACK}")
        return found

    @cached_property
    def scenes(self) -> dict[str, str]:
        """Token of each scene by its name."""
        return {row.name: row.token for row in self.rows("scene", _Scene)}


class NuscenesSettings(RecordingSettings):
    """What docdepth.yaml of a recording in this layout takes."""

    lidar: str = "LIDAR_TOP"  # the channel whose sweeps are read


def turned(rows: NDArray[Any], where: str) -> Cloud:
    """The points of a sweep, x ahead."""
    points = np.stack([rows["y"], -rows["x"], rows["z"]], axis=1)
    return Cloud(points, rows["intensity"].copy(), rings(rows["ring"]))


def _open(path: Path, image_size: tuple[int, int] | None) -> Recording:
    """``ROOT/SCENE``, or ROOT where it holds one scene: LIDAR_TOP at 20 Hz, and its cameras.

    Sweeps are compensated for the motion of the vehicle, to the end of the revolution.
    """
    root = path if path.is_dir() else path.parent
    settings = read_settings(root, NuscenesSettings, {"motion_compensated": True})
    tables, scene = _find_scene(root, None if path == root else path.name)
    channels = _channels(tables, scene)
    if settings.lidar not in channels:
        raise DatasetError(
            f"{tables.folder}: scene {scene} has no {settings.lidar}, but {', '.join(channels)}; "
            f"say lidar: NAME in {settings.file}, or {_UNPACK}"
        )
    rows = [row for channel in channels.values() for row in channel]
    places = tables.by_token(
        "calibrated_sensor", _Place, {row.calibrated_sensor_token for row in rows}
    )
    lidar = channels[settings.lidar]
    place = places[lidar[0].calibrated_sensor_token]
    T_ego_lidar = _pose(place, tables, "calibrated_sensor") @ inverse(_T_LIDAR_THEIRS)
    ego = tables.by_token("ego_pose", _Pose, {row.ego_pose_token for row in lidar})
    T_world_ego = [_pose(ego[row.ego_pose_token], tables, "ego_pose") for row in lidar]
    cameras = {
        name: _camera(root, name, rows, places, tables, T_ego_lidar)
        for name, rows in channels.items()
        if name.startswith("CAM")
    }
    return Recording(
        "nuscenes",
        root,
        [_lidar(root, settings.lidar, lidar, tables)],
        cameras,
        np.stack(T_world_ego) @ T_ego_lidar,
        settings,
    )


def _find_scene(root: Path, name: str | None) -> tuple[Tables, str]:
    """The tables that hold a scene, and its token."""
    versions = [Tables(folder) for folder in _versions(root)]
    scenes = {scene: tables for tables in reversed(versions) for scene in tables.scenes}
    name = one_of(root, "scenes of nuScenes", sorted(scenes), name)
    return scenes[name], scenes[name].scenes[name]


def _channels(tables: Tables, scene: str) -> dict[str, list[_Datum]]:
    """Rows of ``sample_data`` of a scene by sensor, in the order of time."""
    samples = {row.token for row in tables.rows("sample", _Sample) if row.scene_token == scene}
    found = tables.rows("sample_data", _Datum)
    rows = [row for row in found if row.sample_token in samples]
    unknown = [row for row in found if not row.sample_token]
    if unknown and len(tables.scenes) == 1:  # of which all are
        rows += unknown
    elif unknown:
        log.warning(
            "%s: %d of %d rows have no sample_token, so that their scene is not known, and are "
            "left out; write that of the key frame after them",
            tables.folder / "sample_data.json", len(unknown), len(found),
        )  # fmt: skip
    places = tables.by_token(
        "calibrated_sensor", _Place, {row.calibrated_sensor_token for row in rows}
    )
    sensors = tables.by_token("sensor", _Sensor, {place.sensor_token for place in places.values()})
    channels: dict[str, list[_Datum]] = {}
    for row in sorted(rows, key=lambda row: row.timestamp):
        place = places[row.calibrated_sensor_token]
        channels.setdefault(sensors[place.sensor_token].channel, []).append(row)
    return channels


def _lidar(root: Path, name: str, rows: list[_Datum], tables: Tables) -> FileLidar:
    files = [root / row.filename for row in rows]
    lacking = [file for file in files if not file.is_file()]
    if 2 * len(lacking) > len(files):  # fewer are told like other broken sweeps
        raise DatasetError(
            f"{len(lacking)} of {len(files)} sweeps are missing, the first of them {lacking[0]}; "
            f"unpack samples and sweeps of {name}"
        )
    names = [file.name.removesuffix(".pcd.bin") for file in files]
    stream = LidarStream(name, _times(rows, names, tables), names)
    return FileLidar(stream, files, partial(read_stamped, rows=_ROWS, cloud=turned))


def _camera(
    root: Path,
    name: str,
    rows: list[_Datum],
    places: dict[str, _Place],
    tables: Tables,
    T_ego_lidar: NDArray[np.float64],
) -> CameraStream:
    place = places[rows[0].calibrated_sensor_token]
    K = np.array(place.camera_intrinsic, np.float64)
    if K.shape != (3, 3):
        raise CalibrationError(
            f"{tables.folder / 'calibrated_sensor.json'}: {name} has no intrinsics; {_UNPACK}"
        )
    images = [root / row.filename for row in rows]
    names = [image.stem for image in images]
    return CameraStream(
        name,
        camera_of(
            K,
            (rows[0].width, rows[0].height),
            f"{tables.folder / 'calibrated_sensor.json'}, {name}",
        ),
        inverse(_pose(place, tables, "calibrated_sensor")) @ T_ego_lidar,
        _times(rows, names, tables),
        names,
        images_if_any(images),
    )


def _times(rows: list[_Datum], names: list[str], tables: Tables) -> NDArray[np.int64]:
    times = np.array([row.timestamp for row in rows], np.int64) * MICROSECOND
    check_increasing(times, names, tables.folder / "sample_data.json")
    return times


def _pose(row: _Pose, tables: Tables, table: str) -> NDArray[np.float64]:
    where = f"{tables.folder / table}.json, {row.token}"
    return pose_of(row.rotation, row.translation, where)


def _versions(root: Path) -> list[Path]:
    return sorted(file.parent for file in root.glob("v1.0-*/sample_data.json"))


def _recognises(path: Path) -> bool:
    """A root, or a scene that may be in it."""
    return bool(_versions(path if path.is_dir() else path.parent)) and not path.is_file()


FORMAT = Format(
    "nuscenes",
    "ROOT/SCENE of nuScenes, such as nuscenes/scene-0061, where ROOT holds v1.0-mini, samples and "
    "sweeps",
    _recognises,
    _open,
)
