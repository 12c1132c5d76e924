"""What each product of a run is made of, and in which state it is.

The graph is a chain with one end for each camera: recording, odometry, classify, render CAMERA.
What a stage is made of are its parameters, the key of the stage before it and the identity of the
files that it reads. The key is a hash of that. Each file of a run has the key of its stage in the
records of its folder, so the state of a stage follows from its files.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.base import Dataset, Sweep
from docdepth.io.run_folder import RunFolder, stage_key
from docdepth.io.tracks import TRACKS
from docdepth.pipeline.depth_files import DepthFiles
from docdepth.pipeline.input_files import InputFiles
from docdepth.pipeline.label_folder import LabelFolder
from docdepth.pipeline.run_inputs import RunCamera

_VERSIONS = {"odometry": 8, "classify": 20, "render": 10}
"""Counted up when a new version of docdepth makes other results of the same inputs."""

State = Literal["done", "out of date", "incomplete", "damaged", "missing"]

Parts = dict[str, Any]
"""What a product is made of, as plain values."""


@dataclass(frozen=True)
class StageState:
    """State of a stage of a run.

    Attributes
    ----------
    name : str
        ``odometry``, ``classify`` or ``render CAMERA``.
    state : str
        ``done``; ``out of date``: made of other parameters or inputs; ``incomplete``: some files
        are not there; ``damaged``: some files differ from what was written; ``missing``: nothing is
        there.
    why : str
        The reason, if it is not done.
    frames, all_frames : int
        Sweeps or images that are done, and all of them.
    size : int
        Bytes of its files.
    seconds : float
        That it took in all, over all commands.
    """

    name: str
    state: State
    why: str
    frames: int
    all_frames: int
    size: int = 0
    seconds: float = 0.0

    def as_dict(self) -> dict[str, Any]:
        """All values by name, ready for JSON."""
        return dict(vars(self))


def odometry_parts(
    run: RunFolder,
    recording: Dataset,
    first: Sweep,
    poses: NDArray[np.float64] | None,
    inputs: InputFiles,
) -> Parts:
    """What poses and deskewed frames are made of; ``first`` is the recording's first sweep."""
    rig = first.sensor_rig
    up = run.manifest.derived.up
    return {
        "version": _VERSIONS["odometry"],
        "odometry": run.parameters.odometry.model_dump(mode="json"),
        "sweeps": inputs.sweeps(recording),
        "times": stage_key(recording.times.tolist()),
        "poses": None if poses is None else stage_key(np.asarray(poses).tolist()),
        "rays": stage_key(
            None if rig is None else rig.T_lidar_sensor.tolist(),
            first.motion_compensated,
            first.relative_time is not None,
            *([up] if up else []),
        ),
    }


def classify_parts(run: RunFolder, odometry_key: str | None, inputs: InputFiles) -> Parts:
    """What ground, votes and classes are made of, or given labels."""
    p, inputs_of_run = run.parameters, run.manifest.inputs
    labels = None if inputs_of_run is None else inputs_of_run.labels
    first = {"version": _VERSIONS["classify"], "odometry": odometry_key}
    if labels:
        if labels.is_dir():
            given = LabelFolder(labels)
            return first | {"labels": inputs.labels(given.files(), given.folder)}
        return first | {"labels": run.made_of("classify").get("labels")}  # on a disk that is away
    return first | {
        "ground": p.ground.model_dump(mode="json"),
        "dynamics": p.dynamics.model_dump(mode="json"),
    }


def render_parts(classify_key: str | None, camera: RunCamera) -> Parts:
    """What the depth maps of a camera are made of."""
    stream, p = camera.stream, camera.parameters
    return {
        "version": _VERSIONS["render"],
        "classify": classify_key,
        "render": p.render.model_dump(mode="json"),
        "output": p.output.model_dump(mode="json"),
        "camera": {
            **stream.camera.as_dict(),
            "distortion": stream.distortion_coefficients,
            "T_camera_lidar": stream.T_camera_lidar.tolist(),
            "times": stage_key(stream.times.tolist(), stream.names),
        },
    }


class RunGraph:
    """The stages of a run, compared with its parameters and inputs as they are now.

    Parameters
    ----------
    run : RunFolder
    recording : Dataset, optional
        If absent, inputs are taken to be as they were: it may lie on a disk that is away.
    poses : ndarray of float64, shape (n, 4, 4), optional
        Given poses.
    cameras : sequence of RunCamera
        Of the recording, and virtual ones.
    verify : bool
        Compare the content of every file, not only its size and time.
    """

    def __init__(
        self,
        run: RunFolder,
        recording: Dataset | None = None,
        poses: NDArray[np.float64] | None = None,
        cameras: Sequence[RunCamera] = (),
        verify: bool = False,
    ) -> None:
        self._run, self._recording, self._verify = run, recording, verify
        self._cameras = {camera.stream.name: camera for camera in cameras}
        self._inputs = InputFiles(run)
        if recording is None:
            inputs = run.made_of("odometry")
            own = run.parameters.odometry.model_dump(mode="json")
            self._odometry = {**inputs, "odometry": own, "version": _VERSIONS["odometry"]}
        else:
            self._odometry = odometry_parts(run, recording, recording.sweep(0), poses, self._inputs)
        self._classify = classify_parts(run, stage_key(self._odometry), self._inputs)
        self._frames = _all_frames(run, recording)

    def states(self) -> list[StageState]:
        """The state of every stage, in order."""
        return [self.odometry(), self.classify(), *(self.render(c) for c in self._run.cameras)]

    def odometry(self) -> StageState:
        """Poses and deskewed frames."""
        key = {"odometry": stage_key(self._odometry)}
        files = self._frame_files("odometry", key["odometry"])
        once = [self._run.trajectory_path]
        if self._run.sensors_path.name in self._run.records(self._run.path):
            once.append(self._run.sensors_path)
        state = self._state("odometry", self._odometry, key, files, once)
        if state.state == "done" and files and not files[0]:
            return replace(state, why="its frames were deleted when all was done (--keep results)")
        return state

    def classify(self) -> StageState:
        """Classes of the frames, label files, and tracks."""
        key = {"classify": stage_key(self._classify)}
        labels = label_files(self._run)
        files = [
            [*of_frame, labels.get(i, self._run.path / "labels" / f"of frame {i}")]
            for i, of_frame in enumerate(self._frame_files("classify", key["classify"]))
        ]
        tracked = self._run.parameters.dynamics.evidence == "tracks"
        if "labels" in self._classify:
            tracked = TRACKS in self._run.records(self._run.path)
        once = [self._run.path / TRACKS] if tracked else []
        return self._state("classify", self._classify, key, files, once)

    def render(self, name: str) -> StageState:
        """Depth maps of a camera."""
        run, stage, camera = self._run, f"render {name}", self._cameras.get(name)
        classify_key = stage_key(self._classify)
        if camera is None:
            parts = run.made_of(stage) | {"classify": classify_key, "version": _VERSIONS["render"]}
            return self._state(stage, parts, {"render": stage_key(parts)}, *_recorded(run, name))
        parts = render_parts(classify_key, camera)
        files = DepthFiles(run, camera.stream, camera.folder, camera.parameters)
        inside = np.arange(len(camera.stream.times))
        if self._recording is not None:
            times, sweeps = camera.stream.times, self._recording.times
            inside = np.flatnonzero((times >= sweeps[0]) & (times <= sweeps[-1]))
        images = [files.files(int(k)) for k in inside]
        state = self._state(stage, parts, {"render": stage_key(parts)}, images, files.once())
        if state.state == "done" and camera.stream.images:
            identities = self._inputs.images(camera.stream)
            old = [k for k in inside if not files.is_of_image(int(k), identities[k])]
            if old:
                name = camera.stream.images[int(old[0])].name
                why = f"{len(old)} images have changed, {name} first"
                whole = len(images) - len(old)
                return replace(state, state="out of date", why=why, frames=whole)
        return state

    def _frame_files(self, stage: str, key: str) -> list[list[Path]]:
        """The file of each frame that a stage has written; none where the run deleted them."""
        if (self._run.manifest.frames_deleted or {}).get(stage) == key:
            return [[] for _ in range(self._frames)]
        return [[self._run.frame_path(i)] for i in range(self._frames)]

    def _state(
        self,
        stage: str,
        parts: Parts,
        key: dict[str, str],
        files: Sequence[Sequence[Path]],
        once: Sequence[Path] = (),
    ) -> StageState:
        """State of a stage that makes these files of each frame, and some files once."""
        run = self._run
        whole, bad = 0, _Bad()
        for of_frame in files:
            whole += all([bad.check(run, file, key, self._verify) for file in of_frame])
        complete = all([bad.check(run, file, key, self._verify) for file in once])
        entry = run.stage(stage)
        known = StageState(
            stage,
            "done",
            "",
            whole,
            len(files),
            sum(_size(run, file) for of_frame in [*files, once] for file in of_frame),
            entry.total_seconds,
        )
        if files and complete and whole == len(files):
            return known
        if entry.key is None:
            return replace(known, state="missing", why="it was not made yet", frames=0)
        if entry.key != stage_key(parts):
            why = self._why(run.made_of(stage), parts)
            return replace(known, state="out of date", why=why)
        if bad.damaged:
            why = f"{bad.damaged[0]} differs from what was written"
            return replace(known, state="damaged", why=why)
        if entry.state == "running":
            return replace(known, state="incomplete", why="it was interrupted")
        first = bad.missing[0] if bad.missing else "a file"
        return replace(known, state="incomplete", why=f"{first} is missing")

    def _why(self, before: Parts, now: Parts) -> str:
        """Which part of what a product is made of has changed."""
        if not before:
            return "what it was made of is not known"
        if before.get("labels") != now.get("labels"):
            return "other labels are given"
        name, was, value = _first_difference(before, now)
        if name in ("odometry", "classify") and not isinstance(was, dict):
            upstream = self._odometry if name == "odometry" else self._classify
            made_of = self._run.made_of(name)
            if made_of in (upstream, before):  # before: notes that someone has changed
                return f"{name} was made again"
            return f"{name} is out of date: {self._why(made_of, upstream)}"
        if name == "sweeps":
            changed = self._inputs.changed()
            return f"sweeps have changed, {changed[0]} first" if changed else "sweeps have changed"
        if name == "version":
            return "an earlier version of docdepth made it"
        if name in ("times", "poses", "rays", "camera.times"):
            return f"the {name} of the input have changed"
        return f"{name} was {was}, is {value}"


class _Bad:
    """Files that are not as they should be."""

    def __init__(self) -> None:
        self.damaged: list[str] = []
        self.missing: list[str] = []

    def check(self, run: RunFolder, file: Path, key: dict[str, str], verify: bool) -> bool:
        """Whether a file is whole and made of ``key``."""
        records = run.records(file.parent)
        state = records.state(file.name, verify)
        name = file.relative_to(run.path).as_posix()
        if state == "whole":
            of_key = key.items() <= records.recorded_key(file.name).items()
            if not of_key:
                self.missing.append(name)
            return of_key
        (self.damaged if state == "damaged" else self.missing).append(name)
        return False


def label_files(run: RunFolder) -> dict[int, Path]:
    """The label file of each frame that has one."""
    folder = run.path / "labels"
    records = run.records(folder)
    found = {}
    for name in records.names():
        frame = records.recorded_key(name).get("frame", "")
        if frame.isdigit():
            found[int(frame)] = folder / name
    return found


def _recorded(run: RunFolder, name: str) -> tuple[list[list[Path]], list[Path]]:
    """The files of a camera by their records, for want of its images' names."""
    folder = run.path / "depth" / run.cameras[name].folder
    records = run.records(folder)
    images = [file for file in records.names() if "image" in records.recorded_key(file)]
    return [[folder / file] for file in images], []


def _all_frames(run: RunFolder, recording: Dataset | None) -> int:
    if recording is not None:
        return len(recording)
    return run.stage("odometry").all_frames


def _size(run: RunFolder, file: Path) -> int:
    return run.records(file.parent).size(file.name)


def _first_difference(before: Parts, now: Parts, path: str = "") -> tuple[str, Any, Any]:
    """Dotted name of the first part that differs, and both values."""
    for name in {**before, **now}:
        was, value = before.get(name), now.get(name)
        if was != value:
            dotted = f"{path}{name}"
            if isinstance(was, dict) and isinstance(value, dict):
                return _first_difference(was, value, f"{dotted}.")
            return dotted, was, value
    return "", None, None


def outdated(states: Iterable[StageState]) -> list[StageState]:
    """The stages that are not done."""
    return [state for state in states if state.state != "done"]
