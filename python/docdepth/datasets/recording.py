"""A recording put together of LiDARs and cameras: what loaders of most formats return."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets import kitti_lidar
from docdepth.datasets.base import CameraStream, DatasetRepr, ImageStream, LidarStream, Sweep
from docdepth.datasets.cloud import Cloud, LidarReader, joined_columns
from docdepth.datasets.files import is_there, read_bytes, readable
from docdepth.datasets.point_times import (
    USUAL_PERIOD,
    PointTimes,
    TimeSample,
    find_point_times,
    median_period,
    nearest_rows,
)
from docdepth.datasets.resampled import ResampledLidar, resample
from docdepth.datasets.settings import RecordingSettings
from docdepth.datasets.views import without_ego
from docdepth.errors import NOTE, DatasetError, DocDepthError
from docdepth.geometry.camera import checked_mount
from docdepth.geometry.lidar_frame import SensorRig
from docdepth.geometry.points import usable_points
from docdepth.geometry.se3 import inverse, transform_points

log = logging.getLogger(__name__)

Poses = NDArray[np.float64] | None

_TOGETHER = 0.75  # of a sweep: LiDARs whose stamps are farther apart did not measure together


class Part(NamedTuple):
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
    poses : ndarray of float64, shape (n, 4, 4), or callable, optional
        ``T_world_lidar`` of each sweep, or what reads them; NaN where it is not known.
    settings : RecordingSettings
        What files may not tell; ``docdepth.yaml`` does.
    world : bool
        Points are in the frame of the poses; they are brought to the LiDAR frame.
    uncalibrated : dict of ImageStream
        Cameras whose K or place is not known; ``docdepth calibrate`` finds it.
    labels : Path, optional
        Folder of labels ``NAME.label`` of the sweeps.

    Attributes
    ----------
    up : tuple of float, optional
        Direction that points up, LiDAR frame.
    stamp : {"start", "middle", "end"}, optional
        Which instant of a sweep its time is, as the user says.
    masks : dict
        Of cameras, see :func:`~.settings.camera_mask`.
    ego_boxes : list of list of float, optional
        Around the vehicle itself; its points are left out. None where nothing is said.
    broken : list of DocDepthError
        Of sweeps that were tried when the recording was opened; others were taken in their place.
    """

    def __init__(
        self,
        name: str,
        path: Path,
        lidars: Sequence[LidarReader],
        cameras: dict[str, CameraStream],
        poses: Poses | Callable[[], Poses] = None,
        settings: RecordingSettings | None = None,
        world: bool = False,
        uncalibrated: dict[str, ImageStream] | None = None,
        labels: Path | None = None,
    ) -> None:
        for camera in cameras.values():
            checked_mount(f"camera {camera.name}: T_camera_lidar", camera.T_camera_lidar)
        self.name, self.path, self.cameras = name, path, cameras
        self.uncalibrated = uncalibrated or {}
        self._label_folder, self._world = labels, world
        self._settings = settings or RecordingSettings()
        if len(lidars) > 1 and self._settings.sensor_origin is not None:
            raise DatasetError(
                f"{path}: sensor_origin is of one LiDAR, but there are {len(lidars)}, whose places "
                "are known; leave it out of docdepth.yaml"
            )
        self.up, self.masks = self._settings.up, self._settings.camera_masks()
        self.stamp = self._settings.stamp
        self.ego_boxes = self._settings.ego_boxes
        self.broken: list[DocDepthError] = []
        self._poses = poses
        self._take(lidars)
        if self._settings.sweep_duration is not None:
            self._resample(self._settings.sweep_duration)
        if error := self.elevation_error:
            self.cameras = {
                name: replace(
                    camera, T_camera_lidar=kitti_lidar.seen_raised(camera.T_camera_lidar, error)
                )
                for name, camera in cameras.items()
            }

    @cached_property
    def partial_poses(self) -> Poses:
        """``T_world_lidar`` (n, 4, 4), NaN for sweeps without a pose; None without any."""
        return self._poses() if callable(self._poses) else self._poses

    @cached_property
    def poses(self) -> Poses:
        """``T_world_lidar`` (n, 4, 4) if every sweep has a pose; else a warning says which do."""
        partial = self.partial_poses
        if partial is None:
            return None
        known = np.asarray(np.isfinite(partial).all(axis=(1, 2)))
        if known.all():
            return partial
        if not known.any():
            log.warning("%s: no sweep has a pose", self.path)
            return None
        ends = np.flatnonzero(np.diff(np.concatenate([[False], known, [False]])))
        begin, end = max(ends.reshape(-1, 2).tolist(), key=lambda run: run[1] - run[0])
        log.warning(
            "%s: %d of %d sweeps have no pose, so the recording has none; `frames='%d:%d'` has "
            "poses",
            self.path, len(known) - known.sum(), len(known), begin, end,
        )  # fmt: skip
        return None

    def _take(self, lidars: Sequence[LidarReader]) -> None:
        """All that follows from the sweeps of the LiDARs."""
        self.lidars = {lidar.stream.name: lidar.stream for lidar in lidars}
        self._readers: list[LidarReader] = list(lidars)
        self.times: NDArray[np.int64] = lidars[0].stream.times
        if not len(self.times):
            raise DatasetError(f"{self.path} holds no sweep of {lidars[0].stream.name}")
        self._period = median_period(self.times)
        self._partners = [self._find_partners(lidar.stream) for lidar in lidars[1:]]
        self._is_kitti_lidar = False
        self.point_times: list[PointTimes | None] = []
        """How each LiDAR counts the times of its points; None where they are not known."""
        self._look_at_points()

    def _resample(self, duration: float) -> None:
        """Sweeps of this duration [s] in place of those of the recording."""
        if self._settings.motion_compensated or self._world:
            raise DatasetError(
                f"{self.path}: sweep_duration joins sweeps as they were measured, but these are "
                "motion compensated or in the world; leave it out of docdepth.yaml"
            )
        lidars, self._poses = resample(
            self._readers, self.partial_poses, duration, self.point_times, self.path
        )
        del self.partial_poses
        self._settings = self._settings.model_copy(update={"point_time_unit": None, "stamp": None})
        self._take(lidars)

    def __len__(self) -> int:
        return len(self.times)

    def sweep(self, index: int) -> Sweep:
        """Sweep ``index`` of all LiDARs, every row of the recording."""
        index = range(len(self))[index]
        parts = self._parts(index)
        sweep = Sweep(
            np.concatenate([part.points for part in parts]),
            self._readers[0].stream.names[index],
            int(self.times[index]),
            joined_columns([part.cloud.intensity for part in parts]),
            self._relative_time(index, parts),
            self._rig(parts),
            self._settings.motion_compensated or False,
            joined_columns([part.cloud.ring for part in parts]),
            self._compensated_to(parts),
        )
        return without_ego(sweep, self.ego_boxes or [])

    def _parts(self, index: int) -> list[Part]:
        """What each LiDAR has of sweep ``index``."""
        own = [index, *(int(partners[index]) for partners in self._partners)]
        return [self._part(number, k, index) for number, k in enumerate(own) if k >= 0]

    def sweep_files(self, index: int) -> list[Path]:
        """The files of sweep ``index`` of each LiDAR, and the one that masks some of it."""
        index = range(len(self))[index]
        files = self._readers[0].files(index)
        for reader, partners in zip(self._readers[1:], self._partners, strict=True):
            files = files + (reader.files(int(partners[index])) if partners[index] >= 0 else [])
        masks = [self._settings.file] if self.ego_boxes else []
        return list(dict.fromkeys(files + masks))

    def labels(self, index: int) -> NDArray[np.uint32] | None:
        """Labels of every point of sweep ``index``; None without a file."""
        index, reader = range(len(self))[index], self._readers[0]
        if not isinstance(reader, ResampledLidar):
            return self._measured_labels(index, reader)
        found = [
            None if labels is None else labels[piece.rows]
            for piece in reader.pieces(index)
            for labels in [self._measured_labels(piece.own, reader.measured)]
        ]
        if len(self._readers) > 1 and joined_columns(found) is not None:
            raise DatasetError(
                f"{self.path} (frame {index}): labels of several LiDARs cannot be divided by "
                "sweep_duration; leave it out of docdepth.yaml"
            )
        return joined_columns(found)

    def _measured_labels(self, own: int, measured: LidarReader) -> NDArray[np.uint32] | None:
        """Labels of a sweep as it was recorded."""
        if self._label_folder is None:
            return None
        file = self._label_folder / f"{measured.stream.names[own]}.label"
        if not is_there(file):
            return None
        labels = read_bytes(file, "copy the labels again")
        whole = self._parts(own) if measured is self._readers[0] else [measured.read(own)]
        count = sum(len(part.points) for part in whole)
        if len(labels) != 4 * count:
            raise DatasetError(
                f"{file} (frame {own}) has {len(labels)} bytes for a sweep of {count} points; "
                "labels are one uint32 for each point, in the order of the sweep"
            )
        return np.frombuffer(labels, "<u4").astype(np.uint32)

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
            clouds = readable(reader.read, indices, len(stamps), self.broken)
            points = {k: self._in_lidar_frame(cloud, k) for k, cloud in clouds.items()}
            if not number and self._settings.sensor_origin is None:
                self._is_kitti_lidar = kitti_lidar.is_kitti_lidar(points.values())
            if not number and self.elevation_error and "kitti" in self.name:
                log.info(
                    "%s: points are raised by the %.3f degrees that the calibration of KITTI's "
                    "LiDAR lacks; if it was simulated, open the sweeps as a folder of point clouds "
                    "whose docdepth.yaml says sensor_origin: [0, 0, 0]",
                    self.path, np.degrees(self.elevation_error),
                )  # fmt: skip
            elif not number and self.elevation_error:
                log.log(
                    NOTE,
                    "%s: points lie on the lasers of KITTI's LiDAR, whose calibration lacks %.3f "
                    "degrees; they are raised by it. If the LiDAR was simulated, say "
                    "sensor_origin: [0, 0, 0] in docdepth.yaml",
                    self.path, np.degrees(self.elevation_error),
                )  # fmt: skip
            samples = [
                TimeSample(cloud.times, usable_points(points[k]), int(stamps[k]))
                for k, cloud in clouds.items()
                if cloud.times is not None and not np.isnan(cloud.times).all()
            ]
            where = f"{self.path}, {reader.stream.name}" if number else str(self.path)
            said = self._settings
            found = find_point_times(samples, self._period, where, said.point_time_unit, said.stamp)
            self.point_times.append(found)
            if not samples and said.motion_compensated is None:
                log.warning(
                    "%s: points have no times; say in docdepth.yaml motion_compensated: true if "
                    "sweeps are deskewed already, else false",
                    where,
                )

    def _part(self, number: int, own: int, index: int) -> Part:
        reader, point_times = self._readers[number], self.point_times[number]
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
            points = transform_points(T, points.astype(np.float64)).astype(np.float32)
        elif self.elevation_error:
            points = kitti_lidar.raised(points, self.elevation_error)
        return Part(number, cloud, points, relative, int(stream.times[own] - self.times[index]))

    def _in_lidar_frame(self, cloud: Cloud, own: int) -> NDArray[np.float32]:
        """Points in the frame of the LiDAR that measured them, float32 (N, 3)."""
        points = cloud.points
        if self._world:
            if self.poses is None:
                raise DatasetError(
                    f"{self.path}: points are in the world, but there are no poses to bring them "
                    "to the LiDAR; say poses in docdepth.yaml"
                )
            T = inverse(self.poses[own])
            points = transform_points(T, points.astype(np.float64))
            points[(cloud.points == 0).all(axis=1)] = np.nan
        return np.ascontiguousarray(points, np.float32)

    def _relative_time(self, index: int, parts: Sequence[Part]) -> NDArray[np.float32] | None:
        """When each point of sweep ``index`` was measured, as shares of a sweep."""
        if len(parts) == 1 and parts[0].relative_time is None:
            if self._settings.motion_compensated and self._is_kitti_lidar:
                return kitti_lidar.azimuth_relative_time(parts[0].points, self._period)
            return None
        if all(part.relative_time is None and part.late == 0 for part in parts):
            return None
        times, period = [], np.float64(self._period or USUAL_PERIOD)
        for part in parts:
            shares = part.relative_time
            shares = np.zeros(len(part.points), np.float32) if shares is None else shares
            times.append(shares + np.float32(part.late / period) if part.late else shares)
        return np.concatenate(times)

    def _compensated_to(self, parts: Sequence[Part]) -> NDArray[np.float32] | None:
        """Stamps of the LiDARs, as shares of a sweep; points of each are compensated to its own."""
        if not self._settings.motion_compensated or not any(part.late for part in parts):
            return None
        period = self._period or USUAL_PERIOD
        shares = [np.full(len(part.points), part.late / period, np.float32) for part in parts]
        return np.concatenate(shares)

    def _rig(self, parts: Sequence[Part]) -> SensorRig | None:
        points, several = parts[0].points, len(self._readers) > 1
        rig = None
        if self._settings.sensor_origin is not None:
            rig = SensorRig.single(self._settings.sensor_origin, len(points))
        elif self._is_kitti_lidar:
            rig = kitti_lidar.sensor_rig(points, self.elevation_error)
        elif several:
            rig = SensorRig.single((0, 0, 0), len(points))
        counts = {part.number: len(part.points) for part in parts}
        for number, reader in enumerate(self._readers[1:], start=1):
            assert rig is not None
            rig = rig.with_lidar(reader.stream.T_lidar_sensor, counts.get(number, 0))
        width = self._settings.beam_width_deg
        if width is None:
            own = self._is_kitti_lidar and not self._simulated
            width = kitti_lidar.BEAM_WIDTH_DEG if own else 0.0
        if width and rig is None:
            rig = SensorRig.single((0, 0, 0), len(points))
        return rig if rig is None else replace(rig, beam_width=math.radians(width))

    @property
    def _simulated(self) -> bool:
        """Whether the LiDAR is one of docdepth.synthetic, whose beams are where they should be."""
        return False

    @property
    def elevation_error(self) -> float:
        """By how much points of the first LiDAR lie higher than their files say [rad]."""
        return kitti_lidar.ELEVATION_ERROR if self._is_kitti_lidar and not self._simulated else 0.0
