"""A deskewed sweep, as odometry hands it on, and where its rays begin."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from docdepth.errors import InputError
from docdepth.geometry.points import GROUND, STATIC, ShortRepr, float_array
from docdepth.geometry.se3 import check_rigid, inverse, rigid

_MOST_SENSORS = 256  # index is uint8
_AXIS_RANGE = 1e-3  # metres from the axis; nearer points have no direction


@dataclass(frozen=True, eq=False, repr=False)
class SensorRig(ShortRepr):
    """The LiDARs of a sweep, or the lasers of one, and which of them measured each point.

    The points of a sweep are given in one frame, whose origin need not be where the rays begin.
    KITTI's point origin lies 12 to 21 cm below the lasers; docdepth detects this and corrects each
    laser's ray origin. A vehicle may carry several LiDARs. Voting and rendering ask which free
    space a ray crossed, so they need its true origin: seen from 20 cm beside it, a point behind an
    edge at 5 m shifts by two degrees.

    Attributes
    ----------
    index : ndarray of uint8, shape (N,)
        Which of the k sensors, LiDARs or lasers, measured each point.
    T_lidar_sensor : ndarray of float64, shape (k, 4, 4)
        Takes points from the frame of each sensor to the LiDAR frame of the sweep.
    lateral_offset : ndarray of float64, shape (k,), optional
        Distance of a laser to the left of the axis about which it turns, metres; 0 if left out.
    lidar_id : ndarray of uint8, shape (k,), optional
        The LiDAR to which each laser belongs, counted from 0. If left out, each sensor is a LiDAR
        of its own.
    ego_displacement : ndarray of float32, shape (N, 3), optional
        Of a deskewed sweep: how far the vehicle has moved from the sweep's stamp to the measurement
        of each point, LiDAR frame, metres; 0 if left out.
    beam_width : float
        Full angle of a beam, radians; 0 if beams count as lines. Wide beams return from things that
        they only touch, so depth maps take a part of it off their edges.

    Raises
    ------
    InputError
        A shape or dtype is wrong, a pose is not rigid, or an index has no pose.
    """

    index: NDArray[np.uint8]
    T_lidar_sensor: NDArray[np.float64]
    lateral_offset: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    lidar_id: NDArray[np.uint8] = field(default_factory=lambda: np.zeros(0, np.uint8))
    ego_displacement: NDArray[np.float32] | None = None
    beam_width: float = 0.0

    def __post_init__(self) -> None:
        index, T = np.asarray(self.index), float_array("T_lidar_sensor", self.T_lidar_sensor)
        if index.ndim != 1 or T.ndim != 3 or T.shape[1:] != (4, 4):
            raise InputError(
                f"index {index.shape} and T_lidar_sensor {T.shape} must have shapes (N,) and "
                "(k, 4, 4)"
            )
        if index.size and index.dtype.kind not in "iu":
            raise InputError(f"index must be integers, one a point; got {index.dtype}")
        for number in (index.min(initial=0), index.max(initial=0)):
            if not 0 <= number < min(len(T), _MOST_SENSORS):
                raise InputError(
                    f"a point is of sensor {number}, but there are poses of {len(T)} sensors "
                    f"(at most {_MOST_SENSORS})"
                )
        check_rigid(T)
        lateral_offset = np.asarray(self.lateral_offset, np.float64)
        lateral_offset = lateral_offset if lateral_offset.size else np.zeros(len(T))
        lidar_id = np.asarray(self.lidar_id, np.uint8)
        lidar_id = lidar_id if lidar_id.size else np.arange(len(T), dtype=np.uint8)
        if lateral_offset.shape != (len(T),) or lidar_id.shape != (len(T),):
            raise InputError(
                f"lateral_offset {lateral_offset.shape} and lidar_id {lidar_id.shape} must have "
                f"shape ({len(T)},), a value a pose"
            )
        if self.ego_displacement is not None:
            displacement = np.asarray(self.ego_displacement, np.float32)
            if displacement.shape != (len(index), 3):
                raise InputError(
                    f"ego_displacement {displacement.shape} must have shape ({len(index)}, 3), "
                    "one a point"
                )
            object.__setattr__(self, "ego_displacement", displacement)
        object.__setattr__(self, "index", index.astype(np.uint8, copy=False))
        object.__setattr__(self, "T_lidar_sensor", T)
        object.__setattr__(self, "lateral_offset", lateral_offset)
        object.__setattr__(self, "lidar_id", lidar_id)
        object.__setattr__(self, "beam_width", float(self.beam_width))

    @classmethod
    def single(cls, place: ArrayLike, points: int) -> SensorRig:
        """One LiDAR at ``place``, (3,) in metres in the frame of its points."""
        T_lidar_sensor = rigid(np.eye(3), float_array("place", place))
        return cls(np.zeros(points, np.uint8), T_lidar_sensor[None])

    def with_ego_motion(self, velocity: ArrayLike, time_offset: NDArray[np.float32]) -> SensorRig:
        """The rig of a vehicle that drives during the sweep.

        Parameters
        ----------
        velocity : array_like, shape (3,)
            LiDAR frame, metres a second.
        time_offset : ndarray of float32, shape (N,)
            Seconds from the sweep's stamp to the measurement of each point.
        """
        moved = np.empty((len(time_offset), 3), np.float32)
        for axis, speed in enumerate(np.asarray(velocity, np.float32)):
            np.multiply(time_offset, speed, out=moved[:, axis])
        return replace(self, ego_displacement=moved)

    def select(self, rows: NDArray[np.bool_] | slice) -> SensorRig:
        """The rig of some of the points."""
        moved = self.ego_displacement
        return replace(
            self,
            index=self.index[rows],
            ego_displacement=None if moved is None else moved[rows],
        )

    def with_lidar(self, T_lidar_sensor: NDArray[np.float64], points: int) -> SensorRig:
        """The rig with one more LiDAR, whose points come after the others."""
        return SensorRig(
            np.append(self.index, np.full(points, len(self.T_lidar_sensor), np.uint8)),
            np.append(self.T_lidar_sensor, T_lidar_sensor[None], axis=0),
            np.append(self.lateral_offset, 0.0),
            np.append(self.lidar_id, self.lidar_id.max() + 1),
            beam_width=self.beam_width,
        )


class LidarView(NamedTuple):
    """The points that one LiDAR measured, in its own frame."""

    # (N, 3): LiDAR's own frame, whose origin is the centre of its lasers, metres. Rows of points of
    # other LiDARs are NaN
    points: NDArray[np.float32]
    # (4, 4): takes points from its own frame to the LiDAR frame of the sweep
    T_lidar_sensor: NDArray[np.float64]
    # places of its lasers and displacement of the vehicle. None if all rays begin at the origin
    lasers: SensorRig | None

    def ray_origins(self) -> NDArray[np.float32] | None:
        """Origin of each ray, (N, 3) in its own frame, metres; None if at the frame's origin."""
        if self.lasers is None:
            return None
        places = inverse(self.T_lidar_sensor) @ self.lasers.T_lidar_sensor
        ray_origins = np.take(places[:, :3, 3].astype(np.float32), self.lasers.index, axis=0)
        # A laser beside the axis turns with its ray.
        x, y = self.points[:, 0], self.points[:, 1]
        lateral_offset = np.take(self.lasers.lateral_offset.astype(np.float32), self.lasers.index)
        lateral_offset /= np.maximum(np.hypot(x, y), np.float32(_AXIS_RANGE))
        ray_origins[:, 0] -= lateral_offset * y
        ray_origins[:, 1] += lateral_offset * x
        ego_displacement = self._displacement()
        return ray_origins if ego_displacement is None else ray_origins + ego_displacement

    def motion_corrected(self) -> NDArray[np.float32]:
        """The points without the motion of the vehicle during the sweep, (N, 3) in its frame."""
        ego_displacement = self._displacement()
        return self.points if ego_displacement is None else self.points - ego_displacement

    def _displacement(self) -> NDArray[np.float32] | None:
        if self.lasers is None or self.lasers.ego_displacement is None:
            return None
        R = self.T_lidar_sensor[:3, :3].astype(np.float32)
        if np.array_equal(R, np.eye(3)):
            return self.lasers.ego_displacement
        # Not by BLAS, whose threads would keep every core busy waiting.
        return np.einsum("ij,jk->ik", self.lasers.ego_displacement, R)


def lidar_views(points: NDArray[np.float32], sensor_rig: SensorRig | None) -> Iterator[LidarView]:
    """Split a sweep into the views of its LiDARs.

    Parameters
    ----------
    points : ndarray of float32, shape (N, 3)
        LiDAR frame of the sweep, metres.

    Yields
    ------
    LidarView
        One for each LiDAR, in order of ``lidar_id``.
    """
    if sensor_rig is None:
        yield LidarView(points, np.eye(4), None)
        return
    if sensor_rig.index.shape != points.shape[:1]:
        raise InputError(
            f"sensor_rig.index {sensor_rig.index.shape} must name the sensor of each of "
            f"{len(points)} points"
        )
    for lidar_id in sorted(set(sensor_rig.lidar_id.tolist())):
        lasers = sensor_rig.T_lidar_sensor[sensor_rig.lidar_id == lidar_id]
        T_lidar_sensor = lasers[0].copy()
        T_lidar_sensor[:3, 3] = lasers[:, :3, 3].mean(axis=0)
        T = inverse(T_lidar_sensor)
        aligned = np.array_equal(T[:3, :3], np.eye(3))
        exact = points if aligned else points.astype(np.float64) @ T[:3, :3].T
        seen = np.empty(points.shape, np.float32)
        for axis in range(3):  # faster than by rows
            seen[:, axis] = np.add(exact[:, axis], T[axis, 3], dtype=np.float64)
        if (sensor_rig.lidar_id != lidar_id).any():
            seen[sensor_rig.lidar_id[sensor_rig.index] != lidar_id] = np.nan
        at_origin = len(lasers) == 1 and sensor_rig.ego_displacement is None
        yield LidarView(seen, T_lidar_sensor, None if at_origin else sensor_rig)


@dataclass(frozen=True, eq=False, repr=False)
class LidarFrame(ShortRepr):
    """One sweep, deskewed to its stamp.

    Attributes
    ----------
    points : ndarray of float32, shape (N, 3)
        LiDAR frame at the sweep's stamp, metres. Those of a run folder are usable returns only.
    index : ndarray of uint32, shape (N,)
        Row of each point in the input sweep.
    name : str
        Stem of the input file.
    input_points : int
        Rows of the input sweep.
    time_offset : ndarray of float32, shape (N,), optional
        When each point was measured, seconds after the sweep's stamp.
    sensor_rig : SensorRig, optional
        Where each point was measured from; the origin if absent.
    classid : ndarray of uint16, shape (N,), optional
        Below 50 ground, 50 to 99 static, 100 and above dynamic.
    instance : ndarray of uint16, shape (N,), optional
        Track of each dynamic point, 0 if it is of none.
    votes_static, votes_dynamic : ndarray of uint16, shape (N,), optional
    """

    points: NDArray[np.float32]
    index: NDArray[np.uint32]
    name: str
    input_points: int
    time_offset: NDArray[np.float32] | None = None
    sensor_rig: SensorRig | None = None
    classid: NDArray[np.uint16] | None = None
    instance: NDArray[np.uint16] | None = None
    votes_static: NDArray[np.uint16] | None = None
    votes_dynamic: NDArray[np.uint16] | None = None

    def __len__(self) -> int:
        return len(self.points)

    @property
    def classes(self) -> NDArray[np.uint16]:
        """``classid``, which must be there."""
        if self.classid is None:
            raise InputError(f"sweep {self.name} has no classes")
        return self.classid

    @property
    def ground(self) -> NDArray[np.bool_]:
        """Which points are ground, by :attr:`classes`, (N,)."""
        return np.asarray(self.classes < STATIC)

    def with_ground(self, ground: NDArray[np.bool_]) -> LidarFrame:
        """The frame with the classes ground and static alone."""
        classid = np.where(ground, np.uint16(GROUND), np.uint16(STATIC))
        return replace(self, classid=classid, instance=None)

    def select(self, rows: NDArray[np.bool_]) -> LidarFrame:
        """The frame with some of its points."""
        names = [name for name, values in vars(self).items() if isinstance(values, np.ndarray)]
        columns = {name: getattr(self, name).compress(rows, axis=0) for name in names}
        rig = self.sensor_rig
        return replace(self, **columns, sensor_rig=None if rig is None else rig.select(rows))
