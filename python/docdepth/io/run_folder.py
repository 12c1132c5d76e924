"""The run folder: the results of each stage, in the layout of the official DOC-Depth release."""

from __future__ import annotations

import contextlib
import hashlib
import json
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from docdepth import __version__
from docdepth.config import Parameters, stored_parameters
from docdepth.errors import RunError
from docdepth.geometry.camera import Camera
from docdepth.geometry.sensor_rig import SensorRig
from docdepth.geometry.trajectory import Trajectory
from docdepth.io.atomic import write_atomically
from docdepth.io.calibration import EXTRINSICS, INTRINSICS, read_calibration, write_calibration
from docdepth.io.frames import (
    FrameRecord,
    read_frame,
    read_frame_key,
    read_points,
    read_trajectory,
    write_frame,
)

_SENSOR_NAMES = ("T_lidar_sensor", "lateral_offset", "lidar_id")  # arrays of sensors.npz
_OLD_SENSOR_NAMES = {"aside": "lateral_offset", "head": "lidar_id"}  # read for one release


class RunFolder:
    """The files of one run.

    ``run.yaml`` holds the inputs (``source``), the parameters and the state of each stage. All
    other files are results:

    - ``traj_odometry.ply``: LiDAR poses; ``frames/frame_NNNNNN.ply``: deskewed sweeps, with classes
      once they are classified; ``sensors.npz``: where the LiDARs or their lasers sit;
    - ``labels/NAME.label``: a SemanticKITTI label for each point of the input;
    - ``calib.json``, ``calib_lidar_ref_cam.txt``, ``traj_camera.ply``: the camera; of several
      cameras, and of virtual ones, in ``cameras/NAME/``;
    - ``depth/``: depth maps.

    A file has its final name only when it is whole.
    """

    def __init__(self, path: Path) -> None:
        self.path = Path(path)
        self.manifest: dict[str, Any] = {}
        if self._manifest_path.is_file():
            loaded = yaml.safe_load(self._manifest_path.read_text())
            if not isinstance(loaded, dict):
                raise RunError(f"{self._manifest_path} is damaged; delete the folder and run again")
            self.manifest = loaded

    @classmethod
    def create(cls, path: Path, source: dict[str, Any], parameters: Parameters) -> RunFolder:
        """Start a run, or continue the one in this folder if inputs and parameters are the same.

        Parameters
        ----------
        path : Path
        source : dict
            The inputs: dataset, camera, poses and more, plain YAML values; see
            :mod:`docdepth.pipeline.run_inputs`.
        parameters : Parameters

        Raises
        ------
        RunError
            The folder holds another run, or files that are not a run.
        """
        run = cls(path)
        wanted = {"source": source, "parameters": parameters.model_dump(mode="json")}
        if run.manifest:
            # In today's names: a release before this one may have started the run.
            run.manifest["parameters"] = run.parameters.model_dump(mode="json")
            for part, value in wanted.items():
                if run.manifest.get(part) != value:
                    difference = _difference(run.manifest.get(part), value)
                    raise RunError(
                        f"{path} holds another run: its {difference}; "
                        "choose another folder with -o, or delete this one"
                    )
        elif run.path.is_dir() and any(run.path.iterdir()):
            raise RunError(f"{path} is not empty and holds no run; choose another folder with -o")
        else:
            run.manifest = {"docdepth": __version__, **wanted, "stages": {}}
            run.save()
        return run

    @classmethod
    def open(cls, path: Path) -> RunFolder:
        """An existing run, or an official DOC-Depth folder without run.yaml.

        Raises
        ------
        RunError
            The folder holds neither.
        """
        run = cls(path)
        if not run.manifest:
            if not run.trajectory_path.is_file():
                raise RunError(
                    f"{path} holds no run; start one with: docdepth run DATASET -o {path}"
                )
            defaults = Parameters().model_dump(mode="json")
            run.manifest = {"source": {}, "parameters": defaults, "stages": {}}
        return run

    @property
    def _manifest_path(self) -> Path:
        return self.path / "run.yaml"

    @property
    def trajectory_path(self) -> Path:
        return self.path / "traj_odometry.ply"

    @property
    def parameters(self) -> Parameters:
        """The parameters of the run."""
        return stored_parameters(self.manifest.get("parameters"), self._manifest_path)

    def save(self) -> None:
        """Write run.yaml."""
        text = yaml.safe_dump(self.manifest, sort_keys=False)
        write_atomically(self._manifest_path, lambda stream: stream.write(text.encode()))

    def stage(self, name: str) -> dict[str, Any]:
        """State of a stage in run.yaml; empty before it starts."""
        return dict(self.manifest["stages"].get(name, {}))

    def set_stage(self, name: str, **state: Any) -> None:
        """Update and save the state of a stage."""
        self.manifest["stages"][name] = {**self.stage(name), **state}
        self.save()

    def frame_path(self, index: int) -> Path:
        return self.path / "frames" / f"frame_{index:06d}.ply"

    def frame(self, index: int) -> FrameRecord:
        """Frame number ``index``."""
        return read_frame(self.frame_path(index))

    def classified_frame(self, index: int) -> tuple[FrameRecord, NDArray[np.uint16]]:
        """Frame number ``index`` and its classes.

        Raises
        ------
        RunError
            The frame has no classes.
        """
        record = self.frame(index)
        if record.classid is None:
            raise RunError(
                f"frame {index} of {self.path} has no classes; run: docdepth classify {self.path}"
            )
        return record, record.classid

    def points(self, index: int) -> NDArray[np.float32]:
        """The points of frame number ``index``; faster than reading the whole frame."""
        return read_points(self.frame_path(index))

    def sensor_rig(self, frame: FrameRecord) -> SensorRig | None:
        """Where the rays of a frame begin; None where they begin at the origin."""
        return None if frame.sensor is None else SensorRig(frame.sensor, **self._sensors)

    def write_sensors(self, sensor_rig: SensorRig) -> None:
        """Write where the LiDARs or their lasers sit, once for all frames."""
        kept = {name: getattr(sensor_rig, name) for name in _SENSOR_NAMES}
        write_atomically(self._sensors_path, lambda stream: np.savez(stream, **kept))
        self.__dict__.pop("_sensors", None)  # the cache of what was read before

    @property
    def _sensors_path(self) -> Path:
        return self.path / "sensors.npz"

    @cached_property
    def _sensors(self) -> dict[str, NDArray[Any]]:
        try:
            with np.load(self._sensors_path) as kept:
                return {_OLD_SENSOR_NAMES.get(name, name): kept[name] for name in kept}
        except FileNotFoundError:
            raise RunError(
                f"{self._sensors_path} is missing; run again: docdepth odometry {self.path}"
            ) from None

    def frame_key(self, index: int) -> dict[str, str]:
        """Hash of the parameters that made frame ``index``, by stage; empty if it is missing."""
        return read_frame_key(self.frame_path(index))

    def write_frame(self, index: int, frame: FrameRecord) -> None:
        write_frame(self.frame_path(index), frame)

    def trajectory(self) -> Trajectory:
        """LiDAR poses, one a frame."""
        trajectory, indices = read_trajectory(self.trajectory_path)
        if not np.array_equal(indices, np.arange(len(indices))):
            raise RunError(
                f"{self.trajectory_path}: its frames are not numbered 0, 1, 2, ... without gaps"
            )
        return trajectory

    def calibration_folder(self, camera: str = "") -> Path:
        """Folder of a camera's calibration and trajectory; ``camera`` is one among several."""
        return self.path / "cameras" / camera if camera else self.path

    def write_calibration(
        self,
        camera: Camera,
        T_camera_lidar: NDArray[np.float64],
        distortion: Sequence[float] = (0.0,) * 5,
        name: str = "",
    ) -> None:
        """Write the calibration of a camera; ``name`` it if there are several."""
        write_calibration(self.calibration_folder(name), camera, T_camera_lidar, distortion)

    def forget_calibration(self, name: str) -> None:
        """Delete what :meth:`write_calibration` wrote, and the camera's trajectory."""
        folder = self.calibration_folder(name)
        for file in (INTRINSICS, EXTRINSICS, "traj_camera.ply"):
            (folder / file).unlink(missing_ok=True)
        if name:
            self.clear(f"cameras/{name}")

    def calibration(self, name: str = "") -> tuple[Camera, NDArray[np.float64], list[float]]:
        """Camera, ``T_camera_lidar`` (4, 4) and distortion of the images.

        Raises
        ------
        CalibrationError
            A calibration file is missing or damaged.
        """
        remedy = f"it is written by: docdepth render {self.path}"
        return read_calibration(self.calibration_folder(name), remedy)

    def depth_folder(self, camera: str | None = None) -> str:
        """The folder of a camera inside ``depth/``; empty if the run has only one camera.

        Raises
        ------
        RunError
            There is no such camera, or there are several and none is named.
        """
        apart = sorted(p.name for p in (self.path / "depth").glob("*") if p.is_dir())
        stage = self.stage("render")
        folders, cameras = stage.get("folders", [""]), stage.get("cameras", [])
        if camera is None and len(folders) == 1:
            return str(folders[0])
        if camera in apart:
            return camera
        if folders == [""] and camera in cameras:
            return ""
        known = ", ".join(dict.fromkeys([*cameras, *apart])) or "no camera"
        raise RunError(
            f"{self.path} has depth of {known}"
            + (f", not of {camera}" if camera else ": say --camera")
        )

    def clear(self, folder: str) -> None:
        """Delete the files of an output folder."""
        for path in sorted((self.path / folder).glob("*")):
            with contextlib.suppress(IsADirectoryError, PermissionError):
                path.unlink()
        with contextlib.suppress(OSError):
            (self.path / folder).rmdir()


def stage_key(*parts: Any) -> str:
    """Short hash of all that a stage's result depends on."""
    text = json.dumps(parts, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _difference(have: Any, want: Any, path: str = "") -> str:
    if isinstance(have, dict) and isinstance(want, dict):
        for key in {**have, **want}:
            if have.get(key) != want.get(key):
                return _difference(have.get(key), want.get(key), f"{path}.{key}" if path else key)
    return f"{path} is {have!r}, not {want!r}"
