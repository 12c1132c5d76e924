"""Where the LiDAR was when: poses in time and along the path (paper III-B, sections 4 and 6)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from docdepth.errors import InputError

# A pose that lies nearer than this to the last kept one adds no path: standing jitters.
_JITTER = 0.05


@dataclass(frozen=True)
class Trajectory:
    """Poses of a sensor, sorted by time.

    Attributes
    ----------
    times : ndarray of int64, shape (n,)
        Nanoseconds, strictly increasing.
    poses : ndarray of float64, shape (n, 4, 4)
        ``T_world_lidar``, which takes points of a sweep to the world.
    """

    times: NDArray[np.int64]
    poses: NDArray[np.float64]

    def __post_init__(self) -> None:
        times = np.ascontiguousarray(self.times, dtype=np.int64)
        poses = np.ascontiguousarray(self.poses, dtype=np.float64)
        if times.ndim != 1 or poses.shape != (len(times), 4, 4) or not len(times):
            raise InputError(
                f"a trajectory needs n times and (n, 4, 4) poses, n > 0; "
                f"got {times.shape} and {poses.shape}"
            )
        backwards = np.flatnonzero(np.diff(times) <= 0)
        if len(backwards):
            raise InputError(
                f"timestamps do not increase between frames {backwards[0]} and {backwards[0] + 1}; "
                "sort the sweeps by time and drop repeated ones"
            )
        check_rigid(poses)
        object.__setattr__(self, "times", times)
        object.__setattr__(self, "poses", poses)

    def __len__(self) -> int:
        return len(self.times)

    @property
    def arc_length(self) -> NDArray[np.float64]:
        """Path length at each pose, shape (n,), in metres; it does not grow while the ego stands.

        Distances are summed over poses at least 5 cm apart, so that the jitter of a standing
        sensor adds nothing and a crawl is not lost.
        """
        positions = self.poses[:, :3, 3]
        arc = np.zeros(len(self))
        kept, base = positions[0], 0.0
        for i in range(1, len(self)):
            distance = float(np.linalg.norm(positions[i] - kept))
            if distance >= _JITTER:
                base, kept = base + distance, positions[i]
            arc[i] = base
        return arc

    def subsample(self, spacing: float, duration: float = np.inf) -> NDArray[np.int64]:
        """Indices of poses at least ``spacing`` metres of path apart, greedily from the first.

        Or ``duration`` seconds apart, to a twentieth since stamps jitter, whichever comes first.
        The end of the path is taken too: without it nothing looks back at the last sweeps.
        """
        arc, seconds = self.arc_length, (self.times - self.times[0]) * 1e-9
        kept = [0]
        for i in range(1, len(self)):
            late = seconds[i] - seconds[kept[-1]] >= 0.95 * duration
            if late or arc[i] - arc[kept[-1]] >= spacing:
                kept.append(i)
        if arc[-1] > arc[kept[-1]]:
            kept.append(len(self) - 1)
        return np.array(kept)

    def nearest(self, time: int) -> int:
        """Index of the pose nearest in time to ``time`` [ns]; the earlier one on a tie."""
        return int(np.argmin(np.abs(self.times - np.int64(time))))

    def covers(self, times: ArrayLike) -> NDArray[np.bool_]:
        """Which of ``times`` [ns] lie between the first and the last pose."""
        times = np.asarray(times, dtype=np.int64)
        covered: NDArray[np.bool_] = (times >= self.times[0]) & (times <= self.times[-1])
        return covered

    def interpolate(self, times: ArrayLike) -> NDArray[np.float64]:
        """Poses between sweeps: linear in position, SLERP in rotation (shorter arc).

        Parameters
        ----------
        times : array_like of int64, shape (m,)
            Nanoseconds.

        Returns
        -------
        ndarray of float64, shape (m, 4, 4)
            ``T_world_lidar`` at these times.

        Raises
        ------
        InputError
            A time lies outside the trajectory: poses are not extrapolated.
        """
        times = np.atleast_1d(np.asarray(times, dtype=np.int64))
        outside = np.flatnonzero(~self.covers(times))
        if len(outside):
            raise InputError(
                f"{len(outside)} times lie outside the trajectory, the first is "
                f"{times[outside[0]]} ns (entry {outside[0]}); leave these images out"
            )
        after = np.clip(np.searchsorted(self.times, times), 1, max(len(self) - 1, 1))
        before = after - 1
        if len(self) == 1:
            return np.repeat(self.poses, len(times), axis=0)
        span = (self.times[after] - self.times[before]).astype(np.float64)
        share = (times - self.times[before]).astype(np.float64) / span
        result = np.repeat(np.eye(4)[None], len(times), axis=0)
        for k, (a, b, s) in enumerate(zip(before, after, share, strict=True)):
            start, end = self.poses[a], self.poses[b]
            if s in (0.0, 1.0):
                result[k] = start if s == 0.0 else end
                continue
            result[k, :3, :3] = start[:3, :3] @ rotation_power(start[:3, :3].T @ end[:3, :3], s)
            result[k, :3, 3] = (1.0 - s) * start[:3, 3] + s * end[:3, 3]
        return result

    def velocity(self, index: int) -> NDArray[np.float64]:
        """Of the sensor at pose ``index``, (3,) in its frame, metres a second; 0 of a single pose.

        By way and time between the poses before and after.
        """
        before, after = max(index - 1, 0), min(index + 1, len(self) - 1)
        seconds = (self.times[after] - self.times[before]) * 1e-9
        way: NDArray[np.float64] = self.poses[after, :3, 3] - self.poses[before, :3, 3]
        return way @ self.poses[index, :3, :3] / (seconds or 1.0)

    def arc_length_at(self, times: ArrayLike) -> NDArray[np.float64]:
        """Path length at ``times`` [ns], linear between poses."""
        times = np.atleast_1d(np.asarray(times, dtype=np.int64))
        start = self.times[0]
        arc: NDArray[np.float64] = np.interp(
            (times - start).astype(np.float64),
            (self.times - start).astype(np.float64),
            self.arc_length,
        )
        return arc


def check_rigid(poses: NDArray[np.float64]) -> None:
    """Refuse poses that are not rotations and translations.

    Raises
    ------
    InputError
        Names the first such frame.
    """
    rotation = poses[:, :3, :3]
    finite = np.isfinite(poses).all(axis=(1, 2))
    with np.errstate(invalid="ignore"):
        orthogonal = (
            np.abs(rotation @ rotation.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2)) < 1e-3
        )
        right_handed = np.linalg.det(np.where(np.isfinite(rotation), rotation, 0)) > 0
        affine = (poses[:, 3] == (0, 0, 0, 1)).all(axis=1)
    bad = np.flatnonzero(~(finite & orthogonal & right_handed & affine))
    if len(bad):
        raise InputError(
            f"the pose of frame {bad[0]} is not a rotation and a translation; "
            "poses are 4x4 matrices T_world_lidar with finite entries"
        )


def inverse(pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """Inverse of rigid poses, shape (..., 4, 4)."""
    result = np.zeros_like(pose)
    rotation = np.swapaxes(pose[..., :3, :3], -1, -2)
    result[..., :3, :3] = rotation
    result[..., :3, 3] = -(rotation @ pose[..., :3, 3, None])[..., 0]
    result[..., 3, 3] = 1.0
    return result


def rotation_log(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotation vector (axis times angle in radians, shape (3,)) of a 3x3 rotation."""
    x, y, z, w = matrix_to_quaternion(rotation)
    vector, sine = np.array([x, y, z]), float(np.sqrt(x * x + y * y + z * z))
    if sine < 1e-12:
        return np.asarray(2.0 * vector)
    return np.asarray(vector * (2.0 * np.arctan2(sine, w) / sine))


def rotation_exp(vector: ArrayLike) -> NDArray[np.float64]:
    """3x3 rotations of rotation vectors, shape (..., 3) to (..., 3, 3)."""
    vector = np.asarray(vector, dtype=np.float64)
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    x, y, z = vector[..., 0], vector[..., 1], vector[..., 2]
    zero = np.zeros_like(x)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1)
    cross = cross.reshape((*vector.shape[:-1], 3, 3))
    small = angle < 1e-8
    safe = np.where(small, 1.0, angle)
    first = np.where(small, 1.0, np.sin(safe) / safe)
    second = np.where(small, 0.5, (1.0 - np.cos(safe)) / safe**2)
    return np.asarray(np.eye(3) + first * cross + second * (cross @ cross))


def rotation_power(rotation: NDArray[np.float64], share: float) -> NDArray[np.float64]:
    """The ``share``-th part of a rotation, along the shorter arc (SLERP from identity)."""
    return rotation_exp(share * rotation_log(rotation))


def matrix_to_quaternion(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit quaternion (x, y, z, w), w >= 0, of a 3x3 rotation."""
    m = rotation
    # The symmetric matrix whose largest eigenvector is the quaternion (Bar-Itzhack 2000): no
    # special cases, exact for slightly non-orthogonal input too.
    k = np.array(
        [
            [m[0, 0] - m[1, 1] - m[2, 2], 0, 0, 0],
            [m[0, 1] + m[1, 0], m[1, 1] - m[0, 0] - m[2, 2], 0, 0],
            [m[0, 2] + m[2, 0], m[1, 2] + m[2, 1], m[2, 2] - m[0, 0] - m[1, 1], 0],
            [m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1], np.trace(m)],
        ]
    )
    quaternion: NDArray[np.float64] = np.linalg.eigh(k / 3.0)[1][:, 3]
    return -quaternion if quaternion[3] < 0 else quaternion


def quaternion_to_matrix(quaternion: ArrayLike) -> NDArray[np.float64]:
    """3x3 rotation of a quaternion (x, y, z, w) of any length but zero."""
    q = np.asarray(quaternion, dtype=np.float64)
    norm = float(np.linalg.norm(q))
    if not np.isfinite(norm) or norm < 1e-6:
        raise InputError(f"{q.tolist()} is not a quaternion x y z w; its length is {norm}")
    x, y, z, w = q / norm
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def poses_from(
    rotations: Sequence[NDArray[np.float64]], positions: ArrayLike
) -> NDArray[np.float64]:
    """Stack 3x3 rotations and positions (n, 3) into poses (n, 4, 4)."""
    positions = np.asarray(positions, dtype=np.float64)
    poses = np.repeat(np.eye(4)[None], len(positions), axis=0)
    poses[:, :3, :3] = np.asarray(rotations)
    poses[:, :3, 3] = positions
    return poses
