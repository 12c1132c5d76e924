"""KITTI odometry and SemanticKITTI sequences, and synthetic drives written in that layout."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets import kitti_files, kitti_lidar
from docdepth.datasets.base import Sweep, without_ego
from docdepth.datasets.files import FILE, is_there, read_bytes, read_lines
from docdepth.datasets.format import Format
from docdepth.datasets.formats.kitti_odometry_cameras import REMEDY, read_cameras
from docdepth.datasets.kitti_files import Calibration, KittiSweeps
from docdepth.datasets.settings import MountSettings, read_settings
from docdepth.datasets.times import read_times_of
from docdepth.errors import Collector, DatasetError
from docdepth.geometry.se3 import inverse
from docdepth.geometry.sensor_rig import SensorRig
from docdepth.io.poses import read_kitti
from docdepth.io.yaml_json import parse_yaml


class KittiSettings(MountSettings):
    """What ``docdepth.yaml`` of a sequence may say; the last ones tell how a drive was made."""

    motion_compensated: bool = True
    scene: Any = None
    sensor: Any = None
    seed: Any = None
    frames: Any = None
    beam_width_deg: Any = None
    blooming_deg: Any = None


class KittiOdometry(KittiSweeps):
    """A sequence ``sequences/NN`` of KITTI odometry or SemanticKITTI.

    Needed are ``velodyne/*.bin``, ``calib.txt`` (P0 to P3, Tr) and ``times.txt``. Optional are
    ``labels/*.label``, ``image_0`` to ``image_3``, and poses: ``poses.txt`` (SemanticKITTI) or
    ``../../poses/NN.txt`` (KITTI). Files hold poses T of the rectified reference camera; they are
    converted to poses of the LiDAR, Tr^-1 T Tr. Sweeps are motion compensated.

    More than KITTI has, written by :mod:`docdepth.synthetic` and useful for other recordings:

    - ``image_N/times.txt``: the camera's own times in seconds, if it does not fire with the sweeps;
    - ``image_N/size.txt``: ``WIDTH HEIGHT``, if there are no images;
    - ``image_N/distortion.txt``: ``k1 k2 p1 p2 [k3 ...]`` of OpenCV, if images are not rectified.
      P0 to P3 hold their K, and depth maps are of the rectified camera with the same K;
    - ``docdepth.yaml`` with ``motion_compensated: false``: raw sweeps;
    - ``point_times/NAME.bin``: the time of each point, float32, as :attr:`Sweep.relative_time`. Raw
      sweeps need it. For compensated ones it tells when moving objects were measured; for KITTI's
      own LiDAR that is computed from the azimuth;
    - ``docdepth.yaml`` with ``sensor_origin: [x, y, z]``: where the rays of the LiDAR begin, metres
      in the frame of its points, if not at the origin. KITTI's own LiDAR is detected without it;
      and ``up: [x, y, z]``, which direction points up in that frame;
    - ``velodyne_2/NAME.bin`` and so on: sweeps of more LiDARs at the same times, with a row
      ``Tr_2`` in ``calib.txt`` that takes their points to camera 0 as Tr does. All LiDARs form one
      sweep; points, labels and times of the first come first.

    Parameters
    ----------
    path : Path
        The sequence.
    image_size : (int, int), optional
        Width and height in pixels, if there are neither images nor ``size.txt``. Without any of
        them the size is guessed from the principal point, with a warning.
    name : str
        Name of the format: ``kitti_odometry`` or ``semantic_kitti``.

    Raises
    ------
    DatasetError, CalibrationError
        A file is missing, truncated or contradicts another one.
    """

    def __init__(
        self,
        path: Path,
        image_size: tuple[int, int] | None = None,
        name: str = "kitti_odometry",
    ) -> None:
        self.name = name
        self.path = Path(path)
        problems = Collector()
        self._sweeps = kitti_files.find_sweeps(self.path / "velodyne", problems)
        self.times = np.arange(len(self._sweeps))
        with problems.collected():
            self.times = read_times_of(self._sweeps, self.path / "times.txt", "times", REMEDY)
        with problems.collected():
            settings, _ = read_settings(self.path, KittiSettings)
            self.motion_compensated = settings.motion_compensated
            self._sensor_origin, self.up = settings.sensor_origin, settings.up
            self._ego_boxes = settings.ego_boxes
        with problems.collected():
            self._read_calibration(image_size, problems)
        problems.raise_errors()

    def _read_calibration(self, image_size: tuple[int, int] | None, problems: Collector) -> None:
        """All that needs ``calib.txt``: cameras, more LiDARs, and poses of the cameras."""
        calibration = Calibration(self.path / "calib.txt", REMEDY)
        T_camera_lidar = np.eye(4)
        with problems.collected():
            T_camera_lidar = calibration.transform("Tr")
        with problems.collected():
            self.poses = _poses(self.path, self._sweeps, T_camera_lidar)
        with problems.collected():
            self.cameras = read_cameras(
                self.path, self._sweeps, self.times, calibration, T_camera_lidar, image_size
            )
        with problems.collected():
            self._more_lidars = _find_more_lidars(
                self.path, calibration, T_camera_lidar, self._sweeps
            )
            self.lidars = kitti_files.lidars(self._sweeps, self.times, self._more_lidars)

    def sweep(self, index: int) -> Sweep:
        """Sweep ``index`` as it is on disk."""
        file = self._sweeps[index]
        points, intensity = kitti_files.read_sweep(file, index)
        sensor_rig = None
        if self._sensor_origin is not None:
            sensor_rig = SensorRig.single(self._sensor_origin, len(points))
        elif self._is_kitti_lidar:
            sensor_rig = kitti_lidar.sensor_rig(points)
        if self._more_lidars:
            first = sensor_rig or SensorRig.single((0, 0, 0), len(points))
            points, intensity, sensor_rig = self._merge_lidars(points, intensity, first, index)
        sweep = Sweep(
            points,
            file.stem,
            int(self.times[index]),
            intensity,
            self._relative_time(index, points),
            sensor_rig,
            self.motion_compensated,
        )
        return without_ego(sweep, self._ego_boxes)

    def _merge_lidars(
        self,
        points: NDArray[np.float32],
        intensity: NDArray[np.float32],
        sensor_rig: SensorRig,
        frame: int,
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], SensorRig]:
        """A sweep of the first LiDAR with those of the others, in the frame of the first."""
        all_points, all_intensities = [points], [intensity]
        for folder, T_lidar_sensor in self._more_lidars:
            own, bright = kitti_files.read_sweep(folder / self._sweeps[frame].name, frame)
            moved = own @ T_lidar_sensor[:3, :3].T + T_lidar_sensor[:3, 3]
            all_points.append(moved.astype("f4"))
            all_intensities.append(bright)
            sensor_rig = sensor_rig.with_lidar(T_lidar_sensor, len(own))
        return np.concatenate(all_points), np.concatenate(all_intensities), sensor_rig

    def sweep_files(self, index: int) -> list[Path]:
        """Sweep ``index`` of each LiDAR, the times of its points, and what masks some of them."""
        lidars, times = self._lidar_files(index), self._point_times(index)
        masks = super().sweep_files(index)[len(lidars) :]
        return lidars + [times] * times.is_file() + masks

    def _lidar_files(self, index: int) -> list[Path]:
        sweep = self._sweeps[index]
        return [sweep, *(folder / sweep.name for folder, _ in self._more_lidars)]

    def _point_times(self, index: int) -> Path:
        return self.path / "point_times" / f"{self._sweeps[index].stem}.bin"

    def _relative_time(self, frame: int, points: NDArray[np.float32]) -> NDArray[np.float32] | None:
        file = self._point_times(frame)
        there = is_there(file)
        if not there and self.motion_compensated:
            # The azimuth gives the time to a hundredth of a sweep, though the motion is removed.
            return kitti_lidar.azimuth_relative_time(points) if self._is_kitti_lidar else None
        if not there:
            raise DatasetError(
                f"{file} (frame {frame}) is missing: raw sweeps need each point's time; write it, "
                f"or set motion_compensated: true in {self.path / 'docdepth.yaml'}"
            )
        content = read_bytes(file, "write the times of the points again")
        if len(content) != 4 * len(points):
            raise DatasetError(
                f"{file} (frame {frame}) has {len(content)} bytes for a sweep of "
                f"{len(points)} points; it holds one float32 for each, in the order of the sweep"
            )
        return np.frombuffer(content, "<f4").astype(np.float32)


def _poses(
    sequence: Path, sweeps: list[Path], T_camera_lidar: NDArray[np.float64]
) -> NDArray[np.float64] | None:
    """``T_world_lidar`` (n, 4, 4) in the frame of the first LiDAR pose; None without a file."""
    for file in (
        sequence / "poses.txt",
        sequence.parent.parent / "poses" / f"{sequence.name}.txt",
    ):
        if is_there(file):
            poses = read_kitti(file)
            rows = kitti_files.match_rows(sweeps, len(poses), file, "poses")
            return inverse(T_camera_lidar) @ poses[rows] @ T_camera_lidar
    return None


def _find_more_lidars(
    sequence: Path,
    calibration: Calibration,
    T_camera_lidar: NDArray[np.float64],
    sweeps: list[Path],
) -> list[tuple[Path, NDArray[np.float64]]]:
    """Folder and ``T_lidar_sensor`` (4, 4) of each LiDAR but the first."""
    found = []
    problems = Collector()
    for folder in sorted(sequence.glob("velodyne_[2-9]")):
        T_camera_other = calibration.transform(f"Tr_{folder.name[-1]}")
        names = [file.name for file in kitti_files.find_sweeps(folder, problems)]
        problems.raise_errors()
        lacking = sorted({file.name for file in sweeps}.symmetric_difference(names))
        if lacking:
            raise DatasetError(
                f"{lacking[0]} is in one of {sequence / 'velodyne'} and {folder} only; "
                "the LiDARs of a sequence measure each sweep together"
            )
        found.append((folder, inverse(T_camera_lidar) @ T_camera_other))
    return found


def _recognises(path: Path) -> bool:
    """A folder ``velodyne``, unless docdepth.yaml describes a recording of another format."""
    if not (path / "velodyne").is_dir():
        return False
    try:
        given = parse_yaml("\n".join(read_lines(path / FILE, "")))
    except (DatasetError, ValueError):  # told when it is opened
        return True
    return not (isinstance(given, dict) and given.keys() & {"sweeps", "lidars"})


KITTI_ODOMETRY = Format(
    "kitti_odometry",
    "a sequence with velodyne/*.bin, calib.txt and times.txt",
    _recognises,
    KittiOdometry,
)
SEMANTIC_KITTI = Format(
    "semantic_kitti",
    "a sequence with velodyne/*.bin, labels/*.label, calib.txt, times.txt and poses.txt",
    lambda path: _recognises(path) and (path / "labels").is_dir(),
    lambda path, image_size: KittiOdometry(path, image_size, "semantic_kitti"),
)
