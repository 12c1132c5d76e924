"""Checks of results: classes and depth maps that cannot be right.

Each threshold lies between what right recordings give and what wrong ones give; both are named
beside it. Right are KITTI raw drives 0005 and 9001, and synthetic ones: city, crossing, rosette.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from docdepth.errors import Finding
from docdepth.geometry.points import DYNAMIC, GROUND

_LEAST_GROUND = 0.01  # share of returns on the ground: 0.3 to 0.7
# Share of dynamic points of those above the ground: 0.01 to 0.45, the most at a busy crossing; 0.79
# between lorries on a motorway, which is right, too.
_MOST_DYNAMIC = 0.5
_LEAST_DENSITY = 0.05  # mean share of pixels with depth: 0.5 to 0.8


def count_classes(classid: NDArray[np.uint16]) -> NDArray[np.int64]:
    """Points of a sweep: all, of the ground, and dynamic ones, for :func:`check_classes`."""
    ground, dynamic = classid == GROUND, classid >= DYNAMIC
    return np.array([len(classid), np.count_nonzero(ground), np.count_nonzero(dynamic)])


def check_classes(counts: NDArray[np.int64]) -> list[Finding]:
    """Whether there is next to no ground, or moving points are everywhere.

    Parameters
    ----------
    counts : ndarray of int64, shape (3,)
        The sum of those of each sweep, from :func:`count_classes`.
    """
    points, ground, dynamic = counts.tolist()
    above, found = points - ground, []
    if ground < _LEAST_GROUND * points:
        text = (
            f"only {100 * ground / points:.1f} % of the points are ground: the LiDAR's z axis may "
            "not point up, the poses may be wrong, or the points may not be in metres"
        )
        found.append(Finding("no-ground", "", text))
    if dynamic > _MOST_DYNAMIC * above:
        text = (
            f"{100 * dynamic / above:.0f} % of the points above the ground are called dynamic: "
            "unless traffic is all around, the poses or the order of the sweeps may be wrong, or "
            "the points may not be in the frame of the LiDAR"
        )
        found.append(Finding("much-dynamic", "", text))
    return found


def check_density(coverage: Sequence[float], camera: str) -> list[Finding]:
    """Whether the depth maps of a camera are all but empty; ``coverage`` is a share of each map."""
    if not len(coverage) or np.mean(coverage) >= _LEAST_DENSITY:
        return []
    text = (
        f"only {100 * np.mean(coverage):.1f} % of the pixels of {camera} have depth: the "
        "extrinsics or the intrinsics may be wrong, the image times may not fit, or the camera may "
        "look where the LiDAR does not"
    )
    return [Finding("empty-maps", "", text)]
