"""How a spinning LiDAR turns, which gives times to points that have none.

The rows of a sweep tell most of it. If they are in the order of time, azimuth follows the number of
the row all around. If they come ring by ring, it goes round once for each ring; then neither the
direction of rotation nor the seam is known, since software sorts the rows as it likes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from docdepth.geometry.points import elevation_of, usable_points

Floats = NDArray[np.float64]

_FEWEST = 500  # points; fewer show no order
_SECTORS, _SEEN = 36, 0.7  # of which so many hold points, if a LiDAR looks all around
_IN_ORDER = 0.8  # length of the mean of (row - azimuth) on the unit circle: 0.95 to 1, or near 0
_SAME_WAY = 0.8  # share of the steps of azimuth, along a ring
_LEAST_RINGS = 4
_LEVEL_DEG = 0.2  # median step of elevation along a ring
_FIRST = 0.01  # of the rows of a sweep, whose azimuth tells where it starts
_SEAMS_DEG = (0.0, 90.0, 180.0, -90.0)  # sensors start on an axis of their frame


@dataclass(frozen=True)
class Turn:
    """The direction in which a LiDAR turns, and where its sweeps start."""

    clockwise: bool  # seen from above
    # azimuth at which every sweep starts. None: rows are in the order of time, and the first ones
    # tell it
    seam_deg: float | None = None
    # share of a sweep that is measured before its stamp. Half of it is least wrong, if it is not
    # known
    before_stamp: float = 0.5
    # revolutions from one stamp to the next: several, if sweeps were left out
    revolutions: int = 1

    def __str__(self) -> str:
        way = "clockwise" if self.clockwise else "counterclockwise"
        seam = "" if self.seam_deg is None else f" from {self.seam_deg:g} degrees"
        often = "" if self.revolutions == 1 else f", {self.revolutions} times a sweep"
        return way + seam + often

    def relative_time(self, points: NDArray[np.float32]) -> NDArray[np.float32]:
        """When each point was measured, as :attr:`~docdepth.datasets.Sweep.relative_time`.

        Parameters
        ----------
        points : ndarray of float32, shape (N, 3)
            As measured, z along the axis. Rows without a usable return get the time of the stamp.
        """
        usable = usable_points(points)
        turned = _turned(points[usable], self.clockwise)
        if self.seam_deg is not None:
            share = (turned + (self.seam_deg if self.clockwise else -self.seam_deg) / 360) % 1
        else:
            row = np.flatnonzero(usable) / max(len(points), 1)
            first = slice(max(1, round(_FIRST * len(row))))
            share = turned + np.angle(_on_circle(row[first] - turned[first]).sum()) / (2 * np.pi)
            share += np.round(row - share)  # a sweep may go on over its own beginning
        times = np.zeros(len(points), np.float32)
        times[usable] = (share - self.before_stamp) / self.revolutions
        return times


def possible_turns(
    points: NDArray[np.float32], ring: NDArray[np.uint16] | None = None
) -> list[Turn]:
    """The ways in which a LiDAR may have turned that measured a sweep.

    Parameters
    ----------
    points : ndarray of float32, shape (N, 3)
    ring : ndarray of uint16, shape (N,), optional
        Laser of each point.

    Returns
    -------
    list of Turn
        One, if rows are in the order of time; all directions and seams, if they come ring by ring
        or have numbers of rings; none of a LiDAR that does not spin, or if rows show no order.
    """
    usable = usable_points(points)
    kept = points[usable].astype(np.float64)
    turned = _turned(kept, False)
    sectors = np.bincount((turned * _SECTORS).astype(int) % _SECTORS, minlength=_SECTORS)
    if len(kept) < _FEWEST or np.count_nonzero(sectors) < _SEEN * _SECTORS:
        return []
    row = np.flatnonzero(usable) / len(points)
    for clockwise in (True, False):
        in_order = _on_circle(row - (-turned if clockwise else turned)).mean()
        if abs(in_order) > _IN_ORDER:
            return [Turn(clockwise)]
    numbered = ring is not None and len(np.unique(ring[usable])) >= _LEAST_RINGS
    if not numbered and not _ring_by_ring(kept, turned):
        return []
    return [Turn(clockwise, seam) for clockwise in (True, False) for seam in _SEAMS_DEG]


def _ring_by_ring(points: Floats, turned: Floats) -> bool:
    """Whether rows go round several times, always the same way, at one elevation each time."""
    steps = (np.diff(turned) + 0.5) % 1 - 0.5
    elevation = np.degrees(elevation_of(points))
    same_way = max((steps > 0).mean(), (steps < 0).mean()) > _SAME_WAY
    level = np.median(np.abs(np.diff(elevation))) < _LEVEL_DEG
    return bool(same_way and level and abs(steps.sum()) > _LEAST_RINGS - 0.5)


def _turned(points: NDArray[np.float32] | Floats, clockwise: bool) -> Floats:
    """Azimuth of points (N, 3) in the direction of rotation, as a share of a revolution."""
    azimuth = np.arctan2(points[:, 1], points[:, 0], dtype=np.float64) / (2 * np.pi)
    return -azimuth if clockwise else azimuth


def _on_circle(shares: Floats) -> NDArray[np.complex128]:
    """Shares of a revolution as points of the unit circle."""
    return np.exp(2j * np.pi * shares)
