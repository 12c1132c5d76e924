"""KITTI raw recordings, synchronised ("sync"), as unpacked from cvlibs.net."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets import kitti_files, kitti_lidar
from docdepth.datasets.base import CameraStream
from docdepth.datasets.files import is_there, read_lines
from docdepth.datasets.format import Format
from docdepth.datasets.kitti_files import Calibration, camera_offset, in_order
from docdepth.datasets.point_times import nearest_rows
from docdepth.datasets.pose_tables import continue_ends, poses_at, poses_of_angles
from docdepth.datasets.recording import Part, Recording
from docdepth.datasets.settings import RecordingSettings, read_settings
from docdepth.datasets.times import image_times, read_times_of
from docdepth.errors import (
    CalibrationError,
    DatasetError,
    DocDepthError,
    collect_errors,
    raise_together,
)
from docdepth.geometry.camera import camera_of
from docdepth.geometry.se3 import inverse

log = logging.getLogger(__name__)

_RADIUS = 6378137.0  # metres, of the sphere of KITTI's Mercator projection
_REMEDY = "unpack the 'synced+rectified data' of the drive again, or remove the folder oxts"
EXPORT = "KITTI keeps it beside the drive; unpack the 'synced+rectified data' of the drive again"
_LATE = {"00": 12_700_000, "01": 12_700_000, "02": 6_500_000, "03": 6_500_000}
"""By how much the stamps of KITTI's cameras are late [ns].

One trigger, fired when the LiDAR faces forward, exposes all four cameras, yet their stamps lie 10.5
(colour) and 16.7 ms (grey) after the LiDAR's. Edges of sweeps and images of drive 2011_09_26 0013
fit each other 4.0 +- 0.4 ms after the LiDAR's stamp."""
_TRIGGER = 4_000_000  # ns after the stamp of the LiDAR
_STAMPED_ALIKE = 1_500_000  # ns by which stamps of KITTI's own may differ from that
_CALIBRATION = "unpack the 'calibration' archive of that date beside its drives"


class KittiRaw(Recording):
    """A drive ``DATE/DATE_drive_NNNN_sync`` with the calibration in ``DATE``.

    A sweep is one revolution of the LiDAR, clockwise seen from above. It starts backwards and faces
    forward after half its duration, when KITTI takes the stamp. Points come laser by laser and
    carry no time, so their time is computed from the azimuth. Poses are those of GPS and IMU, in
    ``oxts``. SemanticKITTI labels are read from ``labels/NAME.label``.

    Parameters
    ----------
    image_size : (int, int), optional
        Width and height in pixels, for a calibration without ``S_rect``.
    """

    name = "kitti_raw"

    def __init__(self, path: Path, image_size: tuple[int, int] | None = None) -> None:
        self.path = path
        velodyne = path / "velodyne_points"
        problems: list[DocDepthError] = []
        settings, sweeps, broken = RecordingSettings(), list[Path](), list[DatasetError]()
        usual = {"motion_compensated": False}
        with collect_errors(problems):
            settings = read_settings(path, RecordingSettings, usual, ("ego_boxes", "masks"))
        with collect_errors(problems):
            sweeps, broken = kitti_files.find_sweeps(velodyne / "data")
        times = np.arange(len(sweeps))
        with collect_errors(problems):
            times = read_times_of(sweeps, velodyne / "timestamps.txt", "stamps", EXPORT)
        cameras = self._read_cameras(sweeps, times, image_size, problems)
        if problems:
            raise_together([*broken, *problems])
        super().__init__(
            self.name,
            path,
            kitti_files.lidars_of(sweeps, times),
            cameras,
            partial(self._read_poses, sweeps, times),
            settings,
            labels=path / "labels",
        )
        self.broken = list(broken) or self.broken
        if self._is_kitti_lidar:  # which stands upright
            self.up = (0.0, 0.0, 1.0)

    def _relative_time(self, index: int, parts: Sequence[Part]) -> NDArray[np.float32]:
        return kitti_lidar.azimuth_relative_time(parts[0].points, self._period)

    def _read_poses(
        self, sweeps: list[Path], times: NDArray[np.int64]
    ) -> NDArray[np.float64] | None:
        """``T_world_lidar`` of each sweep, NaN where there is none; None without any."""
        return read_oxts(self.path, times)

    def _read_cameras(
        self,
        sweeps: list[Path],
        sweep_times: NDArray[np.int64],
        image_size: tuple[int, int] | None,
        problems: list[DocDepthError],
    ) -> dict[str, CameraStream]:
        file = self.path.parent / "calib_cam_to_cam.txt"
        T_camera0_lidar = T_rectified_camera0 = np.eye(4)
        with collect_errors(problems):
            lidar_file = Calibration(self.path.parent / "calib_velo_to_cam.txt", _CALIBRATION)
            T_camera0_lidar = lidar_file.transform_of("R", "T")
        try:
            camera_file = Calibration(file, _CALIBRATION)
        except CalibrationError as error:
            problems.append(error)
            return {}
        with collect_errors(problems):
            T_rectified_camera0 = camera_file.transform_of("R_rect_00")

        streams: dict[str, CameraStream] = {}
        numbers = [n for n in ("00", "01", "02", "03") if f"P_rect_{n}" in camera_file]
        for number in numbers:
            with collect_errors(problems):
                P = camera_file.matrix(f"P_rect_{number}", 3, 4)
                folder = self.path / f"image_{number}"
                images = kitti_files.image_files(folder / "data")
                size = image_size_of(camera_file, number, images, image_size)
                times, names = image_times(
                    folder / "timestamps.txt", images, sweeps, sweep_times, EXPORT
                )
                times = _triggered(times, number, sweep_times)
                streams[folder.name] = CameraStream(
                    name=folder.name,
                    camera=camera_of(P[:, :3], size, f"{file}: P_rect_{number}"),
                    T_camera_lidar=camera_offset(P) @ T_rectified_camera0 @ T_camera0_lidar,
                    times=times,
                    names=names,
                    images=images,
                )
        with collect_errors(problems):
            if not numbers:
                raise CalibrationError(f"{file} has no camera (P_rect_NN); {_CALIBRATION}")
        return streams


def _triggered(
    times: NDArray[np.int64], number: str, sweep_times: NDArray[np.int64]
) -> NDArray[np.int64]:
    """When a camera of KITTI's was triggered, by its stamps; those of other rigs as they are."""
    if not len(times) or not len(sweep_times):
        return times
    earlier = times - _LATE[number]
    nearest = nearest_rows(sweep_times, earlier)
    after = float(np.median(earlier - sweep_times[nearest]))
    return earlier if abs(after - _TRIGGER) < _STAMPED_ALIKE else times


def image_size_of(
    calibration: Calibration, number: str, images: list[Path], asked: tuple[int, int] | None
) -> tuple[int, int]:
    """Size of the rectified images from all that tell it, which must agree."""
    name, told = f"S_rect_{number}", None
    if name in calibration:
        width, height = calibration.matrix(name, 2)
        told = round(width), round(height)
    claims = {f"{calibration.file} ({name})": told, kitti_files.ASKED: asked}
    size = kitti_files.agreed_size(f"image_{number}", images, claims)
    if size is None:
        raise CalibrationError(
            f"{calibration.file} has no '{name}:' and image_{number} has no images",
            "give their size by `image_size`, for example 1242x375",
        )
    return size


def lies_in_kitti_360(drive: Path) -> bool:
    """Whether a drive lies where KITTI-360 has its own; they are laid out alike."""
    folder = drive.absolute().parent
    return (
        folder.name == "data_3d_raw"
        or (folder.parent / "calibration" / "perspective.txt").is_file()
    )


def read_oxts(drive: Path, times: NDArray[np.int64]) -> NDArray[np.float64] | None:
    """Poses of the LiDAR at the times of the sweeps (n,), nanoseconds; NaN where not known.

    The world is east, north, up from the place of the first packet. Packets have their own times:
    poses are interpolated, and continued to sweeps a little before the first packet.
    ``DATE/calib_imu_to_velo.txt`` tells where the IMU sits. None without it or without packets.
    """
    files = in_order((drive / "oxts" / "data").glob("*.txt"))
    if not files:
        return None
    calibration = drive.parent / "calib_imu_to_velo.txt"
    if not is_there(calibration):
        log.warning(
            "%s: the poses in oxts are not used, since %s is not there; unpack the 'calibration' "
            "archive of that date beside its drives", drive, calibration,
        )  # fmt: skip
        return None
    T_lidar_imu = Calibration(calibration, "unpack it again").transform_of("R", "T")
    stamps = read_times_of(files, drive / "oxts" / "timestamps.txt", "stamps", _REMEDY)
    rows = np.array([_read_packet(file, k) for k, file in enumerate(files)])
    poses = poses_of_angles(_mercator(rows[:, :3]), rows[:, 3:]) @ inverse(T_lidar_imu)
    return continue_ends(poses_at(stamps, poses, times, drive / "oxts"), stamps, poses, times)


def _read_packet(file: Path, frame: int) -> list[float]:
    """Latitude, longitude (degrees), altitude (metres), roll, pitch and yaw (radians)."""
    words = " ".join(read_lines(file, _REMEDY)).split()
    try:
        numbers = [float(word) for word in words[:6]]
    except ValueError:
        numbers = []
    if len(numbers) < 6 or not np.isfinite(numbers).all() or abs(numbers[0]) >= 90:
        raise DatasetError(
            f"{file} (frame {frame}) does not begin with latitude, longitude, altitude, roll, "
            f"pitch and yaw; {_REMEDY}"
        )
    return numbers


def _mercator(places: NDArray[np.float64]) -> NDArray[np.float64]:
    """Metres east, north and up of the first place, by the projection of KITTI's devkit."""
    latitude, longitude = np.radians(places[:, 0]), np.radians(places[:, 1])
    scale = _RADIUS * np.cos(latitude[0])  # so that metres are true at the first place
    north = np.log(np.tan(np.pi / 4 + latitude / 2))
    found = np.stack([scale * longitude, scale * north, places[:, 2]], axis=1)
    return np.asarray(found - found[0])


FORMAT = Format(
    "kitti_raw",
    "a drive DATE/DATE_drive_NNNN_sync with velodyne_points/data/*.bin and "
    "velodyne_points/timestamps.txt, and DATE/calib_*.txt beside it",
    lambda path: (path / "velodyne_points" / "data").is_dir() and not lies_in_kitti_360(path),
    KittiRaw,
)
