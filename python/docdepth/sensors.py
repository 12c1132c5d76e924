"""Where a sweep was measured from: the place of its LiDAR, or of each of several."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from docdepth.errors import InputError
from docdepth.trajectory import check_rigid, inverse


@dataclass(frozen=True)
class Sensors:
    """Where the points of a sweep were seen from, when that is not the origin of their frame.

    A LiDAR may give its points about its foot, and a vehicle may carry several. Points of all are
    given in one frame, the LiDAR frame of the sweep; but what a point was seen through, and which
    returns are neighbours, only the place tells from which it was seen (paper III-C2). Twenty
    centimetres aside, what lies beside an edge five metres away seems to lie two degrees off.

    Attributes
    ----------
    index : ndarray of uint8, shape (N,)
        Which LiDAR measured each point.
    T_lidar_sensor : ndarray of float64, shape (k, 4, 4)
        Takes points in the frame of each LiDAR to that of the sweep.

    Raises
    ------
    InputError
        A shape is wrong, a pose is not rigid, or an index has no pose.
    """

    index: NDArray[np.uint8]
    T_lidar_sensor: NDArray[np.float64]

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
        object.__setattr__(self, "index", index.astype(np.uint8, copy=False))
        object.__setattr__(self, "T_lidar_sensor", T)

    @classmethod
    def at(cls, place: ArrayLike, points: int) -> Sensors:
        """One LiDAR that saw all points from ``place``, (3,) in metres in their frame."""
        T_lidar_sensor = np.eye(4)
        T_lidar_sensor[:3, 3] = place
        return cls(np.zeros(points, np.uint8), T_lidar_sensor[None])

    def of(self, rows: NDArray[np.bool_] | slice) -> Sensors:
        """The same for some of the points."""
        return Sensors(self.index[rows], self.T_lidar_sensor)

    def moved(self, points: NDArray[np.float32], k: int) -> NDArray[np.float32]:
        """All points (N, 3) in the frame of LiDAR k."""
        T = inverse(self.T_lidar_sensor[k])
        return (points.astype(np.float64) @ T[:3, :3].T + T[:3, 3]).astype(np.float32)


def views(
    points: NDArray[np.float32], sensors: Sensors | None
) -> Iterator[tuple[NDArray[np.float32], NDArray[np.float64]]]:
    """What each LiDAR saw, in its own frame and with ``T_lidar_sensor``; NaN for others' points."""
    if sensors is None:
        yield points, np.eye(4)
        return
    if sensors.index.shape != points.shape[:1]:
        raise InputError(
            f"sensors.index {sensors.index.shape} must tell the LiDAR of each of "
            f"{len(points)} points"
        )
    for k, T_lidar_sensor in enumerate(sensors.T_lidar_sensor):
        seen = sensors.moved(points, k)
        if len(sensors.T_lidar_sensor) > 1:
            seen[sensors.index != k] = np.nan
        yield seen, T_lidar_sensor
