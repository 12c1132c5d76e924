"""The result of looking at a recording."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets import Sweep
from docdepth.diagnostics.poses import Window
from docdepth.errors import Finding
from docdepth.geometry.ground_plane import GroundPlane
from docdepth.visualization.inspection import Figures


@dataclass
class Inspection:
    """What a recording holds.

    Attributes
    ----------
    figures : dict
        Of the recording, its sweeps, LiDARs, points, poses and cameras, ready for JSON.
    findings : list of Finding
        Errors, then warnings, then notes on what is unusual, but no problem.
    sweeps : dict of int to Sweep
        Those that were opened, by frame.
    poses : ndarray of float64, shape (n, 4, 4), or None
        ``T_world_lidar`` of every sweep.
    windows : list of Window
        Sweeps that were registered.
    ground : GroundPlane or None
    """

    figures: Figures = field(default_factory=dict)
    findings: list[Finding] = field(default_factory=list)
    sweeps: dict[int, Sweep] = field(default_factory=dict)
    poses: NDArray[np.float64] | None = None
    windows: list[Window] = field(default_factory=list)
    ground: GroundPlane | None = None

    def add(self, code: str, subject: str, text: str, remedy: str = "") -> None:
        """Add a warning."""
        self.findings.append(Finding(code, subject, text, remedy))

    def note(self, code: str, text: str, remedy: str = "") -> None:
        """Add what is unusual, but no problem."""
        self.findings.append(Finding(code, "", text, remedy, "note"))
