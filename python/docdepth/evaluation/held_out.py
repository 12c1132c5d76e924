"""Depth maps against the recording itself: sweeps that were left out serve as ground truth.

One sweep is left out, the depth map of its view is drawn from all other sweeps, and each return of
the sweep is compared with the pixel that it falls into. The result is pessimistic, since the map
lacks its nearest sweep. It says nothing about pixels between returns, or about errors that all
sweeps share.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from docdepth.errors import InputError
from docdepth.evaluation.depth import ERRORS, RANGE_BINS, RangeErrors
from docdepth.evaluation.depth_metrics import PixelSums, RegionErrors
from docdepth.evaluation.pixels import project
from docdepth.evaluation.tables import Table, plain
from docdepth.geometry.points import DYNAMIC
from docdepth.geometry.se3 import inverse
from docdepth.geometry.sensor_rig import lidar_views
from docdepth.geometry.trajectory import Trajectory
from docdepth.io.run_folder import RunFolder
from docdepth.pipeline.render import load_frame
from docdepth.pipeline.render_plan import tracks_of
from docdepth.pipeline.run_inputs import camera_parameters
from docdepth.pipeline.run_state import require
from docdepth.render.depth_map import compose_depth
from docdepth.render.frame import Frame
from docdepth.render.selection import needed_frames


@dataclass(frozen=True)
class HeldOutResult:
    """Metrics over the returns of the sweeps that were left out.

    Attributes
    ----------
    sweeps : int
        Number of sweeps that were left out, one at a time.
    max_range : float
        Returns at a larger depth are not compared [m].
    all, static, dynamic : RegionErrors
        All returns, and those that the run itself classified as static or dynamic. ``shifts`` is
        NaN: returns are too sparse for a map that is moved by a pixel.
    by_range : tuple of RangeErrors
    """

    sweeps: int
    max_range: float
    all: RegionErrors
    static: RegionErrors
    dynamic: RegionErrors
    by_range: tuple[RangeErrors, ...]

    def as_dict(self) -> dict[str, Any]:
        """All metrics by name, ready for JSON; None replaces NaN."""
        regions = {name: getattr(self, name).as_dict() for name in ("all", "static", "dynamic")}
        ranges = [{"near": r.near, "far": r.far, **r.errors.as_dict()} for r in self.by_range]
        head = {"sweeps": self.sweeps, "max_range": self.max_range}
        return dict(plain({**head, **regions, "by_range": ranges}))

    def table(self) -> Table:
        """Errors by class and range, one row each."""
        rows = [("all", self.all), ("static", self.static), ("dynamic", self.dynamic)]
        rows += [(f"{r.near:g}..{r.far:g} m", r.errors) for r in self.by_range]
        header = ("returns", "number", "density %", "MAE m", "RMSE m", "too near %", "too far %")
        cells = [(name, *errors.cells()[:4], *errors.cells()[5:]) for name, errors in rows]
        title = f"depth against {self.sweeps} held-out sweeps, returns up to {self.max_range:g} m"
        note = ERRORS.replace("these pixels that", "the returns whose pixels")
        return Table(title, header, tuple(cells), note)


class _Comparison(NamedTuple):
    """Returns of a held-out sweep against the depth map of the others, shape (k,) each."""

    truth: NDArray[np.float64]
    error: NDArray[np.float64]
    dynamic: NDArray[np.bool_]


def evaluate_held_out(
    run: Path,
    every: int = 10,
    max_range: float = 80.0,
    camera: str | None = None,
    threads: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> HeldOutResult:
    """Compare the depth maps of a run with its own sweeps, each left out of the map it judges.

    The view of the camera is drawn from the position of the LiDAR, so that it sees what the LiDAR
    saw. A return is compared with the pixel that it falls into; the nearest return of a pixel
    counts.

    Parameters
    ----------
    run : Path
        Run folder with classified sweeps and the calibration of a camera.
    every : int
        Leave out every n-th sweep, one at a time.
    max_range : float
        Returns at a larger depth are not compared [m].
    camera : str, optional
        Gives the camera matrix, image size and viewing direction; needed if the run has several.
    threads : int
        0 uses all cores. The result does not depend on it.
    progress : callable, optional
        Called with the number of finished sweeps and the number of all held-out sweeps.

    Returns
    -------
    HeldOutResult

    Raises
    ------
    InputError
        There are fewer than three sweeps, or ``every`` is below 1.
    RunError
        A sweep is not classified.
    """
    folder = RunFolder.open(run)
    require(folder, "classify")
    count = len(folder.trajectory())
    if every < 1 or count < 3:
        raise InputError(
            f"{count} sweeps, each {every}-th left out: give every >= 1 and at least 3 sweeps, so "
            "that one between the first and the last can be left out"
        )
    left_out = range(1 + (min(every, count - 2) - 1) // 2, count - 1, every)
    bins = [border for border in RANGE_BINS if border < max_range] + [max_range]
    sums = PixelSums(bins)
    views = _HeldOutViews(folder, camera, threads)
    for done, index in enumerate(left_out):
        found = views.compare(index, max_range)
        unknown = np.full(len(found.truth), np.nan)  # no shifted depth map
        nowhere = np.zeros(len(found.truth), bool)  # no interior
        sums.add(found.error, found.truth, unknown, nowhere, found.dynamic)
        if progress:
            progress(done + 1, len(left_out))
    return HeldOutResult(
        sweeps=len(left_out),
        max_range=max_range,
        all=sums.errors(),
        static=sums.errors(dynamic=0),
        dynamic=sums.errors(dynamic=1),
        by_range=tuple(
            RangeErrors(near, far, sums.errors(ranges=k))
            for k, (near, far) in enumerate(pairwise(bins))
        ),
    )


class _HeldOutViews:
    """Draws the view of a sweep from all other sweeps of a run."""

    def __init__(self, folder: RunFolder, camera: str | None, threads: int) -> None:
        self._folder, self._threads = folder, threads
        self._trajectory, depths = folder.trajectory(), folder.depth_folder(camera)
        self._parameters = camera_parameters(folder, folder.camera_in(depths))
        self._camera, self._T_camera_lidar, _ = folder.calibration(depths)
        self._tracks = tracks_of(folder)
        self._frames: dict[tuple[int, bool], Frame] = {}

    def compare(self, index: int, max_range: float) -> _Comparison:
        """Returns of sweep ``index``, at most ``max_range`` metres deep, against the others."""
        record, classid = self._folder.classified_frame(index)
        view = next(lidar_views(record.points, self._folder.sensor_rig(record)))
        # The viewing direction of the camera, from the position of the LiDAR.
        T_camera_sensor = self._T_camera_lidar @ view.T_lidar_sensor
        T_camera_sensor[:3, 3] = 0
        truth, row = project(self._camera, T_camera_sensor, view.points)
        depth = self._depth_without(index, T_camera_sensor @ inverse(view.T_lidar_sensor))
        compared = truth <= max_range  # false for pixels without a return, which are NaN
        known = truth[compared].astype(np.float64)
        return _Comparison(known, depth[compared] - known, classid[row[compared]] >= DYNAMIC)

    def _depth_without(
        self, index: int, T_camera_lidar: NDArray[np.float64]
    ) -> NDArray[np.float32]:
        """The depth map at the pose of sweep ``index``, drawn from all other sweeps."""
        trajectory = self._trajectory
        kept = np.delete(np.arange(len(trajectory)), index)
        others = Trajectory(trajectory.times[kept], trajectory.poses[kept])
        time = int(trajectory.times[index])
        p, tracks = self._parameters, self._tracks
        needed = needed_frames(others, time, p.render, tracks)
        wanted = {(int(kept[k]), whole): k for k, whole in sorted(needed.items())}
        self._frames = {
            (k, whole): self._frames.get((k, whole))
            or load_frame(self._folder, trajectory, k, p, tracks, whole)
            for k, whole in wanted
        }
        frames = {k: self._frames[at] for at, k in wanted.items()}
        # The renderer interpolates the pose between the neighbours; the estimated one is better.
        T_lidar_interpolated = inverse(trajectory.poses[index]) @ others.interpolate(time)[0]
        return compose_depth(
            self._camera,
            T_camera_lidar @ T_lidar_interpolated,
            others,
            time,
            frames.__getitem__,
            p.render,
            self._threads,
            tracks=tracks,
        )
