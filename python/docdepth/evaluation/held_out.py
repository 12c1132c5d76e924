"""How true depth maps are where no truth is recorded: sweeps that were left out tell.

A sweep is left out, its view is drawn from all others, and what is drawn is held against every
return that it had. A map has its sweeps nearer than that, since the nearest one was left out; but
what lies between returns is not judged, and what all sweeps measured wrongly is not seen.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from docdepth.errors import InputError
from docdepth.evaluation.depth import RANGE_BINS, RangeErrors
from docdepth.evaluation.depth_metrics import PixelSums, RegionErrors
from docdepth.evaluation.pixels import project
from docdepth.evaluation.tables import Table, plain
from docdepth.geometry.points import DYNAMIC
from docdepth.geometry.se3 import inverse
from docdepth.geometry.sensor_rig import lidar_views
from docdepth.geometry.trajectory import Trajectory
from docdepth.io.run_folder import RunFolder
from docdepth.pipeline.render import load_frame
from docdepth.render import depth_map as render
from docdepth.render.frame import Frame
from docdepth.render.selection import needed_frames


@dataclass(frozen=True)
class HeldOutResult:
    """Figures over the returns of sweeps that were left out.

    Attributes
    ----------
    sweeps : int
        Number of sweeps left out, one at a time.
    max_range : float
        Returns at a larger depth are not compared [m].
    all, standing, moving : RegionErrors
        All returns, and by the run's own classes of them. ``shifts`` is NaN: returns are too sparse
        to be moved by a pixel.
    by_range : tuple of RangeErrors
    """

    sweeps: int
    max_range: float
    all: RegionErrors
    standing: RegionErrors
    moving: RegionErrors
    by_range: tuple[RangeErrors, ...]

    def as_dict(self) -> dict[str, Any]:
        """Everything by name, ready for JSON; what is undefined is None."""
        regions = {name: getattr(self, name).as_dict() for name in ("all", "standing", "moving")}
        ranges = [{"near": r.near, "far": r.far, **r.errors.as_dict()} for r in self.by_range]
        head = {"sweeps": self.sweeps, "max_range": self.max_range}
        return dict(plain({**head, **regions, "by_range": ranges}))

    def table(self) -> Table:
        """Errors by class and range, for a terminal or a report."""
        rows = [("all", self.all), ("standing", self.standing), ("moving", self.moving)]
        rows += [(f"{r.near:g}..{r.far:g} m", r.errors) for r in self.by_range]
        header = ("returns", "number", "density %", "MAE m", "RMSE m", "too near %", "too far %")
        cells = [(name, *errors.cells()[:4], *errors.cells()[5:]) for name, errors in rows]
        title = f"depth against {self.sweeps} sweeps left out, returns up to {self.max_range:g} m"
        return Table(title, header, tuple(cells))


def evaluate_held_out(
    run: Path,
    every: int = 10,
    max_range: float = 80.0,
    camera: str | None = None,
    threads: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> HeldOutResult:
    """Depth maps of a run against its own sweeps, each left out of the map that it judges.

    The view of the camera is drawn from where the LiDAR stands, so that it sees what the LiDAR saw.
    A return is compared with the pixel that it falls into, the nearest one where there are several.

    Parameters
    ----------
    run : Path
        Run folder with classified frames and the calibration of a camera.
    every : int
        Each so many-th sweep is left out, one at a time.
    max_range : float
        Returns at a larger depth are not compared [m].
    camera : str, optional
        Whose matrix, size and direction; needed where there are several.
    threads : int
        0 takes every core. The result does not depend on it.
    progress : callable, optional
        Told how many sweeps of how many are done.

    Returns
    -------
    HeldOutResult

    Raises
    ------
    InputError
        There are fewer than three sweeps, or ``every`` is below 1.
    RunError
        A frame has no classes.
    """
    folder = RunFolder.open(run)
    trajectory, p = folder.trajectory(), folder.parameters
    if every < 1 or len(trajectory) < 3:
        raise InputError(
            f"{len(trajectory)} sweeps, each {every}-th left out: between the first and the last "
            "there must be one to leave out"
        )
    view, T_camera_lidar, _ = folder.calibration(folder.depth_folder(camera))
    inner = len(trajectory) - 2
    left_out = range(1 + (min(every, inner) - 1) // 2, len(trajectory) - 1, every)
    bins = [b for b in RANGE_BINS if b < max_range] + [max_range]
    sums = PixelSums(bins)
    made: dict[int, Frame] = {}
    for done, index in enumerate(left_out):
        record, classid = folder.classified_frame(index)
        seen = next(lidar_views(record.points, folder.sensor_rig(record)))
        T_camera_sensor = T_camera_lidar @ seen.T_lidar_sensor
        T_camera_sensor[:3, 3] = 0
        truth, row = project(view, T_camera_sensor, seen.points)

        kept = np.delete(np.arange(len(trajectory)), index)
        others = Trajectory(trajectory.times[kept], trajectory.poses[kept])
        time = int(trajectory.times[index])
        needed = sorted(needed_frames(others, time, p.render))
        made = {
            i: made.get(i) or load_frame(folder, trajectory, i, p) for i in kept[needed].tolist()
        }
        frames = {k: made[int(kept[k])] for k in needed}
        # The others put the LiDAR between the sweeps before and after; it is known better.
        T_lidar_between = inverse(trajectory.poses[index]) @ others.interpolate(time)[0]
        depth = render.compose_depth(
            view,
            T_camera_sensor @ inverse(seen.T_lidar_sensor) @ T_lidar_between,
            others,
            time,
            frames.__getitem__,
            p.render,
            threads,
        )
        compared = truth <= max_range  # not where there is no return, which is NaN
        there = truth[compared].astype(np.float64)
        error, moving = depth[compared] - there, classid[row[compared]] >= DYNAMIC
        sums.add(error, there, np.full(len(there), np.nan), np.zeros(len(there), bool), moving)
        if progress:
            progress(done + 1, len(left_out))
    return HeldOutResult(
        sweeps=len(left_out),
        max_range=max_range,
        all=sums.errors(),
        standing=sums.errors(dynamic=0),
        moving=sums.errors(dynamic=1),
        by_range=tuple(
            RangeErrors(near, far, sums.errors(ranges=k))
            for k, (near, far) in enumerate(pairwise(bins))
        ),
    )
