"""A recording whose points get their times from the rotation of the LiDAR."""

from __future__ import annotations

from dataclasses import replace

from docdepth.datasets.base import Dataset, Sweep, View
from docdepth.geometry.turn import Turn


class TurningLidar(View):
    """A recording of one spinning LiDAR, as measured, whose points have no times of their own.

    Parameters
    ----------
    whole : Dataset
        z of its points is the axis of the LiDAR, about.
    turn : Turn, optional
        None: points get no times.
    """

    def __init__(self, whole: Dataset, turn: Turn | None) -> None:
        super().__init__(whole)
        self.turn = turn

    def sweep(self, index: int) -> Sweep:
        """Sweep ``index`` as measured, with times of points."""
        sweep = super().sweep(index)
        times = None if self.turn is None else self.turn.relative_time(sweep.points)
        return replace(sweep, relative_time=times, motion_compensated=False)
