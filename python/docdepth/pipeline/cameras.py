"""The cameras of a run: those of its recording, and virtual ones mounted on its LiDAR."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from docdepth.config import Parameters, replaced
from docdepth.datasets import CameraStream, Dataset, FrameRange, full_recording, image_streams
from docdepth.datasets.kitti_lidar import seen_raised
from docdepth.datasets.recording import Recording
from docdepth.datasets.settings import camera_mask
from docdepth.datasets.times import read_times
from docdepth.datasets.views import RecordingView
from docdepth.errors import CalibrationError, ConfigError, DatasetError
from docdepth.geometry.camera import Camera
from docdepth.geometry.ground_plane import level_turn
from docdepth.geometry.se3 import (
    inverse,
    nearest_rotation,
    poses_from,
    quaternion_to_matrix,
    rotation_exp,
)
from docdepth.io.depth import DESCRIPTION
from docdepth.io.inputs import Point, RunInputs
from docdepth.io.manifest import CameraEntry, StoredCameraFit, VirtualCamera
from docdepth.io.run_folder import RunFolder
from docdepth.io.untrusted import read_text
from docdepth.pipeline.execution import check_image_size

ALL, NO_CAMERA = "all", "none"
"""Names that stand for all cameras of a recording, and for no camera: poses and labels alone."""

FORWARD = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Rotation from camera axes to LiDAR axes when the camera looks along the LiDAR's x axis."""


@dataclass(frozen=True)
class RunCamera:
    """A camera of a run."""

    stream: CameraStream
    folder: str  # where its maps lie in ``depth/``; empty for the first camera of a run
    parameters: Parameters  # those of the run with the camera's own settings


def add_cameras(run: RunFolder, streams: Sequence[CameraStream]) -> None:
    """Note cameras of the recording in run.yaml.

    A camera that is alone when the first maps are made has ``depth/`` itself, any other a folder of
    its own. A camera keeps its folder.
    """
    alone = len(streams) == 1 and not run.cameras
    for stream in streams:
        folder = "" if alone else stream.name
        run.cameras.setdefault(stream.name, CameraEntry(folder=folder))


def run_cameras(
    run: RunFolder, recording: Dataset | None, names: Sequence[str] | None = None
) -> list[RunCamera]:
    """The cameras of a run, opened.

    Parameters
    ----------
    recording : Dataset, optional
        None where it is away: only virtual cameras can be opened.
    """
    found = []
    for name, entry in run.cameras.items():
        if names is not None and name not in names:
            continue
        if entry.virtual is not None:
            times = run.trajectory().times if recording is None else recording.times
            stream = virtual_stream(name, entry.virtual, times, run.manifest.derived.up)
        elif recording is not None:
            (given,) = open_cameras(run.manifest.inputs, recording, [name])
            stream = fitted(given, entry.fit)
        else:
            continue
        found.append(RunCamera(stream, entry.folder, camera_parameters(run, name)))
    return found


def fitted(stream: CameraStream, fit: StoredCameraFit | None) -> CameraStream:
    """A camera with what its images ask for, where the run takes that."""
    if fit is None or not fit.applied:
        return stream
    change = poses_from([rotation_exp(np.radians(fit.turn_deg))], [fit.shift_m])[0]
    times = stream.times + round(1e6 * fit.time_ms)
    return replace(stream, T_camera_lidar=change @ stream.T_camera_lidar, times=times)


def camera_parameters(run: RunFolder, name: str) -> Parameters:
    """The parameters of a run with the settings of one camera."""
    return replaced(run.parameters, run.cameras[name].settings if name in run.cameras else {})


def remove_undrawn_cameras(path: Path, names: Sequence[str]) -> None:
    """Take back cameras of which no map was drawn, so that the run can go on without them."""
    run = RunFolder.open(path)  # as it was saved, without the settings that were refused
    undrawn = [name for name in names if name in run.cameras and not _has_maps(run, name)]
    if not undrawn:
        return
    with run.lock("render"):
        for name in undrawn:
            camera = run.cameras.pop(name).folder
            run.manifest.stages.pop(f"render {name}", None)
            for place in (run.path / "depth" / camera, run.calibration_folder(camera)):
                records = run.records(place)
                for file in records.names():
                    if file == DESCRIPTION or "render" in records.recorded_key(file):
                        run.remove(place / file)
        run.save()


def _has_maps(run: RunFolder, camera: str) -> bool:
    place = run.path / "depth" / run.cameras[camera].folder
    return bool(set(run.records(place).names()) - {DESCRIPTION})


def open_cameras(
    inputs: RunInputs | None, recording: Dataset, wanted: Sequence[str] | None
) -> list[CameraStream]:
    """Cameras of a recording, with the image size and the times that a run was given, if any."""
    if inputs is None:
        return [recording.cameras[name] for name in camera_names(wanted, recording)]
    size = parse_size(inputs.image_size)
    whole = full_recording(recording)
    streams = [whole.cameras[name] for name in camera_names(wanted, whole)]
    if size:
        streams = [
            s
            if size == (s.camera.width, s.camera.height)
            else replace(s, camera=Camera(s.camera.K, *size))
            for s in streams
        ]
    streams = _with_masks(inputs, whole, streams)
    if inputs.camera_times is not None:
        streams = [_with_times(stream, inputs.camera_times) for stream in streams]
    if isinstance(recording, FrameRange):
        streams = [recording.part_of(stream) for stream in streams]
    return streams


def _with_masks(
    inputs: RunInputs, recording: Dataset, streams: list[CameraStream]
) -> list[CameraStream]:
    """The cameras with the masks of the recording, or of the inputs in their place."""
    masks = dict(getattr(as_recorded(recording), "masks", {}))
    for named in inputs.mask or ():
        camera, _, file = named.partition(":")
        masks[camera] = Path(file)
    for name in masks.keys() - recording.cameras.keys():
        raise CalibrationError(
            f"{recording.path} has no camera {name!r} for a mask; it has "
            f"{', '.join(recording.cameras) or 'none'}"
        )
    return [
        replace(s, camera=replace(s.camera, mask=camera_mask(s.camera, masks[s.name])))
        if s.name in masks
        else s
        for s in streams
    ]


def as_recorded(recording: Dataset) -> Dataset:
    """The recording itself, which knows what docdepth.yaml says of it."""
    while isinstance(recording, RecordingView):
        recording = recording.whole
    return recording


def place_for_poses(recording: Dataset, camera: str) -> NDArray[np.float64]:
    """``T_camera_lidar`` (4, 4) as the files of a recording give it.

    Poses of its cameras, as KITTI's are of camera 0, were made from those of the LiDAR by it.
    """
    T, whole = recording.cameras[camera].T_camera_lidar, as_recorded(recording)
    return seen_raised(T, -whole.elevation_error) if isinstance(whole, Recording) else T


def camera_names(wanted: Sequence[str] | None, recording: Dataset) -> list[str]:
    """Names of the wanted cameras; the left colour camera if none is named."""
    names = list(dict.fromkeys(wanted or ()))
    if names == [NO_CAMERA]:
        return []
    cameras = recording.cameras
    if not cameras:
        images = ", ".join(image_streams(recording))
        raise CalibrationError(
            f"{recording.path} has no camera with K and T_camera_lidar; docdepth.yaml can add "
            "them"
            + (
                f", and `docdepth.calibration.calibrate()` finds those of {images}"
                if images
                else ""
            ),
            "`camera='none'` makes poses and labels alone",
        )
    if wanted is None:
        colour = [c for c in cameras if c in ("image_02", "image_2")]
        return [colour[0] if colour else next(iter(cameras))]
    if names == [ALL]:
        return list(cameras)
    for name in names:
        if name not in cameras:
            raise DatasetError(
                f"{recording.path} has no camera {name!r}; it has {', '.join(cameras)}, or all"
            )
    return names


def _with_times(stream: CameraStream, path: Path) -> CameraStream:
    """The camera with the times of a file."""
    times = read_times(path)
    if stream.images and len(times) != len(stream.images):
        raise DatasetError(
            f"{path} has {len(times)} times for {len(stream.images)} images of {stream.name}"
        )
    names = stream.names
    if not stream.images:
        digits = len(names[0]) if names and names[0].isdigit() else 10
        names = [f"{i:0{digits}d}" for i in range(len(times))]
    return replace(stream, times=times, names=names)


def virtual_camera(pose: str, K: str, size: str, times: Path | None = None) -> VirtualCamera:
    """Describe a camera that moves with the LiDAR, as run.yaml holds it.

    Parameters
    ----------
    pose : str
        ``T_lidar_camera`` as :func:`parse_pose` reads it.
    K : str
        ``fx,fy,cx,cy`` in pixels.
    size : str
        ``WIDTHxHEIGHT`` in pixels.
    times : Path, optional
        A file with the time of each image in seconds, one per line; the times of the sweeps if
        absent.
    """
    pixels = parse_size(size)
    if pixels is None:
        raise ConfigError("`size` is missing; write WIDTHxHEIGHT, for example 1280x720")
    check_image_size(*pixels, "`size`")
    fx, fy, cx, cy = _numbers("K", K, 4, "fx,fy,cx,cy")
    return VirtualCamera(
        T_lidar_camera=parse_pose(pose).tolist(),
        K=[[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]],
        size=pixels,
        times=None if times is None else times.resolve(),
    )


def virtual_stream(
    name: str,
    described: VirtualCamera,
    sweep_times: NDArray[np.int64],
    up: Point | None = None,
) -> CameraStream:
    """The virtual camera that :func:`virtual_camera` described.

    Parameters
    ----------
    sweep_times : ndarray of int64, shape (n,)
        Nanoseconds.
    up : (float, float, float), optional
        Of the frame in which it was described, where the run's own was turned
        (:class:`~docdepth.datasets.sensor_pose.LevelledRecording`).
    """
    camera = Camera(np.array(described.K), *described.size)
    T_camera_lidar = inverse(np.array(described.T_lidar_camera))
    if up is not None:
        T_camera_lidar[:3, :3] = T_camera_lidar[:3, :3] @ level_turn(up).T
    if described.times is None:
        names = [f"{i:06d}" for i in range(len(sweep_times))]
        return CameraStream(name, camera, T_camera_lidar, sweep_times, names)
    times = read_times(described.times)
    return CameraStream(
        name, camera, T_camera_lidar, times, [f"{i:010d}" for i in range(len(times))]
    )


def check_name(run: RunFolder, name: str) -> None:
    """Refuse a virtual camera whose name is no folder or that of a recorded camera."""
    # A name with a dot could be that of a file of the first camera: 000000.png, depth.json.
    if not name or set(name) & set("./\\\0"):
        raise ConfigError(f"`{name=}` cannot be a folder name; use letters and digits")
    if name in run.cameras and run.cameras[name].virtual is None:
        raise ConfigError(f"`{name=}`: the run has a camera of this name; choose another name")


def parse_size(text: str | None) -> tuple[int, int] | None:
    """Width and height in pixels from ``1242x375``."""
    if not text:
        return None
    width, _, height = text.partition("x")
    if not (width.isdigit() and height.isdigit()):
        raise CalibrationError(f"size {text!r}: write WIDTHxHEIGHT, for example 1242x375")
    return int(width), int(height)


def parse_pose(text: str) -> NDArray[np.float64]:
    """Read the pose ``T_lidar_camera`` of a camera in the LiDAR frame (x forward, y left, z up).

    Parameters
    ----------
    text : str
        Numbers separated by blanks or commas, or the path of a file with them: ``x y z`` of a
        camera that looks along the LiDAR's x axis; ``x y z qx qy qz qw`` with the rotation from
        camera axes (x right, y down, z forward) to LiDAR axes; or a 3x4 or 4x4 matrix, row by row,
        that transforms camera points to the LiDAR frame.

    Returns
    -------
    ndarray of float64, shape (4, 4)
    """
    file = Path(text)
    content = read_text(file) if len(text) < 256 and file.is_file() else text
    try:
        values = np.array(content.replace(",", " ").split(), dtype=np.float64)
    except ValueError:
        values = np.zeros(0)
    rotation, position = FORWARD, values[:3]
    if values.size == 7 and np.linalg.norm(values[3:]) > 0:
        rotation = quaternion_to_matrix(values[3:] / np.linalg.norm(values[3:]))
    elif values.size in (12, 16):
        matrix = values.reshape(-1, 4)
        rotation, position = matrix[:3, :3], matrix[:3, 3]
    elif values.size != 3:
        rotation = np.zeros((3, 3))
    turned = np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-3)
    if not np.isfinite(values).all() or not turned or np.linalg.det(rotation) < 0:
        raise CalibrationError(
            f"`pose={text!r}`: write x,y,z or x,y,z,qx,qy,qz,qw or a file with a 4x4 matrix; it is "
            "the pose of the camera in the LiDAR frame and must be rigid"
        )
    return poses_from([nearest_rotation(rotation)], position[None])[0]


def _numbers(argument: str, text: str, count: int, pattern: str) -> list[float]:
    try:
        values = [float(word) for word in text.split(",")]
    except ValueError:
        values = []
    if len(values) != count:
        raise ConfigError(f"`{argument}={text!r}`: write {pattern}")
    return values
