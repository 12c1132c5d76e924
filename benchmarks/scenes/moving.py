"""Paths with round corners, and actors that brake, stop and go on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from docdepth.synthetic.road import Floats
from docdepth.synthetic.street import Street


@dataclass(frozen=True)
class Speeds:
    """Speed profile by knots: speed changes linearly between them and is constant outside.

    Attributes
    ----------
    times : sequence of float
        Increasing [s].
    speeds : sequence of float
        Speed at each of these times [m/s].
    """

    times: Sequence[float]
    speeds: Sequence[float]

    def _covered(self, t: Floats) -> Floats:
        knots, speeds = np.asarray(self.times, np.float64), np.asarray(self.speeds, np.float64)
        steps = 0.5 * (speeds[1:] + speeds[:-1]) * np.diff(knots)
        before = np.concatenate([[0.0], np.cumsum(steps)])
        piece = np.clip(np.searchsorted(knots, t, side="right") - 1, 0, len(knots) - 1)
        since = t - knots[piece]
        # Outside the knots np.interp is constant, so this trapezoid is exact everywhere.
        result: Floats = before[piece] + 0.5 * (speeds[piece] + self.at(t)) * since
        return result

    def distance(self, times: ArrayLike) -> Floats:
        """Distance travelled since time 0 by ``times`` [s], metres."""
        return self._covered(np.asarray(times, np.float64)) - self._covered(np.zeros(()))

    def at(self, times: ArrayLike) -> Floats:
        """Speed at ``times`` [s], m/s."""
        return np.interp(np.asarray(times, np.float64), self.times, self.speeds)

    def later(self, seconds: float) -> Speeds:
        """The same profile, ``seconds`` later."""
        return Speeds([time + seconds for time in self.times], self.speeds)


def arrive(
    street: Street,
    kind: str,
    points: ArrayLike,
    speed: float,
    stop: float,
    deceleration: float = 2.0,
    name: str = "",
) -> None:
    """Add an actor that stands at the end of the points from ``stop`` [s] on."""
    pace = Speeds((stop - speed / deceleration, stop), (speed, 0.0))
    along = np.linalg.norm(np.diff(np.asarray(points, np.float64), axis=0), axis=1).sum()
    start = float(along - pace.distance(stop))
    street.send(kind, points, pace, start, name or f"{kind} that arrives")


def rounded(points: ArrayLike, radius: float) -> Floats:
    """The polyline (k, 2) with its inner corners replaced by curves that begin ``radius`` away."""
    corners = np.asarray(points, np.float64)
    bend = np.linspace(0.0, 1.0, 9)[:, None]
    pieces = [corners[:1]]
    for before, corner, after in zip(corners, corners[1:], corners[2:], strict=False):
        ends = []
        for other in (before, after):
            length = float(np.linalg.norm(other - corner))
            ends.append(corner + (other - corner) * min(radius / length, 0.5))
        # A quadratic Bezier curve: tangent to both sides of the corner.
        first, last = ends
        pieces.append((1 - bend) ** 2 * first + 2 * bend * (1 - bend) * corner + bend**2 * last)
    return np.concatenate([*pieces, corners[-1:]])
