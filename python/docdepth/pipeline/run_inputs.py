"""The inputs of a run, opened as run.yaml names them: recording, cameras, poses.

The entry ``source`` of run.yaml has ``dataset``, ``name``, ``camera`` (a name, a list of names or
None), ``poses``, ``camera_times`` and ``image_size``, all plain values; ``frames`` (``A:B``) may be
left out.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets import CameraStream, Dataset, FrameRange, open_dataset
from docdepth.datasets.times import read_times
from docdepth.errors import CalibrationError, DatasetError
from docdepth.geometry.camera import Camera
from docdepth.io.poses import read_poses
from docdepth.io.run_folder import RunFolder

ALL = "all"
"""Name that stands for all cameras of a recording."""


def open_inputs(source: dict[str, Any]) -> tuple[Dataset, list[CameraStream]]:
    """Open the recording, and the cameras whose depth maps are wanted.

    Raises
    ------
    DatasetError, CalibrationError
        A file is missing or broken, or there is no such camera.
    """
    size = parse_size(source["image_size"])
    recording = open_dataset(Path(source["dataset"]), source["name"], size)
    streams = [recording.cameras[name] for name in _camera_names(source["camera"], recording)]
    if size:
        streams = [
            s
            if size == (s.camera.width, s.camera.height)
            else replace(s, camera=Camera(s.camera.K, *size))
            for s in streams
        ]
    if source["camera_times"]:
        streams = [_with_times(stream, Path(source["camera_times"])) for stream in streams]
    if source.get("frames"):
        part = FrameRange(recording, source["frames"])
        return part, [part.part_of(stream) for stream in streams]
    return recording, streams


def recorded_camera(run: RunFolder, folder: str) -> CameraStream | None:
    """The camera whose maps are in ``depth/FOLDER``; None for a virtual camera."""
    stage = run.stage("render")
    if not run.manifest["source"] or folder not in stage.get("folders", []):
        return None
    name = stage["cameras"][stage["folders"].index(folder)]
    _, streams = open_inputs(run.manifest["source"])
    return next((stream for stream in streams if stream.name == name), None)


def known_poses(source: dict[str, Any], recording: Dataset) -> NDArray[np.float64] | None:
    """Poses ``T_world_lidar`` (n, 4, 4) from a file or another run; None: to be estimated."""
    if source["poses"]:
        if isinstance(recording, FrameRange):
            every = read_poses(Path(source["poses"]), len(recording.whole))
            return every[recording.indices.start : recording.indices.stop]
        return read_poses(Path(source["poses"]), len(recording))
    return recording.poses if recording.name == "run" else None


def parse_size(text: str | None) -> tuple[int, int] | None:
    """Width and height in pixels from ``1242x375``.

    Raises
    ------
    CalibrationError
        The text is not a size.
    """
    if not text:
        return None
    width, _, height = text.partition("x")
    if not (width.isdigit() and height.isdigit()):
        raise CalibrationError(f"size {text!r}: write WIDTHxHEIGHT, for example 1242x375")
    return int(width), int(height)


def _camera_names(wanted: str | list[str] | None, recording: Dataset) -> list[str]:
    """Names of the wanted cameras; the left colour camera if none is named."""
    cameras = recording.cameras
    if not cameras:
        raise CalibrationError(f"{recording.path} has no calibrated camera; add its calibration")
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
