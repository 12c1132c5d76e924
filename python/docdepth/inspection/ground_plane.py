"""The ground of single sweeps as a plane: which way is up, and how high the LiDAR is."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

_REACH = (1.5, 40.0)  # metres; farther away the ground is not one plane
_VOXEL = 0.5  # metres; one point each, so that near surfaces do not outweigh the rest
_MOST_POINTS = 5000
_TRIALS = 600  # planes through three points; a quarter of all points on the ground gives nine
_NEAR_PLANE = 0.15  # metres
_BELOW = 0.4  # metres; nothing is measured below the ground but mirror images
_HEIGHTS = (-1.0, 30.0)  # metres of the origin above the ground; a vehicle's lies on it
_SPREAD = 2.0  # metres, deviation of the ground's points along its shorter side
_OTHER_DEG = 25.0  # from the ground: planes that are none
_OTHER = 0.8  # of the ground's score that they may have, else nobody knows which one it is
_LEAST_SHARE = 0.08  # of the points, on the ground
_TURNED = 0.4  # of a plane's weight that goes with z: a facade is no ground, though flat
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

    Of two planes that are as large, the one that is more level is taken: z is up in most frames.

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
    _, first = np.unique(np.floor(near / _VOXEL).astype(np.int64), axis=0, return_index=True)
    cloud = near[np.sort(first)]
    cloud = cloud[:: max(1, -(-len(cloud) // _MOST_POINTS))]
    if len(cloud) < 50:
        return None
    rng = np.random.default_rng(0)
    a, b, c = np.moveaxis(cloud[rng.integers(0, len(cloud), (_TRIALS, 3))], 1, 0)
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1)
    normals, a = normals[lengths > 1e-6], a[lengths > 1e-6]
    normals /= lengths[lengths > 1e-6, None]
    offsets = (normals * a).sum(axis=1)
    flip = np.where((cloud @ normals.T - offsets > 0).mean(axis=0) > 0.5, 1.0, -1.0)
    normals, heights = normals * flip[:, None], -offsets * flip  # most points are above
    scores = _scores(cloud, normals, heights)
    best = int(np.argmax(scores))
    up, height = normals[best], float(heights[best])
    others = normals @ up < np.cos(np.radians(_OTHER_DEG))
    if scores[others].max(initial=0.0) > _OTHER * scores[best]:
        return None
    spread = 0.0
    for _ in range(4):
        on = cloud[np.abs(cloud @ up + height) < _NEAR_PLANE]
        if len(on) < 3:
            return None
        _, lengths, axes = np.linalg.svd(on - on.mean(axis=0), full_matrices=False)
        spread, fitted = float(lengths[1] / np.sqrt(len(on))), axes[2]
        up = fitted if fitted @ up > 0 else -fitted
        height = float(-(on @ up).mean())
    share = float(np.mean(np.abs(cloud @ up + height) < _NEAR_PLANE))
    if share < _LEAST_SHARE or spread < _SPREAD or not _HEIGHTS[0] < height < _HEIGHTS[1]:
        return None
    return GroundPlane(up, height, share)


def _scores(
    cloud: NDArray[np.float64], normals: NDArray[np.float64], heights: NDArray[np.float64]
) -> NDArray[np.float64]:
    above = cloud @ normals.T + heights
    on = (np.abs(above) < _NEAR_PLANE).mean(axis=0)
    below = (above < -_BELOW).mean(axis=0)
    weight = 1 - _TURNED + _TURNED * normals[:, 2]
    scores = (on - 2 * below) * weight
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
