"""The run folder: the results of each stage, in the layout of the official DOC-Depth release."""

from __future__ import annotations

import hashlib
import json
import logging
import os
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth.config import Parameters
from docdepth.errors import RunError
from docdepth.geometry.camera import Camera
from docdepth.geometry.lidar_frame import LidarFrame, SensorRig
from docdepth.geometry.trajectory import Trajectory
from docdepth.io.atomic import move_aside, write_atomically
from docdepth.io.calibration import read_calibration
from docdepth.io.frames import (
    checked,
    read_frame,
    read_points,
    read_sensors,
    read_whole_trajectory,
    with_classes,
    write_frame,
    write_sensors,
)
from docdepth.io.inputs import DerivedInputs, RunInputs
from docdepth.io.manifest import CameraEntry, RunManifest, StageEntry, read_manifest
from docdepth.io.recorded_folder import STATE_DIR, RecordedFolder, check_entries
from docdepth.io.untrusted import parse_json, read_file, read_text

log = logging.getLogger(__name__)

_STAGE_INPUTS = "stage_inputs.json"


class RunFolder(RecordedFolder):
    """The files of one run.

    ``run.yaml`` (:class:`RunManifest`) holds the inputs, the parameters, the cameras and the
    profile of each stage. All other files are results:

    - ``traj_odometry.ply``: LiDAR poses; ``frames/frame_NNNNNN.ply``: deskewed sweeps;
      ``sensors.npz``: where the LiDARs or their lasers sit;
    - ``classes/frame_NNNNNN.npy``: class, instance and votes of each point of a frame;
    - ``labels/NAME.label``: a SemanticKITTI label for each point of the input;
    - ``tracks.csv``: where each moving object is over time;
    - ``calib.json``, ``calib_lidar_ref_cam.txt``, ``traj_camera.ply``, ``tracks_kitti.txt``: the
      camera, and the moving objects that it sees; of further cameras in ``cameras/NAME/``;
    - ``depth/``: depth maps; of further cameras in ``depth/NAME/``.

    A file has its final name only when it is whole. ``.docdepth/records`` tells which files
    docdepth wrote (:class:`FileRecords`). Nothing else is overwritten or deleted.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        if any(map(os.path.lexists, (self._manifest_path, self.state_dir))):
            check_entries(self.path)
        self._saved = _content(self._manifest_path)  # run.yaml as it is on disk
        found = read_manifest(self._manifest_path)
        # What a user wrote into run.yaml is no text of ours: it is kept aside, if only a comment.
        self._is_ours = found is not None and self._saved in (
            found.text(),
            _content(self._copy_path),
        )
        if found is None:
            found = read_manifest(self._copy_path)
            if found is not None:
                log.warning("%s was missing or damaged; its copy is used", self._manifest_path)
        self.begun = found is not None
        self.manifest = found or RunManifest()

    def _set_paths(self, path: Path) -> None:
        super()._set_paths(path)
        self._manifest_path, self._copy_path = path / "run.yaml", self.state_dir / "run.yaml"
        self.trajectory_path, self.sensors_path = path / "traj_odometry.ply", path / "sensors.npz"

    @classmethod
    def create(cls, path: Path, inputs: RunInputs | None, parameters: Parameters) -> RunFolder:
        """The folder of a new or an existing run; see :meth:`start`."""
        run = cls(path)
        run.start(inputs, parameters)
        return run

    def start(
        self,
        inputs: RunInputs | None,
        parameters: Parameters,
        force: bool = False,
        derived: DerivedInputs | None = None,
    ) -> None:
        """Start a run, or continue the one in this folder if inputs and parameters are the same.

        Nothing is written before a stage begins.

        Parameters
        ----------
        inputs : RunInputs, optional
            None for arrays that come from no recording.
        parameters : Parameters
            A run that a stage has changed since goes on with what it has, if it was started with
            these.
        force : bool
            Continue a run with other inputs or parameters, too.
        """
        if self.path.exists() and not self.path.is_dir():
            raise RunError(f"{self.path} is a file", "name a folder by `output`")
        derived = derived or DerivedInputs()
        if self.begun:
            self.manifest.continue_with(self.path, inputs, derived, parameters, force)
        elif self._has_foreign_files():
            raise RunError(
                f"{self.path} is not empty and holds no run", "name another folder by `output`"
            )
        else:
            self.manifest = RunManifest(
                inputs=inputs,
                derived=derived,
                parameters=parameters,
                parameters_at_start=parameters,
                folders_written=[],
            )
            self.begun = True

    def _has_foreign_files(self) -> bool:
        """Whether there is something in the folder though docdepth never wrote into it."""
        if not self.path.is_dir():
            return False
        # Another command may start a run here at the moment. A file has a record before it gets
        # its name, so files are listed first.
        own = {STATE_DIR, f".{self._manifest_path.name}.part"}
        others = [file for file in self.path.iterdir() if file.name not in own]
        if self.records(self.path).path.is_file():
            return False
        if self._manifest_path.exists() and self.frame_path(0).parent.is_dir():
            return False  # a run whose state is lost
        return bool(others)

    @classmethod
    def open(cls, path: Path | str | RunFolder) -> RunFolder:
        """An existing run, or a folder of the official release; an open one as it is."""
        if isinstance(path, RunFolder):
            return path
        run = cls(Path(path))
        if not run.begun:
            if run._manifest_path.exists() or run.records(run.path).path.is_file():
                raise RunError(
                    f"{run._manifest_path} is missing or damaged",
                    f"begin the run again: `docdepth.run(RECORDING, {str(path)!r})`",
                )
            if not run.trajectory_path.is_file():
                known = (run.path.parent / run._manifest_path.name).is_file()
                remedy = (
                    f"name {run.path.parent}, which is one"
                    if known
                    else f"start one: `docdepth.run(RECORDING, {str(path)!r})`"
                )
                raise RunError(f"{path} holds no run", remedy)
        return run

    def _check_unchanged(self) -> None:
        if self._saved != _content(self._manifest_path):
            raise RunError(
                f"another command has changed {self.path} meanwhile; run the same command again"
            )

    @property
    def parameters(self) -> Parameters:
        """The parameters of the run."""
        return self.manifest.parameters

    @property
    def inputs(self) -> RunInputs:
        """What the run is made of."""
        if self.manifest.inputs is None:
            raise RunError(
                f"{self.path} was not made of a recording",
                "name one: `docdepth.run(RECORDING, ...)`",
            )
        return self.manifest.inputs

    @property
    def recording_path(self) -> Path | None:
        """The recording; None if the run was not made of one."""
        return None if self.manifest.inputs is None else self.manifest.inputs.recording

    @property
    def is_saved(self) -> bool:
        """Whether run.yaml and its copy hold what is known."""
        text = self.manifest.text()
        return all(_content(path) == text for path in (self._manifest_path, self._copy_path))

    def save(self) -> None:
        """Write run.yaml, and a copy that is used where the first is damaged."""
        if self._saved is not None and not self._is_ours:
            move_aside(self._manifest_path)
        self._is_ours = True
        text = self._saved = self.manifest.text()
        for path in (self._manifest_path, self._copy_path):
            if _content(path) != text:
                write_atomically(path, text)

    def stage(self, name: str) -> StageEntry:
        """State of a stage in run.yaml; its key is None before it starts."""
        return self.manifest.stages.get(name, StageEntry())

    def set_stage(self, name: str, **state: Any) -> None:
        """Update and save the state of a stage."""
        self.manifest.stages[name] = StageEntry(**self.stage(name).model_dump() | state)
        self.save()

    def stage_inputs(self, stage: str) -> dict[str, object]:
        """What the results of a stage were made of; empty before it starts."""
        found = self.read_notes(_STAGE_INPUTS).get(stage, {})
        return dict(found) if isinstance(found, dict) else {}

    def set_stage_inputs(self, stage: str, inputs: Mapping[str, object]) -> None:
        """Note what the results of a stage are made of, to say later what has changed."""
        self.write_notes(_STAGE_INPUTS, {**self.read_notes(_STAGE_INPUTS), stage: inputs})

    def read_notes(self, name: str) -> dict[str, object]:
        """A JSON file of ``.docdepth``; empty where it is missing or damaged."""
        try:
            found = parse_json(read_text(self.state_dir / name))
        except (OSError, ValueError):
            return {}
        return found if isinstance(found, dict) else {}

    def write_notes(self, name: str, notes: Mapping[str, object]) -> None:
        """Write a JSON file of ``.docdepth``."""
        text = json.dumps(notes, indent=1).encode()
        self.write(self.state_dir / name, text, {})

    def frame_path(self, index: int) -> Path:
        return self.path / "frames" / f"frame_{index:06d}.ply"

    def classes_path(self, index: int) -> Path:
        return self.path / "classes" / f"frame_{index:06d}.npy"

    def check_has_frames(self) -> None:
        """Refuse a run whose frames were deleted when all was done."""
        if self.manifest.frames_deleted is not None:
            raise RunError(
                f"{self.path} keeps only its results, and this needs its frames",
                f"make them again: `docdepth.run(..., {str(self.path)!r}, keep='frames')`",
            )

    def frame(self, index: int) -> LidarFrame:
        """Frame number ``index``, with its classes if it is classified."""
        frame, classes = self.deskewed(index), self.classes_path(index)
        return with_classes(frame, classes) if classes.is_file() else frame

    def deskewed(self, index: int) -> LidarFrame:
        """Frame number ``index`` as odometry wrote it."""
        self.check_has_frames()
        path = self.frame_path(index)
        frame = read_frame(path, partial(read_sensors, self.sensors_path))
        checked(path, frame.points)
        return frame

    def classified_frame(self, index: int) -> tuple[LidarFrame, NDArray[np.uint16]]:
        """Frame number ``index`` and its classes."""
        record = self.frame(index)
        if record.classid is None:
            raise RunError(
                f"frame {index} of {self.path} has no classes",
                f"make them: `docdepth.run(..., {str(self.path)!r})`",
            )
        return record, record.classid

    def points(self, index: int) -> NDArray[np.float32]:
        """The points of frame number ``index``; faster than reading the whole frame."""
        self.check_has_frames()
        return checked(self.frame_path(index), read_points(self.frame_path(index)))

    def write_sensors(self, sensor_rig: SensorRig, key: dict[str, str]) -> None:
        """Write where the LiDARs or their lasers sit, once for all frames."""
        write_sensors(self.sensors_path, sensor_rig, self.writer(key))

    def write_frame(self, index: int, frame: LidarFrame, key: dict[str, str] | None = None) -> None:
        """Write frame ``index``; ``key`` tells what it is made of, a hash for each stage."""
        write_frame(self.frame_path(index), frame, self.writer(key or {}))

    def trajectory(self) -> Trajectory:
        """LiDAR poses, one a frame."""
        return read_whole_trajectory(self.trajectory_path)

    def calibration_folder(self, camera: str = "") -> Path:
        """Folder of a camera's calibration and trajectory; ``camera`` is one among several."""
        return self.path / "cameras" / camera if camera else self.path

    def calibration(self, name: str = "") -> tuple[Camera, NDArray[np.float64], list[float]]:
        """Camera, ``T_camera_lidar`` (4, 4) and distortion of the images."""
        remedy = f"it is written by: `docdepth.run(..., {str(self.path)!r})`"
        return read_calibration(self.calibration_folder(name), remedy)

    def depth_folder(self, camera: str | None) -> str:
        """The folder of a camera inside ``depth/``; empty for the first camera of a run."""
        folders = {name: entry.folder for name, entry in self.cameras.items()}
        if not folders and self.manifest.inputs is not None:
            raise RunError(
                f"{self.path} has no depth maps, since its run has no camera",
                f"name one: `docdepth.run(RECORDING, {str(self.path)!r}, camera=NAME)`",
            )
        if not folders:  # of the official release, or of arrays
            apart = (p.name for p in (self.path / "depth").glob("*") if p.is_dir())
            folders = {name: name for name in sorted(apart)} or {"camera": ""}
        recorded = [n for n in folders if n not in self.cameras or self.cameras[n].virtual is None]
        if camera is None and len(recorded) == 1:
            return folders[recorded[0]]
        if camera in folders:
            return folders[camera]
        known = ", ".join(folders)
        raise RunError(
            f"{self.path} has depth of {known}"
            + (f", not of {camera}" if camera else ": say `camera`")
        )

    def camera_in(self, folder: str) -> str:
        """Name of the camera whose maps lie in a folder of ``depth/``."""
        names = (name for name, entry in self.cameras.items() if entry.folder == folder)
        return next(names, folder)

    @property
    def cameras(self) -> dict[str, CameraEntry]:
        """The cameras of the run by name, as run.yaml holds them."""
        return self.manifest.cameras


def _content(path: Path) -> bytes | None:
    """None where there is no file that can be read."""
    try:
        return read_file(path)
    except OSError:
        return None


def stage_key(*parts: Any) -> str:
    """Short hash of all that a stage's result depends on."""
    text = json.dumps(parts, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:16]
