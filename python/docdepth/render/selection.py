"""Which sweeps an image is drawn from (paper V-B).

Only the part of the trajectory around the image is touched, so the length of the drive costs
nothing. Further sweeps saw other parts of a vehicle (ours): beside us a lorry reaches above the
highest beam; farther away, where it came from or goes to, the LiDAR saw it whole.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from docdepth.config import RenderParameters
from docdepth.geometry.lidar_frame import LidarFrame
from docdepth.geometry.points import DYNAMIC, elevation_of
from docdepth.geometry.se3 import inverse
from docdepth.geometry.track import Track, Tracks
from docdepth.geometry.trajectory import Trajectory

DYNAMIC_SWEEPS = 4
"""Triangles: sweeps around an image that tell what moves and where nothing is. An object hidden by
a post in the nearest is seen by the next ones."""

STEP_GROWTH = 0.22
"""Triangles: spacing of static sweeps over their distance to the image [-]. Seen from the camera,
far sweeps differ little from each other: drawing all takes twice the time for 3 % less error."""


class DrawnSweeps(NamedTuple):
    """Indices of the sweeps of an image, in the order in which the core numbers them."""

    static: list[int]  # sweeps whose static points (ground included) are drawn
    dynamic: list[int]  # sweeps around the image, the nearest in time first
    tracked: list[int]  # further sweeps of which only vehicles are drawn

    @property
    def with_objects(self) -> list[int]:
        """Sweeps that dynamic objects are drawn from: those around the image, then others."""
        others = [i for i in self.static if i not in self.dynamic]
        return self.dynamic + others + self.tracked


def drawn_sweeps(
    trajectory: Trajectory,
    time: int,
    p: RenderParameters,
    tracks: Tracks | None = None,
) -> DrawnSweeps:
    """Select the sweeps of the image taken at ``time`` [ns]."""
    static, dynamic = static_sweeps(trajectory, time, p).tolist(), _dynamic(trajectory, time, p)
    if p.primitive == "splats" or not tracks:
        return DrawnSweeps(static, dynamic, [])
    tracked = [i for i in track_sweeps(trajectory, time, tracks) if i not in {*static, *dynamic}]
    return DrawnSweeps(static, dynamic, tracked)


def needed_sweeps(
    trajectory: Trajectory,
    time: int,
    parameters: RenderParameters,
    tracks: Tracks | None = None,
) -> dict[int, bool]:
    """All sweeps that :func:`~docdepth.render.depth_map.compose_depth` asks for.

    Returns
    -------
    dict of int to bool
        Whether a sweep is needed whole, or only what is near vehicles
        (:func:`~docdepth.render.selection.near_vehicles`).
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


def static_sweeps(trajectory: Trajectory, time: int, p: RenderParameters) -> NDArray[np.int64]:
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


Floats: TypeAlias = NDArray[np.float64]

HIGHEST = np.radians(2.0)
"""Vehicles that reach above this elevation are drawn from further sweeps [rad]: many LiDARs have no
beam above it. Lower ones are seen whole by the sweeps around the image."""

TOP_MARGIN = np.radians(0.5)
"""Boxes that end so far below the highest beam were not cut by it [rad]: a ring of a LiDAR whose
highest beam is as low as ``HIGHEST``."""

MOST_TRACK_SWEEPS = 8
"""Further sweeps of a vehicle. One for each half octave of range and eighth of a turn makes a dozen
of a vehicle that passes; neighbours of these show the same."""

BESIDE = np.radians(3.0)
"""Rays that pass this near to a vehicle are kept with it [rad]: more than the rings of any LiDAR
are apart, so that its mesh has neighbours all around."""


def track_sweeps(trajectory: Trajectory, time: int, tracks: Tracks) -> list[int]:
    """Sweeps that saw from elsewhere what is too high at ``time`` [ns] for some beams, ascending.

    The choice belongs to the tracks and not to the image, so consecutive images share it.
    """
    chosen: set[int] = set()
    for track in tracks.between(time, time):
        chosen.update(sweeps_of_track(track, trajectory, time))
    return sorted(chosen)


def sweeps_of_track(track: Track, trajectory: Trajectory, time: int) -> list[int]:
    """Sweeps that saw from elsewhere what of a vehicle is too high at ``time`` [ns], ascending."""
    if track.kind != "vehicle" or not track.covers(time):
        return []
    T_lidar_box = inverse(trajectory.interpolate(time)[0]) @ track.pose_at(time)
    return _views(track, trajectory) if _elevation_of_top(track, T_lidar_box) > HIGHEST else []


def lidar_range(track: Track, trajectory: Trajectory, time: int) -> float:
    """Distance from the LiDAR to an object at ``time`` [ns]."""
    here = trajectory.interpolate(time)[0][:3, 3]
    return float(np.linalg.norm(track.pose_at(time)[:3, 3] - here))


def seen_to_its_top(track: Track, trajectory: Trajectory) -> bool:
    """Whether some sweep looked above an object, so that the height of its box is its own."""
    _, T_box_lidar = _lidar_in_box(track, trajectory)
    return bool((_elevation_of_top(track, inverse(T_box_lidar)) < HIGHEST - TOP_MARGIN).any())


def _elevation_of_top(track: Track, T_lidar_box: Floats) -> Floats:
    """Elevation of the top of a box (...) [rad] for poses (..., 4, 4); the LiDAR may be tilted."""
    top = T_lidar_box @ (0, 0, track.size[2], 1)
    return np.asarray(elevation_of(top))


def _lidar_in_box(track: Track, trajectory: Trajectory) -> tuple[NDArray[np.int64], Floats]:
    """The sweeps that saw an object, (n,), and the poses of the LiDAR in its frame, (n, 4, 4)."""
    sweep = np.minimum(np.searchsorted(trajectory.times, track.times), len(trajectory) - 1)
    seen = trajectory.times[sweep] == track.times
    if track.points.any():
        seen &= track.points > 0
    sweep = sweep[seen]
    return sweep, inverse(track.poses[seen]) @ trajectory.poses[sweep]


def _views(track: Track, trajectory: Trajectory) -> list[int]:
    """Sweeps that saw a vehicle from all around, those whose highest beam met it highest.

    Of each half octave of range and eighth of a turn around it there is one: what is missing lies
    above the beams of the nearest sweep. At most ``MOST_TRACK_SWEEPS`` are taken.
    """
    sweep, T_box_lidar = _lidar_in_box(track, trajectory)
    if not len(sweep):
        return []
    lidar = T_box_lidar[:, :3, 3]
    away = np.maximum(np.hypot(lidar[:, 0], lidar[:, 1]), 1.0)
    octave = np.floor(2 * np.log2(away)).astype(np.int64)
    side = np.round(np.arctan2(lidar[:, 1], lidar[:, 0]) / (np.pi / 4)).astype(np.int64) % 8
    order = np.argsort(-_reach(track, trajectory, sweep), kind="stable")
    _, first = np.unique((8 * octave + side)[order], return_index=True)
    return sorted(sweep[order[np.sort(first)[:MOST_TRACK_SWEEPS]]].tolist())


def _reach(track: Track, trajectory: Trajectory, sweep: NDArray[np.int64]) -> Floats:
    """How high above the bottom of a vehicle a beam of elevation ``HIGHEST`` met it, (n,) [m]."""
    T_world_lidar = trajectory.poses[sweep]
    places = np.array([track.pose_at(time)[:3, 3] for time in trajectory.times[sweep].tolist()])
    local = np.einsum("nji,nj->ni", T_world_lidar[:, :3, :3], places - T_world_lidar[:, :3, 3])
    away = np.hypot(local[:, 0], local[:, 1])
    local[:, 2] = away * np.tan(HIGHEST)
    met = np.einsum("nij,nj->ni", T_world_lidar[:, :3, :3], local) + T_world_lidar[:, :3, 3]
    return np.asarray(met[:, 2] - places[:, 2])


def near_vehicles(frame: LidarFrame, tracks: Tracks) -> NDArray[np.bool_]:
    """Which points of a sweep lie on or beside a vehicle as the LiDAR sees it; shape (N,)."""
    points, instance = frame.points, frame.instance
    kept = np.zeros(len(points), np.bool_)
    if instance is None:
        return kept
    azimuth = np.arctan2(points[:, 1], points[:, 0])
    elevation = elevation_of(points)
    own = np.where(frame.classes >= DYNAMIC, instance, 0)
    for of in np.unique(own[own > 0]).tolist():
        if of not in tracks or tracks[of].kind != "vehicle":
            continue
        rows = np.flatnonzero(own == of)
        turn = azimuth - azimuth[rows[0]] + np.pi
        turn[turn < 0] += 2 * np.pi
        turn[turn >= 2 * np.pi] -= 2 * np.pi
        turn -= np.pi
        kept |= _between(turn, rows) & _between(elevation, rows)
    return kept


def _between(angle: NDArray[np.floating], rows: NDArray[np.int64]) -> NDArray[np.bool_]:
    low, high = angle[rows].min() - BESIDE, angle[rows].max() + BESIDE
    return np.asarray((low <= angle) & (angle <= high))
