"""KITTI odometry and SemanticKITTI sequences, and synthetic drives written in that layout."""

from __future__ import annotations

import logging
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from docdepth.datasets import kitti_files, kitti_lidar
from docdepth.datasets.base import CameraStream, Sweep
from docdepth.datasets.kitti_files import Calibration
from docdepth.datasets.times import nanoseconds
from docdepth.errors import CalibrationError, DatasetError
from docdepth.geometry.camera import Camera
from docdepth.geometry.se3 import inverse
from docdepth.geometry.sensor_rig import SensorRig
from docdepth.io.poses import read_kitti

log = logging.getLogger(__name__)

_REMEDY = "unpack the 'calibration files' of the odometry benchmark over the sequence"


class KittiOdometry:
    """A sequence ``sequences/NN`` of KITTI odometry or SemanticKITTI.

    Read are ``velodyne/*.bin``, ``calib.txt`` (P0 to P3, Tr), ``times.txt`` and, where they are,
    ``labels/*.label``, ``image_0`` to ``image_3``, and poses from ``poses.txt`` (SemanticKITTI)
    or ``../../poses/NN.txt`` (KITTI). Their poses are those of the rectified reference camera;
    here they become the LiDAR's, Tr^-1 T Tr. Sweeps of these sequences are motion compensated.

    Beyond KITTI, written by :mod:`docdepth.synthetic` and of use to others:

    - ``image_N/times.txt``: the camera's own times in seconds, else it fires with the sweeps;
    - ``image_N/size.txt``: ``WIDTH HEIGHT`` where there are no images to tell it;
    - ``image_N/distortion.txt``: ``k1 k2 p1 p2 [k3 ...]`` of OpenCV where the images are not
      rectified; the K of P0 to P3 is theirs, and depth maps are of the camera with that K;
    - ``docdepth.yaml`` with ``motion_compensated: false``: raw sweeps;
    - ``point_times/NAME.bin``: each point's time, float32, as :attr:`Sweep.relative_time`. Raw
      sweeps need it; of others it tells when what moves was seen, as azimuth does of KITTI's own;
    - ``docdepth.yaml`` with ``looks_from: [x, y, z]``: where the LiDAR looks from, metres in the
      frame of its points, when that is not the origin; known of KITTI's own LiDAR without;
    - ``velodyne_2/NAME.bin`` and further ones: sweeps of more LiDARs at the same time, and a row
      ``Tr_2`` in ``calib.txt`` that takes their points to camera 0 as Tr does. Their points, labels
      and times come after those of the first LiDAR in one sweep.

    Parameters
    ----------
    path : Path
        The sequence.
    image_size : (int, int), optional
        Width and height in pixels where neither images nor ``size.txt`` tell. Without any of
        them it is guessed from the principal point, with a warning.

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
        self.sweeps = kitti_files.sweep_files(self.path / "velodyne")
        self.times = _times(self.path / "times.txt", self.sweeps)
        calibration = Calibration(self.path / "calib.txt", _REMEDY)
        Tr = calibration.matrix("Tr", 3, 4)
        T_camera_lidar = kitti_files.rigid_transform(Tr[:, :3], Tr[:, 3])
        self.poses = _poses(self.path, self.sweeps, T_camera_lidar)
        settings = _settings(self.path / "docdepth.yaml")
        self.motion_compensated: bool = settings["motion_compensated"]
        self._looks_from: list[float] | None = settings["looks_from"]
        self.cameras = _cameras(self, calibration, T_camera_lidar, image_size)
        self._others = _other_lidars(self.path, calibration, T_camera_lidar, self.sweeps)

    def __len__(self) -> int:
        return len(self.sweeps)

    def sweep(self, index: int) -> Sweep:
        """Sweep ``index`` as it is on disk."""
        file = self.sweeps[index]
        points, intensity = kitti_files.read_sweep(file, index)
        sensor_rig = None
        if self._looks_from is not None:
            sensor_rig = SensorRig.single(self._looks_from, len(points))
        elif self._is_kitti_lidar:
            sensor_rig = kitti_lidar.sensor_rig(points)
        if self._others:
            sensor_rig = sensor_rig or SensorRig.single((0, 0, 0), len(points))
            points, intensity, sensor_rig = self._join(
                points, intensity, sensor_rig, file.name, index
            )
        relative_time = self._fraction(file.stem, index, points)
        time, motion_compensated = int(self.times[index]), self.motion_compensated
        return Sweep(
            points, file.stem, time, intensity, relative_time, sensor_rig, motion_compensated
        )

    def _join(
        self,
        points: NDArray[np.float32],
        intensity: NDArray[np.float32],
        sensor_rig: SensorRig,
        name: str,
        frame: int,
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], SensorRig]:
        """A sweep of the first LiDAR and those of the others, in the frame of the first."""
        parts, brightness = [points], [intensity]
        for folder, T_lidar_sensor in self._others:
            own, bright = kitti_files.read_sweep(folder / name, frame)
            parts.append((own @ T_lidar_sensor[:3, :3].T + T_lidar_sensor[:3, 3]).astype("f4"))
            brightness.append(bright)
            sensor_rig = sensor_rig.with_lidar(T_lidar_sensor, len(own))
        return np.concatenate(parts), np.concatenate(brightness), sensor_rig

    @cached_property
    def _is_kitti_lidar(self) -> bool:
        return kitti_lidar.is_kitti_lidar(
            kitti_files.read_sweep(file, k)[0] for k, file in enumerate(self.sweeps)
        )

    def labels(self, index: int) -> NDArray[np.uint32] | None:
        """Labels of every point of sweep ``index``, None when there are none."""
        sweep = self.sweeps[index]
        all_lidars = [sweep, *(folder / sweep.name for folder, _ in self._others)]
        file = self.path / "labels" / f"{sweep.stem}.label"
        return kitti_files.read_labels(file, all_lidars, index)

    def _fraction(
        self, stem: str, frame: int, points: NDArray[np.float32]
    ) -> NDArray[np.float32] | None:
        file = self.path / "point_times" / f"{stem}.bin"
        if not file.is_file() and self.motion_compensated:
            # Azimuth tells the time to a hundredth of a turn, though the motion is removed.
            return kitti_lidar.azimuth_relative_time(points) if self._is_kitti_lidar else None
        if not file.is_file():
            raise DatasetError(
                f"{file} (frame {frame}) is missing: raw sweeps need each point's time; write it, "
                f"or set motion_compensated: true in {self.path / 'docdepth.yaml'}"
            )
        if file.stat().st_size != 4 * len(points):
            raise DatasetError(
                f"{file} (frame {frame}) has {file.stat().st_size} bytes for a sweep of "
                f"{len(points)} points; it holds one float32 for each, in the order of the sweep"
            )
        return np.fromfile(file, dtype="<f4").astype(np.float32, copy=False)


def _times(file: Path, files: list[Path]) -> NDArray[np.int64]:
    """Nanoseconds of each file from lines of seconds, exact to the last digit."""
    lines = kitti_files.lines_of(file, _REMEDY)
    seconds = np.array([nanoseconds(line, n, file) for n, line in enumerate(lines, 1)], np.int64)
    times: NDArray[np.int64] = seconds[kitti_files.rows_of(files, len(lines), file, "times")]
    kitti_files.check_increasing(times, [f.name for f in files], file)
    return times


def _poses(
    sequence: Path, sweeps: list[Path], T_camera_lidar: NDArray[np.float64]
) -> NDArray[np.float64] | None:
    """``T_world_lidar`` of each sweep in the world of the first LiDAR pose, None without a file."""
    for file in (
        sequence / "poses.txt",
        sequence.parent.parent / "poses" / f"{sequence.name}.txt",
    ):
        if file.is_file():
            poses = read_kitti(file)
            rows = kitti_files.rows_of(sweeps, len(poses), file, "poses")
            return inverse(T_camera_lidar) @ poses[rows] @ T_camera_lidar
    return None


def _other_lidars(
    sequence: Path,
    calibration: Calibration,
    T_camera_lidar: NDArray[np.float64],
    sweeps: list[Path],
) -> list[tuple[Path, NDArray[np.float64]]]:
    """Folder and ``T_lidar_sensor`` of each LiDAR but the first."""
    found = []
    for folder in sorted(sequence.glob("velodyne_[2-9]")):
        Tr = calibration.matrix(f"Tr_{folder.name[-1]}", 3, 4)
        names = [file.name for file in kitti_files.sweep_files(folder)]
        lacking = sorted({file.name for file in sweeps}.symmetric_difference(names))
        if lacking:
            raise DatasetError(
                f"{lacking[0]} is in one of {sequence / 'velodyne'} and {folder} only; "
                "the LiDARs of a sequence measure each sweep together"
            )
        found.append(
            (folder, inverse(T_camera_lidar) @ kitti_files.rigid_transform(Tr[:, :3], Tr[:, 3]))
        )
    return found


def _settings(file: Path) -> dict[str, Any]:
    """What ``docdepth.yaml`` says of the sweeps; KITTI's own are motion compensated."""
    known: dict[str, Any] = {"motion_compensated": True, "looks_from": None}
    if not file.is_file():
        return known
    try:
        given: Any = yaml.safe_load(file.read_text(encoding="utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise DatasetError(f"{file} is not YAML: {error}") from None
    known |= given if isinstance(given, dict) else {"motion_compensated": None}
    if not isinstance(known["motion_compensated"], bool):
        raise DatasetError(f"{file}: motion_compensated must be true or false")
    place = known["looks_from"]
    if place is not None and (
        not isinstance(place, list)
        or len(place) != 3
        or not all(isinstance(x, (int, float)) and abs(x) < 100 for x in place)
    ):
        raise DatasetError(f"{file}: looks_from must be [x, y, z] in metres, got {place}")
    return known


def _cameras(
    dataset: KittiOdometry,
    calibration: Calibration,
    T_camera0_lidar: NDArray[np.float64],
    asked: tuple[int, int] | None,
) -> dict[str, CameraStream]:
    streams: dict[str, CameraStream] = {}
    guessed: list[str] = []
    folders = {n: dataset.path / f"image_{n}" for n in range(4) if f"P{n}" in calibration}
    files_of = {n: kitti_files.image_files(folder) for n, folder in folders.items()}
    sizes = {n: _size(folders[n], files_of[n], asked) for n in folders}
    # Rectified together, the images of all cameras have one size.
    common = None if asked else next((size for size in sizes.values() if size), None)
    for n, folder in folders.items():
        P = calibration.matrix(f"P{n}", 3, 4)
        images = files_of[n]
        size = sizes[n] or common
        if size is None:
            size = (round(2 * P[0, 2]), round(2 * P[1, 2]))
            guessed.append(f"{folder.name} {size[0]}x{size[1]}")
        times, names = dataset.times, [file.stem for file in dataset.sweeps]
        if (folder / "times.txt").is_file():
            count = len(kitti_files.lines_of(folder / "times.txt", _REMEDY))
            files = images or [Path(f"{k:06d}") for k in range(count)]
            times, names = _times(folder / "times.txt", files), [file.stem for file in files]
        elif images:
            times, names = _times(dataset.path / "times.txt", images), [i.stem for i in images]
        streams[folder.name] = CameraStream(
            name=folder.name,
            camera=Camera(P[:, :3], *size),
            T_camera_lidar=kitti_files.camera_offset(P) @ T_camera0_lidar,
            times=times,
            names=names,
            images=images,
            distortion=_distortion(folder / "distortion.txt"),
        )
    if not streams:
        raise CalibrationError(f"{calibration.file} has no camera (P0 to P3); {_REMEDY}")
    if guessed:
        log.warning(
            "%s: image sizes guessed from the principal points (%s); "
            "give the size (--image-size 1242x375) or put the images there",
            dataset.path,
            ", ".join(guessed),
        )
    return streams


def _distortion(file: Path) -> NDArray[np.float64] | None:
    if not file.is_file():
        return None
    try:
        return np.array(file.read_text(encoding="utf-8").split(), dtype=np.float64)
    except ValueError as error:
        raise CalibrationError(f"{file} must be numbers, k1 k2 p1 p2 [k3 ...]: {error}") from None


def _size(
    folder: Path, images: list[Path], asked: tuple[int, int] | None
) -> tuple[int, int] | None:
    """Size of the images as they, ``size.txt`` or the caller say, None when nobody does."""
    known: tuple[int, int] | None = None
    source = folder / "size.txt"
    if images:
        source, known = images[0], kitti_files.image_size(images[0])
    elif source.is_file():
        words = source.read_text(encoding="utf-8").split()
        if len(words) != 2 or not all(word.isdigit() for word in words):
            raise DatasetError(f"{source} must be two numbers, width and height in pixels")
        known = (int(words[0]), int(words[1]))
    if known and asked and known != asked:
        raise CalibrationError(
            f"{source} is {known[0]} x {known[1]} pixels, the image size asked for is "
            f"{asked[0]} x {asked[1]}; leave it out"
        )
    return known or asked
