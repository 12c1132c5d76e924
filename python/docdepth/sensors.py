"""Where a sweep was measured from: the place of its LiDAR, or of each of several."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import NamedTuple

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
        Which LiDAR, or which laser of one, measured each point.
    T_lidar_sensor : ndarray of float64, shape (k, 4, 4)
        Takes points in the frame of each to that of the sweep.
    aside : ndarray of float64, shape (k,), optional
        Metres by which a laser sits to the left of the axis on which it turns; 0 if left out.
    head : ndarray of uint8, shape (k,), optional
        The LiDAR that each is a laser of, counted from 0; all are LiDARs of their own if left out.
    way : ndarray of float32, shape (N, 3), optional
        How far it had come since the sweep's stamp when it measured each point, of a deskewed
        sweep; nowhere if left out.

    Raises
    ------
    InputError
        A shape is wrong, a pose is not rigid, or an index has no pose.
    """

    index: NDArray[np.uint8]
    T_lidar_sensor: NDArray[np.float64]
    aside: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    head: NDArray[np.uint8] = field(default_factory=lambda: np.zeros(0, np.uint8))
    way: NDArray[np.float32] | None = None

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
        aside, head = np.asarray(self.aside, np.float64), np.asarray(self.head, np.uint8)
        aside = aside if aside.size else np.zeros(len(T))
        head = head if head.size else np.arange(len(T), dtype=np.uint8)
        if aside.shape != (len(T),) or head.shape != (len(T),):
            raise InputError(
                f"aside {aside.shape} and head {head.shape} must have shape ({len(T)},), "
                "a value a pose"
            )
        if self.way is not None and self.way.shape != (len(index), 3):
            raise InputError(f"way {self.way.shape} must have shape ({len(index)}, 3), one a point")
        object.__setattr__(self, "index", index.astype(np.uint8, copy=False))
        object.__setattr__(self, "T_lidar_sensor", T)
        object.__setattr__(self, "aside", aside)
        object.__setattr__(self, "head", head)

    @classmethod
    def at(cls, place: ArrayLike, points: int) -> Sensors:
        """One LiDAR that saw all points from ``place``, (3,) in metres in their frame."""
        T_lidar_sensor = np.eye(4)
        T_lidar_sensor[:3, 3] = place
        return cls(np.zeros(points, np.uint8), T_lidar_sensor[None])

    def driving(self, velocity: ArrayLike, late: NDArray[np.float32]) -> Sensors:
        """The same at a velocity, (3,) in metres a second; points are measured ``late`` seconds
        after the stamp.
        """
        return replace(self, way=late[:, None] * np.asarray(velocity, np.float32))

    def of(self, rows: NDArray[np.bool_] | slice) -> Sensors:
        """The same for some of the points."""
        way = None if self.way is None else self.way[rows]
        return replace(self, index=self.index[rows], way=way)

    def and_another(self, T_lidar_sensor: NDArray[np.float64], points: int) -> Sensors:
        """With the points of one more LiDAR after the others."""
        return Sensors(
            np.append(self.index, np.full(points, len(self.T_lidar_sensor), np.uint8)),
            np.append(self.T_lidar_sensor, T_lidar_sensor[None], axis=0),
            np.append(self.aside, 0.0),
            np.append(self.head, self.head.max() + 1),
        )


class View(NamedTuple):
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
    lasers: Sensors | None

    def starts(self) -> NDArray[np.float32] | None:
        """Where each line of sight begins, (N, 3) in its frame, if not at the origin."""
        if self.lasers is None:
            return None
        places = inverse(self.T_lidar_sensor) @ self.lasers.T_lidar_sensor
        starts = np.take(places[:, :3, 3].astype(np.float32), self.lasers.index, axis=0)
        # A laser beside the axis turns with the direction in which it looks.
        x, y = self.points[:, 0], self.points[:, 1]
        aside = np.take(self.lasers.aside.astype(np.float32), self.lasers.index)
        aside /= np.maximum(np.hypot(x, y), np.float32(1e-3))
        starts[:, 0] -= aside * y
        starts[:, 1] += aside * x
        way = self._way()
        return starts if way is None else starts + way

    def still(self) -> NDArray[np.float32]:
        """The points as if it had not moved on between them, (N, 3) in its frame."""
        way = self._way()
        return self.points if way is None else self.points - way

    def _way(self) -> NDArray[np.float32] | None:
        if self.lasers is None or self.lasers.way is None:
            return None
        R = self.T_lidar_sensor[:3, :3].astype(np.float32)
        if np.array_equal(R, np.eye(3)):
            return self.lasers.way
        # Not by BLAS, which would keep every core busy, waiting for the next product.
        return np.einsum("ij,jk->ik", self.lasers.way, R)


def views(points: NDArray[np.float32], sensors: Sensors | None) -> Iterator[View]:
    """What each LiDAR saw."""
    if sensors is None:
        yield View(points, np.eye(4), None)
        return
    if sensors.index.shape != points.shape[:1]:
        raise InputError(
            f"sensors.index {sensors.index.shape} must tell the LiDAR of each of "
            f"{len(points)} points"
        )
    for head in sorted(set(sensors.head.tolist())):
        lasers = sensors.T_lidar_sensor[sensors.head == head]
        T_lidar_sensor = lasers[0].copy()
        T_lidar_sensor[:3, 3] = lasers[:, :3, 3].mean(axis=0)
        T = inverse(T_lidar_sensor)
        aligned = np.array_equal(T[:3, :3], np.eye(3))
        exact = points if aligned else points.astype(np.float64) @ T[:3, :3].T
        seen = np.add(exact, T[:3, 3], dtype=np.float64).astype(np.float32)
        if (sensors.head != head).any():
            seen[sensors.head[sensors.index] != head] = np.nan
        at_origin = len(lasers) == 1 and sensors.way is None
        yield View(seen, T_lidar_sensor, None if at_origin else sensors)
