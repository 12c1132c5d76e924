"""Where a sweep was measured from: the place of its LiDAR, or of each of several."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from docdepth.errors import InputError
from docdepth.geometry.se3 import check_rigid, inverse


@dataclass(frozen=True)
class SensorRig:
    """Where the points of a sweep were seen from, when that is not the origin of their frame.

    A LiDAR may give its points about its foot, and a vehicle may carry several. Points of all are
    given in one frame, the LiDAR frame of the sweep; but what a point was seen through, and which
    returns are neighbours, only the place tells from which it was seen (paper III-C2). Twenty
    centimetres aside, what lies beside an edge five metres away seems to lie two degrees off.

    Attributes
    ----------
    index : ndarray of uint8, shape (N,)
        Which LiDAR, or which laser of one, measured each point.
    T_lidar_sensor : ndarray of float64, shape (k, 4, 4)
        Takes points in the frame of each to that of the sweep.
    lateral_offset : ndarray of float64, shape (k,), optional
        Metres by which a laser sits to the left of the axis on which it turns; 0 if left out.
    lidar_id : ndarray of uint8, shape (k,), optional
        The LiDAR that each is a laser of, counted from 0; all are LiDARs of their own if left out.
    ego_displacement : ndarray of float32, shape (N, 3), optional
        How far it had come since the sweep's stamp when it measured each point, of a deskewed
        sweep; nowhere if left out.

    Raises
    ------
    InputError
        A shape is wrong, a pose is not rigid, or an index has no pose.
    """

    index: NDArray[np.uint8]
    T_lidar_sensor: NDArray[np.float64]
    lateral_offset: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    lidar_id: NDArray[np.uint8] = field(default_factory=lambda: np.zeros(0, np.uint8))
    ego_displacement: NDArray[np.float32] | None = None

    def __post_init__(self) -> None:
        index, T = np.asarray(self.index), np.asarray(self.T_lidar_sensor, np.float64)
        if index.ndim != 1 or T.ndim != 3 or T.shape[1:] != (4, 4):
            raise InputError(
                f"index {index.shape} and T_lidar_sensor {T.shape} must have shapes (N,) and "
                "(k, 4, 4)"
            )
        if index.max(initial=0) >= len(T):
            raise InputError(
                f"a point is of LiDAR {index.max()}, but there are {len(T)} poses of LiDARs"
            )
        check_rigid(T)
        lateral_offset, lidar_id = (
            np.asarray(self.lateral_offset, np.float64),
            np.asarray(self.lidar_id, np.uint8),
        )
        lateral_offset = lateral_offset if lateral_offset.size else np.zeros(len(T))
        lidar_id = lidar_id if lidar_id.size else np.arange(len(T), dtype=np.uint8)
        if lateral_offset.shape != (len(T),) or lidar_id.shape != (len(T),):
            raise InputError(
                f"lateral_offset {lateral_offset.shape} and lidar_id {lidar_id.shape} must have "
                f"shape ({len(T)},), a value a pose"
            )
        if self.ego_displacement is not None and self.ego_displacement.shape != (len(index), 3):
            raise InputError(
                f"ego_displacement {self.ego_displacement.shape} must have shape "
                f"({len(index)}, 3), one a point"
            )
        object.__setattr__(self, "index", index.astype(np.uint8, copy=False))
        object.__setattr__(self, "T_lidar_sensor", T)
        object.__setattr__(self, "lateral_offset", lateral_offset)
        object.__setattr__(self, "lidar_id", lidar_id)

    @classmethod
    def single(cls, place: ArrayLike, points: int) -> SensorRig:
        """One LiDAR that saw all points from ``place``, (3,) in metres in their frame."""
        T_lidar_sensor = np.eye(4)
        T_lidar_sensor[:3, 3] = place
        return cls(np.zeros(points, np.uint8), T_lidar_sensor[None])

    def with_ego_motion(self, velocity: ArrayLike, time_offset: NDArray[np.float32]) -> SensorRig:
        """The same at a velocity, (3,) in m/s; ``time_offset`` are seconds after the stamp."""
        return replace(
            self, ego_displacement=time_offset[:, None] * np.asarray(velocity, np.float32)
        )

    def select(self, rows: NDArray[np.bool_] | slice) -> SensorRig:
        """The same for some of the points."""
        ego_displacement = None if self.ego_displacement is None else self.ego_displacement[rows]
        return replace(self, index=self.index[rows], ego_displacement=ego_displacement)

    def with_lidar(self, T_lidar_sensor: NDArray[np.float64], points: int) -> SensorRig:
        """With the points of one more LiDAR after the others."""
        return SensorRig(
            np.append(self.index, np.full(points, len(self.T_lidar_sensor), np.uint8)),
            np.append(self.T_lidar_sensor, T_lidar_sensor[None], axis=0),
            np.append(self.lateral_offset, 0.0),
            np.append(self.lidar_id, self.lidar_id.max() + 1),
        )


class LidarView(NamedTuple):
    """What one LiDAR saw.

    Attributes
    ----------
    points : ndarray of float32, shape (N, 3)
        All points in its frame, in the middle of its lasers; NaN for those of other LiDARs.
    T_lidar_sensor : ndarray of float64, shape (4, 4)
    lasers : Sensors or None
        Where its lasers sit, and how it moved on; None where all lines of sight begin at the
        origin.
    """

    points: NDArray[np.float32]
    T_lidar_sensor: NDArray[np.float64]
    lasers: SensorRig | None

    def ray_origins(self) -> NDArray[np.float32] | None:
        """Where each line of sight begins, (N, 3) in its frame, if not at the origin."""
        if self.lasers is None:
            return None
        places = inverse(self.T_lidar_sensor) @ self.lasers.T_lidar_sensor
        ray_origins = np.take(places[:, :3, 3].astype(np.float32), self.lasers.index, axis=0)
        # A laser beside the axis turns with the direction in which it looks.
        x, y = self.points[:, 0], self.points[:, 1]
        lateral_offset = np.take(self.lasers.lateral_offset.astype(np.float32), self.lasers.index)
        lateral_offset /= np.maximum(np.hypot(x, y), np.float32(1e-3))
        ray_origins[:, 0] -= lateral_offset * y
        ray_origins[:, 1] += lateral_offset * x
        ego_displacement = self._displacement()
        return ray_origins if ego_displacement is None else ray_origins + ego_displacement

    def motion_corrected(self) -> NDArray[np.float32]:
        """The points as if it had not moved on between them, (N, 3) in its frame."""
        ego_displacement = self._displacement()
        return self.points if ego_displacement is None else self.points - ego_displacement

    def _displacement(self) -> NDArray[np.float32] | None:
        if self.lasers is None or self.lasers.ego_displacement is None:
            return None
        R = self.T_lidar_sensor[:3, :3].astype(np.float32)
        if np.array_equal(R, np.eye(3)):
            return self.lasers.ego_displacement
        # Not by BLAS, which would keep every core busy, waiting for the next product.
        return np.einsum("ij,jk->ik", self.lasers.ego_displacement, R)


def lidar_views(points: NDArray[np.float32], sensor_rig: SensorRig | None) -> Iterator[LidarView]:
    """What each LiDAR saw."""
    if sensor_rig is None:
        yield LidarView(points, np.eye(4), None)
        return
    if sensor_rig.index.shape != points.shape[:1]:
        raise InputError(
            f"sensor_rig.index {sensor_rig.index.shape} must tell the LiDAR of each of "
            f"{len(points)} points"
        )
    for lidar_id in sorted(set(sensor_rig.lidar_id.tolist())):
        lasers = sensor_rig.T_lidar_sensor[sensor_rig.lidar_id == lidar_id]
        T_lidar_sensor = lasers[0].copy()
        T_lidar_sensor[:3, 3] = lasers[:, :3, 3].mean(axis=0)
        T = inverse(T_lidar_sensor)
        aligned = np.array_equal(T[:3, :3], np.eye(3))
        exact = points if aligned else points.astype(np.float64) @ T[:3, :3].T
        seen = np.add(exact, T[:3, 3], dtype=np.float64).astype(np.float32)
        if (sensor_rig.lidar_id != lidar_id).any():
            seen[sensor_rig.lidar_id[sensor_rig.index] != lidar_id] = np.nan
        at_origin = len(lasers) == 1 and sensor_rig.ego_displacement is None
        yield LidarView(seen, T_lidar_sensor, None if at_origin else sensor_rig)
