"""Clocks that step: stamps that are farther apart, or nearer, than sweeps were taken.

A clock that is set during a drive makes one interval longer or shorter, and a sweep that is stamped
late makes two so. The vehicle drives on as it did. Where sweeps were lost, it has driven for as
long as the stamps say; or for longer, if sweeps are stamped as they are counted.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from docdepth.errors import Finding
from docdepth.geometry.trajectory import Trajectory

_APART = 0.3
"""Metres between where the stamps lead and where one sweep's time leads. Poses of a first pass are
off by less, and where it is less, nothing goes wrong."""
_MOST_LOST = 5  # sweeps that may be missing between two that are stamped one after the other
_SURE = 1.0  # metres a sweep; a faster vehicle does not double its speed from sweep to sweep
_ONWARD = 0.9  # cosine; a step that leads aside is a jump of the poses
_AROUND = 2  # intervals on either side, of which the median speed is taken


def possible_times(velocity: NDArray[np.float64], elapsed: float, usual: float) -> list[float]:
    """In what time a vehicle may have moved: as the stamps say, and in that of one sweep.

    Only the first where it makes no difference. Metres a unit of time, and times in that unit.
    """
    apart = abs(elapsed - usual) * float(np.linalg.norm(velocity))
    return [elapsed, usual] if apart > _APART else [elapsed]


def times_if_lost(velocity: NDArray[np.float64], elapsed: float, usual: float) -> list[float]:
    """In what time it may have moved if sweeps are missing of which the stamps do not tell.

    None where it is too slow to tell.
    """
    if usual * float(np.linalg.norm(velocity)) < _SURE:
        return []
    return [elapsed + lost * usual for lost in range(1, _MOST_LOST + 1)]


def time_gone(
    moved: NDArray[np.float64], velocity: NDArray[np.float64], elapsed: float, usual: float
) -> float:
    """That of all these times in which it is most likely to have ``moved`` so far."""
    times = possible_times(velocity, elapsed, usual) + times_if_lost(velocity, elapsed, usual)
    return min(times, key=lambda time: float(np.linalg.norm(moved - time * velocity)))


def even_stamps(
    poses: NDArray[np.float64], times: NDArray[np.int64], usual: float
) -> NDArray[np.int64]:
    """Stamps of a part without gaps, as if the clock had not stepped.

    Parameters
    ----------
    poses : ndarray of float64, shape (n, 4, 4)
        ``T_world_lidar`` at each stamp.
    times : ndarray of int64, shape (n,)
        Nanoseconds.
    usual : float
        Nanoseconds that are usual between stamps.
    """
    elapsed = np.diff(times)
    steps = np.diff(poses[:, :3, 3], axis=0)
    moved = np.linalg.norm(steps, axis=1)
    speed = moved / elapsed
    odd = moved * np.abs(elapsed - usual) > _APART * np.minimum(elapsed, usual)
    on = (steps[1:] * steps[:-1]).sum(axis=1) > _ONWARD * moved[1:] * moved[:-1]
    odd[1:] |= on & (moved[1:] > 1.5 * moved[:-1] + _SURE / 2)
    for i in np.flatnonzero(odd):
        around = np.median(speed[max(i - _AROUND, 0) : i + _AROUND + 1], keepdims=True)
        elapsed[i] = round(time_gone(moved[i : i + 1], around, float(elapsed[i]), usual))
    return times[0] + np.concatenate([[0], np.cumsum(elapsed)])


def even_steps(trajectory: Trajectory) -> NDArray[np.int64]:
    """Nanoseconds from each pose to the next (n - 1,), as if the clock had not stepped."""
    steps = np.diff(trajectory.times)
    for part in trajectory.parts if len(steps) else []:
        rows = slice(part.start, part.stop)
        even = even_stamps(trajectory.poses[rows], trajectory.times[rows], float(np.median(steps)))
        steps[part.start : part.stop - 1] = np.diff(even)
    return steps


def find_clock_steps(trajectory: Trajectory) -> list[Finding]:
    """Whether stamps do not fit the motion."""
    late = np.diff(trajectory.times) - even_steps(trajectory)
    wrong = np.flatnonzero(late)
    if not len(wrong):
        return []
    first = int(wrong[0])
    text = (
        f"the stamps jump by {1e-9 * late[first]:+.2f} s between frames {first} and {first + 1}, "
        f"but the vehicle goes on as before ({len(wrong)} such jumps): the clock was set, "
        "sweeps were stamped late, or sweeps are missing"
    )
    remedy = (
        "images and tracks at a jump may be wrong; correct the stamps, or leave these frames out "
        "(`frames`)"
    )
    return [Finding("clock-steps", "", text, remedy)]
