"""KITTI odometry and SemanticKITTI sequences, and synthetic drives written in that layout."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets import kitti_files, kitti_lidar
from docdepth.datasets.base import CameraStream
from docdepth.datasets.files import FILE, is_there, read_bytes, read_lines
from docdepth.datasets.format import Format
from docdepth.datasets.kitti_files import Calibration
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
from docdepth.io.poses import read_kitti
from docdepth.io.untrusted import parse_yaml


class KittiSettings(RecordingSettings):
    """What ``docdepth.yaml`` of a sequence may say; the last ones tell how a drive was made."""

    motion_compensated: bool = True
    scene: object = None
    sensor: object = None
    seed: object = None
    frames: object = None
    blooming_deg: object = None


_TAKEN = KittiSettings.model_fields.keys() - {
    *("stamp", "point_time_unit", "sweep_duration", "poses")
}


class KittiOdometry(Recording):
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
    image_size : (int, int), optional
        Width and height in pixels, if there are neither images nor ``size.txt``. Without any of
        them the size is guessed from the principal point, with a warning.
    name : str
        Name of the format: ``kitti_odometry`` or ``semantic_kitti``.
    """

    def __init__(
        self,
        path: Path,
        image_size: tuple[int, int] | None = None,
        name: str = "kitti_odometry",
    ) -> None:
        problems: list[DocDepthError] = []
        sweeps, broken = list[Path](), list[DatasetError]()
        settings, more = KittiSettings(), list[tuple[Path, NDArray[np.float64]]]()
        cameras: dict[str, CameraStream] = {}
        poses, T_camera_lidar = None, np.eye(4)
        with collect_errors(problems):
            sweeps, broken = kitti_files.find_sweeps(path / "velodyne")
        times = np.arange(len(sweeps))
        with collect_errors(problems):
            times = read_times_of(sweeps, path / "times.txt", "times", REMEDY)
        with collect_errors(problems):
            settings = read_settings(path, KittiSettings, taken=_TAKEN)
        with collect_errors(problems):
            calibration = Calibration(path / "calib.txt", REMEDY)
            with collect_errors(problems):
                T_camera_lidar = calibration.transform("Tr")
            with collect_errors(problems):
                poses = _poses(path, sweeps, T_camera_lidar)
            with collect_errors(problems):
                cameras = read_cameras(path, sweeps, times, calibration, T_camera_lidar, image_size)
            with collect_errors(problems):
                more = _find_more_lidars(path, calibration, T_camera_lidar, sweeps)
        if problems:
            raise_together([*broken, *problems])
        lidars = kitti_files.lidars_of(sweeps, times, more)
        super().__init__(name, path, lidars, cameras, poses, settings, labels=path / "labels")
        self.broken = list(broken) or self.broken

    def sweep_files(self, index: int) -> list[Path]:
        """The files of sweep ``index`` of each LiDAR, and the times of its points."""
        times = self._times_file(index)
        return super().sweep_files(index) + [times] * times.is_file()

    @property
    def _simulated(self) -> bool:
        return isinstance(self._settings, KittiSettings) and self._settings.scene is not None

    def _times_file(self, index: int) -> Path:
        return self.path / "point_times" / f"{self._readers[0].stream.names[index]}.bin"

    def _relative_time(self, index: int, parts: Sequence[Part]) -> NDArray[np.float32] | None:
        file = self._times_file(index)
        points = np.concatenate([part.points for part in parts])
        if is_there(file):
            content = read_bytes(file, "write the times of the points again")
            if len(content) != 4 * len(points):
                raise DatasetError(
                    f"{file} (frame {index}) has {len(content)} bytes for a sweep of {len(points)} "
                    "points; it holds one float32 for each, in the order of the sweep"
                )
            return np.frombuffer(content, "<f4").astype(np.float32)
        if not self._settings.motion_compensated:
            raise DatasetError(
                f"{file} (frame {index}) is missing: raw sweeps need each point's time; write it, "
                f"or set motion_compensated: true in {self._settings.file}"
            )
        # The azimuth gives the time to a hundredth of a sweep, though the motion is removed.
        if not self._is_kitti_lidar:
            return None
        return kitti_lidar.azimuth_relative_time(points, self._period)


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
    for folder in sorted(sequence.glob("velodyne_[2-9]")):
        T_camera_other = calibration.transform(f"Tr_{folder.name[-1]}")
        files, broken = kitti_files.find_sweeps(folder)
        raise_together(broken)
        names = [file.name for file in files]
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


log = logging.getLogger(__name__)

REMEDY = (
    "unpack the 'calibration files' of the odometry benchmark over the sequence; a recording of "
    "your own is described in docdepth.yaml, with sweeps: velodyne"
)
"""What to do where ``calib.txt`` or ``times.txt`` is missing or incomplete."""


def read_cameras(
    sequence: Path,
    sweeps: list[Path],
    sweep_times: NDArray[np.int64],
    calibration: Calibration,
    T_camera0_lidar: NDArray[np.float64],
    image_size: tuple[int, int] | None,
) -> dict[str, CameraStream]:
    """The cameras ``image_0`` to ``image_3`` that ``calib.txt`` has a projection of.

    ``T_camera0_lidar`` (4, 4) takes LiDAR points to the rectified reference camera. Cameras without
    times of their own fire with the sweeps. ``image_size`` is width and height that the caller
    gives, pixels.
    """
    folders = {n: sequence / f"image_{n}" for n in range(4) if f"P{n}" in calibration}
    if not folders:
        raise CalibrationError(f"{calibration.file} has no camera (P0 to P3); {REMEDY}")
    problems: list[DocDepthError] = []
    images = {n: kitti_files.image_files(folder) for n, folder in folders.items()}
    sizes: dict[int, tuple[int, int] | None] = dict.fromkeys(folders)
    for n, folder in folders.items():
        with collect_errors(problems):
            sizes[n] = _image_size(folder, images[n], image_size)
    # Rectified together, the images of all cameras have one size.
    common = None if image_size else next((size for size in sizes.values() if size), None)
    streams: dict[str, CameraStream] = {}
    guessed: list[str] = []
    for n, folder in folders.items():
        with collect_errors(problems):
            P = calibration.matrix(f"P{n}", 3, 4)
            size = sizes[n] or common
            if size is None:
                size = (round(2 * P[0, 2]), round(2 * P[1, 2]))
                guessed.append(f"{folder.name} {size[0]}x{size[1]}")
            table = folder / "times.txt"
            if images[n] and not is_there(table):
                table = sequence / "times.txt"
            times, names = image_times(table, images[n], sweeps, sweep_times, REMEDY)
            streams[folder.name] = CameraStream(
                name=folder.name,
                camera=camera_of(P[:, :3], size, f"{calibration.file}: P{n}"),
                T_camera_lidar=kitti_files.camera_offset(P) @ T_camera0_lidar,
                times=times,
                names=names,
                images=images[n],
                distortion=_distortion(folder / "distortion.txt"),
            )
    raise_together(problems)
    if guessed:
        log.warning(
            "%s: image sizes guessed from the principal points (%s); "
            "give the size by `image_size`, for example 1242x375, or put the images there",
            sequence, ", ".join(guessed),
        )  # fmt: skip
    return streams


def _distortion(file: Path) -> NDArray[np.float64] | None:
    """Coefficients in OpenCV's order; None without a file."""
    if not is_there(file):
        return None
    try:
        words = " ".join(read_lines(file, "write k1 k2 p1 p2 [k3 ...]")).split()
        return np.array(words, dtype=np.float64)
    except ValueError as error:
        raise CalibrationError(f"{file} must be numbers, k1 k2 p1 p2 [k3 ...]: {error}") from None


def _image_size(
    folder: Path, images: list[Path], asked: tuple[int, int] | None
) -> tuple[int, int] | None:
    """Size of the images from themselves, ``size.txt`` or the caller; None if unknown."""
    source, told = folder / "size.txt", None
    if not images and is_there(source):
        words = " ".join(read_lines(source, "write width and height in pixels")).split()
        if len(words) != 2 or not all(word.isdigit() for word in words):
            raise DatasetError(f"{source} must be two numbers, width and height in pixels")
        told = int(words[0]), int(words[1])
    claims = {str(source): told, kitti_files.ASKED: asked}
    return kitti_files.agreed_size(folder.name, images, claims)
