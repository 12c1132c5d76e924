"""The body of the vehicle: boxes whose points are no returns of the world."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from docdepth.datasets.base import Sweep


def without_ego(sweep: Sweep, boxes: Sequence[Sequence[float]]) -> Sweep:
    """A sweep whose points within the boxes are no returns.

    Rows stay, so that times, rings and labels keep theirs.

    Parameters
    ----------
    sweep : Sweep
    boxes : sequence of six numbers
        Least and greatest x, y and z, metres in the LiDAR frame.
    """
    if not boxes:
        return sweep
    points = sweep.points.copy()
    for box in boxes:
        low, high = np.array(box, np.float32).reshape(3, 2).T
        points[((sweep.points >= low) & (sweep.points <= high)).all(axis=1)] = np.nan
    return replace(sweep, points=points)
