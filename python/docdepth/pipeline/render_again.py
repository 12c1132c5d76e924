"""A run rendered again: with other parameters, of further cameras, or with other labels."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from docdepth.concurrency import Progress, null_progress
from docdepth.config import Settings, replaced
from docdepth.datasets.base import Dataset
from docdepth.errors import DocDepthError
from docdepth.io.inputs import names_in
from docdepth.io.manifest import CameraEntry, VirtualCamera
from docdepth.io.run_folder import RunFolder
from docdepth.pipeline.cameras import (
    add_cameras,
    check_name,
    open_cameras,
    remove_undrawn_cameras,
    run_cameras,
)
from docdepth.pipeline.classify import open_labels, take_labels
from docdepth.pipeline.plan import require
from docdepth.pipeline.render import run_render
from docdepth.pipeline.run_inputs import check_place, recording_of
from docdepth.render.backends import Renderer


def render_again(
    output: Path | str,
    changes: Settings | None = None,
    camera: str | Sequence[str] | None = None,
    virtual: tuple[str, VirtualCamera] | None = None,
    *,
    labels: Path | str | None = None,
    threads: int = 0,
    renderer: Renderer | None = None,
    progress: Progress = null_progress,
) -> RunFolder:
    """Render with other parameters, of further cameras of the recording, or of a virtual camera.

    Parameters
    ----------
    output : Path
        Run folder with up to date classes.
    changes : dict, optional
        Parameters of the stages ``render`` and ``output`` by dotted name. They belong to the named
        cameras alone, or to the whole run if none is named.
    camera : str or sequence of str, optional
        Cameras of the recording to render; all cameras of the run if absent.
    virtual : (str, VirtualCamera), optional
        Name and description of a virtual camera, from :func:`virtual_camera`.
    labels : Path, optional
        Folder of labels of another method, which replace the classes of the run.
    """
    folder = RunFolder.open(Path(output))
    require(folder, "classify" if labels is None else "odometry")
    check_place(folder)
    if labels is not None:
        folder.manifest.inputs = folder.inputs.but(labels=labels)
        open_labels(folder)
    changes, recording = changes or {}, recording_of(folder)
    named = _named_cameras(folder, recording, camera, virtual)
    new = [name for name in named if f"render {name}" not in folder.manifest.stages]
    if named:
        for name in named:
            entry = folder.cameras[name]
            settings = {**entry.settings, **changes}
            folder.cameras[name] = entry.model_copy(update={"settings": settings})
    else:
        folder.manifest.parameters = replaced(folder.parameters, changes)
    cameras = run_cameras(folder, recording, named or None)
    streams = [camera.stream for camera in cameras]
    try:
        if labels is not None:
            take_labels(folder, progress)
        run_render(folder, streams, threads, progress, renderer)
    except DocDepthError:
        remove_undrawn_cameras(folder.path, new)
        raise
    return folder


def _named_cameras(
    folder: RunFolder,
    recording: Dataset,
    camera: str | Sequence[str] | None,
    virtual: tuple[str, VirtualCamera] | None,
) -> list[str]:
    """Names of the cameras that were asked for, which the run knows from now on."""
    if virtual:
        name, description = virtual
        check_name(folder, name)
        folder.cameras[name] = CameraEntry(folder=name, virtual=description)
        return [name]
    if camera is not None:
        streams = open_cameras(folder.manifest.inputs, recording, names_in(camera))
        add_cameras(folder, streams)
        return [stream.name for stream in streams]
    if not folder.cameras:
        add_cameras(folder, list(recording.cameras.values()))
    return []
