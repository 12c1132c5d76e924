"""Places of a drive, and where one lies within another.

A place is what several sweeps see around one pose. Two places are first laid over each other as
maps seen from above, at every shift within reach at once: poses that drifted are no start for a
registration. small_gicp then registers the points, both ways.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from docdepth.geometry.se3 import (
    inverse,
    nearest_rigid,
    rigid,
    rotation_exp,
    se3_log,
    transform_points,
)
from docdepth.odometry.deskewing import centred_motion
from docdepth.odometry.registration import FEWEST_POINTS
from docdepth.odometry.sweeps import SweepPart, ThinnedSweeps, deskewed_points

REACH = 45.0
"""Points of a place lie within this distance of its pose, seen from above [m]."""

_SPAN, _SPACING = 15.0, 1.5  # metres of path before and behind the pose, and from sweep to sweep
_VOXEL = 0.5  # metres; of it a place keeps one point, and it is the pixel of a map
_TALL = 3  # voxels above each other, of which walls, trunks and vehicles have more than ground
_HIGHEST = 12  # voxels, so that a few high walls do not outweigh everything else
_YAW_STEP = 0.02  # radians; a pixel at half of the reach
_APART = 4.0  # metres; shifts farther from the best one are another answer
_NEIGHBORS = 10  # points that give the covariance of one
_ALIGN = {"num_threads": 1, "max_iterations": 40, "rotation_epsilon": 1e-4}
_COARSE, _FINE = 2.0, 0.8  # metres between points that are paired
_SAME = 0.4  # metres between points of one surface: those of a voxel may lie anywhere in it
_KEPT = 6  # places that are kept: those of both visits come one after the other
KEPT_SWEEPS = 64
"""Sweeps of places that follow each other are the same but for a few."""


class Placed(NamedTuple):
    """Where a place lies in the frame of another."""

    pose: NDArray[np.float64]  # (4, 4)
    likeness: float  # of both maps where they fit best, 0 to 1
    lead: float  # that over the likeness of the best other answer
    # share of what stands in one place and is in reach of the other that both show, the smaller of
    # both ways
    overlap: float
    # turn, shift: by which registration the other way differs [rad, m]
    turn: float
    shift: float


@dataclass(frozen=True)
class Place:
    """What several sweeps see around a pose."""

    # (N, 3): in the axes of the world, from the position of the sensor [m]
    points: NDArray[np.float64]

    def map(self, yaw: float = 0.0) -> NDArray[np.float64]:
        """The place seen from above, turned: how much stands in each pixel."""
        return _columns(self.points @ rotation_exp((0.0, 0.0, yaw)).T)[0]

    @cached_property
    def standing(self) -> NDArray[np.float64]:
        """Points (M, 3) of what stands on the ground."""
        heights, column = _columns(self.points)
        return self.points[heights.ravel()[column] > 0]

    @cached_property
    def registered(self) -> tuple[Any, Any]:
        """small_gicp's cloud with covariances, and its tree."""
        import small_gicp

        cloud = small_gicp.PointCloud(self.points)
        tree = small_gicp.KdTree(cloud)
        small_gicp.estimate_covariances(cloud, tree, _NEIGHBORS, 1)
        return cloud, tree


class Places:
    """Places along a drive whose poses are known."""

    def __init__(
        self,
        sweeps: ThinnedSweeps | SweepPart,
        poses: NDArray[np.float64],
        arc_length: NDArray[np.float64],
    ) -> None:
        self._sweeps, self._poses, self._arc = sweeps, poses, arc_length
        self.at = lru_cache(maxsize=_KEPT)(self._place)

    def _place(self, index: int) -> Place:
        """The place around the pose of a sweep."""
        import small_gicp

        here, origin, clouds = self._arc[index], self._poses[index, :3, 3], []
        marks = np.arange(-_SPAN, _SPAN + _SPACING / 2, _SPACING) + here
        for k in np.unique(np.searchsorted(self._arc, marks).clip(0, len(self._arc) - 1)).tolist():
            if abs(self._arc[k] - here) > _SPAN + _SPACING:
                continue
            motion = centred_motion(self._poses, self._sweeps.times, [k])[0]
            points = deskewed_points(self._sweeps[k], k, motion).astype(np.float64)
            points = points @ self._poses[k, :3, :3].T + (self._poses[k, :3, 3] - origin)
            clouds.append(points[np.hypot(points[:, 0], points[:, 1]) < REACH])
        points = np.concatenate(clouds)
        if len(points) < FEWEST_POINTS:
            return Place(points)
        cloud = small_gicp.voxelgrid_sampling(points, _VOXEL)
        return Place(np.asarray(cloud.points())[:, :3])


def _columns(points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """How many voxels stand above each other in a pixel, beyond ground; the pixel of each point."""
    half = int(REACH / _VOXEL) + 1
    width = 2 * half
    voxels = np.floor(points / _VOXEL).astype(np.int64)
    pixel = (voxels[:, 0] + half).clip(0, width - 1) * width
    pixel += (voxels[:, 1] + half).clip(0, width - 1)
    height = voxels[:, 2] - voxels[:, 2].min(initial=0)
    occupied = np.unique(pixel * (height.max(initial=0) + 1) + height) // (
        height.max(initial=0) + 1
    )
    count = np.bincount(occupied, minlength=width * width).reshape(width, width)
    return np.clip(count - (_TALL - 1), 0, _HIGHEST).astype(np.float64), pixel


def locate(
    one: Place, other: Place, guess: NDArray[np.float64], radius: float, turn: float
) -> Placed:
    """Find a place within another.

    Parameters
    ----------
    guess : ndarray of float64, shape (2,)
        Where the other's pose lies from that of ``one``, seen from above [m].
    radius, turn : float
        How wrong the guess and the axes may be [m, rad].

    Returns
    -------
    Placed
        Of ``other``, in the frame of ``one``; nothing is alike where points are too few.
    """
    if min(len(one.points), len(other.points)) < FEWEST_POINTS:
        return Placed(np.eye(4), 0.0, 0.0, 0.0, 0.0, 0.0)
    start, likeness, lead = _laid_over(one, other, guess, radius, turn)
    pose = _registered(one, other, start)
    back = _registered(other, one, inverse(start))
    omega, shift = se3_log(pose @ back)
    overlap = min(_overlap(one, other, pose), _overlap(other, one, inverse(pose)))
    lengths = float(np.linalg.norm(omega)), float(np.linalg.norm(shift))
    return Placed(pose, likeness, lead, overlap, *lengths)


def _laid_over(
    one: Place, other: Place, guess: NDArray[np.float64], radius: float, turn: float
) -> tuple[NDArray[np.float64], float, float]:
    """Pose (4, 4) at which both maps fit best, how well, and how much better than elsewhere."""
    fixed = one.map()
    low = np.floor((guess - radius) / _VOXEL).astype(int)
    high = np.ceil((guess + radius) / _VOXEL).astype(int)
    size = len(fixed) + int(np.abs([low, high]).max()) + 1
    spectrum = np.fft.rfft2(fixed, (size, size))
    rows, columns = np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1)
    shifts = _VOXEL * np.stack(np.meshgrid(rows, columns, indexing="ij"), axis=-1)
    inside = np.linalg.norm(shifts - guess, axis=-1) <= radius
    yaws = _YAW_STEP * np.arange(-round(turn / _YAW_STEP), round(turn / _YAW_STEP) + 1)
    fits = []
    for yaw in yaws:
        moved = other.map(yaw)
        product = spectrum * np.conj(np.fft.rfft2(moved, (size, size)))
        fit = np.fft.irfft2(product, (size, size))[np.ix_(rows % size, columns % size)]
        norm = np.sqrt((fixed * fixed).sum()) * np.sqrt((moved * moved).sum())
        fits.append(np.where(inside, fit / max(norm, 1e-9), 0.0))
    every = np.array(fits)
    best = np.unravel_index(int(every.argmax()), every.shape)
    likeness, place = float(every[best]), shifts[best[1:]]
    elsewhere = every[:, np.linalg.norm(shifts - place, axis=-1) > _APART]
    start = rigid(rotation_exp((0.0, 0.0, yaws[best[0]])))
    start[:2, 3] = place
    return start, likeness, likeness / max(float(elsewhere.max(initial=0.0)), 1e-9)


def _registered(target: Place, source: Place, start: NDArray[np.float64]) -> NDArray[np.float64]:
    """Pose (4, 4) of the source in the frame of the target."""
    import small_gicp

    (cloud, tree), (moved, _), pose = target.registered, source.registered, start
    for distance in (_COARSE, _FINE):
        found = small_gicp.align(
            cloud, moved, tree, pose, max_correspondence_distance=distance, **_ALIGN
        )
        if np.isfinite(found.T_target_source).all():
            pose = np.array(nearest_rigid(found.T_target_source), order="C")
    return pose


def _overlap(target: Place, source: Place, pose: NDArray[np.float64]) -> float:
    """Share of what stands in the source, in reach of the target, that the target shows, too."""
    points = transform_points(pose, source.standing)
    points = points[np.hypot(points[:, 0], points[:, 1]) < REACH]
    if not len(points):
        return 0.0
    _, squared = target.registered[1].batch_nearest_neighbor_search(points)
    return float((np.asarray(squared) < _SAME**2).mean())
