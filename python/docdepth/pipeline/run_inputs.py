"""The inputs of a run, opened as run.yaml names them: recording, cameras, poses.

The entry ``source`` of run.yaml has ``dataset``, ``name``, ``camera`` (a name, a list of names or
None), ``poses`` (a file, ``CAMERA:FILE`` or ``dataset``), ``camera_times`` and ``image_size``, all
plain values; ``frames`` (``A:B``) and ``calibration`` (a file) may be left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth.config import Parameters, replaced
from docdepth.datasets import (
    CameraStream,
    Dataset,
    FrameRange,
    ImageStream,
    image_streams,
    open_dataset,
)
from docdepth.datasets.images import read_image_of
from docdepth.datasets.times import read_times
from docdepth.errors import CalibrationError, DatasetError
from docdepth.geometry.camera import Camera
from docdepth.io.calibration import read_camera_calibration
from docdepth.io.run_folder import RunFolder
from docdepth.pipeline.given_poses import read_given_poses
from docdepth.pipeline.virtual_camera import parse_size, virtual_stream

ALL = "all"
"""Name that stands for all cameras of a recording."""


@dataclass(frozen=True)
class RunCamera:
    """A camera of a run.

    Attributes
    ----------
    stream : CameraStream
    folder : str
        Where its maps lie in ``depth/``; empty for the first camera of a run.
    parameters : Parameters
        Those of the run with the camera's own settings.
    """

    stream: CameraStream
    folder: str
    parameters: Parameters


def open_inputs(source: dict[str, Any]) -> tuple[Dataset, list[CameraStream]]:
    """Open the recording, and the cameras whose depth maps are wanted.

    Raises
    ------
    DatasetError, CalibrationError
        A file is missing or broken, or there is no such camera.
    """
    recording = open_recording(source)
    return recording, open_cameras(source, recording, source["camera"])


def open_recording(source: dict[str, Any]) -> Dataset:
    """Open the recording of a run."""
    size, frames = parse_size(source.get("image_size")), source.get("frames")
    recording = open_dataset(Path(source["dataset"]), source["name"], size)
    if source.get("calibration"):
        stream = _calibrated(recording, Path(source["calibration"]))
        recording.cameras[stream.name] = stream
    return FrameRange(recording, frames) if frames else recording


def _calibrated(recording: Dataset, file: Path) -> CameraStream:
    """The camera of a recording that a calibration is of, with that calibration."""
    found = read_camera_calibration(file)
    images = image_streams(recording)
    streams: dict[str, CameraStream | ImageStream] = {**images, **recording.cameras}
    name = found.name if found.name in streams or len(streams) != 1 else next(iter(streams))
    if name not in streams:
        raise CalibrationError(
            f"{file} is of {f'the camera {name}' if name else 'a camera without a name'}, "
            f"{recording.path} has {', '.join(streams) or 'no camera'}; say which it is in "
            'calib.json, as in "camera": "front"'
        )
    stream = streams[name]
    camera = found.camera or stream.camera
    if camera is None:
        raise CalibrationError(f"{file} has no K, and {recording.path} neither; name calib.json")
    if stream.camera is not None:
        width, height = stream.camera.width, stream.camera.height
    else:
        height, width = read_image_of(stream.images[0]).shape[:2]
    if (camera.width, camera.height) != (width, height):
        raise CalibrationError(
            f"{file} is of images of {camera.width}x{camera.height} pixels, those of {name} in "
            f"{recording.path} are {width}x{height}; calibrate images of this size"
        )
    distortion, model = stream.distortion, stream.model
    if found.camera is not None:
        numbers = np.array(found.distortion, np.float64)
        distortion, model = (numbers if numbers.any() else None), found.model
    return CameraStream(
        name, camera, found.T_camera_lidar, stream.times, stream.names, stream.images, distortion,
        model,
    )  # fmt: skip


def open_cameras(
    source: dict[str, Any], recording: Dataset, wanted: str | Sequence[str] | None
) -> list[CameraStream]:
    """Cameras of a recording, with the image size and the times that the run was given.

    Raises
    ------
    DatasetError, CalibrationError
        There is no such camera, or its times are broken.
    """
    size = parse_size(source.get("image_size"))
    whole = recording.whole if isinstance(recording, FrameRange) else recording
    streams = [whole.cameras[name] for name in _camera_names(wanted, whole)]
    if size:
        streams = [
            s
            if size == (s.camera.width, s.camera.height)
            else replace(s, camera=Camera(s.camera.K, *size))
            for s in streams
        ]
    if source.get("camera_times"):
        streams = [_with_times(stream, Path(source["camera_times"])) for stream in streams]
    if isinstance(recording, FrameRange):
        streams = [recording.part_of(stream) for stream in streams]
    return streams


def register(run: RunFolder, streams: Sequence[CameraStream]) -> None:
    """Note cameras of the recording in run.yaml.

    A camera that is alone when the first maps are made has ``depth/`` itself, any other a folder of
    its own. A camera keeps its folder.
    """
    alone = len(streams) == 1 and not run.cameras
    for stream in streams:
        folder = "" if alone else stream.name
        run.cameras.setdefault(stream.name, {"folder": folder, "settings": {}})


def run_cameras(
    run: RunFolder, recording: Dataset | None, names: Sequence[str] | None = None
) -> list[RunCamera]:
    """The cameras of a run, opened.

    Parameters
    ----------
    run : RunFolder
    recording : Dataset, optional
        None where it is away: only virtual cameras can be opened.
    names : sequence of str, optional
        Only these.
    """
    found = []
    for name, entry in run.cameras.items():
        if names is not None and name not in names:
            continue
        if "virtual" in entry:
            times = run.trajectory().times if recording is None else recording.times
            stream = virtual_stream(name, entry["virtual"], times)
        elif recording is not None:
            (stream,) = open_cameras(run.manifest["source"], recording, [name])
        else:
            continue
        found.append(RunCamera(stream, entry["folder"], camera_parameters(run, name)))
    return found


def camera_parameters(run: RunFolder, name: str) -> Parameters:
    """The parameters of a run with the settings of one camera."""
    return replaced(run.parameters, run.cameras.get(name, {}).get("settings", {}))


def recorded_camera(run: RunFolder, folder: str) -> CameraStream | None:
    """The camera whose maps are in ``depth/FOLDER``; None for a virtual camera."""
    source = run.manifest["source"]
    for name, entry in run.cameras.items():
        if entry["folder"] == folder and "virtual" not in entry and source.get("dataset"):
            return open_cameras(source, open_recording(source), [name])[0]
    return None


def known_poses(source: dict[str, Any], recording: Dataset) -> NDArray[np.float64] | None:
    """Poses ``T_world_lidar`` (n, 4, 4) of file, recording or run; None: to be estimated."""
    if source.get("poses"):
        return read_given_poses(str(source["poses"]), recording)
    return recording.poses if recording.name == "run" else None


def _camera_names(wanted: str | Sequence[str] | None, recording: Dataset) -> list[str]:
    """Names of the wanted cameras; the left colour camera if none is named."""
    cameras = recording.cameras
    if not cameras:
        images = ", ".join(image_streams(recording))
        raise CalibrationError(
            f"{recording.path} has no calibrated camera; add its calibration"
            + (f", or find that of {images} by docdepth calibrate" if images else "")
        )
    if wanted is None:
        colour = [c for c in cameras if c in ("image_02", "image_2")]
        return [colour[0] if colour else next(iter(cameras))]
    names = [wanted] if isinstance(wanted, str) else list(dict.fromkeys(wanted))
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
