"""The exact drive as a recording that can be spoilt: its poses, points and times."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from docdepth.datasets import CameraStream, Sweep
from docdepth.geometry.camera import Camera
from docdepth.geometry.se3 import inverse, poses_from, rotation_exp
from exact_drive import Drive

COUNT = 10
T_CAMERA_LIDAR = poses_from(
    [np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])], [[0.05, -0.1, -0.2]]
)[0]
_DRIVE = Drive(COUNT)
_MEASURED: dict[int, Sweep] = {}


def right_poses() -> np.ndarray:
    """``T_world_lidar`` in the frame of the first sweep; the vehicle turns."""
    return np.asarray(inverse(_DRIVE.exact[0]) @ _DRIVE.exact)


@dataclass
class Recorded:
    """The drive, after ``change`` was made to each of its sweeps."""

    poses: np.ndarray | None = field(default_factory=right_poses)
    change: Callable[[Sweep, int], Sweep] = lambda sweep, index: sweep
    cameras: dict[str, CameraStream] = field(default_factory=dict)
    name: str = "exact"
    path: Path = Path("exact")
    times: np.ndarray = field(default_factory=lambda: _DRIVE.times)

    @property
    def lidars(self) -> dict:
        return {}

    def __len__(self) -> int:
        return COUNT

    def sweep(self, index: int) -> Sweep:
        index = range(COUNT)[index]
        if index not in _MEASURED:
            _MEASURED[index] = _DRIVE.sweep(index)
        return self.change(_MEASURED[index], index)

    def sweep_files(self, index: int) -> list[Path]:
        return []

    def labels(self, index: int) -> None:
        return None


def moved(T: np.ndarray) -> Callable[[Sweep, int], Sweep]:
    """All points in another frame, rows without a return too."""

    def change(sweep: Sweep, _: int) -> Sweep:
        points = sweep.points.astype(np.float64) @ T[:3, :3].T + T[:3, 3]
        return replace(sweep, points=points.astype(np.float32))

    return change


def turned(degrees: tuple[float, float, float]) -> np.ndarray:
    return poses_from([rotation_exp(np.radians(degrees))], [[0, 0, 0]])[0]


def camera(late_ns: int = 0, **changes: Any) -> dict[str, CameraStream]:
    """A camera without images that looks ahead and fires with the sweeps."""
    K = np.array([[200.0, 0, 160], [0, 200, 100], [0, 0, 1]])
    stream = CameraStream(
        "front", Camera(K, 320, 200), T_CAMERA_LIDAR, _DRIVE.times + late_ns,
        [f"{k:06d}" for k in range(COUNT)],
    )  # fmt: skip
    return {"front": replace(stream, **changes)}
