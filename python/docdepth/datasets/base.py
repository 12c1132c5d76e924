"""What every recording looks like to the pipeline.

A dataset gives sweeps and cameras one at a time and keeps none of them. Arrays come as they are
on disk: checking for points that cannot be used is the job of :func:`usable_points`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from docdepth.errors import CalibrationError
from docdepth.geometry.camera import Camera
from docdepth.geometry.sensor_rig import SensorRig


@dataclass(frozen=True)
class Sweep:
    """One turn of the LiDAR.

    Attributes
    ----------
    points : ndarray of float32, shape (N, 3)
        LiDAR frame (x forward, y left, z up), metres, every row of the input.
    name : str
        Stem of the input file; labels are written under it.
    time : int
        Nanoseconds; the pose of the sweep holds at this time.
    intensity : ndarray of float32, shape (N,), optional
    relative_time : ndarray of float32, shape (N,), optional
        When each point was measured, as a share of the sweep's duration before (negative) or
        after (positive) ``time``. None where nobody knows.
    motion_compensated : bool
        The motion of the LiDAR is removed already: points are where they were seen from its place
        at ``time``. What moves is where it was when it was measured.
    sensor_rig : Sensors, optional
        Where the sweep was measured from; None where its LiDAR looks from the origin.
    """

    points: NDArray[np.float32]
    name: str
    time: int
    intensity: NDArray[np.float32] | None = None
    relative_time: NDArray[np.float32] | None = None
    sensor_rig: SensorRig | None = None
    motion_compensated: bool = False


@dataclass(frozen=True)
class CameraStream:
    """One camera of the rig: calibration, time of each image, and the images where there are any.

    Attributes
    ----------
    name : str
    camera : Camera
    T_camera_lidar : ndarray of float64, shape (4, 4)
        Takes LiDAR points to the camera.
    times : ndarray of int64, shape (m,)
        Nanoseconds, on the clock of the sweeps.
    names : list of str
        Stems of the images; depth maps are written under them.
    images : list of Path, optional
        Empty when the images are not on disk.
    distortion : ndarray of float64, shape (4,), (5,), (8,), (12,) or (14,), optional
        Of the images, as OpenCV has it: k1 k2 p1 p2 [k3 ...]. Depth maps are those of the
        rectified camera with the same K, ``cv2.undistort(image, K, distortion)``.
    """

    name: str
    camera: Camera
    T_camera_lidar: NDArray[np.float64]
    times: NDArray[np.int64]
    names: list[str]
    images: list[Path] = field(default_factory=list)
    distortion: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        d, lengths = self.distortion, [(n,) for n in (4, 5, 8, 12, 14)]
        if d is not None and (d.shape not in lengths or not np.isfinite(d).all()):
            raise CalibrationError(
                f"{self.name}: distortion must be 4, 5, 8, 12 or 14 numbers k1 k2 p1 p2 [k3 ...], "
                f"got {d.tolist()}"
            )


@runtime_checkable
class Dataset(Protocol):
    """A recorded drive. Frames are read when asked for, never all at once."""

    name: str
    path: Path
    times: NDArray[np.int64]
    """Nanoseconds of each sweep, shape (n,), strictly increasing."""
    poses: NDArray[np.float64] | None
    """``T_world_lidar`` (n, 4, 4) that came with the recording, else None."""
    cameras: dict[str, CameraStream]

    def __len__(self) -> int: ...

    def sweep(self, index: int) -> Sweep: ...

    def labels(self, index: int) -> NDArray[np.uint32] | None:
        """SemanticKITTI labels of every input point (low 16 bits class, high instance), or None."""
        ...
