"""Which key frames vote on each sweep (paper IV-B)."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from docdepth.config import DynamicsParameters
from docdepth.geometry.trajectory import Trajectory

# Key frames that the paper does not have, used with a `time_spacing` above 0.
TIME_RADIUS = 10.0
"""Key frames in time vote this long before and after: what crosses the road has passed then [s]."""

END_RADIUS = 3.0
"""Sweeps this near an end of the drive get more key frames: theirs lie on one side only [s]."""

END_SPACING = 0.4
"""Spacing of these: every fourth sweep of a LiDAR that turns ten times a second [s]."""

_ROUNDING = 1e-6

_RECENT = 256
"""Sweeps whose key frames are kept: those in hand ask several times."""


class _Family(NamedTuple):
    """Key frames of one spacing.

    Attributes
    ----------
    frames : ndarray of int64, shape (k,)
        Ascending.
    arc, time : ndarray of float64, shape (k,)
        Path length [m] and time [s] of each, ascending.
    radius, duration : float
        They vote on sweeps within this path length [m] and time [s].
    """

    frames: NDArray[np.int64]
    arc: NDArray[np.float64]
    time: NDArray[np.float64]
    radius: float
    duration: float

    def near(self, arc: float, time: float) -> NDArray[np.int64]:
        """Those that vote on a sweep at this path length and time."""
        window = slice(0, len(self.frames))
        for ascending, here, reach in (
            (self.arc, arc, self.radius),
            (self.time, time, self.duration),
        ):
            # The rounding of `arc - radius` differs from that of `arc[frames] - arc`; the window is
            # a little wider, and the exact condition decides.
            first = np.searchsorted(ascending, here - reach - _ROUNDING, "left")
            end = np.searchsorted(ascending, here + reach + _ROUNDING, "right")
            window = slice(max(window.start, int(first)), min(window.stop, int(end)))
        within = np.abs(self.arc[window] - arc) <= self.radius
        within &= np.abs(self.time[window] - time) <= self.duration
        return self.frames[window][within]


class KeyFrames:
    """The key frames that vote on each sweep: their indices, ascending; chosen when asked for.

    The trajectory is subsampled twice: fine key frames vote on sweeps nearby, coarse ones also on
    sweeps farther away. With ``time_spacing``, key frames are also chosen by time where the vehicle
    crawls or stands, to see cross traffic come and go, and near the ends of the drive, where a
    sweep has key frames on one side only. A key frame votes once, never on its own sweep, and not
    over a gap: a car that parks may have left in it.

    Parameters
    ----------
    trajectory : Trajectory
    parameters : DynamicsParameters, optional
    """

    def __init__(
        self, trajectory: Trajectory, parameters: DynamicsParameters | None = None
    ) -> None:
        p = parameters or DynamicsParameters()
        self._arc, self._part = trajectory.arc_length, trajectory.part
        self._time = (trajectory.times - trajectory.times[0]) * 1e-9
        self._families = [
            self._family(trajectory.subsample(p.fine_spacing), p.fine_radius, np.inf),
            self._family(trajectory.subsample(p.coarse_spacing), p.coarse_radius, np.inf),
        ]
        self._ends = np.zeros(0, np.int64)
        if p.time_spacing:
            often = trajectory.subsample(p.fine_spacing, p.time_spacing)
            self._families.append(self._family(often, p.fine_radius, TIME_RADIUS))
            last = [part[-1] for part in trajectory.parts]
            self._ends = np.union1d(trajectory.subsample(np.inf, END_SPACING), last)
        self._chosen = lru_cache(_RECENT)(self._choose)

    def _family(self, frames: NDArray[np.int64], radius: float, duration: float) -> _Family:
        return _Family(frames, self._arc[frames], self._time[frames], radius, duration)

    def __getitem__(self, i: int) -> NDArray[np.int64]:
        return self._chosen(i)

    def _choose(self, i: int) -> NDArray[np.int64]:
        time, ends, part = self._time, self._ends, self._part(i)
        near = [of.near(self._arc[i], time[i]) for of in self._families]
        if time[part[-1]] - time[i] <= END_RADIUS:
            near.append(ends[np.searchsorted(ends, i, "right") :])
        if time[i] - time[part[0]] <= END_RADIUS:
            near.append(ends[: np.searchsorted(ends, i, "left")])
        every = np.unique(np.concatenate(near))
        every = every[(every >= part.start) & (every < part.stop) & (every != i)]
        return every.astype(np.int64, copy=False)
