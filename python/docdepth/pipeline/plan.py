"""The stages of a run: recording, odometry, classify, and a render for each camera."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.base import CameraStream, Dataset, Sweep
from docdepth.datasets.files import ImageSource, file_of
from docdepth.errors import DatasetError, RunError
from docdepth.geometry.trajectory import within_parts
from docdepth.io.run_folder import RunFolder, stage_key
from docdepth.io.tracks import TRACKS
from docdepth.io.untrusted import open_file
from docdepth.pipeline.cameras import RunCamera, run_cameras
from docdepth.pipeline.depth_files import DepthFiles, files_of_image
from docdepth.pipeline.label_folder import LabelFolder
from docdepth.pipeline.run_inputs import known_poses, open_recording
from docdepth.pipeline.stage import FrameOutputs, Stage, StageInputs, StageState

_Known = dict[str, list[int | str]]
_NOTES = "inputs.json"
"""By name size and time of each file, and perhaps its hash and the time of its state."""

_VERSIONS = {"odometry": 16, "classify": 54, "render": 21}
"""Counted up when a new version of docdepth makes other results of the same inputs."""


class InputFiles:
    """What is known of the files of a recording.

    Parameters
    ----------
    run : RunFolder
        Its inputs say whether contents are hashed (``hash_inputs``). The hash of a file that nobody
        has written since, by the time that the system notes of it, is that of an earlier command.
    """

    def __init__(self, run: RunFolder) -> None:
        self._run = run
        self._hashed = run.manifest.inputs is not None and run.manifest.inputs.hash_inputs
        self._before = {what: _known(entry) for what, entry in run.read_notes(_NOTES).items()}
        self._now: dict[str, _Known] = {}

    def sweeps(self, recording: Dataset) -> str:
        """Hash of the identity of all files that sweeps are read from."""
        files = (file for index in range(len(recording)) for file in recording.sweep_files(index))
        return self.identify("sweeps", files, recording.path)

    def images(self, stream: CameraStream) -> list[str]:
        """The identity of each image of a camera; empty strings where there are none."""
        if not stream.images:
            return [""] * len(stream.names)
        name = f"images of {stream.name}"
        self.identify(name, stream.images, stream.images[0].parent)
        return [stage_key(self._identity(known)) for known in self._now[name].values()]

    def changed(self, what: str) -> list[str]:
        """Names of ``sweeps`` or ``labels`` that differ from those that were saved."""
        if what not in self._now:
            return []
        before, now = self._before.get(what, {}), self._now[what]
        return sorted(
            name
            for name in before.keys() | now.keys()
            if name not in before
            or name not in now
            or self._identity(before[name]) != self._identity(now[name])
        )

    def save(self) -> None:
        """Write what is known now."""
        before = self._run.read_notes(_NOTES)
        now = {**before, **self._now}
        if now != before:
            self._run.write_notes(_NOTES, now)

    def identify(self, what: str, files: Iterable[ImageSource], root: Path) -> str:
        """Hash of the identity of all these files, named from ``root``."""
        before: _Known = self._before.get(what, {})
        now: _Known = {}
        hashes: dict[Path, str] = {}  # a bag holds many sweeps and images
        for one in files:
            name, file = os.path.relpath(one, root), file_of(one)
            if name in now:
                continue
            try:
                known = file.stat()
                entry: list[int | str] = [known.st_size, known.st_mtime_ns]
                if self._hashed:
                    # Anybody can set the time of a change, but not that of a change of the file's
                    # state.
                    noted = before.get(name, [])
                    same = len(noted) > 3 and noted[3] == known.st_ctime_ns and noted[:2] == entry
                    if not same and file not in hashes:
                        hashes[file] = _hash(file)
                    entry += [noted[2] if same else hashes[file], known.st_ctime_ns]
            except OSError as error:
                raise DatasetError(
                    f"{file} cannot be read: {error.strerror}; put it back"
                ) from None
            now[name] = entry
        self._now[what] = now
        return stage_key([[name, self._identity(entry)] for name, entry in now.items()])

    def _identity(self, entry: list[int | str]) -> list[int | str]:
        """Size and time, or size and hash."""
        return [entry[0], entry[2]] if self._hashed and len(entry) > 2 else entry[:2]


def _known(files: object) -> _Known:
    """What was noted of files; nothing where someone has changed it."""
    entries = files.items() if isinstance(files, dict) else ()
    return {name: entry for name, entry in entries if isinstance(entry, list)}


def _hash(file: Path) -> str:
    found = hashlib.sha256()
    with open_file(file) as stream:
        while data := stream.read(1 << 22):
            found.update(data)
    return found.hexdigest()


def odometry_stage(
    run: RunFolder,
    recording: Dataset | None,
    poses: NDArray[np.float64] | None,
    first: Sweep | None = None,
) -> Stage:
    """Poses, and deskewed sweeps as frames.

    Where the recording is None, since it lies on a disk that is away, it counts as unchanged.
    ``first`` is its first sweep, which is read if absent.
    """
    own = {
        "version": _VERSIONS["odometry"],
        "odometry": run.parameters.odometry.model_dump(mode="json"),
    }
    input_files = InputFiles(run)
    inputs: StageInputs
    if recording is None:
        inputs, count = {**run.stage_inputs("odometry"), **own}, run.stage("odometry").all_frames
    else:
        first, derived, count = first or recording.sweep(0), run.manifest.derived, len(recording)
        up, boxes = derived.up, derived.ego_boxes
        rig = first.sensor_rig
        kept = ["as given"] if keeps_given_poses(run) else []
        inputs = own | {
            "sweeps": input_files.sweeps(recording),
            "times": stage_key(recording.times.tolist()),
            "poses": None if poses is None else stage_key(np.asarray(poses).tolist(), *kept),
            "rays": stage_key(
                None if rig is None else rig.T_lidar_sensor.tolist(),
                *([rig.beam_width] if rig is not None and rig.beam_width else []),
                first.motion_compensated,
                first.relative_time is not None,
                *([up] if up else []),
            ),
        }
        inputs |= {"ego_boxes": stage_key(boxes)} if boxes else {}
    has_sensors = first is not None and first.sensor_rig is not None
    if recording is None:
        has_sensors = run.sensors_path.name in run.records(run.path)
    changed = input_files.changed("sweeps")
    sweeps = f"sweeps have changed, {changed[0]} first" if changed else "sweeps have changed"
    names = "times", "poses", "rays", "ego_boxes"
    others = {name: f"the {name} of the input have changed" for name in names}
    return Stage(
        run,
        "odometry",
        inputs,
        _frames(run, "odometry", inputs, [[run.frame_path(i)] for i in range(count)]),
        [run.trajectory_path, *([run.sensors_path] if has_sensors else [])],
        [run.frame_path(0).parent],
        reasons={"sweeps": sweeps, **others},
        save_inputs=input_files.save,
    )


def keeps_given_poses(run: RunFolder) -> bool:
    """Whether a run takes poses as they are given: by its inputs, or since it has none."""
    inputs = run.manifest.inputs
    return inputs is None or not inputs.poses or inputs.poses_as_given


def classify_stage(run: RunFolder, odometry: Stage | None = None) -> Stage:
    """Classes of the frames, label files, and tracks; or labels that the run was given.

    Without the stage before it, frames count as up to date.
    """
    labels = None if run.manifest.inputs is None else run.manifest.inputs.labels
    input_files = InputFiles(run)
    known = run.stage("odometry")
    inputs: dict[str, object] = {
        "version": _VERSIONS["classify"],
        "odometry": known.key if odometry is None else odometry.key,
    }
    if labels is None:
        inputs["ground"] = run.parameters.ground.model_dump(mode="json")
        inputs["dynamics"] = run.parameters.dynamics.model_dump(mode="json")
        has_tracks = run.parameters.dynamics.evidence == "tracks"
    else:
        inputs["labels"] = run.stage_inputs("classify").get("labels")
        if labels.is_dir():  # else on a disk that is away
            given = LabelFolder(labels)
            inputs["labels"] = input_files.identify("labels", given.files(), given.folder)
        has_tracks = TRACKS in run.records(run.path)
    label_files = _label_files(run)
    count = len(run.trajectory()) if odometry is None else len(odometry.frames)
    files = [[run.classes_path(i)] for i in range(count)]
    frames = [
        FrameOutputs(
            [*outputs.files, label_files.get(i, run.path / "labels" / f"of frame {i}")],
            {"frame": str(i)},
        )
        for i, outputs in enumerate(_frames(run, "classify", inputs, files))
    ]
    return Stage(
        run,
        "classify",
        inputs,
        frames,
        [run.path / TRACKS] if has_tracks else [],
        [run.path / "classes", run.path / "labels", run.path],
        previous=odometry,
        reasons={"labels": "other labels are given"},
        save_inputs=input_files.save,
    )


def render_stage(
    run: RunFolder,
    camera: RunCamera | str,
    times: NDArray[np.int64] | None,
    classify: Stage | None = None,
) -> Stage:
    """Depth maps of a camera, with layers and pictures.

    ``times`` are those of the sweeps: images outside, and in gaps, have no depth. A camera that
    cannot be opened, since the recording is away, is given by its name and counts as unchanged.
    Without the stage before it, classes count as up to date.
    """
    key = run.stage("classify").key if classify is None else classify.key
    own = {"version": _VERSIONS["render"], "classify": key}
    if isinstance(camera, str):
        name, inputs = f"render {camera}", {**run.stage_inputs(f"render {camera}"), **own}
        folder = run.path / "depth" / run.cameras[camera].folder
        records = run.records(folder)
        maps = [file for file in records.names() if "image" in records.recorded_key(file)]
        return Stage(
            run, name, inputs, [FrameOutputs([folder / m]) for m in maps], previous=classify
        )
    stream, p, input_files = camera.stream, camera.parameters, InputFiles(run)
    inputs = {
        **own,
        "render": p.render.model_dump(mode="json"),
        "output": p.output.model_dump(mode="json", exclude={"layers"}),
        "times": stage_key(stream.times.tolist(), stream.names),
        "camera": {
            **stream.camera.as_dict(),
            "distortion": stream.distortion_coefficients,
            "T_camera_lidar": stream.T_camera_lidar.tolist(),
        },
    }
    files = DepthFiles(stream, camera.folder, p)
    identities = input_files.images(stream)
    inside = np.ones(len(stream.times), bool)
    if times is not None:
        inside = within_parts(stream.times, times)
    return Stage(
        run,
        f"render {stream.name}",
        inputs,
        [
            FrameOutputs(
                [*files_of_image(run, camera.folder, stream.names[k], p.output).values()],
                {"image": identities[k]},
                stream.images[k].name if stream.images else "",
                k,
            )
            for k in np.flatnonzero(inside).tolist()
        ],
        files.once(run),
        [run.path / kind / camera.folder for kind in ("depth", "report", "layers")],
        previous=classify,
        also=files.layers_key,
        reasons={"times": "the times of the images have changed"},
        save_inputs=input_files.save,
    )


def _frames(
    run: RunFolder, stage: str, inputs: StageInputs, files: list[list[Path]]
) -> list[FrameOutputs]:
    """Files of frames; none where they were deleted when all was done."""
    deleted = (run.manifest.frames_deleted or {}).get(stage) == stage_key(inputs)
    return [FrameOutputs([] if deleted else of_frame) for of_frame in files]


def _label_files(run: RunFolder) -> dict[int, Path]:
    """The label file of each frame that has one."""
    folder = run.path / "labels"
    records = run.records(folder)
    found = {}
    for name in records.names():
        frame = records.recorded_key(name).get("frame", "")
        if frame.isdigit():
            found[int(frame)] = folder / name
    return found


def plan(
    run: RunFolder,
    recording: Dataset | None = None,
    poses: NDArray[np.float64] | None = None,
    cameras: Sequence[RunCamera] = (),
) -> list[Stage]:
    """All stages of a run in order: odometry, classify, and a render for each camera.

    Parameters
    ----------
    recording : Dataset, optional
        If absent, inputs count as unchanged: it may lie on a disk that is away.
    poses : ndarray of float64, shape (n, 4, 4), optional
        Given poses.
    cameras : sequence of RunCamera
        Of the recording, and virtual ones.
    """
    odometry = odometry_stage(run, recording, poses)
    classify = classify_stage(run, odometry)
    opened = {camera.stream.name: camera for camera in cameras}
    times = None if recording is None else recording.times
    renders = [render_stage(run, opened.get(c, c), times, classify) for c in run.cameras]
    return [odometry, classify, *renders]


def stages_of(run: RunFolder) -> list[Stage]:
    """:func:`plan` with the inputs that the run was given."""
    place = run.recording_path
    if place is None or not place.exists():
        return plan(run)
    recording = open_recording(run.inputs, run.manifest.derived)
    return plan(run, recording, known_poses(run.inputs, recording), run_cameras(run, recording))


def states(run: RunFolder, *, verify: bool = False) -> list[StageState]:
    """The state of each stage of a run."""
    return [stage.state(verify) for stage in stages_of(run)]


def require(run: RunFolder, name: str, *, frames: bool = True) -> None:
    """Refuse results of a stage that are missing, damaged or out of date.

    Folders that docdepth did not write, or an earlier version, are taken as they are.

    Parameters
    ----------
    name : str
        ``odometry``, ``classify``, or ``render CAMERA``.
    frames : bool
        Whether frames are needed, too. Maps of ``render`` never need them.
    """
    if run.manifest.folders_written is None:
        return
    frames = frames and not name.startswith("render")
    stages = {stage.name: stage for stage in stages_of(run)}
    # Classes are of the frames that odometry wrote.
    needed = [name] if name == "odometry" or not frames else ["odometry", name]
    for state in (stages[one].state() for one in needed):
        if state.state != "done":
            raise RunError(
                f"{state.name} of {run.path} is {state.state}: {state.why}",
                f"bring it up to date: `docdepth.run(..., {str(run.path)!r})`",
            )
    if frames:
        run.check_has_frames()
