"""Frames and trajectories of a run folder, in the PLY layout of the official DOC-Depth release."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth.errors import DamagedFileError, InputError, RunError
from docdepth.geometry.lidar_frame import LidarFrame, SensorRig
from docdepth.geometry.points import FARTHEST
from docdepth.geometry.se3 import matrix_to_quaternion, poses_from, quaternion_to_matrix
from docdepth.geometry.trajectory import Trajectory
from docdepth.io.atomic import WriteFile, write_atomically
from docdepth.io.file_records import is_file_name
from docdepth.io.ply import read_comments, read_vertices, write_vertices
from docdepth.io.untrusted import ArrayError, read_array, read_kept_arrays

_SECOND = 1_000_000_000  # nanoseconds

_TRAJECTORY = np.dtype(
    [(name, "<f8") for name in ("x", "y", "z", "q_w", "q_x", "q_y", "q_z", "timestamp")]
    # A double loses the nanoseconds of a clock that counts from 1970, so they stand apart.
    + [("indices", "<i4"), ("seconds", "<u4"), ("nanoseconds", "<u4")]
)
_GRID = 2.0**-48  # of quaternions in files: 7e-15 radians, 16 times what a double loses
_LARGE = 0.4  # the largest component of a unit quaternion is at least 0.5
_SECONDS = {"<u4": (0, 1 << 32), "<i4": (-(1 << 31), 1 << 31)}
"""Limits of what holds the seconds: 1970 to 2106, or 1902 to 2038 where a stamp is before 1970."""

_CLASSES = {name: "<u2" for name in ("classid", "instance", "votes_static", "votes_dynamic")}
_OF_SENSORS = ("T_lidar_sensor", "lateral_offset", "lidar_id", "beam_width")
_OPTIONAL = {**_CLASSES, "time_offset": "<f4", "sensor": "<u1"}
"""Properties of a frame that it may lack. Frames of a run have their classes in another file."""


def write_trajectory(
    path: Path,
    trajectory: Trajectory,
    indices: NDArray[np.int64],
    write_file: WriteFile = write_atomically,
) -> None:
    """Write poses as ``x y z q_w q_x q_y q_z timestamp indices``, in doubles and seconds."""
    rows = np.zeros(len(trajectory), _trajectory_type(trajectory.times, path))
    rows["x"], rows["y"], rows["z"] = trajectory.poses[:, :3, 3].T
    quaternions = np.array([_stored_quaternion(pose[:3, :3]) for pose in trajectory.poses])
    rows["q_x"], rows["q_y"], rows["q_z"], rows["q_w"] = quaternions.T
    rows["timestamp"] = trajectory.times / _SECOND
    rows["seconds"], rows["nanoseconds"] = np.divmod(trajectory.times, _SECOND)
    rows["indices"] = indices
    write_vertices(path, rows, [], write_file)


def _stored_quaternion(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Quaternion (x, y, z, w) of a 3x3 rotation; poses that were read are written as they were.

    The way to a matrix and back moves the last digits. So three components lie on a grid that is
    coarser than that, and a large one makes the length 1.
    """
    quaternion = np.round(matrix_to_quaternion(rotation) / _GRID) * _GRID
    # Not the largest: rounding could make another one the largest.
    large = int(np.argmax(np.abs(quaternion) > _LARGE))
    others = np.delete(quaternion, large)
    quaternion[large] = np.copysign(np.sqrt(1 - others @ others), quaternion[large])
    return quaternion


def _trajectory_type(times: NDArray[np.int64], path: Path) -> np.dtype[Any]:
    """Of a row of a trajectory with these stamps."""
    first, last = int(times[0]) // _SECOND, int(times[-1]) // _SECOND
    for kind, (low, end) in _SECONDS.items():
        if low <= first and last < end:
            names = _TRAJECTORY.names or ()
            return np.dtype([(n, kind if n == "seconds" else _TRAJECTORY[n].str) for n in names])
    raise InputError(
        f"{path.name}: stamps from {first} to {last} s are no times between 1902 and 2106; are "
        "those of the recording in another unit than they should be?"
    )


def read_trajectory(path: Path) -> tuple[Trajectory, NDArray[np.int64]]:
    """Read poses and their frame indices; ``qx`` is read like ``q_x``."""
    rows, _ = read_vertices(path)
    names = rows.dtype.names or ()
    try:
        quaternions = np.stack(
            [rows[f"q_{a}" if f"q_{a}" in names else f"q{a}"] for a in "xyzw"], axis=1
        )
        positions = np.stack([rows[a] for a in "xyz"], axis=1)
        if "nanoseconds" in names:
            times = rows["seconds"].astype(np.int64) * _SECOND + rows["nanoseconds"].astype(
                np.int64
            )
        else:
            if not np.isfinite(rows["timestamp"]).all():
                raise ValueError("a timestamp is not finite")
            times = np.round(rows["timestamp"] * _SECOND).astype(np.int64)
        indices = rows["indices"].astype(np.int64)
    except (KeyError, ValueError) as error:
        raise DamagedFileError(
            path, f"{error}; a trajectory has x y z q_w q_x q_y q_z timestamp indices"
        ) from None
    if not len(rows):
        raise DamagedFileError(path, "it holds no poses")
    try:
        poses = poses_from([quaternion_to_matrix(q) for q in quaternions], positions)
        return Trajectory(times, poses), indices
    except InputError as error:
        raise DamagedFileError(path, str(error)) from None


def read_whole_trajectory(path: Path) -> Trajectory:
    """The poses of a run, one a frame; read once, since all chunks of a worker ask for them."""
    return _whole_trajectory(path, _identity(path))


@lru_cache(maxsize=1)
def _whole_trajectory(path: Path, identity: tuple[int, ...]) -> Trajectory:
    trajectory, indices = read_trajectory(path)
    if not np.array_equal(indices, np.arange(len(indices))):
        raise RunError(f"{path}: its frames are not numbered 0, 1, 2, ... without gaps")
    return trajectory


def _identity(path: Path) -> tuple[int, ...]:
    """Changes when a file is written anew; empty where there is no file."""
    try:
        known = path.stat()
    except OSError:
        return ()
    return known.st_ino, known.st_size, known.st_mtime_ns


def write_sensors(path: Path, sensor_rig: SensorRig, write_file: WriteFile) -> None:
    """Write where the LiDARs or their lasers sit, once for all frames, as NPZ."""
    arrays = {name: getattr(sensor_rig, name) for name in _OF_SENSORS}
    write_file(path, lambda stream: np.savez(stream, **arrays))


def read_sensors(path: Path, sensor: NDArray[np.uint8]) -> SensorRig:
    """Where the rays of points begin, by the sensor of each."""
    try:
        T, offsets, lidars, beam_width = _sensors(path, _identity(path))
        return SensorRig(sensor, T, offsets, lidars, beam_width=float(beam_width))
    except (InputError, TypeError, ValueError) as error:
        raise DamagedFileError(path, str(error)) from None


@lru_cache(maxsize=1)
def _sensors(path: Path, identity: tuple[int, ...]) -> list[NDArray[Any]]:
    """Arguments of :class:`SensorRig` that all frames of a run share, read once."""
    return read_kept_arrays(path, *_OF_SENSORS)


def write_frame(path: Path, frame: LidarFrame, write_file: WriteFile = write_atomically) -> None:
    """Write a frame; classes, votes, times and sensors only where it has them."""
    fields: list[tuple[str, str]] = [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("index", "<u4")]
    columns = {name: getattr(frame, name, None) for name in _OPTIONAL}
    columns["sensor"] = None if frame.sensor_rig is None else frame.sensor_rig.index
    extra = {name: values for name, values in columns.items() if values is not None}
    fields += [(name, _OPTIONAL[name]) for name in extra]
    rows = np.empty(len(frame.points), np.dtype(fields))
    # Numpy is slow where both sides are strided and one of them is not aligned.
    rows["x"], rows["y"], rows["z"] = np.ascontiguousarray(frame.points.T)
    rows["index"] = frame.index
    for name, values in extra.items():
        rows[name] = values
    comments = [f"name {frame.name}", f"input_points {frame.input_points}"]
    write_vertices(path, rows, comments, write_file)


def read_frame(
    path: Path, rig_of: Callable[[NDArray[np.uint8]], SensorRig] | None = None
) -> LidarFrame:
    """Read a frame of docdepth or of the official release.

    Of the official release, which has no indices, row ``i`` has index ``i``. ``rig_of`` makes the
    sensor rig of the sensor of each point.
    """
    rows, comments = read_vertices(path)
    names = rows.dtype.names or ()
    points = _points(path, rows)
    notes = _notes(comments)
    name = notes.get("name", path.stem)
    if not is_file_name(name):
        raise DamagedFileError(path, f"its sweep is called {name[:60]!r}")
    index = (
        rows["index"].astype(np.uint32)
        if "index" in names
        else np.arange(len(rows), dtype=np.uint32)
    )
    columns = {
        name: np.ascontiguousarray(rows[name], kind)
        for name, kind in _OPTIONAL.items()
        if name in names
    }
    sensor = columns.pop("sensor", None)
    return LidarFrame(
        points,
        index,
        name,
        _count(path, notes.get("input_points", str(len(rows)))),
        sensor_rig=None if sensor is None or rig_of is None else rig_of(sensor),
        **columns,
    )


def write_classes(path: Path, frame: LidarFrame, write_file: WriteFile = write_atomically) -> None:
    """Write class, instance and votes of each point of a frame, as far as it has them, as NPY."""
    columns = {name: getattr(frame, name) for name in _CLASSES}
    known = {name: values for name, values in columns.items() if values is not None}
    rows = np.empty(len(frame), [(name, _CLASSES[name]) for name in known])
    for name, values in known.items():
        rows[name] = values
    write_file(path, lambda stream: np.save(stream, rows))


def with_classes(frame: LidarFrame, path: Path) -> LidarFrame:
    """A frame with the classes that :func:`write_classes` wrote."""
    try:
        rows = read_array(path)
    except (OSError, ArrayError) as error:
        raise DamagedFileError(path, str(error)) from None
    names = rows.dtype.names or ()
    if "classid" not in names or rows.shape != (len(frame),):
        raise DamagedFileError(path, f"it holds no classes of {len(frame)} points")
    columns = {
        name: np.ascontiguousarray(rows[name], kind) if name in names else None
        for name, kind in _CLASSES.items()
    }
    return replace(frame, **columns)  # type: ignore[arg-type]


def read_points(path: Path) -> NDArray[np.float32]:
    """Read only the points of a frame, float32 (N, 3)."""
    return _points(path, read_vertices(path)[0])


def _points(path: Path, rows: NDArray[Any]) -> NDArray[np.float32]:
    if not {"x", "y", "z"} <= set(rows.dtype.names or ()):
        raise DamagedFileError(path, "it has no x y z")
    return np.stack([np.ascontiguousarray(rows[name], np.float32) for name in "xyz"], axis=1)


def checked(path: Path, points: NDArray[np.float32]) -> NDArray[np.float32]:
    """The points of a frame, all of which a LiDAR may have seen."""
    if not (np.abs(points) < FARTHEST).all():
        raise DamagedFileError(path, "a point is not finite, or 100 km away")
    return points


def _count(path: Path, text: str) -> int:
    if not text.isascii() or not text.isdigit() or len(text) > 18:
        raise DamagedFileError(path, f"input_points is {text[:20]!r}")
    return int(text)


def read_frame_name(path: Path) -> str:
    """Name of the sweep of a frame, from the header of its file."""
    return _notes(read_comments(path)).get("name", path.stem)


def read_input_points(path: Path) -> int | None:
    """Rows of the input sweep of a frame, from the header of its file; None if it is not told."""
    told = _notes(read_comments(path)).get("input_points")
    return None if told is None else _count(path, told)


def _notes(comments: list[str]) -> dict[str, str]:
    return {name: value for name, _, value in (comment.partition(" ") for comment in comments)}
