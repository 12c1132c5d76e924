"""Logs of Argoverse 2's sensor dataset, through pyarrow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.base import CameraStream, LidarStream
from docdepth.datasets.cloud import Cloud, FileLidar, cloud_from_fields, rows_of
from docdepth.datasets.files import extra, unreadable
from docdepth.datasets.format import Format
from docdepth.datasets.kitti_files import image_files, in_order
from docdepth.datasets.pose_tables import pose_of
from docdepth.datasets.recording import Recording
from docdepth.datasets.settings import RecordingSettings, read_settings
from docdepth.datasets.times import times_of_names
from docdepth.errors import CalibrationError, DatasetError
from docdepth.geometry.camera import Camera
from docdepth.geometry.se3 import inverse, rigid, transform_points

_LIDARS = {"up_lidar": (0, 32), "down_lidar": (32, 64)}
"""Lasers of the two LiDARs, which stand on each other."""

_DOWNLOAD = "download the log again"
_COLUMNS = ("x", "y", "z", "intensity", "laser_number", "offset_ns")
_POSE = ("qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m")
_INTRINSICS = ("fx_px", "fy_px", "cx_px", "cy_px", "width_px", "height_px")


def read_sweep(
    file: Path, where: str, lasers: tuple[int, int], T_ego_sensor: NDArray[np.float64]
) -> Cloud:
    """The points of one of the two LiDARs, whose sweeps are in one file, in its frame."""
    table = read_feather(file, where, _COLUMNS)
    laser = table["laser_number"]
    kept = (laser >= lasers[0]) & (laser < lasers[1])
    cloud = cloud_from_fields(rows_of({name: table[name][kept] for name in _COLUMNS}), where)
    T = inverse(T_ego_sensor)
    points = transform_points(T, cloud.points.astype(np.float64))
    return replace(cloud, points=points.astype(np.float32))


def _open(path: Path, image_size: tuple[int, int] | None) -> Recording:
    """Two LiDARs on each other, nine cameras, poses.

    Sweeps are compensated for the motion of the vehicle, to the start of the sweep. The LiDAR frame
    has the axes of the vehicle and the place of the upper LiDAR.
    """
    settings = read_settings(path, RecordingSettings, {"motion_compensated": True})
    sweeps = in_order((path / "sensors" / "lidar").glob("*.feather"))
    remedy = "names are nanoseconds; download the log again"
    times = times_of_names(sweeps, 1, remedy)
    names = [file.stem for file in sweeps]
    places = _places(path / "calibration" / "egovehicle_SE3_sensor.feather")
    T_ego_lidar = rigid(np.eye(3), places["up_lidar"][:3, 3])
    lidars: list[FileLidar] = []
    for name, lasers in _LIDARS.items():
        T_ego_sensor = places[name] if lidars else T_ego_lidar
        stream = LidarStream(name, times, names, _exact(inverse(T_ego_lidar) @ T_ego_sensor))
        read = partial(read_sweep, lasers=lasers, T_ego_sensor=T_ego_sensor)
        lidars.append(FileLidar(stream, sweeps, read))
    cameras = _cameras(path, places, T_ego_lidar, lidars[0].stream)
    poses = _poses(path / "city_SE3_egovehicle.feather", times, names) @ T_ego_lidar
    return Recording("argoverse2", path, lidars, cameras, poses, settings)


def read_feather(file: Path, where: str, columns: Sequence[str]) -> dict[str, NDArray[Any]]:
    """These columns of a Feather file by name."""
    feather = extra("pyarrow.feather", "Feather files need pyarrow", "argoverse")
    pyarrow = import_module("pyarrow")
    if not file.is_file():
        raise unreadable(file, _DOWNLOAD)
    try:
        table = feather.read_table(file, memory_map=False)
    except (pyarrow.ArrowException, OSError) as error:
        raise DatasetError(f"{where} is no whole Feather file ({error}); {_DOWNLOAD}") from None
    if lacking := [name for name in columns if name not in table.column_names]:
        raise DatasetError(f"{where} has no column {lacking[0]}; {_DOWNLOAD}")
    return {name: table[name].to_numpy() for name in columns}


def _exact(T: NDArray[np.float64]) -> NDArray[np.float64]:
    """The identity where rounding alone parts a transform from it."""
    return np.eye(4) if np.abs(T - np.eye(4)).max() < 1e-12 else T


def _places(file: Path) -> dict[str, NDArray[np.float64]]:
    """``T_ego_sensor`` of each sensor."""
    table = read_feather(file, str(file), ("sensor_name", *_POSE))
    found = {
        str(name): _pose(table, k, f"{file}, {name}") for k, name in enumerate(table["sensor_name"])
    }
    for name in _LIDARS:
        if name not in found:
            raise CalibrationError(f"{file} has no {name}; {_DOWNLOAD}")
    return found


def _pose(table: dict[str, NDArray[Any]], row: int, where: str) -> NDArray[np.float64]:
    numbers = [table[name][row] for name in _POSE]
    return pose_of(numbers[:4], numbers[4:], where)


def _poses(file: Path, times: NDArray[np.int64], names: list[str]) -> NDArray[np.float64]:
    """``T_city_ego`` at each sweep."""
    table = read_feather(file, str(file), ("timestamp_ns", *_POSE))
    row_of = {int(time): row for row, time in enumerate(table["timestamp_ns"])}
    for frame, time in enumerate(times.tolist()):
        if time not in row_of:
            raise DatasetError(f"{file} has no pose of sweep {names[frame]} (frame {frame})")
    return np.stack([_pose(table, row_of[time], f"{file}, {time}") for time in times.tolist()])


def _cameras(
    path: Path,
    places: dict[str, NDArray[np.float64]],
    T_ego_lidar: NDArray[np.float64],
    lidar: LidarStream,
) -> dict[str, CameraStream]:
    """Cameras with intrinsics; those without images fire with the sweeps."""
    file = path / "calibration" / "intrinsics.feather"
    table = read_feather(file, str(file), ("sensor_name", *_INTRINSICS))
    cameras = {}
    for row, name in enumerate(str(name) for name in table["sensor_name"]):
        if name not in places:
            raise CalibrationError(f"{file}: {name} has no extrinsics; {_DOWNLOAD}")
        fx, fy, cx, cy = (float(table[c][row]) for c in _INTRINSICS[:4])
        images = image_files(path / "sensors" / "cameras" / name)
        cameras[name] = CameraStream(
            name,
            Camera(
                np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]),
                int(table["width_px"][row]),
                int(table["height_px"][row]),
            ),
            inverse(places[name]) @ T_ego_lidar,
            times_of_names(images, 1, "names are nanoseconds") if images else lidar.times,
            [image.stem for image in images] or lidar.names,
            images,
        )
    return cameras


def _recognises(path: Path) -> bool:
    return any((path / "sensors" / "lidar").glob("*.feather"))


FORMAT = Format(
    "argoverse2",
    "a log of Argoverse 2 with sensors/lidar/*.feather, calibration and "
    "city_SE3_egovehicle.feather",
    _recognises,
    _open,
)
