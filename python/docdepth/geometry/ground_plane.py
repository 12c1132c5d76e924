"""The ground of a drive as a plane: which way is up, and how high the LiDAR is."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

_REACH = (1.5, 40.0)  # metres; farther away the ground is not one plane
_VOXEL = 0.5  # metres; one point each, so that near surfaces do not outweigh the rest
_MOST_READ, _MOST_POINTS, _FEW_POINTS = 60_000, 5000, 1250  # before and after; of the first choice
_TRIALS = 2000  # planes through three points; a sixth of all points on the ground gives nine
_NEAR_PLANE = 0.15  # metres
_BELOW = 0.4  # metres; nothing is measured below the ground but mirror images
_HEIGHTS = (-1.0, 30.0)  # metres of the origin above the ground; a vehicle's lies on it
_SPREAD = 0.25  # metres, deviation of the ground's points along its shorter side
_LEAST_SHARE = 0.04  # of the points, on the ground
_REFINED, _FITS = 4, 4  # of similar planes that are fitted to their points, and how often
_MOST_DISTINCT = 60  # planes that are looked at closely
_CANDIDATES = 6  # planes of a sweep that may be its ground
_LEANING = (0.87, 0.5)  # cosine of the angle to z, up to 30 degrees and from 60 on
_TURNED = 0.5  # weight of planes that are turned farther: a facade is no ground, though flat
_MOUNTED, _HIGH = 3.5, 0.4  # metres: higher LiDARs are rare, and their planes have this weight
_SAME_DEG, _SAME_HEIGHT = 8.0, 1.0  # within which planes are one: a vehicle pitches and sinks less
_CLOSE, _FEWEST_CLOSE = 12.0, 20  # metres to the ground that a vehicle stands on; points a sweep
_OTHER_DEG = 20.0  # from the ground: planes that are no slope of it
_OTHER = 0.8  # of the ground's score that another may have, else nobody knows which one it is


class GroundPlane(NamedTuple):
    """The ground around a LiDAR."""

    up: NDArray[np.float64]  # (3,): unit normal in the LiDAR frame
    height: float  # of the frame's origin above it, metres
    share: float  # of voxels of the sweep that lie on it
    score: float  # higher for planes that are larger, lower and more level, with less below

    @property
    def tilt_deg(self) -> float:
        """Angle between z and ``up``, degrees."""
        return float(np.degrees(np.arccos(np.clip(self.up[2], -1, 1))))


def find_ground(sweeps: Sequence[NDArray[np.float32]]) -> GroundPlane | None:
    """The ground of a drive: the plane below the LiDAR that stays where it is from sweep to sweep.

    In each sweep some planes may be the ground, those with most points and next to nothing below
    them. A vehicle keeps the height and the lean of its LiDAR above the ground, not above facades,
    banks and roofs of cars, which come and go. Of two planes that are as good, the one that is more
    level and nearer is taken: z is up in most frames, and facades are farther away.

    Parameters
    ----------
    sweeps : sequence of ndarray of float32, shape (N, 3)
        Usable points of some sweeps in the LiDAR frame, metres; any axis may be up.

    Returns
    -------
    GroundPlane or None
        None if a third of the sweeps or less agree on one plane, or others on another one as well.
    """
    clouds = [_thinned(points) for points in sweeps]
    planes = [(k, plane) for k, cloud in enumerate(clouds) for plane in _candidates(cloud)]
    if not planes:
        return None
    of_sweep = np.array([k for k, _ in planes])
    ups = np.array([plane.up for _, plane in planes])
    heights, shares, scores = (np.array([p[k] for _, p in planes]) for k in (1, 2, 3))
    alike = ups @ ups.T > np.cos(np.radians(_SAME_DEG))
    same = alike & (np.abs(heights[:, None] - heights) < _SAME_HEIGHT)
    totals = np.zeros(len(planes))
    for k in range(len(sweeps)):
        totals += np.where(same[:, of_sweep == k], scores[of_sweep == k], 0).max(1, initial=0)
    best = int(np.argmax(totals))
    group = same[best]
    others = ups @ ups[best] < np.cos(np.radians(_OTHER_DEG))
    if totals[others].max(initial=0.0) > _OTHER * totals[best]:
        return None
    if 3 * len(np.unique(of_sweep[group])) <= len(sweeps):
        return None
    up = scores[group] @ ups[group]
    height, share = (float(np.median(values[group])) for values in (heights, shares))
    up, height = _road(clouds, up / np.linalg.norm(up), height)
    return GroundPlane(up, height, share, float(totals[best] / len(sweeps)))


def _road(
    clouds: Sequence[NDArray[np.float64]], up: NDArray[np.float64], height: float
) -> tuple[NDArray[np.float64], float]:
    """The ground close to the LiDAR in all sweeps together: beside a road it may slope."""
    close = np.concatenate([cloud[np.linalg.norm(cloud, axis=1) < _CLOSE] for cloud in clouds])
    found, level = up, height
    for distance in (2 * _NEAR_PLANE, _NEAR_PLANE, _NEAR_PLANE):
        on = close[np.abs(close @ found + level) < distance]
        if len(on) < _FEWEST_CLOSE * len(clouds):
            return up, height
        middle = on.mean(axis=0)
        across, normals = np.linalg.eigh((on - middle).T @ (on - middle) / len(on))
        found = normals[:, 0] * np.sign(normals[:, 0] @ up)
        level = -float(middle @ found)
        if across[1] < _SPREAD**2 or found @ up < np.cos(np.radians(_SAME_DEG)):
            return up, height
    return found, level


def _candidates(cloud: NDArray[np.float64]) -> list[GroundPlane]:
    """Planes of a thinned sweep that may be its ground, the best first."""
    if len(cloud) < 50:
        return []
    few = cloud[:: -(-len(cloud) // _FEW_POINTS)]
    rng = np.random.default_rng(0)
    a, b, c = np.moveaxis(cloud[rng.integers(0, len(cloud), (_TRIALS, 3))], 1, 0)
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1)
    normals, a = normals[lengths > 1e-6] / lengths[lengths > 1e-6, None], a[lengths > 1e-6]
    ups, heights, scores = _facing_points(few, normals, -(normals * a).sum(axis=1))
    rough = _distinct(scores, ups, heights, _REFINED)
    ups, heights, scores = _facing_points(cloud, *_refined(cloud, ups[rough], heights[rough]))
    found = list[GroundPlane]()
    for k in _distinct(scores, ups, heights, 1)[:_CANDIDATES]:
        on = np.abs(cloud @ ups[k] + heights[k]) < _NEAR_PLANE
        lengths = np.linalg.svd(cloud[on] - cloud[on].mean(axis=0), compute_uv=False)
        if on.mean() > _LEAST_SHARE and lengths[1] / np.sqrt(on.sum()) > _SPREAD:
            found.append(GroundPlane(ups[k], float(heights[k]), float(on.mean()), float(scores[k])))
    return found


def _distinct(
    scores: NDArray[np.float64],
    ups: NDArray[np.float64],
    heights: NDArray[np.float64],
    alike: int,
) -> list[int]:
    """The best planes, of those that are nearly the same a few only."""
    found: list[int] = []
    left = scores > 0
    while left.any() and len(found) < _MOST_DISTINCT:
        best = int(np.argmax(np.where(left, scores, -1)))
        same = (ups @ ups[best] > np.cos(np.radians(_SAME_DEG))) & left
        same &= np.abs(heights - heights[best]) < _SAME_HEIGHT
        group = np.flatnonzero(same)
        found += group[np.argsort(-scores[group])[:alike]].tolist()
        left &= ~same
    return found


def _thinned(points: NDArray[np.float32]) -> NDArray[np.float64]:
    """Some of the points around the LiDAR, at most one a voxel."""
    distance = np.linalg.norm(points, axis=1)
    near = points[(distance > _REACH[0]) & (distance < _REACH[1])].astype(np.float64)
    near = near[:: max(1, -(-len(near) // _MOST_READ))]
    voxels = np.floor(near / _VOXEL).astype(np.int64) + 2**12
    _, first = np.unique((voxels << [0, 16, 32]).sum(axis=1), return_index=True)
    cloud = near[np.sort(first)]
    return cloud[:: max(1, -(-len(cloud) // _MOST_POINTS))]


def _facing_points(
    cloud: NDArray[np.float64], normals: NDArray[np.float64], heights: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Normals to the side of most points, heights of the origin along them, and scores."""
    above = cloud @ normals.T + heights
    over, under = (above > _NEAR_PLANE).sum(axis=0), (above < -_NEAR_PLANE).sum(axis=0)
    beyond, below = (above > _BELOW).sum(axis=0), (above < -_BELOW).sum(axis=0)
    on = (np.abs(above) < _NEAR_PLANE).sum(axis=0)
    faces = over >= under
    signs = np.where(faces, 1.0, -1.0)
    ups, heights = normals * signs[:, None], heights * signs
    level = np.clip((ups[:, 2] - _LEANING[1]) / (_LEANING[0] - _LEANING[1]), 0, 1)
    weight = (_TURNED + (1 - _TURNED) * level) * np.where(heights > _MOUNTED, _HIGH, 1.0)
    scores = (on / len(cloud) - np.where(faces, below, beyond) / len(cloud)) * weight
    impossible = (heights < _HEIGHTS[0]) | (heights > _HEIGHTS[1])
    return ups, heights, np.where(impossible, -1.0, scores)


def _refined(
    cloud: NDArray[np.float64], ups: NDArray[np.float64], heights: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Planes fitted to the points on them, a few times."""
    ups, heights = ups.copy(), heights.copy()
    for k in range(len(ups)):
        for _ in range(_FITS):
            on = cloud[np.abs(cloud @ ups[k] + heights[k]) < _NEAR_PLANE]
            if len(on) < 3:
                break
            middle = on.mean(axis=0)
            ups[k] = np.linalg.eigh((on - middle).T @ (on - middle))[1][:, 0]
            heights[k] = -middle @ ups[k]
    return ups, heights


def level_turn(up: ArrayLike) -> NDArray[np.float64]:
    """The smallest turn (3, 3) that brings ``up``, a unit vector (3,), to z."""
    up = np.asarray(up, np.float64)
    if up[2] < -0.999:
        return np.diag([1.0, -1, -1])
    # Half a turn about the middle of both takes one to the other; half a turn about z keeps that.
    half = up + (0, 0, 1)
    half /= np.linalg.norm(half)
    return np.asarray(np.diag([-1.0, -1, 1]) @ (2 * np.outer(half, half) - np.eye(3)))
