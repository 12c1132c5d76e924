"""A pass over the drive: its sweeps registered one after the other, and their poses filtered."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from docdepth.config import OdometryParameters
from docdepth.errors import Finding, OdometryError
from docdepth.geometry.se3 import inverse, power
from docdepth.odometry.clock import possible_times, time_gone, times_if_lost
from docdepth.odometry.deskewing import NEIGHBORS, centred_motion
from docdepth.odometry.registration import FEWEST_POINTS, SEEN, UNKNOWN, Found, Registration
from docdepth.odometry.registration_log import RegistrationLog
from docdepth.odometry.smoothing import State, filtered, first_state, stamp_error_of
from docdepth.odometry.sweeps import SweepPart, deskewed_points

KnownPoses = Callable[[int], NDArray[np.float64]]
"""``known(k)`` gives poses (n, 4, 4) of an earlier pass; the first k + 1 of them are known."""

# Voxels of 0.5 m resolve kerbs and posts, and still hold points enough for a normal.
_FINE_VOXEL = 0.5  # metres, edge of a voxel of the map
_FINE_TOLERANCE = 0.05
"""In the second pass a point so far from its surface counts half [m]: the noise of ranges and of
the means of voxels. The poses of the first pass are off by more."""
_NEIGHBORS, _FINE_NEIGHBORS = 20, 15
"""Neighbours from which the normal of a point is taken, in the first pass and in the second. On a
road the nearest ones lie on the ring of one laser. By 16 beams, ten of them are a short arc, whose
bend is less than the noise along the rays. So the normal leans towards the LiDAR, and poses pitch
a little more with each sweep. Still more neighbours blur normals at edges."""

_MARGIN = 15.0
"""Metres that points lie farther from a logged pose in the map than from the sensor when they were
measured: deskewing moves them by up to 10 m at 60 m/s, and the filter moves the pose."""

# A finding tells if registration disagrees with the motion in a large share of the sweeps.
_DISAGREES = 0.3  # metres between a registered position and the predicted one
_MAX_DISAGREEING = 0.05  # share of the sweeps
_UNFIT, _SETTLED_FIT = 0.85, 10
"""A sweep of which fewer points find their surfaces, by this share of the median of so many sweeps
before, may lie elsewhere: of wrong poses 52 to 80 % of the points do, of right ones 86 to 97 %."""
_SETTLED = 4  # sweeps after which the filter knows the motion


class LoggedRegistration:
    """A registration with an empty map that goes on behind what a log of ``count`` sweeps holds.

    Points are no farther than ``reach`` [m]; ``first`` is the first sweep that the map shows.
    """

    def __init__(
        self, registration: Registration, kept: RegistrationLog, count: int, reach: float
    ) -> None:
        self._registration, self._log = registration, kept
        self._fitting = deque[float](maxlen=_SETTLED_FIT)
        # Two sweeps touch one voxel from either side.
        self.first = kept.first_needed(2 * (reach + _MARGIN)) if len(kept) < count else count
        # Traffic in the first sweep is told by those before it.
        self._read = max(0, self.first - SEEN) if len(kept) < count else count

    def align(
        self,
        index: int,
        deskewed: Callable[[], NDArray[np.float32]],
        guesses: Sequence[NDArray[np.float64]],
        if_unfit: Sequence[NDArray[np.float64]] = (),
    ) -> Found:
        """What registration finds, or has found, of a sweep; it is read only if it is needed.

        Other guesses are tried ``if_unfit``: if far fewer points find their surfaces than did in
        the sweeps before.
        """
        found = self._log.found(index)
        if found is None or (index >= self._read and found.usable):
            points = deskewed()
            usable = len(points) >= FEWEST_POINTS
            if usable:
                self._registration.take(points, guesses[0])
            if found is None:
                found = Found(guesses[0], UNKNOWN**2 * np.eye(6), False)
                if usable:
                    found = self._registered(guesses, if_unfit)
                self._log.add(found)
        if found.usable:
            self._fitting.append(found.fitting)
        return found

    def _registered(
        self, guesses: Sequence[NDArray[np.float64]], if_unfit: Sequence[NDArray[np.float64]]
    ) -> Found:
        found = self._registration.align(*guesses)
        usual = float(np.median(self._fitting)) if self._fitting else 0.0
        if not if_unfit or found.fitting >= _UNFIT * usual:
            return found
        other = self._registration.align(*if_unfit)
        return other if found.fitting < _UNFIT * other.fitting else found

    def insert(self, index: int, pose: NDArray[np.float64]) -> None:
        """Add a sweep to the map, where the map shows it still."""
        if index >= self.first:
            self._registration.insert(pose)


def fine_registration(threads: int) -> Registration:
    """An empty map of fine voxels, on which poses are refined."""
    return Registration(_FINE_VOXEL, None, _FINE_NEIGHBORS, threads, _FINE_TOLERANCE)


def register(
    sweeps: SweepPart,
    parameters: OdometryParameters,
    first: NDArray[np.float64] | None,
    known: KnownPoses | None,
    threads: int,
    kept: RegistrationLog,
    findings: list[Finding],
) -> Iterator[State]:
    """Register sweeps one after the other.

    Parameters
    ----------
    first : ndarray of float64, shape (4, 4), optional
        Motion in one sweep's duration at the start, if it is known.
    known : callable, optional
        Poses of an earlier pass, which are refined: sweeps are deskewed with the motion around
        them. Without them poses are found from scratch: sweeps are deskewed with the motion of the
        sweep before.
    kept : RegistrationLog
        What an interrupted pass found is taken from there, and what is found is added.
    findings : list of Finding
        At the end, what looks wrong is added.

    Yields
    ------
    State
        ``T_world_lidar`` of each sweep in the frame of the first, and how it moves.
    """
    count, times = len(sweeps), sweeps.times
    if known is None:
        voxel = parameters.voxel_size
        fresh = Registration(voxel, 0.5 * voxel, _NEIGHBORS, threads)
    else:
        voxel = _FINE_VOXEL
        fresh = fine_registration(threads)
    registration = LoggedRegistration(fresh, kept, count, parameters.max_range + voxel)
    period = float(np.median(np.diff(times))) if count > 1 else 1.0
    stamp_error = stamp_error_of(times)
    motion = np.eye(4) if first is None else first
    velocity = None if first is None else 1e9 / period * first[:3, 3]
    pose, predicted, disagreeing = np.eye(4), list[int](), 0
    state: State | None = None
    for k in range(count):
        last, elapsed = pose, float(times[k] - times[k - 1]) / period if k else 0.0
        if known is None:
            of_motion = motion[:3, 3], elapsed, 1.0
            guesses = _extrapolated(last, motion, possible_times(*of_motion) if k else [0.0])
            if_unfit = _extrapolated(last, motion, times_if_lost(*of_motion) if k else [])
        else:
            poses = known(min(k + NEIGHBORS, count - 1))
            motion = centred_motion(poses, times, [k])[0]
            guesses, if_unfit = [last @ inverse(poses[k - 1]) @ poses[k] if k else last], []
        deskewed = partial(_deskewed, sweeps, k, motion)
        found = registration.align(k, deskewed, guesses, if_unfit)
        if not np.isfinite(found.pose).all():
            raise OdometryError(
                f"frame {sweeps.first + k} could not be registered",
                "bring poses (`poses`) or try another odometry.voxel_size",
                code="not-registered",
            )
        if state is None:
            state = first_state(found.pose, velocity)
        else:
            moved, way = found.pose[:3, 3] - last[:3, 3], 1e-9 * period * state.velocity
            elapsed = time_gone(moved, way, elapsed, 1.0)
            seconds = elapsed * period * 1e-9
            state = filtered(state, found.pose, found.covariance, seconds, stamp_error)
        pose = state.pose
        off = np.linalg.norm(found.pose[:3, 3] - state.predicted[:3])
        disagreeing += bool(found.usable and k >= _SETTLED and off > _DISAGREES)
        if found.usable:
            registration.insert(k, pose)
        else:
            predicted.append(sweeps.first + k)
        if k and known is None:
            # The filtered velocity: the last step would feed its error back by deskewing.
            motion = power(inverse(last) @ pose, 1 / elapsed)
            motion[:3, 3] = 1e-9 * period * pose[:3, :3].T @ state.velocity
        yield state
    if predicted and known is None:  # the other passes would say the same
        findings.append(_predicted_poses(predicted, count, parameters))
    if known is not None and disagreeing > _MAX_DISAGREEING * count:
        findings.append(_disagreement(disagreeing, count))


def _deskewed(sweeps: SweepPart, index: int, motion: NDArray[np.float64]) -> NDArray[np.float32]:
    return deskewed_points(sweeps[index], sweeps.first + index, motion)


def _extrapolated(
    pose: NDArray[np.float64], motion: NDArray[np.float64], times: Sequence[float]
) -> list[NDArray[np.float64]]:
    """Where a motion leads from a pose in each of these times."""
    return [pose @ power(motion, time) for time in times]


def _disagreement(disagreeing: int, count: int) -> Finding:
    text = (
        f"{disagreeing} of {count} sweeps were registered more than {_DISAGREES} m from where the "
        "motion led; perhaps the LiDAR sees little that stands still, traffic goes along, or times "
        "are wrong; poses may be metres off"
    )
    remedy = "look at them, or bring better ones (`poses`)"
    return Finding("registration-disagrees", "", text, remedy)


def _predicted_poses(predicted: list[int], count: int, parameters: OdometryParameters) -> Finding:
    """One finding of all sweeps that could not be registered."""
    few = 2 * len(predicted) < count
    return Finding(
        "predicted-poses",
        "",
        f"{len(predicted)} of {count} sweeps have less than {FEWEST_POINTS} usable points between "
        f"{parameters.min_range:g} and {parameters.max_range:g} m, the first of them frame "
        f"{predicted[0]}: their poses are predicted",
        ""
        if few
        else "the points may not be in metres, their format may not be what it is taken for, or "
        "odometry.min_range and max_range leave too few",
    )
