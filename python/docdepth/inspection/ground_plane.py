"""The ground of single sweeps as a plane: which way is up, and how high the LiDAR is."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

_REACH = (1.5, 40.0)  # metres; farther away the ground is not one plane
_VOXEL = 0.5  # metres; one point each, so that near surfaces do not outweigh the rest
_MOST_READ, _MOST_POINTS = 60_000, 5000  # before and after this
_TRIALS = 600  # planes through three points; a quarter of all points on the ground gives nine
_NEAR_PLANE = 0.15  # metres
_BELOW = 0.4  # metres; nothing is measured below the ground but mirror images
_HEIGHTS = (-1.0, 30.0)  # metres of the origin above the ground; a vehicle's lies on it
_SPREAD = 2.0  # metres, deviation of the ground's points along its shorter side
_OTHER_DEG = 12.0  # from the ground: planes that are none
_OTHER = 0.8  # of the ground's score that they may have, else nobody knows which one it is
_LEAST_SHARE = 0.08  # of the points, on the ground
_REFINED, _FITS = 40, 4  # planes of these that are fitted to their points, and how often
_LEANING = (0.87, 0.5)  # cosine of the angle to z, up to 30 degrees and from 60 on
_TURNED = 0.5  # weight of planes that are turned farther: a facade is no ground, though flat
_MOUNTED, _HIGH = 3.5, 0.4  # metres: higher LiDARs are rare, and their planes have this weight
_SAME_DEG = 10.0  # within which sweeps agree


class GroundPlane(NamedTuple):
    """The ground around a LiDAR.

    Attributes
    ----------
    up : ndarray of float64, shape (3,)
        Unit normal in the LiDAR frame.
    height : float
        Of the frame's origin above it, metres.
    share : float
        Of voxels of the sweep that lie on it.
    """

    up: NDArray[np.float64]
    height: float
    share: float

    @property
    def tilt_deg(self) -> float:
        """Angle between z and ``up``, degrees."""
        return float(np.degrees(np.arccos(np.clip(self.up[2], -1, 1))))


def find_ground(points: NDArray[np.float32]) -> GroundPlane | None:
    """The plane below the LiDAR with most points, below which there is next to nothing.

    Of two planes that are as large, the one that is more level and nearer is taken: z is up in
    most frames, and facades are farther away than the ground.

    Parameters
    ----------
    points : ndarray of float32, shape (N, 3)
        Usable points in the LiDAR frame, metres; any axis may be up.

    Returns
    -------
    GroundPlane or None
        None if no plane is large enough.
    """
    distance = np.linalg.norm(points, axis=1)
    near = points[(distance > _REACH[0]) & (distance < _REACH[1])].astype(np.float64)
    near = near[:: max(1, -(-len(near) // _MOST_READ))]
    voxels = np.floor(near / _VOXEL).astype(np.int64) + 2**12
    _, first = np.unique((voxels << [0, 16, 32]).sum(axis=1), return_index=True)
    cloud = near[np.sort(first)]
    cloud = cloud[:: max(1, -(-len(cloud) // _MOST_POINTS))]
    if len(cloud) < 50:
        return None
    rng = np.random.default_rng(0)
    a, b, c = np.moveaxis(cloud[rng.integers(0, len(cloud), (_TRIALS, 3))], 1, 0)
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1)
    normals, a = normals[lengths > 1e-6] / lengths[lengths > 1e-6, None], a[lengths > 1e-6]
    ups, heights = _facing_points(cloud, normals, -(normals * a).sum(axis=1))
    rough = np.argsort(_scores(cloud, ups, heights))[-_REFINED:]
    ups, heights = _facing_points(cloud, *_refined(cloud, ups[rough], heights[rough]))
    scores = _scores(cloud, ups, heights)
    best = int(np.argmax(scores))
    up, height = ups[best], float(heights[best])
    others = ups @ up < np.cos(np.radians(_OTHER_DEG))
    if scores[best] <= 0 or scores[others].max(initial=0.0) > _OTHER * scores[best]:
        return None
    on = np.abs(cloud @ up + height) < _NEAR_PLANE
    lengths = np.linalg.svd(cloud[on] - cloud[on].mean(axis=0), compute_uv=False)
    if on.mean() < _LEAST_SHARE or lengths[1] / np.sqrt(on.sum()) < _SPREAD:
        return None
    return GroundPlane(up, height, float(on.mean()))


def _facing_points(
    cloud: NDArray[np.float64], normals: NDArray[np.float64], heights: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Normals to the side on which most points are, and heights of the origin along them."""
    above = cloud @ normals.T + heights
    more_above = (above > _NEAR_PLANE).sum(axis=0) >= (above < -_NEAR_PLANE).sum(axis=0)
    signs = np.where(more_above, 1.0, -1.0)
    return normals * signs[:, None], heights * signs


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


def _scores(
    cloud: NDArray[np.float64], normals: NDArray[np.float64], heights: NDArray[np.float64]
) -> NDArray[np.float64]:
    above = cloud @ normals.T + heights
    on = (np.abs(above) < _NEAR_PLANE).mean(axis=0)
    below = (above < -_BELOW).mean(axis=0)
    level = np.clip((normals[:, 2] - _LEANING[1]) / (_LEANING[0] - _LEANING[1]), 0, 1)
    weight = (_TURNED + (1 - _TURNED) * level) * np.where(heights > _MOUNTED, _HIGH, 1.0)
    scores = (on - below) * weight
    impossible = (heights < _HEIGHTS[0]) | (heights > _HEIGHTS[1])
    return np.asarray(np.where(impossible, -1.0, scores))


def common_ground(planes: Sequence[GroundPlane | None]) -> GroundPlane | None:
    """What most sweeps of a drive have for the ground; None if they do not agree."""
    found = [plane for plane in planes if plane is not None]
    if 2 * len(found) < len(planes) or not found:
        return None
    ups = np.array([plane.up for plane in found])
    alike = ups @ ups.T > np.cos(np.radians(_SAME_DEG))
    group = alike[int(alike.sum(axis=1).argmax())]
    if 2 * group.sum() < len(planes):
        return None
    up = ups[group].mean(axis=0)
    heights, shares = ([plane[k] for plane in found] for k in (1, 2))
    return GroundPlane(
        up / np.linalg.norm(up),
        float(np.median(np.array(heights)[group])),
        float(np.median(np.array(shares)[group])),
    )
