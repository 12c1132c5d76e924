"""The cameras of a run: those of its recording, and virtual ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from docdepth.config import Parameters, replaced
from docdepth.datasets.base import CameraStream, Dataset
from docdepth.io.manifest import CameraEntry
from docdepth.io.run_folder import RunFolder
from docdepth.pipeline.run_inputs import camera_names, open_cameras, recording_of
from docdepth.pipeline.virtual_camera import virtual_stream


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


def add_cameras(run: RunFolder, streams: Sequence[CameraStream]) -> None:
    """Note cameras of the recording in run.yaml.

    A camera that is alone when the first maps are made has ``depth/`` itself, any other a folder of
    its own. A camera keeps its folder.
    """
    alone = len(streams) == 1 and not run.cameras
    for stream in streams:
        folder = "" if alone else stream.name
        run.cameras.setdefault(stream.name, CameraEntry(folder=folder))


def open_run_cameras(
    run: RunFolder, recording: Dataset, names: Sequence[str] | None
) -> list[CameraStream]:
    """Cameras of a recording as the run was given them."""
    if run.manifest.inputs is None:
        found = recording.cameras
        return [found[name] for name in camera_names(names, recording)]
    return open_cameras(run.manifest.inputs, recording, names)


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
        if entry.virtual is not None:
            times = run.trajectory().times if recording is None else recording.times
            stream = virtual_stream(name, entry.virtual, times, run.manifest.derived.up)
        elif recording is not None:
            (stream,) = open_run_cameras(run, recording, [name])
        else:
            continue
        found.append(RunCamera(stream, entry.folder, camera_parameters(run, name)))
    return found


def cameras_at_hand(run: RunFolder) -> dict[str, CameraStream]:
    """The recorded cameras of a run by name; none where its recording is away."""
    path = run.recording_path
    if path is None or not path.exists():
        return {}
    cameras = run_cameras(run, recording_of(run))
    return {camera.stream.name: camera.stream for camera in cameras}


def camera_parameters(run: RunFolder, name: str) -> Parameters:
    """The parameters of a run with the settings of one camera."""
    return replaced(run.parameters, run.cameras[name].settings if name in run.cameras else {})


def recorded_camera(run: RunFolder, folder: str) -> CameraStream | None:
    """The camera whose maps are in ``depth/FOLDER``; None for a virtual camera."""
    inputs = run.manifest.inputs
    for name, entry in run.cameras.items():
        if entry.folder == folder and entry.virtual is None and inputs is not None:
            return open_cameras(inputs, recording_of(run), [name])[0]
    return None
