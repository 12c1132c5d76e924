"""The run folder of one trial; it reads the sweeps of another run."""

from __future__ import annotations

import json
import shutil
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth import __version__
from docdepth.config import Parameters
from docdepth.geometry.sensor_rig import SensorRig
from docdepth.geometry.trajectory import Trajectory
from docdepth.io.atomic import npz_bytes, write_atomically
from docdepth.io.frames import FrameRecord
from docdepth.io.run_folder import RunFolder

_STORED = ("classid", "votes_static", "votes_dynamic")


class TrialFolder(RunFolder):
    """A run folder with its own classes and votes, and the trajectory and sweeps of another run.

    Parameters
    ----------
    path : Path
        Folder of the trial; emptied unless ``key`` made it.
    source : Path
        The run whose sweeps are read.
    parameters : Parameters
    key : str
        Hash of everything that the results depend on.
    """

    def __init__(self, path: Path, source: Path, parameters: Parameters, key: str) -> None:
        super().__init__(path)
        self._source = RunFolder.open(source)
        if self.manifest.get("trial") != key:
            shutil.rmtree(path, ignore_errors=True)
            stages = {"odometry": self._source.stage("odometry")}
            self.manifest = {
                "docdepth": __version__,
                "trial": key,
                "source": self._source.manifest["source"],
                "parameters": parameters.model_dump(mode="json"),
                "cameras": {},
                "stages": stages,
            }
            self.save()

    def trajectory(self) -> Trajectory:
        """LiDAR trajectory of the run."""
        return self._source.trajectory()

    def sensor_rig(self, frame: FrameRecord) -> SensorRig | None:
        """Laser positions of a sweep of the run."""
        return self._source.sensor_rig(frame)

    def points(self, index: int) -> NDArray[np.float32]:
        """Points of a sweep of the run, float32 (N, 3), LiDAR frame [m]."""
        return self._source.points(index)

    def frame(self, index: int) -> FrameRecord:
        """A sweep of the run with the classes and votes of the trial, if it has them."""
        record = self._source.frame(index)
        stored = self._stored(index)
        return replace(
            record,
            classid=stored.get("classid"),
            votes_static=stored.get("votes_static"),
            votes_dynamic=stored.get("votes_dynamic"),
        )

    def frame_key(self, index: int) -> dict[str, str]:
        """Hash of the parameters that made the classes of a sweep, by stage."""
        return _key(self._stored(index))

    def write_frame(
        self, index: int, frame: FrameRecord, key: dict[str, str] | None = None
    ) -> None:
        """Store the classes and votes of a sweep; its points stay in the run."""
        arrays = {name: getattr(frame, name) for name in _STORED}
        arrays = {name: value for name, value in arrays.items() if value is not None}
        content = npz_bytes(key=np.array(json.dumps(key or {})), **arrays)
        write_atomically(self._path(index), lambda out: out.write(content))

    def _path(self, index: int) -> Path:
        return self.path / "frames" / f"{index:06d}.npz"

    def _stored(self, index: int) -> dict[str, Any]:
        try:
            with np.load(self._path(index)) as stored:
                return dict(stored)
        except FileNotFoundError:
            return {}
        except (OSError, EOFError, ValueError, zipfile.BadZipFile):
            return {}  # damaged: made again


def _key(stored: dict[str, Any]) -> dict[str, str]:
    return dict(json.loads(str(stored["key"]))) if stored else {}
