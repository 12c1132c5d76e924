"""Key frames, and how they vote on the points of a sweep (paper IV-C, Algorithm 1)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import docdepth._core as _core
from docdepth.config import DynamicsParameters
from docdepth.errors import InputError
from docdepth.geometry.lidar_frame import SensorRig, lidar_views
from docdepth.geometry.points import ShortRepr
from docdepth.geometry.scan_mesh import ScanMesh
from docdepth.geometry.trajectory import Trajectory

NEVER = 65535
"""Stands for a key frame where there was none."""

MAX_STATIC_RATIO = int(_core.ClassificationOptions().max_static_ratio)
"""A place was free only if fewer than so many times as many key frames found it occupied [-]. Of
the leaves of a tree that sixteen beams see, one ray in ten or more passes through."""


class OccupancyIntervals(NamedTuple):
    """When the place of each point of a sweep was occupied, as far as votes tell.

    Attributes
    ----------
    occupied_once : ndarray of bool, shape (N,)
        The place was free at some time, and was occupied in one stretch of time only, around the
        sweep: something arrived there, left or passed. Twigs and fences are found free and occupied
        in turn.
    porous : ndarray of bool, shape (N,)
        The place was occupied, free, and occupied again within a second. Few road users
        follow each other so closely.
    first, last : ndarray of uint16 or int32, shape (N,)
        The first and the last that found the place occupied: of votes the number of the key frame
        among those that voted, :data:`NEVER` if none did; of
        :meth:`Votes.occupancy_by_sweep` the sweep.
    """

    occupied_once: NDArray[np.bool_]
    porous: NDArray[np.bool_]
    first: NDArray[Any]
    last: NDArray[Any]


@dataclass(frozen=True, eq=False, repr=False)
class Votes(ShortRepr):
    """Votes of the key frames on the points of one sweep.

    Attributes
    ----------
    static : ndarray of uint16, shape (N,)
        Key frames that measured a surface at the point.
    dynamic : ndarray of uint16, shape (N,)
        Key frames that looked through the point.
    occupancy : OccupancyIntervals, optional
        Not kept in frames.
    """

    static: NDArray[np.uint16]
    dynamic: NDArray[np.uint16]
    occupancy: OccupancyIntervals | None = None

    def occupancy_by_sweep(self, key_frames: NDArray[np.int64], sweep: int) -> OccupancyIntervals:
        """When the points were occupied, by sweeps; ``sweep`` found all of them occupied itself.

        Places that nearly all key frames found occupied were never free.
        """
        if self.occupancy is None:
            raise InputError("tracking needs votes with their order; vote again")
        once, porous, first, last = self.occupancy
        once = once & (self.static < MAX_STATIC_RATIO * self.dynamic.astype(np.int64))
        index = np.full(NEVER + 1, sweep, np.int32)
        index[: len(key_frames)] = key_frames
        first = np.minimum(index[first], sweep, dtype=np.int32)
        return OccupancyIntervals(once, porous, first, np.maximum(index[last], sweep))


class KeyFrame:
    """A sweep prepared to vote on the points of other sweeps.

    With ``vote_model="range_image"`` it is the paper's range image; with ``"surface"`` its pixels
    also hold the triangles of the sweep's mesh, so that it votes between its returns, too.

    Parameters
    ----------
    points : ndarray of float32, shape (N, 3)
        The deskewed sweep, LiDAR frame, metres. Rows that are not finite or lie at the origin are
        no returns and are left out.
    ground : ndarray of bool, shape (N,)
    mesh : ScanMesh, optional
        Of these points; made here when needed and not given.
    sensor_rig : SensorRig, optional
        Where the sweep was measured from; each of several LiDARs votes from its own place.
    """

    def __init__(
        self,
        points: NDArray[np.float32],
        ground: NDArray[np.bool_],
        parameters: DynamicsParameters | None = None,
        mesh: ScanMesh | None = None,
        sensor_rig: SensorRig | None = None,
    ) -> None:
        p = parameters or DynamicsParameters()
        self._views: list[tuple[_core.KeyFrame, NDArray[np.float64]]] = []
        if p.vote_model == "range_image":
            size = np.radians(p.resolution_deg), p.window, p.tolerance
            for view in lidar_views(points, sensor_rig):
                image = _core.RangeImage(view.points, ground, *size)
                self._views.append((image, view.T_lidar_sensor))
            return
        for view, core in (mesh or ScanMesh(points, sensor_rig)).parts:
            surface = _surface_parameters(p)
            # The LiDAR frame has z up, the frame of one of its LiDARs need not.
            surface.up = view.T_lidar_sensor[2, :3].tolist()
            voter = _core.MeshImage(view.points, ground, core, surface)
            self._views.append((voter, view.T_lidar_sensor))


def vote(
    points: NDArray[np.float32],
    ground: NDArray[np.bool_],
    T_world_lidar: NDArray[np.float64],
    key_frames: Sequence[KeyFrame],
    poses: NDArray[np.float64],
    threads: int = 0,
    seconds: NDArray[np.float64] | None = None,
    coarse_first: bool = False,
) -> Votes:
    """Let key frames vote on every point of a sweep (Algorithm 1).

    Range images do not vote on ground points. Surfaces vote on every point, with a smaller
    tolerance where the point, or the triangle it is compared with, is ground. Rows that are not
    finite get no votes.

    Parameters
    ----------
    points : ndarray of float32, shape (N, 3)
        The deskewed sweep, LiDAR frame, metres.
    ground : ndarray of bool, shape (N,)
    T_world_lidar : ndarray of float64, shape (4, 4)
        Pose of the sweep.
    key_frames : sequence of KeyFrame, length k
        In order of time.
    poses : ndarray of float64, shape (k, 4, 4)
        ``T_world_lidar`` of each key frame.
    seconds : ndarray of float64, shape (k,), optional
        How long after the sweep each key frame was measured; negative before it. Absent if that is
        not known; then no place is porous.
    coarse_first : bool
        Of 24 key frames or more whose times are known, a third votes on a quarter of the points
        first, and all of them only near directions where anything was found free. Elsewhere points
        take the votes on a point near them, three for one.
    """
    voters = [
        (core, T_world_key @ T_lidar_sensor)
        for frame, T_world_key in zip(key_frames, poses, strict=True)
        for core, T_lidar_sensor in frame._views
    ]
    views = [len(frame._views) for frame in key_frames]
    if seconds is None:
        seconds = np.full(len(views), np.inf)
    static, dynamic, once, porous, first, last = _core.vote(
        points,
        ground,
        T_world_lidar,
        [core for core, _ in voters],
        np.array([T for _, T in voters]).reshape(-1, 4, 4),
        np.repeat(seconds, views).tolist(),
        threads,
        coarse_first,
    )
    number = np.full(NEVER + 1, NEVER, np.uint16)
    number[: sum(views)] = np.repeat(np.arange(len(views)), views)
    occupancy = OccupancyIntervals(
        once.view(np.bool_), porous.view(np.bool_), number[first], number[last]
    )
    return Votes(static, dynamic, occupancy)


def _surface_parameters(p: DynamicsParameters) -> _core.MeshImageParameters:
    """The public values; all others are constants, the defaults of the C++ structure."""
    core = _core.MeshImageParameters()
    core.resolution = float(np.radians(p.resolution_deg))
    core.window, core.tolerance = p.window, p.tolerance
    return core


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


class _Series(NamedTuple):
    """Key frames of one spacing."""

    frames: NDArray[np.int64]  # (k,): ascending
    # arc, time: (k,): path length [m] and time [s] of each, ascending
    arc: NDArray[np.float64]
    time: NDArray[np.float64]
    # radius, duration: they vote on sweeps within this path length [m] and time [s]
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
    """

    def __init__(
        self, trajectory: Trajectory, parameters: DynamicsParameters | None = None
    ) -> None:
        p = parameters or DynamicsParameters()
        self._arc, self._part = trajectory.arc_length, trajectory.part
        self._time = (trajectory.times - trajectory.times[0]) * 1e-9
        self._series = [
            self._spaced(trajectory.subsample(p.fine_spacing), p.fine_radius, np.inf),
            self._spaced(trajectory.subsample(p.coarse_spacing), p.coarse_radius, np.inf),
        ]
        self._ends = np.zeros(0, np.int64)
        if p.time_spacing:
            often = trajectory.subsample(p.fine_spacing, p.time_spacing)
            self._series.append(self._spaced(often, p.fine_radius, TIME_RADIUS))
            last = [part[-1] for part in trajectory.parts]
            self._ends = np.union1d(trajectory.subsample(np.inf, END_SPACING), last)
        self._chosen = lru_cache(_RECENT)(self._choose)

    def _spaced(self, frames: NDArray[np.int64], radius: float, duration: float) -> _Series:
        return _Series(frames, self._arc[frames], self._time[frames], radius, duration)

    def __getitem__(self, i: int) -> NDArray[np.int64]:
        return self._chosen(i)

    def _choose(self, i: int) -> NDArray[np.int64]:
        time, ends, part = self._time, self._ends, self._part(i)
        near = [of.near(self._arc[i], time[i]) for of in self._series]
        if time[part[-1]] - time[i] <= END_RADIUS:
            near.append(ends[np.searchsorted(ends, i, "right") :])
        if time[i] - time[part[0]] <= END_RADIUS:
            near.append(ends[: np.searchsorted(ends, i, "left")])
        every = np.unique(np.concatenate(near))
        every = every[(every >= part.start) & (every < part.stop) & (every != i)]
        return every.astype(np.int64, copy=False)
