"""The poses of the first sweeps, registered once more on the sweeps behind them.

The first sweep finds no map, and the next ones a map of few sweeps. By 16 beams these lean by a
tenth of a degree to one, as all that they see of the ground is a few rings; later ones are right to
some hundredths. So a map is made of later sweeps, and those before them are registered on it, from
the last to the first.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from docdepth.geometry.se3 import inverse, power
from docdepth.odometry.deskewing import centred_motion
from docdepth.odometry.registration import FEWEST_POINTS, Found, Registration
from docdepth.odometry.registration_log import RegistrationLog
from docdepth.odometry.smoothing import filtered, first_state, stamp_error_of
from docdepth.odometry.sweeps import SweepPart, deskewed_points

FIRST = 8
"""Sweeps that are registered once more: after as many, poses are as exact as anywhere."""

USED = 16
"""Those, and the sweeps of which the map is made."""


def with_first_poses(
    poses: Iterator[NDArray[np.float64]],
    sweeps: SweepPart,
    registration: Registration,
    kept: RegistrationLog,
) -> Iterator[NDArray[np.float64]]:
    """The poses (4, 4) of a part, of which the first are registered once more.

    Parameters
    ----------
    poses : iterator of ndarray of float64, shape (4, 4)
        ``T_world_lidar`` of each sweep.
    registration : Registration
        Its map is empty.
    kept : RegistrationLog
        What an interrupted estimation found is taken from there, and what is found is added.

    Yields
    ------
    ndarray of float64, shape (4, 4)
        In the frame of the first sweep.
    """
    first = np.array(list(islice(poses, USED))).reshape(-1, 4, 4)
    known = [kept.found(k) for k in range(FIRST)]
    if all(known) and len(first) == USED:
        first[:FIRST] = [found.pose for found in known if found]
    elif len(first) == USED:
        first = _registered_back(first, sweeps, registration)
        for pose in first[:FIRST]:
            kept.add(Found(pose, np.zeros((6, 6)), True))
        kept.close()
    home = inverse(first[0])
    for pose in first:
        yield home @ pose
    for pose in poses:
        yield home @ pose


def _registered_back(
    poses: NDArray[np.float64], sweeps: SweepPart, registration: Registration
) -> NDArray[np.float64]:
    """The poses with better first ones; as they are if one of the sweeps has too few points."""
    times, poses = sweeps.times[:USED], poses.copy()
    period, error = float(np.median(np.diff(sweeps.times))), stamp_error_of(sweeps.times)
    motions = centred_motion(poses, times)
    clouds = [deskewed_points(sweeps[k], sweeps.first + k, motions[k]) for k in range(USED)]
    if min(len(cloud) for cloud in clouds) < FEWEST_POINTS:
        return poses
    for k in range(FIRST, USED):
        registration.take(clouds[k], poses[k])
        registration.insert(poses[k])
    motion, back = motions[FIRST], 1e9 / period
    state = first_state(poses[FIRST], -back * poses[FIRST][:3, :3] @ motion[:3, 3])
    for k in reversed(range(FIRST)):
        elapsed = float(times[k + 1] - times[k]) / period
        guess = poses[k + 1] @ power(motion, -elapsed)
        registration.take(clouds[k], guess)
        found = registration.align(guess)
        seconds = elapsed * period * 1e-9
        state = filtered(state, found.pose, found.covariance, seconds, error)
        registration.insert(state.pose)
        poses[k] = state.pose
        motion = power(inverse(poses[k]) @ poses[k + 1], 1 / elapsed)
        motion[:3, 3] = -poses[k][:3, :3].T @ state.velocity / back
    return poses
