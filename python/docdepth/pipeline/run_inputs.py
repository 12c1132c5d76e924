"""The inputs of a run, opened as run.yaml names them: recording, cameras, poses.

The entry ``source`` of run.yaml has ``dataset``, ``name``, ``camera`` (a name, a list of names or
None), ``poses`` (a file, ``CAMERA:FILE`` or ``dataset``), ``camera_times`` and ``image_size``, all
plain values; ``frames`` (``A:B``), ``calibration`` (a file), ``up`` (a unit vector in the LiDAR
frame of the recording, whose z is not up), ``looks_from`` (where its rays begin, metres) and
``skipped`` (see :mod:`.broken_frames`) may be left out.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from contextlib import nullcontext
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
    full_recording,
    image_streams,
    open_dataset,
)
from docdepth.datasets.images import read_image_of
from docdepth.datasets.readable_frames import broken_frames_tolerated, first_readable
from docdepth.datasets.times import read_times
from docdepth.datasets.up_axis import LEVEL_DEG, LevelledRecording, ground_of
from docdepth.diagnostics.sweeps import find_sensor_origin
from docdepth.errors import CalibrationError, DatasetError, log_findings
from docdepth.geometry.camera import Camera
from docdepth.io.calibration import read_camera_calibration
from docdepth.io.manifest import SKIPPED
from docdepth.io.run_folder import RunFolder
from docdepth.pipeline.broken_frames import find_broken, kept_part
from docdepth.pipeline.given_poses import read_given_poses
from docdepth.pipeline.virtual_camera import parse_size, virtual_stream

log = logging.getLogger(__name__)

ALL, NO_CAMERA = "all", "none"
"""Names that stand for all cameras of a recording, and for no camera: poses and labels alone."""


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
    whole = _open_whole(source)
    note_broken(source, whole, source)
    recording = _part(whole, source)
    return recording, open_cameras(source, recording, source["camera"])


def open_upright(
    source: dict[str, Any], begun: dict[str, Any] | None = None
) -> tuple[Dataset, list[CameraStream]]:
    """Open the inputs of a run that begins.

    It is noted in ``source`` where rays begin and which way is up, if that is found.

    The arguments are those of :func:`open_inputs` and :func:`find_up`.
    """
    whole = _open_whole(source)
    note_broken(source, whole, begun)
    looks_from = find_looks_from(_part(whole, source), begun)
    if looks_from:
        source["looks_from"] = looks_from
    up = find_up(_part(whole, source), begun)
    if up:
        source["up"] = up
    recording = _part(whole, source)
    return recording, open_cameras(source, recording, source["camera"])


def open_recording(source: dict[str, Any]) -> Dataset:
    """Open the recording of a run."""
    return _part(_open_whole(source), source)


def _open_whole(source: dict[str, Any]) -> Dataset:
    """The recording, with the calibration that the run was given."""
    size = parse_size(source.get("image_size"))
    with broken_frames_tolerated() if SKIPPED in source else nullcontext():
        recording = open_dataset(Path(source["dataset"]), source["name"], size)
        if source.get("calibration"):
            stream = _calibrated(recording, Path(source["calibration"]), source["camera"])
            recording.cameras[stream.name] = stream
    return recording


def note_broken(
    source: dict[str, Any], whole: Dataset, begun: dict[str, Any] | None = None
) -> None:
    """Note in ``source`` which frames are broken, if the run leaves them out.

    Parameters
    ----------
    source : dict
    whole : Dataset
        The whole recording.
    begun : dict, optional
        ``source`` of a run that goes on. What it says holds as long as the files are the same.
    """
    if SKIPPED not in source:
        return
    recording = kept_part(whole, {"frames": source.get("frames")})
    streams = open_cameras(source, recording, source["camera"]) if whole.cameras else []
    source[SKIPPED] = find_broken(recording, streams, (begun or {}).get(SKIPPED))


def _part(recording: Dataset, source: dict[str, Any]) -> Dataset:
    """The sweeps of a recording that the run is of, in a frame whose z is up."""
    if source.get("up") or source.get("looks_from"):
        recording = LevelledRecording(recording, source.get("up"), source.get("looks_from"))
    return kept_part(recording, source)


def find_looks_from(recording: Dataset, begun: dict[str, Any] | None = None) -> list[Any] | None:
    """Where rays begin, found where they clearly do not begin at the origin; metres.

    [x, y, z], or a list of them for the LiDARs of merged sweeps in the order of their returns.

    The arguments are those of :func:`find_up`.
    """
    if begun:
        found: list[Any] | None = begun.get("looks_from")
        return None if recording.sweep(0).sensor_rig is not None else found
    viewpoint, found = find_sensor_origin(recording)
    if viewpoint is None:
        return None  # if returns lack neighbours, a run warns of it
    log_findings(log, found)
    places = viewpoint.places
    return [list(place) for place in places] if len(places) > 1 else list(places[0])


def find_up(recording: Dataset, begun: dict[str, Any] | None = None) -> list[float] | None:
    """Which way is up in the LiDAR frame, told by the recording or found by the ground.

    Parameters
    ----------
    recording : Dataset
    begun : dict, optional
        ``source`` of a run that goes on: what was found when it began holds for good.

    Returns
    -------
    list of float, or None
        Unit vector for ``source``; None if z is up, or if it is not known.
    """
    whole = full_recording(recording)
    told = getattr(whole, "up", None)
    if told is not None:
        up = np.array(told, np.float64) / np.linalg.norm(told)
        return None if (up == (0, 0, 1)).all() else [float(x) for x in up]
    if begun:
        found: list[float] | None = begun.get("up")
        return found
    if recording.name == "run":
        return None
    ground = ground_of(recording)
    if ground is None:
        log.warning(
            "%s: sweeps do not tell which way is up, so z is taken; if it is another direction, "
            "say up: [x, y, z] in docdepth.yaml", recording.path,
        )  # fmt: skip
    if ground is None or ground.tilt_deg < LEVEL_DEG:
        return None
    up = ground.up.round(4)
    log.warning(
        "%s: z of the points is %.0f degrees from up, by the ground: they are turned so that z is "
        "up. If that is not the ground, say up: [x, y, z] in docdepth.yaml; up is [%g, %g, %g] now",
        recording.path, ground.tilt_deg, *up,
    )  # fmt: skip
    return [float(x) for x in up / np.linalg.norm(up)]


def _calibrated(recording: Dataset, file: Path, asked: str | Sequence[str] | None) -> CameraStream:
    """The camera of a recording that a calibration is of, with that calibration.

    A calibration that names none is of the camera that was asked for, or of the only one with
    images.
    """
    found = read_camera_calibration(file)
    images = image_streams(recording)
    streams: dict[str, CameraStream | ImageStream] = {**images, **recording.cameras}
    asked = [asked] if isinstance(asked, str) else list(asked or ())
    seeing = [name for name, stream in streams.items() if stream.images]
    one = next((some[0] for some in (list(streams), asked, seeing) if len(some) == 1), "")
    name = one if len(streams) == 1 else found.name or one
    if name not in streams:
        raise CalibrationError(
            f"{file} is of {f'the camera {name}' if name else 'a camera without a name'}, "
            f"{recording.path} has {', '.join(streams) or 'no camera'}; say which it is with "
            '--camera, or in calib.json, as in "camera": "front"'
        )
    stream = streams[name]
    camera = found.camera or stream.camera
    if camera is None:
        raise CalibrationError(f"{file} has no K, and {recording.path} neither; name calib.json")
    if stream.camera is not None:
        width, height = stream.camera.width, stream.camera.height
    else:
        height, width = first_readable(read_image_of, stream.images).shape[:2]
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
    whole = full_recording(recording)
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


def cameras_at_hand(run: RunFolder) -> dict[str, CameraStream]:
    """The recorded cameras of a run by name; none where its recording is away."""
    path = run.manifest["source"].get("dataset")
    if not path or not Path(path).exists():
        return {}
    cameras = run_cameras(run, open_recording(run.manifest["source"]))
    return {camera.stream.name: camera.stream for camera in cameras}


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
    names = [wanted] if isinstance(wanted, str) else list(dict.fromkeys(wanted or ()))
    if names == [NO_CAMERA]:
        return []
    cameras = recording.cameras
    if not cameras:
        images = ", ".join(image_streams(recording))
        raise CalibrationError(
            f"{recording.path} has no camera with K and T_camera_lidar; docdepth.yaml can add "
            "them"
            + (f", and docdepth calibrate finds those of {images}" if images else "")
            + "; --camera none makes poses and labels alone"
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
