"""Parts of a recording between gaps, laid together where they see the same place.

Nobody knows what a vehicle did in a gap of seconds or hours. So each part is registered as if it
were alone. What the last sweeps before a gap see is then looked for in what the first ones behind
it see: first where the motion led, if the gap is short, then as far as the vehicle may have gone. A
part that does not fit is put where it meets no other, and this is said.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from docdepth.errors import Finding
from docdepth.geometry.se3 import inverse, se3_exp, se3_log
from docdepth.geometry.trajectory import Trajectory
from docdepth.odometry.deskewing import centred_motion
from docdepth.odometry.loop_closure import passes
from docdepth.odometry.places import REACH, Place, Placed, Places, locate
from docdepth.odometry.sweeps import SweepPart, ThinnedSweeps

log = logging.getLogger(__name__)

APART = 1000.0
"""Metres between a part that does not fit and all before it. No LiDAR sees so far."""

_ACCELERATION, _TURN = 4.0, 0.6  # metres/s^2, radians/s; a vehicle hardly does more for seconds
_MOST_UNSURE = 10.0  # metres that motion may lead astray, in two seconds; beyond it is no start
_ALIKE, _OVERLAP = 0.45, 0.4
"""Least likeness and overlap of two places, of which the motion told where to look. Likeness counts
the part that both can see. Right places had 0.51 to 0.78 and 0.45 to 0.62; wrong ones that matched
in both directions had 0.28 and 0.32."""
_LEAST = 2.0  # metres; by which poses may err, and a pixel of a map


def joined_parts(
    sweeps: ThinnedSweeps, paths: Sequence[NDArray[np.float64]], findings: list[Finding]
) -> NDArray[np.float64]:
    """Poses of all parts in one world.

    Parameters
    ----------
    sweeps : ThinnedSweeps
        Of all parts, one after the other.
    paths : sequence of ndarray of float64, each of shape (n, 4, 4)
        ``T_part_lidar`` of each part, in the frame of its first sweep.
    findings : list of Finding
        One is added for each part that does not fit the part before.

    Returns
    -------
    ndarray of float64, shape (N, 4, 4)
        ``T_world_lidar`` in the frame of the first sweep of all.
    """
    laid = [paths[0]]
    begin = 0
    for before, path in pairwise(paths):
        start = begin + len(before)
        times = sweeps.times[begin : start + len(path)]
        seconds = float(times[len(before)] - times[len(before) - 1]) * 1e-9
        step = _step(sweeps, begin, before, path, seconds)
        if step is None:
            laid.append(_placed_apart(laid, path))
            text = (
                f"{seconds:.1f} s lie between frames {start - 1} and {start}, and they do not see "
                f"the same place: frame {start} begins a part of its own, {APART:g} m aside"
            )
            findings.append(Finding("part-apart", "", text))
        else:
            log.info("frames from %d on are laid on those before a gap of %.1f s", start, seconds)
            laid.append(laid[-1][-1] @ step @ path)
        begin = start
    return np.concatenate(laid)


def _placed_apart(
    laid: Sequence[NDArray[np.float64]], path: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Poses (n, 4, 4) of a part where it meets no other, at the height of the last."""
    aside = np.eye(4)
    aside[0, 3] = max(part[:, 0, 3].max() for part in laid) + APART - path[:, 0, 3].min()
    aside[1:3, 3] = laid[-1][-1, 1:3, 3]
    moved: NDArray[np.float64] = aside @ path
    return moved


def _step(
    sweeps: ThinnedSweeps,
    begin: int,
    before: NDArray[np.float64],
    path: NDArray[np.float64],
    seconds: float,
) -> NDArray[np.float64] | None:
    """Pose (4, 4) of the first sweep behind a gap in the frame of the last before it, if found."""
    last, start = len(before) - 1, begin + len(before)
    # Both in the frame of the sweep at the gap.
    one = _place(sweeps, begin, inverse(before[-1]) @ before, last)
    other = _place(sweeps, start, path, 0)
    way = _way(sweeps.times[begin:start], before, seconds)
    unsure = _LEAST + _ACCELERATION / 2 * seconds**2
    turn = min(_TURN * seconds, np.pi)
    far = float(np.linalg.norm(way))
    if unsure <= _MOST_UNSURE and far < REACH:
        placed = locate(one, other, way, unsure, turn)
        if _fits(placed):
            return placed.pose
    placed = locate(one, other, np.zeros(2), min(unsure + far, REACH), turn)
    return placed.pose if passes(placed) else None


def _fits(placed: Placed) -> bool:
    """Whether a place is where its motion led, though both see only a part of the same."""
    apart = min(float(np.linalg.norm(placed.pose[:2, 3])) / (2 * REACH), 1.0)
    common = 2 / np.pi * (np.arccos(apart) - apart * np.sqrt(1 - apart**2))  # share of both discs
    return passes(placed, _ALIKE * common, _OVERLAP)


def _place(sweeps: ThinnedSweeps, first: int, poses: NDArray[np.float64], index: int) -> Place:
    """What the sweeps around one of a part see."""
    part = SweepPart(sweeps, range(first, first + len(poses)))
    return Places(part, poses, Trajectory(part.times, poses).arc_length).at(index)


def _way(
    times: NDArray[np.int64], poses: NDArray[np.float64], seconds: float
) -> NDArray[np.float64]:
    """Where the motion of the last sweeps leads, in the axes of the last, seen from above [m]."""
    omega, velocity = se3_log(centred_motion(poses, times, [len(poses) - 1])[0])
    periods = seconds / (1e-9 * float(np.median(np.diff(times)))) if len(times) > 1 else 0.0
    return se3_exp(periods * omega, periods * velocity)[:2, 3]
