"""Sequences of PandaSet, whose sweeps are tables of pandas in the frame of the world."""

from __future__ import annotations

import gzip
import io
import pickle
import zlib
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.base import CameraStream, LidarStream
from docdepth.datasets.cloud import Cloud, FileLidar, cloud_from_fields, rows_of
from docdepth.datasets.files import Entry, Seconds, extra, read_bytes, read_json
from docdepth.datasets.format import Format
from docdepth.datasets.kitti_files import check_increasing, image_files, image_size, in_order
from docdepth.datasets.pose_tables import pose_of
from docdepth.datasets.recording import Recording
from docdepth.datasets.settings import RecordingSettings, read_settings
from docdepth.errors import CalibrationError, DatasetError
from docdepth.geometry.camera import Camera
from docdepth.geometry.se3 import inverse

_COPY = "unpack the sequence again"
_MOST = 1 << 28  # bytes of an inflated table; sweeps of PandaSet have 8 MB
_SPINNING = 0  # column d of the LiDAR on the roof; 1 is the one that looks ahead
_SIZE = (1920, 1080)  # pixels
_FRONT = "front_camera"
# Pandar64 has x to the left and y backwards, docdepth x ahead and y to the left.
_T_LIDAR_THEIRS = np.array([[0.0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
# From Pandar64 to each camera, of PandaSet's static calibration: quaternion w x y z, metres.
_EXTRINSICS = {
    "back_camera": (
        (0.713789231075861, 0.7003585531940812, -0.001595758695393934, -0.0005330311533742299),
        (-0.0004217634029916384, -0.21683144949675118, -1.0553445472201475),
    ),
    "front_camera": (
        (0.016213200031258722, 0.0030578899383849464, 0.7114721800418571, -0.7025205466606356),
        (0.0002585796504896516, -0.03907777167811011, -0.0440125762408362),
    ),
    "front_left_camera": (
        (0.33540022607039827, 0.3277491469609924, -0.6283486651480494, 0.6206973014480826),
        (-0.25842240863267835, -0.3070654284505582, -0.9244245686318884),
    ),
    "front_right_camera": (
        (0.3537633879725252, 0.34931795852655334, 0.6120314641083645, -0.6150170047424814),
        (0.2546935700219631, -0.24929449717803095, -0.8686597280810242),
    ),
    "left_camera": (
        (0.5050391917998245, 0.49253073152800625, -0.4989265501075421, 0.503409565706149),
        (0.23864835336611942, -0.2801448284013492, -0.5376795959387791),
    ),
    "right_camera": (
        (0.5087448402081216, 0.4947520981649951, 0.4977829953071897, -0.49860920419297333),
        (-0.23097163411257893, -0.30843497058841024, -0.6850441215571058),
    ),
}


class _Vector(Entry):
    x: float
    y: float
    z: float


class _Quaternion(_Vector):
    w: float


class _Pose(Entry):
    heading: _Quaternion
    position: _Vector


class _Intrinsics(Entry):
    fx: float
    fy: float
    cx: float
    cy: float


_Kind = TypeVar("_Kind")
# What the pickle of a table of numbers is made of. Others could run programs.
_HARMLESS = {
    "pandas": {
        *("DataFrame", "BlockManager", "Index", "RangeIndex", "_new_Index"),
        *("Int64Index", "UInt64Index", "Float64Index", "new_block", "_unpickle_block"),
    },
    "numpy": {"_reconstruct", "_frombuffer", "ndarray", "dtype", "scalar"},
    "builtins": {"slice"},
    "_codecs": {"encode"},
}


def T_camera_lidar(name: str) -> NDArray[np.float64]:
    """The place of a camera, (4, 4)."""
    return pose_of(*_EXTRINSICS[name], name) @ inverse(_T_LIDAR_THEIRS)


def read_sweep(file: Path, where: str) -> Cloud:
    """The points of the Pandar64, in the world."""
    table = read_table(file, where)
    lacking = [name for name in "xyzitd" if name not in table]
    if lacking:
        raise DatasetError(f"{where} has no column {lacking[0]}; {_COPY}")
    kept = table["d"] == _SPINNING
    return cloud_from_fields(rows_of({n: table[n][kept].astype("f8") for n in "xyzit"}), where)


def _open(path: Path, image_size: tuple[int, int] | None) -> Recording:
    """Pandar64 and six cameras.

    Sweeps are compensated for the motion of the vehicle. They are stamped when the front camera
    fires, in the middle of a revolution, and have the LiDAR's pose of then, which follows from that
    of the camera. The poses that come with the sweeps are of another place on the vehicle. Points
    of the LiDAR that looks ahead are left out: nothing tells clearly where it sits.
    """
    settings = read_settings(path, RecordingSettings, {"motion_compensated": True})
    front = path / "camera" / _FRONT
    sweeps = in_order((path / "lidar").glob("*.pkl.gz"))
    names = [sweep.name.removesuffix(".pkl.gz") for sweep in sweeps]
    times = _times(front / "timestamps.json", len(sweeps), "sweeps")
    file = front / "poses.json"
    poses = [
        pose_of((q.w, q.x, q.y, q.z), (t.x, t.y, t.z), f"{file}, entry {k}")
        for k, (q, t) in enumerate(
            (entry.heading, entry.position)
            for entry in _entries(file, _Pose, len(sweeps), "sweeps")
        )
    ]
    cameras = {
        name: _camera(path / "camera" / name)
        for name in _EXTRINSICS
        if (path / "camera" / name).is_dir()
    }
    return Recording(
        "pandaset",
        path,
        [FileLidar(LidarStream("pandar64", times, names), sweeps, read_sweep)],
        cameras,
        np.stack(poses) @ T_camera_lidar(_FRONT),
        settings,
        world=True,
    )


def read_table(file: Path, where: str) -> dict[str, NDArray[Any]]:
    """Columns of a zipped pickle of a table of pandas, without running what else may be in it."""
    pandas = extra("pandas", "sweeps of PandaSet need pandas", "pandaset")
    from pandas.compat.pickle_compat import Unpickler

    class Careful(Unpickler):  # type: ignore[misc]
        def find_class(self, module: str, name: str) -> Any:
            if name not in _HARMLESS.get(module.partition(".")[0], ()):
                raise pickle.UnpicklingError(f"it asks for {module}.{name}, which no table needs")
            return super().find_class(module, name)

    content = read_bytes(file, _COPY)
    try:
        with gzip.GzipFile(fileobj=io.BytesIO(content)) as stream:
            inflated = stream.read(_MOST + 1)
        if len(inflated) > _MOST:
            raise pickle.UnpicklingError("it holds more than 256 MB")
        table = Careful(io.BytesIO(inflated)).load()
    except (OSError, EOFError, zlib.error, pickle.UnpicklingError) as error:
        raise DatasetError(f"{where} is no whole table of pandas ({error}); {_COPY}") from None
    if not isinstance(table, pandas.DataFrame):
        raise DatasetError(f"{where} holds no table of pandas; {_COPY}")
    columns = {str(name): table[name].to_numpy() for name in table.columns}
    if other := [name for name, values in columns.items() if values.dtype.kind not in "fiub"]:
        raise DatasetError(f"{where} holds no numbers in its column {other[0]}; {_COPY}")
    return columns


def _entries(file: Path, kind: type[_Kind], count: int, what: str) -> list[_Kind]:
    """A list of JSON with an entry for each sweep or image."""
    entries = read_json(file, _COPY, list[kind])  # type: ignore[valid-type]
    if len(entries) != count or not count:
        raise DatasetError(f"{file} has {len(entries)} entries for {count} {what}; {_COPY}")
    return entries


def _times(file: Path, count: int, what: str) -> NDArray[np.int64]:
    seconds = np.array(_entries(file, Seconds, count, what))
    times = np.round(seconds * 1e9).astype(np.int64)
    check_increasing(times, [f"entry {k}" for k in range(count)], file)
    return times


def _camera(folder: Path) -> CameraStream:
    file = folder / "intrinsics.json"
    known = read_json(file, _COPY, _Intrinsics, CalibrationError)
    images = image_files(folder)
    stamps = folder / "timestamps.json"
    count = len(images) or len(read_json(stamps, _COPY, list[Seconds]))
    return CameraStream(
        folder.name,
        Camera(
            np.array([[known.fx, 0, known.cx], [0, known.fy, known.cy], [0, 0, 1]]),
            *(image_size(images) or _SIZE),
        ),
        T_camera_lidar(folder.name),
        _times(stamps, count, "images"),
        [image.stem for image in images] or [f"{k:02d}" for k in range(count)],
        images,
    )


FORMAT = Format(
    "pandaset",
    "a sequence of PandaSet with lidar/*.pkl.gz and camera/front_camera",
    lambda path: any((path / "lidar").glob("*.pkl.gz")),
    _open,
    experimental=True,
)
