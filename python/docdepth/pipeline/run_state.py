"""Questions about a run: what is up to date, and what has changed since it was started."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from docdepth.errors import RunError
from docdepth.io.depth import DESCRIPTION
from docdepth.io.run_folder import RunFolder
from docdepth.pipeline.graph import RunGraph, StageState
from docdepth.pipeline.run_inputs import known_poses, open_recording, run_cameras


def states(folder: RunFolder, *, verify: bool = False) -> list[StageState]:
    """The state of each stage of a run.

    Parameters
    ----------
    folder : RunFolder
    verify : bool
        Compare the content of each file with its checksum, not only size and time.
    """
    return _graph(folder, verify).states()


def changes_since_start(folder: RunFolder) -> list[str]:
    """The parameters that a stage has changed since the run was started, and how to go back."""
    if folder.manifest.parameters_at_start is None:
        return []
    at_start = folder.manifest.parameters_at_start.model_dump(mode="json")
    verbs = {"odometry": "odometry", "ground": "classify", "dynamics": "classify"}
    now = folder.parameters.model_dump(mode="json")
    sentences: list[str] = []
    for verb in dict.fromkeys([*verbs.values(), "render"]):
        changed = [
            (f"{stage}.{name}", now[stage][name], value)
            for stage, values in at_start.items()
            if isinstance(values, dict) and verbs.get(stage, "render") == verb
            for name, value in values.items()
            if now[stage][name] != value
        ]
        if changed:
            what = ", ".join(f"{name} is {new}, was {old}" for name, new, old in changed)
            back = " ".join(f"--set {name}={old}" for name, _, old in changed)
            sentences.append(f"{what}; back: docdepth {verb} {folder.path} {back}")
    return sentences


def require(folder: RunFolder, stage: str, *, frames: bool = True) -> None:
    """Refuse results of a stage that are missing, damaged or out of date.

    Folders that docdepth did not write, or an earlier version, are taken as they are.

    Parameters
    ----------
    folder : RunFolder
    stage : str
        ``odometry``, ``classify``, or ``render CAMERA``.
    frames : bool
        Whether what ``odometry`` and ``classify`` wrote into the frames is needed.

    Raises
    ------
    RunError
    """
    if folder.manifest.folders_written is None:
        return
    graph = _graph(folder)
    name, _, camera = stage.partition(" ")
    state = graph.render(camera) if name == "render" else getattr(graph, name)()
    if state.state != "done":
        raise RunError(
            f"{stage} of {folder.path} is {state.state}: {state.why}; "
            f"bring it up to date: docdepth run {folder.path}"
        )
    if frames and name != "render":
        folder.check_has_frames()


def _graph(folder: RunFolder, verify: bool = False) -> RunGraph:
    recording, poses, place = None, None, folder.recording_path
    if place is not None and place.exists():
        recording = open_recording(folder.inputs, folder.manifest.derived)
        poses = known_poses(folder.inputs, recording)
    cameras = run_cameras(folder, recording) if recording else []
    return RunGraph(folder, recording, poses, cameras, verify)


def forget_cameras(path: Path, names: Sequence[str]) -> None:
    """Take back cameras of which no map was drawn, so that the run can go on without them."""
    folder = RunFolder.open(path)  # as it was saved, without the settings that were refused
    undrawn = [name for name in names if name in folder.cameras and not _has_maps(folder, name)]
    if not undrawn:
        return
    with folder.lock("render"):
        for name in undrawn:
            camera = folder.cameras.pop(name).folder
            folder.manifest.stages.pop(f"render {name}", None)
            for place in (folder.path / "depth" / camera, folder.calibration_folder(camera)):
                records = folder.records(place)
                for file in records.names():
                    if file == DESCRIPTION or "render" in records.recorded_key(file):
                        folder.remove(place / file)
        folder.save()


def _has_maps(folder: RunFolder, camera: str) -> bool:
    place = folder.path / "depth" / folder.cameras[camera].folder
    return bool(set(folder.records(place).names()) - {DESCRIPTION})
