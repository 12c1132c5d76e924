"""Deskewing: sweeps as if measured in one instant (paper III-B)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from docdepth.errors import InputError
from docdepth.geometry.points import usable_points
from docdepth.geometry.se3 import inverse, se3_exp, se3_log, skew
from docdepth.geometry.trajectory import parts_of
from docdepth.odometry.clock import even_stamps

NEIGHBORS = 2
"""Sweeps on either side whose poses give the motion of one."""

_STRAIGHT = 1e-9  # radians a sweep; a smaller turn moves no point by a micrometre


def deskew(
    points: NDArray[np.float32], relative_time: NDArray[np.float32], motion: ArrayLike
) -> NDArray[np.float32]:
    """Move each point to where the sensor would have measured it at the sweep's stamp.

    Parameters
    ----------
    points : ndarray of float32, shape (N, 3)
        In the sensor's frame at the time of each point.
    relative_time : ndarray of float32, shape (N,)
        Time of each point after the stamp, as a share of the sweep's duration.
    motion : array_like of float64, shape (4, 4)
        The sensor's pose one sweep after the stamp, in its frame at the stamp. Angular and linear
        velocity are constant during the sweep (a screw motion).

    Returns
    -------
    ndarray of float32, shape (N, 3)
        In the sensor's frame at the stamp. Rows without a usable return are kept as they are.
    """
    usable = usable_points(points)
    if not np.isfinite(relative_time[usable]).all():
        raise InputError("a usable point has no finite time; drop it or give it one")
    omega, velocity = se3_log(motion)
    angle = float(np.linalg.norm(omega))
    share = np.where(usable, relative_time, 0).astype(np.float32)
    x, y, z = (np.where(usable, points[:, k], 0).astype(np.float32) for k in range(3))
    if angle < _STRAIGHT:
        moved = [p + share * np.float32(v) for p, v in zip((x, y, z), velocity, strict=True)]
    else:
        # The exponential of share * twist applied to p, sorted by what depends on the time:
        # p + sin a (A p + b) + (1 - cos a)(A A p + c) + share d, a = share * angle, A = [axis]x.
        axis = omega / angle
        A = skew(axis)
        sine = np.sin(share * np.float32(angle))
        half = np.sin(share * np.float32(0.5 * angle))
        versine = np.float32(2) * half * half
        first, second = A.astype(np.float32), (A @ A).astype(np.float32)
        b = (-A @ A @ velocity / angle).astype(np.float32)
        c = (A @ velocity / angle).astype(np.float32)
        d = (axis * (axis @ velocity)).astype(np.float32)
        moved = [
            p
            + sine * (m[0] * x + m[1] * y + m[2] * z + b[k])
            + versine * (n[0] * x + n[1] * y + n[2] * z + c[k])
            + share * d[k]
            for k, (p, m, n) in enumerate(zip((x, y, z), first, second, strict=True))
        ]
    result = points.copy()
    for k in range(3):
        np.copyto(result[:, k], moved[k], where=usable)
    return result


def centred_motion(
    poses: NDArray[np.float64],
    times: ArrayLike | None = None,
    frames: Sequence[int] | None = None,
) -> NDArray[np.float64]:
    """Motion of the sensor during one sweep around each stamp, fitted to neighbouring poses.

    The fit is a straight line through the twists to up to two poses before and two after. It passes
    half as much jitter of the poses on to the points as one neighbour on either side would. Poses
    beyond a gap are not used, and steps of the clock are taken out.

    Parameters
    ----------
    poses : ndarray of float64, shape (n, 4, 4)
        ``T_world_lidar`` at each stamp.
    times : array_like of int64, shape (n,), optional
        Nanoseconds; without them sweeps are evenly spaced. A sweep lasts the median difference of
        stamps, so that a lost sweep does not double the motion.
    frames : sequence of int, optional
        Sweeps whose motion is wanted, all by default. Only poses up to :data:`NEIGHBORS` sweeps
        away from these are used.

    Returns
    -------
    ndarray of float64, shape (n, 4, 4) or (len(frames), 4, 4)
        The motion of one sweep's duration.
    """
    n = len(poses)
    frames = range(n) if frames is None else frames
    if n < 2:
        return np.repeat(np.eye(4)[None], len(frames), axis=0)
    stamps = np.arange(n) if times is None else np.asarray(times, dtype=np.int64)
    usual = float(np.median(np.diff(stamps)))
    motions = np.repeat(np.eye(4)[None], len(frames), axis=0)
    parts = parts_of(stamps) if times is not None else [range(n)]
    ends = np.array([part.stop for part in parts])
    for row, k in enumerate(frames):
        part = parts[int(np.searchsorted(ends, k, "right"))]
        around = np.arange(max(k - NEIGHBORS, part.start), min(k + NEIGHBORS + 1, part.stop))
        if len(around) < 2:
            continue
        twists = np.array([np.concatenate(se3_log(inverse(poses[k]) @ poses[j])) for j in around])
        # One more, so that a step has intervals on either side.
        known = slice(max(k - NEIGHBORS - 1, part.start), around[-1] + 1)
        even = even_stamps(poses[known], stamps[known], usual)
        sweeps = (even - even[0])[-len(around) :] / usual
        x = sweeps - sweeps.mean()
        slope = x @ twists / (x @ x)
        motions[row] = se3_exp(slope[:3], slope[3:])
    return motions
