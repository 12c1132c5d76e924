"""Sequences of KITTI-360: sweeps as KITTI's, calibration and poses of its own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets import kitti_files
from docdepth.datasets.base import CameraStream
from docdepth.datasets.files import is_there, read_numbers
from docdepth.datasets.format import Format
from docdepth.datasets.formats.kitti_raw import EXPORT, KittiRaw, image_size_of, lies_in_kitti_360
from docdepth.datasets.formats.mei_camera import read_mei
from docdepth.datasets.kitti_files import Calibration
from docdepth.datasets.pose_tables import poses_at, poses_of_matrices, read_pose_table
from docdepth.datasets.settings import transform
from docdepth.datasets.times import image_times, times_of_names
from docdepth.errors import CalibrationError, Collector, DatasetError
from docdepth.geometry.camera import Camera
from docdepth.geometry.se3 import inverse

_CALIBRATION = "unpack KITTI-360's 'Calibrations' again"
_POSES = "unpack KITTI-360's 'Vehicle Poses' again"
_PERSPECTIVE = ("00", "01")
_FISHEYES = ("02", "03")


class Kitti360(KittiRaw):
    """A sequence ``ROOT/data_3d_raw/2013_05_28_drive_NNNN_sync``.

    Sweeps turn and are stamped as those of KITTI raw. Cameras are the rectified image_00 and
    image_01, and of the fisheyes the middle: fisheye_02 and fisheye_03. Poses are known where the
    vehicle moved; sweeps between them are interpolated.

    Parameters
    ----------
    path : Path
        The sequence; ROOT has ``calibration`` and may have ``data_2d_raw`` and ``data_poses``.
    image_size : (int, int), optional
        Width and height in pixels, for a calibration without ``S_rect``.
    """

    name = "kitti_360"

    @property
    def _root(self) -> Path:
        return self.path.absolute().parent.parent

    def _beside(self, kind: str) -> Path:
        """Where KITTI-360 keeps what else there is of this sequence."""
        return self._root / kind / self.path.absolute().name

    def _read_cameras(
        self,
        sweeps: list[Path],
        sweep_times: NDArray[np.int64],
        image_size: tuple[int, int] | None,
        problems: Collector,
    ) -> dict[str, CameraStream]:
        file = self._root / "calibration" / "perspective.txt"
        streams: dict[str, CameraStream] = {}
        with problems.collected():
            calibration = Calibration(file, _CALIBRATION)
            numbers = [n for n in _PERSPECTIVE if f"P_rect_{n}" in calibration]
            if not numbers:
                raise CalibrationError(f"{file} has no camera (P_rect_00); {_CALIBRATION}")
            for number in numbers:
                folder = self._beside("data_2d_raw") / f"image_{number}"
                images = kitti_files.image_files(folder / "data_rect")
                times, names = image_times(
                    folder / "timestamps.txt", images, sweeps, sweep_times, EXPORT
                )
                P = calibration.matrix(f"P_rect_{number}", 3, 4)
                streams[folder.name] = CameraStream(
                    folder.name,
                    Camera(P[:, :3], *image_size_of(calibration, number, images, image_size)),
                    self._rectified_lidar(calibration, number),
                    times,
                    names,
                    images,
                )
        for name in _FISHEYES:
            with problems.collected():
                calibration_file = file.with_name(f"image_{name}.yaml")
                if is_there(calibration_file):
                    lens = read_mei(calibration_file, _CALIBRATION)
                    folder = self._beside("data_2d_raw") / f"image_{name}"
                    images = kitti_files.image_files(folder / "data_rgb")
                    times, names = image_times(
                        folder / "timestamps.txt", images, sweeps, sweep_times, EXPORT
                    )
                    streams[f"fisheye_{name}"] = CameraStream(
                        f"fisheye_{name}",
                        lens.pinhole,  # of its middle
                        inverse(self._T_imu_camera(name)) @ self._T_imu_lidar(),
                        times,
                        names,
                        [lens.rectified(image) for image in images],
                    )
        return streams

    def _T_imu_camera(self, number: str) -> NDArray[np.float64]:
        file = self._root / "calibration" / "calib_cam_to_pose.txt"
        return Calibration(file, _CALIBRATION).transform(f"image_{number}")

    def _rectified_lidar(self, perspective: Calibration, number: str) -> NDArray[np.float64]:
        """``T_camera_lidar`` of a rectified camera."""
        T_rectified_camera = perspective.transform_of(f"R_rect_{number}")
        return T_rectified_camera @ inverse(self._T_imu_camera(number)) @ self._T_imu_lidar()

    def _T_imu_lidar(self) -> NDArray[np.float64]:
        """The LiDAR's place; both it and the IMU are calibrated to camera 00."""
        file = self._root / "calibration" / "calib_cam_to_velo.txt"
        T_lidar_camera0 = transform(read_numbers(file, _CALIBRATION), str(file))
        return self._T_imu_camera("00") @ inverse(T_lidar_camera0)

    def _read_poses(
        self, sweeps: list[Path], times: NDArray[np.int64]
    ) -> NDArray[np.float64] | None:
        """``T_world_lidar`` of each sweep, NaN where there is none; None without a file."""
        folder = self._beside("data_poses")
        file = folder / "poses.txt"
        if is_there(file):
            T_theirs_lidar = self._T_imu_lidar()
        else:
            file = folder / "cam0_to_world.txt"
            if not is_there(file):
                return None
            perspective = Calibration(self._root / "calibration" / "perspective.txt", _CALIBRATION)
            T_theirs_lidar = self._rectified_lidar(perspective, "00")
        frames, rows = read_pose_table(file, (12, 16), _POSES)
        poses = poses_of_matrices(rows, file) @ T_theirs_lidar
        own = times_of_names(sweeps, 1, "it is the number of the frame")
        posed = np.isin(frames, own)
        if not posed.any():
            raise DatasetError(f"{file} has no pose of a sweep of {self.path}; {_POSES}")
        stamps = times[np.isin(own, frames)]
        return poses_at(stamps, poses[posed], times, file)


FORMAT = Format(
    "kitti_360",
    "ROOT/data_3d_raw/2013_05_28_drive_NNNN_sync with velodyne_points/data/*.bin and "
    "velodyne_points/timestamps.txt, and ROOT/calibration",
    lambda path: (path / "velodyne_points" / "data").is_dir() and lies_in_kitti_360(path),
    Kitti360,
    experimental=True,
)
