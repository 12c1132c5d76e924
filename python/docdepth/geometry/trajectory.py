"""The poses of a sensor over time and along its path (paper III-B; interpolation: V-A)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from docdepth.errors import InputError
from docdepth.geometry.points import ShortRepr, float_array, nanoseconds
from docdepth.geometry.se3 import check_rigid, rotation_exp, rotation_log

_JITTER = 0.05  # metres; poses of a standing sensor differ by less
_KEPT = 256  # an image asks for the same few times again and again; bounded as in track.py
_EARLY = 0.95  # share of a duration that counts as all of it, since stamps jitter
_GAP, _GAP_PERIODS = 1.0, 3.5
"""A gap is longer than so many seconds, and so many usual times from one stamp to the next. Within
a second a vehicle drives on as it did; after it, it may have braked or turned."""


def parts_of(times: NDArray[np.int64]) -> list[range]:
    """Parts between the gaps of stamps (n,) [ns], as ranges of indices."""
    steps = np.diff(times)
    longest = max(1e9 * _GAP, _GAP_PERIODS * float(np.median(steps))) if len(steps) else np.inf
    ends = [0, *(np.flatnonzero(steps > longest) + 1).tolist(), len(times)]
    return [range(first, end) for first, end in pairwise(ends)]


def within_parts(times: NDArray[np.int64], stamps: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which ``times`` [ns] lie between ``stamps`` (n,) [ns], in no gap: there nobody knows where
    the sensor was."""
    within = np.zeros(times.shape, bool)
    for part in parts_of(stamps):
        within |= (times >= stamps[part.start]) & (times <= stamps[part.stop - 1])
    return within


@dataclass(frozen=True, eq=False, repr=False)
class Trajectory(ShortRepr):
    """Poses of a sensor, sorted by time.

    Its arrays are copies and read-only, since lengths are computed once.

    Attributes
    ----------
    times : ndarray of int64, shape (n,)
        Nanoseconds, strictly increasing.
    poses : ndarray of float64, shape (n, 4, 4)
        ``T_world_lidar``: takes points from the LiDAR frame of a sweep to the world frame.

    Raises
    ------
    InputError
        Shapes do not fit, times are no integers or do not increase, or a pose is not rigid.
    """

    times: NDArray[np.int64]
    poses: NDArray[np.float64]

    def __post_init__(self) -> None:
        times, poses = nanoseconds("times", self.times), float_array("poses", self.poses)
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
        for array in (times, poses):
            array.setflags(write=False)
        object.__setattr__(self, "times", times)
        object.__setattr__(self, "poses", poses)

    def __len__(self) -> int:
        return len(self.times)

    @staticmethod
    def check(trajectory: object, sweeps: object) -> None:
        """Refuse arguments that were swapped, or that are no drive.

        Raises
        ------
        InputError
            ``trajectory`` is no Trajectory, ``sweeps`` no sequence, or their lengths differ.
        """
        if not isinstance(trajectory, Trajectory):
            raise InputError(
                "trajectory must be docdepth.Trajectory(times, poses), "
                f"not {type(trajectory).__name__}"
            )
        if not hasattr(sweeps, "__len__") or not hasattr(sweeps, "__getitem__"):
            raise InputError(f"sweeps must be a list or sequence, not {type(sweeps).__name__}")
        if len(sweeps) != len(trajectory):
            raise InputError(
                f"{len(sweeps)} sweeps need as many poses; the trajectory has {len(trajectory)}"
            )

    @cached_property
    def parts(self) -> list[range]:
        """The poses between gaps, see :func:`parts_of`."""
        return parts_of(self.times)

    def part(self, index: int) -> range:
        """The part that a pose belongs to."""
        return next(part for part in self.parts if index < part.stop)

    @cached_property
    def arc_length(self) -> NDArray[np.float64]:
        """Path length from the first pose to each pose, shape (n,), metres, read-only.

        Distances are summed over poses at least 5 cm apart. So the jitter of a standing sensor
        adds nothing, and a crawl is not lost.
        """
        positions = self.poses[:, :3, 3]
        arc = np.zeros(len(self))
        kept, base = positions[0], 0.0
        begin = {part.start for part in self.parts}
        for i in range(1, len(self)):
            distance = float(np.linalg.norm(positions[i] - kept))
            if distance >= _JITTER or i in begin:
                base, kept = base + distance, positions[i]
            arc[i] = base
        arc.setflags(write=False)
        return arc

    def subsample(self, spacing: float, duration: float = np.inf) -> NDArray[np.int64]:
        """Indices of poses spaced along the path, chosen greedily from the first.

        Parameters
        ----------
        spacing : float
            Least distance along the path between two of them, metres.
        duration : float
            A pose that is this many seconds after the last one is taken whatever its distance.

        Returns
        -------
        ndarray of int64, shape (k,)
            Increasing. Each part of the path begins anew, and its end is taken too: without it no
            key frame would look back at its last sweeps.
        """
        arc, seconds = self.arc_length.tolist(), ((self.times - self.times[0]) * 1e-9).tolist()
        kept = list[int]()
        for part in self.parts:
            kept.append(part.start)
            for i in part[1:]:
                overdue = seconds[i] - seconds[kept[-1]] >= _EARLY * duration
                if overdue or arc[i] - arc[kept[-1]] >= spacing:
                    kept.append(i)
            if arc[part[-1]] > arc[kept[-1]]:
                kept.append(part[-1])
        return np.array(kept)

    def nearest(self, time: int) -> int:
        """Index of the pose nearest in time to ``time`` [ns]; the earlier one on a tie."""
        after = int(np.searchsorted(self.times, np.int64(time)))
        if after in (0, len(self)):
            return min(after, len(self) - 1)
        late = int(self.times[after]) - int(time)
        return after if late < int(time) - int(self.times[after - 1]) else after - 1

    def covers(self, times: ArrayLike) -> NDArray[np.bool_]:
        """Which of ``times`` [ns] lie between the first and the last pose."""
        times = np.asarray(times, dtype=np.int64)
        covered: NDArray[np.bool_] = (times >= self.times[0]) & (times <= self.times[-1])
        return covered

    def interpolate(self, times: ArrayLike) -> NDArray[np.float64]:
        """Poses at any time within the trajectory (paper V-A).

        Positions are interpolated linearly, rotations by SLERP along the shorter arc.

        Parameters
        ----------
        times : array_like of int64, shape (m,)
            Nanoseconds. A single time counts as an array of one.

        Returns
        -------
        ndarray of float64, shape (m, 4, 4)
            ``T_world_lidar`` at these times.

        Raises
        ------
        InputError
            A time lies outside the trajectory: poses are not extrapolated.
        """
        if isinstance(times, int):
            return _at(self, times).copy()
        return self._interpolated(np.atleast_1d(nanoseconds("times", times)))

    def _interpolated(self, times: NDArray[np.int64]) -> NDArray[np.float64]:
        if times.ndim != 1:
            raise InputError(f"times must have shape (m,), got {times.shape}")
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
            result[k, :3, :3] = start[:3, :3] @ rotation_exp(s * _turn(self, int(a)))
            result[k, :3, 3] = (1.0 - s) * start[:3, 3] + s * end[:3, 3]
        return result

    def velocity(self, index: int) -> NDArray[np.float64]:
        """Velocity at pose ``index`` in the sensor's frame, shape (3,), metres a second.

        By central differences, at ends and gaps one-sided; 0 for a single pose.
        """
        index = range(len(self))[index]
        part = self.part(index)
        before, after = max(index - 1, part.start), min(index + 1, part.stop - 1)
        seconds = (self.times[after] - self.times[before]) * 1e-9
        distance: NDArray[np.float64] = self.poses[after, :3, 3] - self.poses[before, :3, 3]
        return distance @ self.poses[index, :3, :3] / (seconds or 1.0)

    def arc_length_at(self, times: ArrayLike) -> NDArray[np.float64]:
        """Path length at ``times`` [ns], metres, linear between poses."""
        times = np.atleast_1d(np.asarray(times, dtype=np.int64))
        # Since the first pose, so that a float is exact for drives of up to 104 days.
        elapsed, known = ((t - self.times[0]).astype(np.float64) for t in (times, self.times))
        arc: NDArray[np.float64] = np.interp(elapsed, known, self.arc_length)
        return arc


@lru_cache(maxsize=_KEPT)
def _at(trajectory: Trajectory, time: int) -> NDArray[np.float64]:
    """What :meth:`Trajectory.interpolate` finds at a single time."""
    after = int(np.searchsorted(trajectory.times, time))
    if after < len(trajectory) and trajectory.times[after] == time:
        return trajectory.poses[after : after + 1]
    return trajectory._interpolated(np.array([time]))


@lru_cache(maxsize=_KEPT)
def _turn(trajectory: Trajectory, index: int) -> NDArray[np.float64]:
    """Rotation vector from pose ``index`` to the next, in the frame of the first."""
    start, end = trajectory.poses[index, :3, :3], trajectory.poses[index + 1, :3, :3]
    return rotation_log(start.T @ end)
