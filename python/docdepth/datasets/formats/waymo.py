"""Segments of the Waymo Open Dataset's perception data, version 2, through pyarrow."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.base import LidarStream
from docdepth.datasets.cloud import Cloud
from docdepth.datasets.files import one_of
from docdepth.datasets.format import Format
from docdepth.datasets.formats.parquet_rows import ParquetRows
from docdepth.datasets.formats.waymo_cameras import (
    CAMERA,
    FRAME,
    FRONT,
    REMEDY,
    nanoseconds,
    pose_of_row,
    read_cameras,
)
from docdepth.datasets.formats.waymo_range_image import Beams, compensated, points_in_vehicle
from docdepth.datasets.kitti_files import check_increasing
from docdepth.datasets.point_times import USUAL_PERIOD, median_period
from docdepth.datasets.recording import Recording
from docdepth.datasets.settings import RecordingSettings, read_settings
from docdepth.errors import CalibrationError, DatasetError
from docdepth.geometry.se3 import inverse, transform_points

log = logging.getLogger(__name__)

LIDARS = {1: "TOP", 2: "FRONT", 3: "SIDE_LEFT", 4: "SIDE_RIGHT", 5: "REAR"}
_TOP = 1

_LASER = "key.laser_name"
_SAME_POSE = 1e-3  # metres, and entries of rotations
_MOVES = 0.2  # metres within a sweep; less does not tell which column came first


@dataclass(frozen=True)
class WaymoLidar:
    """One of the five LiDARs, whose sweeps are range images."""

    stream: LidarStream
    number: int  # as Waymo numbers LiDARs
    frames: list[int]  # microseconds that name each frame
    images: ParquetRows
    beams: Beams
    # (4, 4): Takes points of the vehicle to the frame of this LiDAR
    T_own_vehicle: NDArray[np.float64]
    poses: ParquetRows | None  # of the vehicle at each pixel; of the upper LiDAR alone
    T_world_vehicle: NDArray[np.float64]  # (n, 4, 4)
    period: int  # nanoseconds from frame to frame
    clockwise: bool = True  # columns were measured from the first to the last

    def read(self, index: int) -> Cloud:
        """Own sweep ``index``: a row for each pixel of the first return."""
        image = self._image(self.images, "LiDARComponent", index)
        if image is None:  # a LiDAR beside the upper one may lack a frame
            image = np.zeros((1, 1, 2), np.float32)
        height, width = image.shape[:2]
        where = f"{self.images.file} (frame {index}), {self.stream.name}"
        try:
            points = points_in_vehicle(image[..., 0], self.beams)
        except ValueError as error:
            raise DatasetError(f"{where}: {error}") from None
        if self.poses is not None:
            poses = self.pixel_poses(index)
            if poses.shape != (height, width, 6):
                raise DatasetError(
                    f"{self.poses.file} (frame {index}) is of other images; {REMEDY}"
                )
            points = compensated(points, poses, self.T_world_vehicle[index])
        own = transform_points(self.T_own_vehicle, points.reshape(-1, 3))
        times = None
        if self.number == _TOP:
            shares = (np.arange(width) + 0.5) / width - 0.5
            late = np.rint((shares if self.clockwise else -shares) * self.period)
            times = np.tile(late.astype(np.int64), height)
        return Cloud(
            own.astype(np.float32),
            np.ascontiguousarray(image[..., 1].ravel()),
            np.repeat(np.arange(height, dtype=np.uint16), width),
            times,
        )

    def files(self, index: int) -> list[Path]:
        """The files of its components, which hold all sweeps."""
        return [self.images.file, *([] if self.poses is None else [self.poses.file])]

    def pixel_poses(self, index: int) -> NDArray[np.float32]:
        """Roll, pitch, yaw, x, y and z of the vehicle at each pixel, (H, W, 6)."""
        assert self.poses is not None
        poses = self._image(self.poses, "LiDARPoseComponent", index)
        assert poses is not None
        return poses

    def _image(self, rows: ParquetRows, component: str, index: int) -> NDArray[np.float32] | None:
        """A range image (H, W, k); None if this LiDAR has none, which the upper one must have."""
        key = self.frames[index], self.number
        if key not in rows.rows and self.number != _TOP:
            return None
        where = f"{rows.file} (frame {index}), {self.stream.name}"
        name = f"[{component}].range_image_return1"
        values, shape = rows.read(key, (f"{name}.values", f"{name}.shape"), where)
        sizes = [int(n) for n in shape.as_py() or ()]
        numbers = np.zeros(0, np.float32)
        if values.is_valid:
            numbers = np.asarray(values.values.to_numpy(zero_copy_only=False), np.float32)
        if len(sizes) != 3 or int(np.prod(sizes)) != len(numbers) or 0 in sizes or sizes[2] < 2:
            raise DatasetError(
                f"{where}: {len(numbers)} numbers are no range image of the shape {sizes}; {REMEDY}"
            )
        return numbers.reshape(sizes)


def _open(path: Path, image_size: tuple[int, int] | None) -> Recording:
    """``ROOT/SEGMENT``, where ROOT holds ``lidar/SEGMENT.parquet``, or ROOT of one segment.

    The points of the upper LiDAR are compensated for the motion of the vehicle by the pose of each
    pixel. The LiDAR frame has the axes of the vehicle and the place of the upper LiDAR. A frame is
    stamped when its pose holds, in the middle of the revolution.
    """
    root = path if path.is_dir() else path.parent
    known = sorted(file.stem for file in (root / "lidar").glob("*.parquet"))
    wanted = None if path == root else path.name.removesuffix(".parquet")
    segment = one_of(root, "segments of Waymo", known, wanted)

    def file(component: str) -> Path:
        return root / component / f"{segment}.parquet"

    images = ParquetRows(file("lidar"), (FRAME, _LASER), REMEDY)
    poses = None
    if file("lidar_pose").is_file():
        poses = ParquetRows(file("lidar_pose"), (FRAME, _LASER), REMEDY)
    usual = {"motion_compensated": poses is not None}
    settings = read_settings(root, RecordingSettings, usual)
    frames = sorted({frame for frame, laser in images.rows if laser == _TOP})
    if not frames:
        raise DatasetError(f"{file('lidar')} holds no sweep of the LiDAR TOP; {REMEDY}")
    T_world_vehicle = _poses(file("vehicle_pose"), frames)
    times = _times(file("camera_image"), frames, T_world_vehicle)
    lidars = _lidars(file("lidar_calibration"), images, poses, frames, times, T_world_vehicle)
    T_vehicle_lidar = inverse(lidars[0].T_own_vehicle)
    cameras = read_cameras(
        file("camera_calibration"), file("camera_image"), T_vehicle_lidar, lidars[0].stream
    )
    return Recording("waymo", root, lidars, cameras, T_world_vehicle @ T_vehicle_lidar, settings)


def _poses(file: Path, frames: list[int]) -> NDArray[np.float64]:
    """``T_world_vehicle`` of each frame."""
    rows = ParquetRows(file, (FRAME,), REMEDY)
    column = "[VehiclePoseComponent].world_from_vehicle.transform"
    poses = []
    for index, frame in enumerate(frames):
        where = f"{file} (frame {index})"
        poses.append(pose_of_row(rows.read((frame,), (column,), where)[0], where))
    return np.stack(poses)


def _times(
    file: Path, frames: list[int], T_world_vehicle: NDArray[np.float64]
) -> NDArray[np.int64]:
    """Nanoseconds at which the pose of each frame holds.

    Frames are named by the start of their revolution, but have the pose of the front camera's
    image, which is taken in the middle. Those without this image are taken to be as late as others.
    """
    starts = np.array(frames, np.int64) * 1000
    half = (median_period(starts) or USUAL_PERIOD) // 2
    if not file.is_file():
        return np.asarray(starts + half)
    rows = ParquetRows(file, (FRAME, CAMERA), REMEDY)
    columns = ("[CameraImageComponent].pose.transform", "[CameraImageComponent].pose_timestamp")
    late = np.full(len(frames), np.nan)
    for index, frame in enumerate(frames):
        if (frame, FRONT) in rows.rows:
            where = f"{file} (frame {index})"
            pose, seconds = rows.read((frame, FRONT), columns, where)
            apart = np.abs(pose_of_row(pose, where) - T_world_vehicle[index]).max()
            if apart < _SAME_POSE and seconds.is_valid:
                late[index] = nanoseconds(seconds.as_py()) - starts[index]
    if np.isnan(late).all():
        log.warning(
            "%s: no image of FRONT has the pose of its frame, so nothing tells when that holds; "
            "the middle of the revolution is taken", file,
        )  # fmt: skip
        return np.asarray(starts + half)
    late = np.where(np.isnan(late), np.nanmedian(late), late)
    times: NDArray[np.int64] = starts + np.rint(late).astype(np.int64)
    check_increasing(times, [str(frame) for frame in frames], file)
    return times


def _lidars(
    file: Path,
    images: ParquetRows,
    poses: ParquetRows | None,
    frames: list[int],
    times: NDArray[np.int64],
    T_world_vehicle: NDArray[np.float64],
) -> list[WaymoLidar]:
    """The LiDARs that have sweeps, the upper one first."""
    rows = ParquetRows(file, (_LASER,), REMEDY)
    names, period = [str(frame) for frame in frames], median_period(times) or USUAL_PERIOD
    T_vehicle_lidar = np.eye(4)
    lidars: list[WaymoLidar] = []
    for number in sorted({laser for _, laser in images.rows if laser in LIDARS}):
        beams = _beams(rows, number, f"{file}, {LIDARS[number]}")
        T_vehicle_own = beams.T_vehicle_sensor
        if number == _TOP:
            T_vehicle_lidar[:3, 3] = T_vehicle_own[:3, 3]
            T_vehicle_own = T_vehicle_lidar
        T_lidar_own = inverse(T_vehicle_lidar) @ T_vehicle_own if lidars else np.eye(4)
        lidars.append(
            WaymoLidar(
                LidarStream(LIDARS[number], times, names, T_lidar_own), number, frames, images,
                beams, inverse(T_vehicle_own), poses if number == _TOP else None,
                T_world_vehicle, period,
            )
        )  # fmt: skip
    return [replace(lidars[0], clockwise=_clockwise(lidars[0])), *lidars[1:]]


def _beams(rows: ParquetRows, number: int, where: str) -> Beams:
    name = "[LiDARCalibrationComponent]"
    columns = tuple(
        f"{name}.{one}"
        for one in (
            "beam_inclination.min", "beam_inclination.max", "beam_inclination.values",
            "extrinsic.transform",
        )
    )  # fmt: skip
    low, high, values, extrinsic = (one.as_py() for one in rows.read((number,), columns, where))
    T = pose_of_row(extrinsic, where)
    inclinations = np.array(values or [low, high], np.float64)
    if not np.isfinite(inclinations).all():
        raise CalibrationError(f"{where} has no inclinations; {REMEDY}")
    return Beams(T, inclinations, not values)


def _clockwise(lidar: WaymoLidar) -> bool:
    """Whether columns were measured in their order: the vehicle tells, where it moves.

    Range images run clockwise, and so does the LiDAR where nothing tells the opposite.
    """
    if lidar.poses is None or len(lidar.frames) < 2:
        return True
    steps = np.diff(lidar.T_world_vehicle[:, :3, 3], axis=0)
    index = int(np.linalg.norm(steps, axis=1).argmax())
    if np.linalg.norm(steps[index]) < _MOVES:
        return True
    poses = lidar.pixel_poses(index)
    known = np.flatnonzero((poses != 0).any(axis=(0, 2)))
    if len(known) < 2:
        return True
    ends = [poses[:, column, 3:].astype(np.float64) for column in known[[0, -1]]]
    first, last = (places[(places != 0).any(axis=1)].mean(axis=0) for places in ends)
    return bool((last - first) @ steps[index] >= 0)


def _recognises(path: Path) -> bool:
    """A root, or a segment that may be in it."""
    if path.is_dir():
        return any((path / "lidar").glob("*.parquet"))
    return not path.is_file() and any((path.parent / "lidar").glob("*.parquet"))


FORMAT = Format(
    "waymo",
    "ROOT/SEGMENT of the Waymo Open Dataset, version 2, where ROOT holds lidar/SEGMENT.parquet, "
    "lidar_calibration, vehicle_pose and other components",
    _recognises,
    _open,
    experimental=True,
)
