"""Results that cannot be right: one warning each, with the likely causes.

Each threshold lies between what right recordings give and what wrong ones give; both are named
beside it. Right are KITTI raw drives 0005 and 9001, and synthetic ones: city, crossing, rosette.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.viewpoint import LEAST_IN_TRIANGLES
from docdepth.geometry.points import DYNAMIC, GROUND
from docdepth.geometry.scan_mesh import share_in_triangles
from docdepth.geometry.sensor_rig import SensorRig

log = logging.getLogger(__name__)

SAMPLES = 5
"""Sweeps whose mesh is made to see whether their returns have neighbours."""

LEAST_GROUND = 0.01
"""Share of returns on the ground: 0.3 to 0.7."""

MOST_DYNAMIC = 0.5
"""Share of dynamic points of those above the ground: 0.01 to 0.45, the most at a busy crossing."""

LEAST_DENSITY = 0.05
"""Mean share of pixels with depth: 0.5 to 0.8."""


def sampled(count: int, most: int) -> list[int]:
    """At most ``most`` of ``count`` indices, evenly spread."""
    return sorted({int(k) for k in np.linspace(0, count - 1, min(count, most))})


def warn_of_viewpoint(
    points: Callable[[int], NDArray[np.float32]],
    rig: Callable[[int], SensorRig | None],
    count: int,
) -> None:
    """Warn if returns lack neighbours: they were not measured from where they are seen.

    Parameters
    ----------
    points : callable
        Points of a sweep, float32 (N, 3). A few sweeps are asked for.
    rig : callable
        Where a sweep was measured from.
    count : int
        Number of sweeps.
    """
    shares = []
    for k in sampled(count, SAMPLES):
        cloud = points(k)
        if len(cloud):
            shares.append(share_in_triangles(cloud, rig(k)))
    if shares and np.median(shares) < LEAST_IN_TRIANGLES:
        log.warning(
            "only %.0f %% of the returns have neighbours in their sweep: the points may be merged "
            "of several LiDARs, or be in the vehicle's frame; say with looks_from in "
            "docdepth.yaml where the LiDAR is",
            100 * np.median(shares),
        )


def count_classes(classid: NDArray[np.uint16]) -> NDArray[np.int64]:
    """Points of a sweep: all, of the ground, and dynamic ones, for :func:`warn_of_classes`."""
    ground, dynamic = classid == GROUND, classid >= DYNAMIC
    return np.array([len(classid), np.count_nonzero(ground), np.count_nonzero(dynamic)])


def warn_of_classes(counts: NDArray[np.int64]) -> None:
    """Warn if there is next to no ground, or if moving points are everywhere.

    Parameters
    ----------
    counts : ndarray of int64, shape (3,)
        The sum of those of each sweep, from :func:`count_classes`.
    """
    points, ground, dynamic = counts.tolist()
    if ground < LEAST_GROUND * points:
        log.warning(
            "only %.1f %% of the points are ground: the LiDAR's z axis may not point up, the poses "
            "may be wrong, or the points may not be in metres",
            100 * ground / points,
        )
    above = points - ground
    if dynamic > MOST_DYNAMIC * above:
        log.warning(
            "%.0f %% of the points above the ground are called dynamic: the poses or the order of "
            "the sweeps may be wrong, or the points may not be in the frame of the LiDAR",
            100 * dynamic / above,
        )


def warn_of_density(coverage: Sequence[float], camera: str) -> None:
    """Warn if the depth maps of a camera are all but empty; ``coverage`` is a share of each map."""
    if len(coverage) and np.mean(coverage) < LEAST_DENSITY:
        log.warning(
            "only %.1f %% of the pixels of %s have depth: the extrinsics or the intrinsics may be "
            "wrong, the image times may not fit, or the camera may look where the LiDAR does not",
            100 * np.mean(coverage), camera,
        )  # fmt: skip
