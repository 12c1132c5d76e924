"""Scenes in Toyota's Dataset Governance Policy (DGP), such as DDAD."""

from __future__ import annotations

import datetime
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from docdepth.datasets.base import CameraStream, LidarStream
from docdepth.datasets.cloud import Cloud, FileLidar, cloud_from_fields, rows_of
from docdepth.datasets.files import Entry, PathInside, images_if_any, read_json
from docdepth.datasets.format import Format
from docdepth.datasets.kitti_files import check_increasing
from docdepth.datasets.pose_tables import pose_of
from docdepth.datasets.recording import Recording
from docdepth.datasets.settings import RecordingSettings, read_settings
from docdepth.errors import CalibrationError, DatasetError
from docdepth.geometry.camera import Camera
from docdepth.geometry.se3 import inverse
from docdepth.io.untrusted import ArrayError, read_arrays

_COPY = "copy the scene again"
_MICROSECOND = 1000  # ns
# Some scenes count ten microseconds a microsecond, which puts them beyond this year.
_LAST_YEAR = 2100


class _Quaternion(Entry):
    qw: float
    qx: float
    qy: float
    qz: float


class _Vector(Entry):
    x: float
    y: float
    z: float


class _Pose(Entry):
    rotation: _Quaternion
    translation: _Vector


class _Intrinsics(Entry):
    fx: float
    fy: float
    cx: float
    cy: float
    skew: float = 0.0


class _Calibration(Entry):
    names: list[str]
    extrinsics: list[_Pose]
    intrinsics: list[_Intrinsics]


class _About(Entry):
    filename: PathInside
    point_format: tuple[Annotated[str, Field(min_length=1)], ...] = ()
    width: int = 0
    height: int = 0
    pose: _Pose | None = None


class _Kinds(Entry):
    point_cloud: _About | None = None
    image: _About | None = None


class _Id(Entry):
    name: str
    timestamp: str


class _Datum(Entry):
    id: _Id
    datum: _Kinds


class _Sample(Entry):
    calibration_key: PathInside


class _Scene(Entry):
    data: list[_Datum]
    samples: list[_Sample]


@dataclass(frozen=True)
class Datum:
    """A sweep or an image of a scene."""

    name: str  # of the sensor
    kind: str  # ``point_cloud`` or ``image``
    time: int  # nanoseconds
    file: Path
    entry: _About  # what the scene says of it


def read_sweep(file: Path, where: str, columns: dict[Path, list[str]]) -> Cloud:
    """The points of a file, whose columns the scene tells."""
    try:
        table = read_arrays(file)["data"]
    except (OSError, ArrayError, KeyError) as error:
        raise DatasetError(f"{where} is no sweep of DGP ({error}); {_COPY}") from None
    names = columns[file]
    if table.ndim != 2 or table.shape[1] != len(names):
        raise DatasetError(
            f"{where} has shape {table.shape}, but the scene says {' '.join(names)}; {_COPY}"
        )
    return cloud_from_fields(rows_of({n: table[:, k] for k, n in enumerate(names)}), where)


def _open(path: Path, image_size: tuple[int, int] | None) -> Recording:
    """LiDARs, cameras, and a pose of each sweep.

    DDAD's points are of several LiDARs in the vehicle's frame, one after the other; a run finds
    where they are.
    """
    settings = read_settings(path, RecordingSettings)
    file = _scene_file(path)
    scene = read_json(file, _COPY, _Scene)
    data = list(_data(path, scene, file))
    keys = {sample.calibration_key for sample in scene.samples}
    if len(keys) != 1:
        raise CalibrationError(f"{file} has {len(keys)} calibrations; docdepth reads one")
    calibration = _Sensors(path / "calibration" / f"{keys.pop()}.json")
    names = list(dict.fromkeys(datum.name for datum in data))
    by_name = {n: sorted((d for d in data if d.name == n), key=lambda d: d.time) for n in names}
    clouds = {name: own for name, own in by_name.items() if own[0].kind == "point_cloud"}
    if not clouds:
        raise DatasetError(f"{file} has no point clouds; {_COPY}")
    first = next(iter(clouds))
    T_ego_lidar = calibration.place(first)
    lidars = []
    for name, own in clouds.items():
        T = np.eye(4) if name == first else inverse(T_ego_lidar) @ calibration.place(name)
        stream = LidarStream(name, _times(own, file), [d.file.stem for d in own], T)
        columns = {d.file: [c.lower() for c in d.entry.point_format] for d in own}
        lidars.append(
            FileLidar(stream, [d.file for d in own], partial(read_sweep, columns=columns))
        )
    cameras = {
        name: _camera(name, own, calibration, T_ego_lidar, file)
        for name, own in by_name.items()
        if own[0].kind == "image"
    }
    poses = [_pose(d.entry.pose, f"{file}, {d.file.name}") for d in clouds[first]]
    return Recording("dgp", path, lidars, cameras, np.stack(poses), settings)


class _Sensors:
    """Intrinsics and extrinsics of a scene's sensors."""

    def __init__(self, file: Path) -> None:
        self.file = file
        self._known = read_json(file, _COPY, _Calibration, CalibrationError)

    def _number(self, name: str) -> int:
        known = self._known
        if not (name in known.names and len(known.names) == len(known.extrinsics)
                == len(known.intrinsics)):  # fmt: skip
            raise CalibrationError(f"{self.file} has no place of {name}; {_COPY}")
        return known.names.index(name)

    def place(self, name: str) -> NDArray[np.float64]:
        """``T_ego_sensor`` (4, 4)."""
        return _pose(self._known.extrinsics[self._number(name)], f"{self.file}, {name}")

    def camera(self, name: str, width: int, height: int) -> Camera:
        """The camera of a sensor."""
        known = self._known.intrinsics[self._number(name)]
        if known.skew:
            raise CalibrationError(f"{self.file}: {name} has skew; rectify its images")
        K = [[known.fx, 0, known.cx], [0, known.fy, known.cy], [0, 0, 1]]
        return Camera(np.array(K, np.float64), width, height)


def _data(path: Path, scene: _Scene, file: Path) -> Iterator[Datum]:
    """Sweeps and images in the order of the scene."""
    for entry in scene.data:
        for kind, about in (("point_cloud", entry.datum.point_cloud), ("image", entry.datum.image)):
            if about is not None:
                time = _nanoseconds(entry.id.timestamp, file)
                yield Datum(entry.id.name, kind, time, path / about.filename, about)


def _nanoseconds(text: str, file: Path) -> int:
    """Time since 1970 of a date."""
    try:
        date = datetime.datetime.fromisoformat(text.replace("Z", "+00:00"))
    except ValueError:
        raise DatasetError(f"{file}: {text!r} is no time; {_COPY}") from None
    if date.tzinfo is None:
        date = date.replace(tzinfo=datetime.timezone.utc)
    since = date - datetime.datetime.fromtimestamp(0, datetime.timezone.utc)
    microseconds = (since.days * 86400 + since.seconds) * 10**6 + since.microseconds
    return microseconds * (_MICROSECOND // 10 if date.year > _LAST_YEAR else _MICROSECOND)


def _times(data: list[Datum], file: Path) -> NDArray[np.int64]:
    times = np.array([datum.time for datum in data], np.int64)
    check_increasing(times, [datum.file.name for datum in data], file)
    return times


def _camera(
    name: str,
    data: list[Datum],
    calibration: _Sensors,
    T_ego_lidar: NDArray[np.float64],
    file: Path,
) -> CameraStream:
    images = [datum.file for datum in data]
    return CameraStream(
        name,
        calibration.camera(name, data[0].entry.width, data[0].entry.height),
        inverse(calibration.place(name)) @ T_ego_lidar,
        _times(data, file),
        [image.stem for image in images],
        images_if_any(images),
    )


def _pose(entry: _Pose | None, where: str) -> NDArray[np.float64]:
    if entry is None:
        raise DatasetError(f"{where} has no pose; {_COPY}")
    q, t = entry.rotation, entry.translation
    return pose_of((q.qw, q.qx, q.qy, q.qz), (t.x, t.y, t.z), where)


def _scene_file(path: Path) -> Path:
    files = sorted(path.glob("scene_*.json"))
    if len(files) != 1:
        raise DatasetError(f"{path} has {len(files)} files scene_*.json; a scene has one; {_COPY}")
    return files[0]


def _recognises(path: Path) -> bool:
    return (path / "calibration").is_dir() and any(path.glob("scene_*.json"))


FORMAT = Format(
    "dgp",
    "a scene of DGP (DDAD) with scene_*.json, calibration and point_cloud",
    _recognises,
    _open,
)
