"""The result of looking at a recording."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets import Sweep
from docdepth.geometry.ground_plane import GroundPlane
from docdepth.inspection.pose_figures import Window
from docdepth.pipeline.problems import Problem


@dataclass
class Inspection:
    """What a recording holds.

    Attributes
    ----------
    figures : dict
        Of the recording, its sweeps, LiDARs, points, poses and cameras, ready for JSON.
    problems : list of Problem
        Errors first; empty if all is well.
    notes : list of str
        What is unusual, but no problem.
    sweeps : dict of int to Sweep
        Those that were opened, by frame.
    poses : ndarray of float64, shape (n, 4, 4), or None
        ``T_world_lidar`` of every sweep.
    windows : list of Window
        Sweeps that were registered.
    ground : GroundPlane or None
    """

    figures: dict[str, Any] = field(default_factory=dict)
    problems: list[Problem] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    sweeps: dict[int, Sweep] = field(default_factory=dict)
    poses: NDArray[np.float64] | None = None
    windows: list[Window] = field(default_factory=list)
    ground: GroundPlane | None = None
