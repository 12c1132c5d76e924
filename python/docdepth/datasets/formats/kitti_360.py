"""Sequences of KITTI-360: sweeps as KITTI's, calibration and poses of its own."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from docdepth.datasets import kitti_files
from docdepth.datasets.base import CameraStream
from docdepth.datasets.files import StoredImage, is_there, read_image, read_lines, read_numbers
from docdepth.datasets.format import Format
from docdepth.datasets.formats.kitti_raw import EXPORT, KittiRaw, image_size_of, lies_in_kitti_360
from docdepth.datasets.kitti_files import Calibration
from docdepth.datasets.pose_tables import poses_at, poses_of_matrices, read_pose_table
from docdepth.datasets.settings import transform
from docdepth.datasets.times import image_times, times_of_names
from docdepth.errors import CalibrationError, DatasetError, DocDepthError, collect_errors
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
        problems: list[DocDepthError],
    ) -> dict[str, CameraStream]:
        file = self._root / "calibration" / "perspective.txt"
        streams: dict[str, CameraStream] = {}
        with collect_errors(problems):
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
            with collect_errors(problems):
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


_SECTIONS = {
    "mirror_parameters": ("xi",),
    "distortion_parameters": ("k1", "k2", "p1", "p2"),
    "projection_parameters": ("gamma1", "gamma2", "u0", "v0"),
}


@dataclass(frozen=True)
class MeiCamera:
    """A fisheye of Mei's model, which may see more than half a sphere, and its rectified middle.

    C. Mei and P. Rives, "Single View Point Omnidirectional Camera Calibration from Planar Grids",
    2007.
    """

    xi: float  # of the mirror
    k1: float  # radial and tangential distortion
    k2: float
    p1: float
    p2: float
    gamma1: float  # focal lengths and principal point, pixels
    gamma2: float
    u0: float
    v0: float
    width: int  # of the images, pixels
    height: int

    @property
    def pinhole(self) -> Camera:
        """Same size and principal point, and as large in the middle as the fisheye."""
        f, g = self.gamma1 / (1 + self.xi), self.gamma2 / (1 + self.xi)
        K = np.array([[f, 0, self.u0], [0, g, self.v0], [0, 0, 1]])
        return Camera(K, self.width, self.height)

    def project(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Pixels (..., 2) of points (..., 3) in the frame of the camera."""
        x, y, z = np.moveaxis(points / np.linalg.norm(points, axis=-1, keepdims=True), -1, 0)
        x, y = x / (z + self.xi), y / (z + self.xi)
        r2, xy = x * x + y * y, x * y
        radial = 1 + self.k1 * r2 + self.k2 * r2 * r2
        u = x * radial + 2 * self.p1 * xy + self.p2 * (r2 + 2 * x * x)
        v = y * radial + 2 * self.p2 * xy + self.p1 * (r2 + 2 * y * y)
        return np.stack([self.gamma1 * u + self.u0, self.gamma2 * v + self.v0], axis=-1)

    def rectified(self, file: Path) -> StoredImage:
        """An image of the fisheye as the pinhole camera sees it."""
        return StoredImage(file, "rectified", partial(read_rectified, self, file))


def read_rectified(camera: MeiCamera, file: Path) -> NDArray[np.uint8]:
    """Read an image of a fisheye and rectify it."""
    image = read_image(file)
    if image.shape[:2] != (camera.height, camera.width):
        raise DatasetError(
            f"{file} is {image.shape[1]}x{image.shape[0]} pixels, its calibration is of "
            f"{camera.width}x{camera.height}; replace or remove it"
        )
    return np.asarray(cv2.remap(image, _places(camera), None, cv2.INTER_LINEAR), np.uint8)


def read_mei(file: Path, remedy: str) -> MeiCamera:
    """Read a calibration that camodocal wrote."""
    try:
        text = "\n".join(read_lines(file, remedy)) + "\n"
        root = cv2.FileStorage()
        root.open(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        numbers = {
            name: _number(root.getNode(section).getNode(name), file, name, remedy)
            for section, names in _SECTIONS.items()
            for name in names
        }
        width, height = (
            round(_number(root.getNode(name), file, name, remedy))
            for name in ("image_width", "image_height")
        )
    except DatasetError as error:
        raise CalibrationError(str(error)) from None
    except cv2.error:
        raise CalibrationError(f"{file} is no YAML of OpenCV; {remedy}") from None
    return MeiCamera(**numbers, width=width, height=height)


def _number(node: cv2.FileNode, file: Path, name: str, remedy: str) -> float:
    if not (node.isReal() or node.isInt()):
        raise CalibrationError(f"{file} has no number {name}; {remedy}")
    return float(node.real())


@lru_cache(maxsize=4)
def _places(camera: MeiCamera) -> NDArray[np.float32]:
    """Where in the fisheye's image each pixel of the pinhole camera lies, (height, width, 2)."""
    K = camera.pinhole.K
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    rays = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones(u.shape)], axis=-1)
    return camera.project(rays).astype(np.float32)
