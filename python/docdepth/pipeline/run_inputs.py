"""The inputs of a run, opened: recording, cameras, poses."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets import (
    CameraStream,
    Dataset,
    FrameRange,
    ImageStream,
    image_streams,
    open_dataset,
)
from docdepth.datasets.files import first_readable, read_image_of
from docdepth.datasets.formats.docdepth_run import RunDataset
from docdepth.datasets.point_times import Instant
from docdepth.datasets.sensor_pose import LEVEL_DEG, LevelledRecording, ground_of
from docdepth.datasets.views import TurningLidar, WithoutEgo, lacks_times
from docdepth.diagnostics.own_vehicle import find_own_vehicle
from docdepth.diagnostics.sweeps import find_sensor_origin
from docdepth.errors import CalibrationError, Finding, RunError, log_findings
from docdepth.geometry.turn import Turn
from docdepth.io.calibration import read_camera_calibration
from docdepth.io.inputs import Box, DerivedInputs, Point, RunInputs, SkippedFrames
from docdepth.io.run_folder import RunFolder
from docdepth.odometry.skew import find_rotation
from docdepth.pipeline.broken_frames import find_broken
from docdepth.pipeline.cameras import as_recorded, fitted, open_cameras, parse_size, run_cameras
from docdepth.pipeline.given_poses import read_given_poses

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class OpenedInputs:
    """The inputs of a run, opened."""

    recording: Dataset  # the sweeps that the run is of, in a frame whose z is up
    cameras: list[CameraStream]  # whose depth maps are wanted
    derived: DerivedInputs  # what was found in the inputs


def open_inputs(
    inputs: RunInputs, begun: DerivedInputs | None = None, kept_ego: bool = False
) -> OpenedInputs:
    """Open the recording, and the cameras whose depth maps are wanted.

    Parameters
    ----------
    begun : DerivedInputs, optional
        Of a run that goes on: what was found when it began holds for good, unless the recording
        itself tells another. What is broken holds as long as the files are the same.
    kept_ego : bool
        That run did not look for its own vehicle.
    """
    whole = _open_whole(inputs)
    derived = DerivedInputs(skipped=_find_skipped(inputs, whole, begun))
    recording, stamp = _part(whole, inputs, derived), getattr(whole, "stamp", None)
    of_vehicle = None if kept_ego else begun
    # Each is looked for in the recording as those before it leave it.
    searches: dict[str, Callable[[], object]] = {
        "ego_boxes": lambda: None if inputs.keep_ego else find_ego_boxes(recording, of_vehicle),
        "sensor_origin": lambda: find_ray_origin(recording, begun),
        "up": lambda: find_up(recording, begun),
        "turn": lambda: find_turn(recording, stamp, begun),
    }
    for name, search in searches.items():
        found = search()
        if found is not None:
            derived = derived.model_copy(update={name: found})
            recording = _part(whole, inputs, derived)
    return OpenedInputs(recording, open_cameras(inputs, recording, inputs.camera), derived)


def open_as_begun(inputs: RunInputs, begun: DerivedInputs) -> OpenedInputs:
    """:func:`open_inputs` where only broken frames are looked for again."""
    whole = _open_whole(inputs)
    skipped = _find_skipped(inputs, whole, begun)
    derived = begun.model_copy(update={"skipped": skipped})
    recording = _part(whole, inputs, derived)
    return OpenedInputs(recording, open_cameras(inputs, recording, inputs.camera), derived)


def open_recording(inputs: RunInputs, derived: DerivedInputs | None = None) -> Dataset:
    """Open the recording of a run."""
    return _part(_open_whole(inputs), inputs, derived or DerivedInputs())


def check_place(folder: RunFolder) -> None:
    """Refuse to go on without the recording."""
    place = folder.recording_path
    if place is not None and not place.exists():
        raise RunError(
            f"{place}, the recording of {folder.path}, is not there",
            "if it was moved, say where it is now: "
            f"`docdepth.run(recording, {str(folder.path)!r})`",
        )


def recording_of(run: RunFolder) -> Dataset:
    """The recording of a run, or the run itself if it was made of arrays."""
    if run.manifest.inputs is None:
        return RunDataset(run.path)
    return open_recording(run.manifest.inputs, run.manifest.derived)


def _open_whole(inputs: RunInputs) -> Dataset:
    """The recording, with the calibration that the run was given."""
    size = parse_size(inputs.image_size)
    on_error = inputs.on_error or "stop"
    recording = open_dataset(inputs.recording, inputs.dataset, size, on_error=on_error)
    if inputs.calibration is not None:
        stream = _calibrated(recording, inputs.calibration, inputs.camera or ())
        recording.cameras[stream.name] = stream
    return recording


def _find_skipped(
    inputs: RunInputs, whole: Dataset, begun: DerivedInputs | None
) -> SkippedFrames | None:
    """Which frames of the whole recording are broken, if the run leaves them out."""
    if inputs.on_error != "skip":
        return None
    recording = _part(whole, inputs, DerivedInputs())
    streams = open_cameras(inputs, recording, inputs.camera) if whole.cameras else []
    return find_broken(recording, streams, None if begun is None else begun.skipped)


def _part(recording: Dataset, inputs: RunInputs, derived: DerivedInputs) -> Dataset:
    """The sweeps of a recording that the run is of, without its vehicle, and with z up."""
    if derived.ego_boxes:
        recording = WithoutEgo(recording, derived.ego_boxes)
    if derived.up or derived.sensor_origin:
        recording = LevelledRecording(recording, derived.up, derived.sensor_origin)
    if derived.turn:
        recording = TurningLidar(recording, derived.turn)
    skipped = derived.skipped
    sweeps, images = ([*skipped.sweeps], skipped.images) if skipped else ([], {})
    if not inputs.frames and not sweeps and not images:
        return recording
    return FrameRange(recording, inputs.frames or ":", sweeps, images)


def find_ego_boxes(
    recording: Dataset, begun: DerivedInputs | None = None
) -> tuple[Box, ...] | None:
    """Boxes around what the LiDAR sees of its own vehicle, unless the recording tells them.

    The arguments are those of :func:`find_up`.
    """
    if recording.name == "run" or getattr(as_recorded(recording), "ego_boxes", None) is not None:
        return None
    if begun:
        return begun.ego_boxes
    vehicle = find_own_vehicle(recording)
    if vehicle is None:
        return None
    mirrored = " and its mirror images" if vehicle.mirrored else ""
    found = Finding(
        "own-vehicle",
        str(recording.path),
        f"{vehicle.returns} returns a sweep within {vehicle.reach:g} m stay with the LiDAR while "
        f"it moves: the own vehicle{mirrored}. They are left out; run.yaml keeps their ego_boxes",
        "`keep_ego=True` keeps these returns, and ego_boxes in docdepth.yaml takes other boxes",
        "note",
    )
    log_findings(log, [found])
    return vehicle.boxes


def find_ray_origin(
    recording: Dataset, begun: DerivedInputs | None = None
) -> Point | tuple[Point, ...] | None:
    """Where rays begin, found where they clearly do not begin at the origin; metres.

    (x, y, z), or several of them for the LiDARs of merged sweeps in the order of their returns.

    The arguments are those of :func:`find_up`.
    """
    if begun:
        return None if recording.sweep(0).sensor_rig is not None else begun.sensor_origin
    viewpoint, found = find_sensor_origin(recording)
    if viewpoint is None:
        return None  # if returns lack neighbours, a run warns of it
    log_findings(log, found)
    places = viewpoint.places
    x, y, z = places[0]
    return tuple(places) if len(places) > 1 else (x, y, z)


def find_up(recording: Dataset, begun: DerivedInputs | None = None) -> Point | None:
    """Which way is up in the LiDAR frame, told by the recording or found by the ground.

    Parameters
    ----------
    begun : DerivedInputs, optional
        Of a run that goes on: what was found when it began holds for good.
    """
    told = getattr(as_recorded(recording), "up", None)
    if told is not None:
        up = np.array(told, np.float64) / np.linalg.norm(told)
        return None if (up == (0, 0, 1)).all() else _point(up)
    if begun:
        return begun.up
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
    return _point(up / np.linalg.norm(up))


def find_turn(
    recording: Dataset, stamp: Instant | None = None, begun: DerivedInputs | None = None
) -> Turn | None:
    """How the LiDAR turns, where that gives times to points that have none.

    Parameters
    ----------
    recording : Dataset
        Its z is up.
    stamp : {"start", "middle", "end"}, optional
        Which instant of a sweep its time is, if it is known.
    begun : DerivedInputs, optional
        As for :func:`find_up`.
    """
    if not lacks_times(recording):
        return None
    if begun:
        return begun.turn
    turn, found = find_rotation(recording, stamp)
    log_findings(log, found)
    return turn


def _point(values: NDArray[np.float64]) -> Point:
    x, y, z = values.tolist()
    return x, y, z


def _calibrated(recording: Dataset, file: Path, asked: Sequence[str]) -> CameraStream:
    """The camera of a recording that a calibration is of, with that calibration.

    A calibration that names none is of the camera that was asked for, or of the only one with
    images.
    """
    found = read_camera_calibration(file)
    images = image_streams(recording)
    streams: dict[str, CameraStream | ImageStream] = {**images, **recording.cameras}
    asked = list(asked)
    seeing = [name for name, stream in streams.items() if stream.images]
    one = next((some[0] for some in (list(streams), asked, seeing) if len(some) == 1), "")
    name = one if len(streams) == 1 else found.name or one
    if name not in streams:
        raise CalibrationError(
            f"{file} is of {f'the camera {name}' if name else 'a camera without a name'}, "
            f"{recording.path} has {', '.join(streams) or 'no camera'}",
            'say which it is with `camera`, or in calib.json, as in "camera": "front"',
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


def known_poses(inputs: RunInputs, recording: Dataset) -> NDArray[np.float64] | None:
    """Poses ``T_world_lidar`` (n, 4, 4) of file, recording or run; None: to be estimated."""
    if inputs.poses:
        return read_given_poses(inputs.poses, recording)
    return recording.poses if recording.name == "run" else None


def cameras_at_hand(run: RunFolder) -> dict[str, CameraStream]:
    """The recorded cameras of a run by name; none where its recording is away."""
    path = run.recording_path
    if path is None or not path.exists():
        return {}
    cameras = run_cameras(run, recording_of(run))
    return {camera.stream.name: camera.stream for camera in cameras}


def recorded_camera(run: RunFolder, folder: str) -> CameraStream | None:
    """The camera whose maps are in ``depth/FOLDER``; None for a virtual camera."""
    inputs = run.manifest.inputs
    for name, entry in run.cameras.items():
        if entry.folder == folder and entry.virtual is None and inputs is not None:
            return fitted(open_cameras(inputs, recording_of(run), [name])[0], entry.fit)
    return None
