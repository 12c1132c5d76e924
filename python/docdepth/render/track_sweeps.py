"""Sweeps that saw other parts of a vehicle than those around the image (ours).

Beside us a lorry reaches above the highest beam; farther away, where it came from or goes to, the
LiDAR saw it whole.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from docdepth.geometry.lidar_frame import LidarFrame
from docdepth.geometry.points import DYNAMIC
from docdepth.geometry.se3 import inverse
from docdepth.geometry.track import Track, Tracks
from docdepth.geometry.trajectory import Trajectory

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
    return np.asarray(np.arctan2(top[..., 2], np.hypot(top[..., 0], top[..., 1])))


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
    elevation = np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1]))
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
