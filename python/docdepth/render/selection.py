"""Which sweeps an image is drawn from (paper V-B).

Only the part of the trajectory around the image is touched, so the length of the drive costs
nothing.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from docdepth.config import RenderParameters
from docdepth.geometry.track import Tracks
from docdepth.geometry.trajectory import Trajectory
from docdepth.render.track_sweeps import track_sweeps

DYNAMIC_SWEEPS = 4
"""Triangles: sweeps around an image that tell what moves and where nothing is. An object hidden by
a post in the nearest is seen by the next ones."""

STEP_GROWTH = 0.22
"""Triangles: spacing of static sweeps over their distance to the image [-]. Seen from the camera,
far sweeps differ little from each other: drawing all takes twice the time for 3 % less error."""


class DrawnSweeps(NamedTuple):
    """Indices of the sweeps of an image, in the order in which the core numbers them.

    Attributes
    ----------
    static : list of int
        Sweeps whose static points (ground included) are drawn.
    dynamic : list of int
        Sweeps around the image, the nearest in time first.
    tracked : list of int
        Further sweeps of which only vehicles are drawn.
    """

    static: list[int]
    dynamic: list[int]
    tracked: list[int]

    @property
    def with_objects(self) -> list[int]:
        """Sweeps that dynamic objects are drawn from: those around the image, then others."""
        others = [i for i in self.static if i not in self.dynamic]
        return self.dynamic + others + self.tracked


def drawn_sweeps(
    trajectory: Trajectory,
    time: int,
    parameters: RenderParameters | None = None,
    tracks: Tracks | None = None,
) -> DrawnSweeps:
    """Select the sweeps of the image taken at ``time`` [ns]."""
    p = parameters or RenderParameters()
    static, dynamic = static_sweeps(trajectory, time, p).tolist(), _dynamic(trajectory, time, p)
    if p.primitive == "splats" or not tracks:
        return DrawnSweeps(static, dynamic, [])
    tracked = [i for i in track_sweeps(trajectory, time, tracks) if i not in {*static, *dynamic}]
    return DrawnSweeps(static, dynamic, tracked)


def needed_sweeps(
    trajectory: Trajectory,
    time: int,
    parameters: RenderParameters | None = None,
    tracks: Tracks | None = None,
) -> dict[int, bool]:
    """All sweeps that :func:`~docdepth.render.depth_map.compose_depth` asks for.

    Returns
    -------
    dict of int to bool
        Whether a sweep is needed whole, or only what is near vehicles
        (:func:`~docdepth.render.track_sweeps.near_vehicles`).
    """
    drawn = drawn_sweeps(trajectory, time, parameters, tracks)
    return dict.fromkeys(drawn.tracked, False) | dict.fromkeys(drawn.static + drawn.dynamic, True)


def times_needed(
    trajectory: Trajectory,
    first: int,
    last: int,
    parameters: RenderParameters,
    tracks: Tracks,
) -> tuple[int, int]:
    """Bounds of the stamps of the sweeps that images taken from ``first`` to ``last`` [ns] need.

    Returns
    -------
    low, high : int
        Nanoseconds.
    """
    arc, times = trajectory.arc_length, trajectory.times
    here, there = trajectory.arc_length_at([first, last]).tolist()
    begin = min(_window(arc, here, parameters)[0], trajectory.nearest(first) - DYNAMIC_SWEEPS)
    end = max(_window(arc, there, parameters)[1], trajectory.nearest(last) + DYNAMIC_SWEEPS + 1)
    low, high = int(times[max(begin, 0)]), int(times[min(end, len(times)) - 1])
    for track in tracks.between(first, last):  # further sweeps of a vehicle
        low, high = min(low, int(track.times[0])), max(high, int(track.times[-1]))
    return low, high


def static_sweeps(
    trajectory: Trajectory, time: int, parameters: RenderParameters | None = None
) -> NDArray[np.int64]:
    """Select the sweeps whose static points are drawn into the image taken at ``time`` [ns].

    A sweep is a candidate when its arc length is less than ``behind`` before or less than ``ahead``
    after that of the image, and no gap lies between: cars may have come or gone in it.

    Splats: candidates in order of arc length, at least ``step`` apart. Among candidates of equal
    arc length (the ego stands) the nearest in time is taken.

    Triangles: first the sweep nearest in time, which is drawn with the highest priority, then
    others by their distance to the image. The path is divided at multiples of ``step``; a candidate
    is taken when it is the first after a multiple ``n * step``, n = m * 2^k with m odd, whose
    spacing ``2^k * step`` is at least ``STEP_GROWTH`` times its distance. Multiples belong to the
    path and not to the image, so consecutive images share their sweeps.

    Returns
    -------
    ndarray of int64, shape (k,)
        Indices of the trajectory, in the order in which they are drawn.
    """
    p = parameters or RenderParameters()
    here = float(trajectory.arc_length_at(time)[0])
    select = _spaced if p.primitive == "splats" else _thinned
    part = trajectory.part(trajectory.nearest(time))
    return np.array([i for i in select(trajectory, time, here, p) if i in part], dtype=np.int64)


def _window(arc: NDArray[np.float64], here: float, p: RenderParameters) -> tuple[int, int]:
    """First candidate and the one after the last; arc lengths never decrease."""
    begin = bisect_right(arc, -p.behind, key=lambda a: a - here)
    return begin, _first_beyond(arc, here, p.ahead, begin, len(arc))


def _first_beyond(
    arc: NDArray[np.float64], origin: float, distance: float, begin: int, end: int
) -> int:
    """First index from ``begin`` on where arc length exceeds ``origin`` by ``distance`` or more."""
    return bisect_left(arc, distance, begin, end, key=lambda a: a - origin)


def _spaced(trajectory: Trajectory, time: int, here: float, p: RenderParameters) -> list[int]:
    arc = trajectory.arc_length
    first, end = _window(arc, here, p)
    kept: list[int] = []
    while first < end:
        last = bisect_right(arc, arc[first], first, end)
        delay = np.abs(trajectory.times[first:last] - np.int64(time))
        kept.append(first + int(np.argmin(delay)))
        first = _first_beyond(arc, arc[first], p.step, last, end)
    return kept


def _thinned(trajectory: Trajectory, time: int, here: float, p: RenderParameters) -> list[int]:
    arc = trajectory.arc_length
    begin, end = _window(arc, here, p)
    nearest = trajectory.nearest(time)
    multiple = (arc[begin:end] // p.step).astype(np.int64)
    before = int(arc[begin - 1] // p.step) if begin else -1
    passed = np.diff(multiple, prepend=before)
    kept: list[int] = []
    for k in np.flatnonzero(passed > 0):
        sweep, last = begin + int(k), int(multiple[k])
        spacing = p.step * _roundest(last - int(passed[k]), last)
        apart = abs(arc[sweep] - arc[nearest]) >= p.step / 2
        if apart and STEP_GROWTH * abs(arc[sweep] - here) <= spacing:
            kept.append(sweep)
    kept.sort(key=lambda sweep: abs(arc[sweep] - here))
    return [nearest, *kept]


def _roundest(first: int, last: int) -> float:
    """The largest power of two that divides a number after ``first`` up to ``last``.

    It is the highest bit in which the two differ: the number that ends in zeros from there on lies
    between them. 0 is divided by all.
    """
    return np.inf if first < 0 <= last else float(1 << ((first ^ last).bit_length() - 1))


def _dynamic(trajectory: Trajectory, time: int, p: RenderParameters) -> list[int]:
    nearest = trajectory.nearest(time)
    if p.primitive == "splats":
        return [nearest]
    part = trajectory.part(nearest)
    first = max(nearest - DYNAMIC_SWEEPS, part.start)
    around = np.arange(first, min(nearest + DYNAMIC_SWEEPS + 1, part.stop))
    delay = np.abs(trajectory.times[around] - np.int64(time))
    return [int(i) for i in around[np.argsort(delay, kind="stable")[:DYNAMIC_SWEEPS]]]
