"""A recording put together of LiDARs and cameras: what loaders of most formats return."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets import kitti_lidar
from docdepth.datasets.base import (
    CameraStream,
    DatasetRepr,
    ImageStream,
    LidarStream,
    Sweep,
    without_ego,
)
from docdepth.datasets.cloud import Cloud, LidarReader
from docdepth.datasets.files import settings_file
from docdepth.datasets.point_times import (
    USUAL_PERIOD,
    Instant,
    PointTimes,
    TimeSample,
    Unit,
    find_point_times,
    median_period,
    nearest_rows,
)
from docdepth.datasets.pose_tables import whole_poses
from docdepth.datasets.readable_frames import readable
from docdepth.datasets.resampled import ResampledLidar, joined_columns, resample
from docdepth.errors import DatasetError
from docdepth.geometry.points import usable_points
from docdepth.geometry.se3 import inverse
from docdepth.geometry.sensor_rig import SensorRig

log = logging.getLogger(__name__)

_TOGETHER = 0.75  # of a sweep: LiDARs whose stamps are farther apart did not measure together


@dataclass(frozen=True)
class RecordingOptions:
    """What files may not tell of a recording; ``docdepth.yaml`` does.

    Attributes
    ----------
    motion_compensated : bool, optional
        None: not said, taken as False.
    sensor_origin : tuple of float, optional
        Where the rays of a single LiDAR begin, metres in the frame of its points.
    unit, instant : str, optional
        Of the times of points, see :func:`~.point_times.find_point_times`.
    world : bool
        Points are in the frame of the poses; they are brought to the LiDAR frame.
    ego_boxes : sequence of six numbers
        Boxes around the vehicle itself, see :func:`~.base.without_ego`.
    sweep_duration : float, optional
        Seconds of a sweep: those of the recording are joined or cut, see :mod:`.resampled`.
    up : tuple of float, optional
        Direction that points up, LiDAR frame.
    """

    motion_compensated: bool | None = None
    sensor_origin: tuple[float, float, float] | None = None
    unit: Unit | None = None
    instant: Instant | None = None
    world: bool = False
    ego_boxes: Sequence[Sequence[float]] = ()
    sweep_duration: float | None = None
    up: tuple[float, float, float] | None = None


class _Part(NamedTuple):
    """The points of one LiDAR in the frame of the sweep, and nanoseconds since its stamp."""

    number: int
    cloud: Cloud
    points: NDArray[np.float32]
    relative_time: NDArray[np.float32] | None
    late: int


class Recording(DatasetRepr):
    """A dataset of one or more LiDARs.

    The first LiDAR gives the stamps and the frame of the sweeps. The others' points are added to
    the sweep that is nearest in time.

    Parameters
    ----------
    name : str
        Of the format.
    path : Path
    lidars : sequence of LidarReader
    cameras : dict of CameraStream
    poses : ndarray of float64, shape (n, 4, 4), optional
        ``T_world_lidar`` of each sweep; NaN where it is not known, which is kept as
        ``partial_poses`` for ranges of frames.
    options : RecordingOptions
    uncalibrated : dict of ImageStream
        Cameras whose K or place is not known; ``docdepth calibrate`` finds it.
    labels : callable, optional
        ``labels(index)`` gives the labels of a sweep, uint32 (N,), or None.

    Raises
    ------
    DatasetError
        There is no sweep, or one that was tried cannot be read.
    """

    def __init__(
        self,
        name: str,
        path: Path,
        lidars: Sequence[LidarReader],
        cameras: dict[str, CameraStream],
        poses: NDArray[np.float64] | None = None,
        options: RecordingOptions | None = None,
        labels: Callable[[int], NDArray[np.uint32] | None] | None = None,
        uncalibrated: dict[str, ImageStream] | None = None,
    ) -> None:
        self.name, self.path, self.cameras = name, path, cameras
        self.uncalibrated = uncalibrated or {}
        self._labels = labels
        self._options = options or RecordingOptions()
        if len(lidars) > 1 and self._options.sensor_origin is not None:
            raise DatasetError(
                f"{path}: sensor_origin is of one LiDAR, but there are {len(lidars)}, whose places "
                "are known; leave it out of docdepth.yaml"
            )
        self.up = self._options.up
        self._take(lidars, poses)
        if self._options.sweep_duration is not None:
            self._resample(self._options.sweep_duration, poses)

    def _take(self, lidars: Sequence[LidarReader], poses: NDArray[np.float64] | None) -> None:
        """All that follows from the sweeps of the LiDARs."""
        self.partial_poses, self.poses = poses, whole_poses(poses, self.path)
        self.lidars = {lidar.stream.name: lidar.stream for lidar in lidars}
        self._readers: list[LidarReader] = list(lidars)
        self.times: NDArray[np.int64] = lidars[0].stream.times
        if not len(self.times):
            raise DatasetError(f"{self.path} holds no sweep of {lidars[0].stream.name}")
        self._period = median_period(self.times)
        self._partners = [self._find_partners(lidar.stream) for lidar in lidars[1:]]
        self._point_times: list[PointTimes | None] = []
        self._is_kitti_lidar = False
        self._look_at_points()

    def _resample(self, duration: float, poses: NDArray[np.float64] | None) -> None:
        """Sweeps of this duration [s] in place of those of the recording."""
        if self._options.motion_compensated or self._options.world:
            raise DatasetError(
                f"{self.path}: sweep_duration joins sweeps as they were measured, but these are "
                "motion compensated or in the world; leave it out of docdepth.yaml"
            )
        lidars, poses = resample(self._readers, poses, duration, self._point_times, self.path)
        self._options = replace(self._options, unit=None, instant=None)
        self._take(lidars, poses)

    def __len__(self) -> int:
        return len(self.times)

    @property
    def point_times(self) -> list[PointTimes | None]:
        """How each LiDAR counts the times of its points; None where they are not known."""
        return list(self._point_times)

    def sweep(self, index: int) -> Sweep:
        """Sweep ``index`` of all LiDARs, every row of the recording."""
        index = range(len(self))[index]
        parts = [self._part(0, index, index)]
        for number, partners in enumerate(self._partners, start=1):
            if partners[index] >= 0:
                parts.append(self._part(number, int(partners[index]), index))
        sweep = Sweep(
            np.concatenate([part.points for part in parts]),
            self._readers[0].stream.names[index],
            int(self.times[index]),
            joined_columns([part.cloud.intensity for part in parts]),
            self._relative_time(parts),
            self._rig(parts),
            self._options.motion_compensated or False,
            joined_columns([part.cloud.ring for part in parts]),
        )
        return without_ego(sweep, self._options.ego_boxes)

    def sweep_files(self, index: int) -> list[Path]:
        """The files of sweep ``index`` of each LiDAR, and the one that masks some of it."""
        index = range(len(self))[index]
        files = self._readers[0].files(index)
        for reader, partners in zip(self._readers[1:], self._partners, strict=True):
            files = files + (reader.files(int(partners[index])) if partners[index] >= 0 else [])
        masks = [settings_file(self.path)] if self._options.ego_boxes else []
        return list(dict.fromkeys(files + masks))

    def labels(self, index: int) -> NDArray[np.uint32] | None:
        """Labels of every point of sweep ``index``; None without a file."""
        index, reader = range(len(self))[index], self._readers[0]
        if not isinstance(reader, ResampledLidar):
            return self._measured_labels(index)
        found = [
            None if labels is None else labels[piece.rows]
            for piece in reader.pieces(index)
            for labels in [self._measured_labels(piece.index)]
        ]
        if len(self._readers) > 1 and joined_columns(found) is not None:
            raise DatasetError(
                f"{self.path} (frame {index}): labels of several LiDARs cannot be divided by "
                "sweep_duration; leave it out of docdepth.yaml"
            )
        return joined_columns(found)

    def _measured_labels(self, own: int) -> NDArray[np.uint32] | None:
        """Labels of a sweep as it was recorded."""
        return None if self._labels is None else self._labels(own)

    def _find_partners(self, other: LidarStream) -> NDArray[np.int64]:
        """For each sweep the nearest one of another LiDAR; -1 where there is none."""
        if not len(other.times):
            return np.full(len(self), -1)
        nearest = nearest_rows(other.times, self.times)
        if self._period is not None:
            far = np.abs(other.times[nearest] - self.times) > _TOGETHER * self._period
            nearest = np.where(far, -1, nearest)
        if (nearest < 0).any():
            log.warning(
                "%s: %d of %d sweeps have no points of %s, whose sweeps are at other times",
                self.path, (nearest < 0).sum(), len(self), other.name,
            )  # fmt: skip
        return nearest

    def _look_at_points(self) -> None:
        """Find how times of points count, and whether the LiDAR is KITTI's."""
        for number, reader in enumerate(self._readers):
            stamps = reader.stream.times
            indices = sorted({0, len(stamps) // 2, len(stamps) - 1}) if len(stamps) else []
            read = readable(reader.read, indices, len(stamps))
            indices, clouds = list(read), list(read.values())
            points = [self._in_lidar_frame(c, k) for c, k in zip(clouds, indices, strict=True)]
            if len(self._readers) == 1 and self._options.sensor_origin is None:
                self._is_kitti_lidar = kitti_lidar.is_kitti_lidar(points)
            samples = [
                TimeSample(cloud.times, usable_points(own), int(stamps[k]))
                for cloud, own, k in zip(clouds, points, indices, strict=True)
                if cloud.times is not None
            ]
            where = f"{self.path}, {reader.stream.name}" if number else str(self.path)
            options = self._options
            found = find_point_times(samples, self._period, where, options.unit, options.instant)
            self._point_times.append(found)
            if not samples and options.motion_compensated is None:
                log.warning(
                    "%s: points have no times, so sweeps are not deskewed; say in docdepth.yaml "
                    "motion_compensated: true if they are already, else false",
                    where,
                )

    def _part(self, number: int, own: int, index: int) -> _Part:
        reader, point_times = self._readers[number], self._point_times[number]
        cloud, stream = reader.read(own), reader.stream
        points, relative = self._in_lidar_frame(cloud, own), None
        if cloud.times is not None and point_times is not None:
            stamp = int(stream.times[own])
            relative = point_times.relative(TimeSample(cloud.times, usable_points(points), stamp))
            if relative is None:
                log.warning(
                    "%s (frame %d): points are measured more than a sweep and a half from the "
                    "stamp; their times are ignored, and the sweep stays as it was measured",
                    reader.files(own)[0], own,
                )  # fmt: skip
        if number:
            T = stream.T_lidar_sensor
            points = (points.astype(np.float64) @ T[:3, :3].T + T[:3, 3]).astype(np.float32)
        return _Part(number, cloud, points, relative, int(stream.times[own] - self.times[index]))

    def _in_lidar_frame(self, cloud: Cloud, own: int) -> NDArray[np.float32]:
        """Points in the frame of the LiDAR that measured them, float32 (N, 3)."""
        points = cloud.points
        if self._options.world:
            pose = cloud.T_world_lidar
            if pose is None:
                if self.poses is None:
                    raise DatasetError(
                        f"{self.path}: points are in the world, but there are no poses to bring "
                        "them to the LiDAR; say poses in docdepth.yaml"
                    )
                pose = self.poses[own]
            T = inverse(pose)
            points = points.astype(np.float64) @ T[:3, :3].T + T[:3, 3]
            points[(cloud.points == 0).all(axis=1)] = np.nan
        return np.ascontiguousarray(points, np.float32)

    def _relative_time(self, parts: Sequence[_Part]) -> NDArray[np.float32] | None:
        if len(parts) == 1 and parts[0].relative_time is None:
            if self._options.motion_compensated and self._is_kitti_lidar:
                return kitti_lidar.azimuth_relative_time(parts[0].points)
            return None
        if all(part.relative_time is None and part.late == 0 for part in parts):
            return None
        times, period = [], np.float64(self._period or USUAL_PERIOD)
        for part in parts:
            shares = part.relative_time
            shares = np.zeros(len(part.points), np.float32) if shares is None else shares
            times.append(shares + np.float32(part.late / period) if part.late else shares)
        return np.concatenate(times)

    def _rig(self, parts: Sequence[_Part]) -> SensorRig | None:
        if len(self._readers) == 1:
            points = parts[0].points
            if self._options.sensor_origin is not None:
                return SensorRig.single(self._options.sensor_origin, len(points))
            return kitti_lidar.sensor_rig(points) if self._is_kitti_lidar else None
        poses = np.stack([reader.stream.T_lidar_sensor for reader in self._readers])
        numbers = np.array([part.number for part in parts], np.uint8)
        return SensorRig(np.repeat(numbers, [len(part.points) for part in parts]), poses)
