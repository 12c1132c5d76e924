"""Depth maps against the recording itself: returns that were left out serve as ground truth.

A sweep is left out, or some beams of it, or a whole LiDAR of a rig. The depth map of its view is
drawn from all else, and each return is compared with the pixel that it falls into. Without the
nearest sweep the result is pessimistic. It says nothing about pixels between returns, or about
errors that all sweeps share.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from docdepth.concurrency import Progress, null_progress
from docdepth.errors import InputError
from docdepth.evaluation.depth import ERRORS
from docdepth.evaluation.depth_metrics import RANGE_BINS, PixelSums, RegionErrors
from docdepth.evaluation.left_out import LeftOut, Neighbour
from docdepth.evaluation.pixels import cloud_distance, project
from docdepth.evaluation.tables import Band, Figures, Table, number, plain, ratio
from docdepth.geometry.camera import View, points_of
from docdepth.geometry.points import DYNAMIC
from docdepth.geometry.se3 import inverse
from docdepth.geometry.trajectory import Trajectory
from docdepth.io.run_folder import RunFolder
from docdepth.io.tracks import tracks_in
from docdepth.pipeline.cameras import camera_parameters
from docdepth.pipeline.plan import require
from docdepth.render.depth_map import compose_depth, render_list
from docdepth.render.render_sweep import RenderSweep, prepare_sweep
from docdepth.render.selection import needed_sweeps


@dataclass(frozen=True)
class HeldOutResult(Figures):
    """Metrics over the returns that were left out.

    Attributes
    ----------
    sweeps : int
        Number of sweeps that were left out, one at a time.
    max_range : float
        Returns at a larger depth are not compared [m].
    all, static, dynamic : RegionErrors
        All returns, and those that the run itself classified as static or dynamic. Their
        ``edge_displacement`` is NaN: returns are too sparse for a map that is moved by a pixel.
    by_range : tuple of Band
        Returns with ``near < depth <= far`` [m].
    clear : RegionErrors
        Returns of which it is clear what their pixel shows: none beside a depth edge of its own
        sweep, and where a whole LiDAR was left out, none that the others could not see.
    point_to_point, clear_point_to_point : float
        From each return to the nearest point of the depth map, and back, over the pixels that have
        both [m]; of all returns, and of clear ones.
    left_out : str
        What was left out, in words.
    found : tuple of str
        What is wrong with poses, motion compensation or the camera, see
        :mod:`docdepth.diagnostics.error_sources` and :mod:`.camera_error`; empty if nothing was
        found or looked for.
    camera_mae, camera_wrong : float
        What a wrong camera adds, as far as the images tell: mean absolute difference of the maps
        [m], and pixels that it puts more than 5 % off [%]. NaN if nothing was found or looked for.
    """

    sweeps: int
    max_range: float
    all: RegionErrors
    static: RegionErrors
    dynamic: RegionErrors
    clear: RegionErrors
    by_range: tuple[Band[RegionErrors], ...]
    point_to_point: float
    clear_point_to_point: float
    left_out: str
    found: tuple[str, ...] = ()
    camera_mae: float = math.nan
    camera_wrong: float = math.nan

    def as_dict(self) -> dict[str, object]:
        """All metrics by name, ready for JSON; None replaces NaN."""
        result = super().as_dict()
        result["all"] = plain(self.all) | {"point_to_point": result.pop("point_to_point")}
        between = result.pop("clear_point_to_point")
        result["clear"] = plain(self.clear) | {"point_to_point": between}
        result["camera"] = {name: result.pop(f"camera_{name}") for name in ("mae", "wrong")}
        return result

    def table(self) -> Table:
        """Errors by class and range, one row each."""
        rows = {name: getattr(self, name) for name in ("all", "static", "dynamic", "clear")}
        rows |= {f"{band} m": band.figures for band in self.by_range}
        header = ("returns", "number", "density %", "MAE m", "RMSE m", "too near %", "too far %")
        distances = {"all": self.point_to_point, "clear": self.clear_point_to_point}
        cells = []
        for name, errors in rows.items():
            *figures, _, near, far = errors.cells()  # without the column of edge displacement
            distance = number(distances.get(name, math.nan), 3)
            cells.append((name, *figures, near, far, distance))
        title = f"depth against {self.sweeps} {self.left_out}, returns up to {self.max_range:g} m"
        note = ERRORS.replace("these pixels that", "the returns whose pixels") + _NOTE
        return Table(title, (*header, "point to point m"), tuple(cells), note)


_NOTE = (
    "; point to point: from each return to the nearest point of the depth map, and back; clear: "
    "without returns beside a depth edge of their sweep, whose pixel may show either side, and, if "
    "a LiDAR was left out, without those that no other LiDAR saw at that time"
)


@dataclass(frozen=True)
class HeldOutView:
    """A depth map and the returns that were left out of it.

    Attributes
    ----------
    index : int
        Of the sweep.
    name : str
        Of its file.
    depth, truth : ndarray of float32, shape (h, w)
        The map, and the returns in their pixels [m]; NaN = none.
    classid : ndarray of uint16, shape (h, w)
        Class of each return, 0 without one.
    clear : ndarray of bool, shape (h, w)
        Of which returns it is clear what their pixel shows.
    """

    index: int
    name: str
    depth: NDArray[np.float32]
    truth: NDArray[np.float32]
    classid: NDArray[np.uint16]
    clear: NDArray[np.bool_]


def evaluate_held_out(
    run: Path | str | RunFolder,
    every: int = 10,
    max_range: float = 80.0,
    camera: str | None = None,
    threads: int = 0,
    progress: Progress = null_progress,
    left_out: LeftOut | None = None,
    look: Callable[[HeldOutView], None] | None = None,
) -> HeldOutResult:
    """Compare depth maps with returns of the run's own sweeps that they are drawn without.

    The view of the camera is drawn from the position of the LiDAR, so that it sees what the LiDAR
    saw. A return is compared with the pixel that it falls into; the nearest return of a pixel
    counts. Poses and classes are those of the run, to which the returns that are left out have
    contributed.

    Parameters
    ----------
    run : Path, str or RunFolder
        Run folder with classified sweeps and the calibration of a camera.
    every : int
        Leave out every n-th sweep, one at a time.
    max_range : float
        Returns at a larger depth are not compared [m].
    camera : str, optional
        Gives the camera matrix, image size and viewing direction; needed if the run has several.
    left_out : LeftOut, optional
        Beams of the sweep, or a LiDAR of the rig in all sweeps; the whole sweep if left out.
    look : callable, optional
        Called with each :class:`HeldOutView`.
    """
    folder = RunFolder.open(run)
    require(folder, "classify")
    count = len(folder.trajectory())
    if every < 1 or count < 3:
        raise InputError(
            f"{count} sweeps, each {every}-th left out: give every >= 1 and at least 3 sweeps, so "
            "that one between the first and the last can be left out"
        )
    evaluated = range(1 + (min(every, count - 2) - 1) // 2, count - 1, every)
    sums, left_out = PixelSums(max_range, RANGE_BINS), left_out or LeftOut()
    distances = np.zeros((2, 2))  # sum and number, of all and of clear returns
    views = _HeldOutViews(folder, camera, threads, left_out)
    for done, index in enumerate(evaluated):
        view = views.view(index)
        with np.errstate(invalid="ignore"):
            compared = view.truth <= max_range  # false for pixels without a return
        truth = view.truth[compared].astype(np.float64)
        unknown = np.full(len(truth), np.nan)  # no shifted depth map
        moving = view.classid[compared] >= DYNAMIC
        sums.add(view.depth[compared] - truth, truth, unknown, view.clear[compared], moving)
        both = compared & ~np.isnan(view.depth)
        for row, chosen in enumerate((both, both & view.clear)):
            K, pixels = views.camera.K, np.flatnonzero(chosen)
            clouds = (points_of(K, depth, pixels) for depth in (view.truth, view.depth))
            distances[row] += cloud_distance(*clouds)
        if look:
            look(view)
        progress("held out", done + 1, len(evaluated))
    of_all, of_clear = distances.tolist()
    return HeldOutResult(
        sweeps=len(evaluated),
        max_range=max_range,
        all=sums.errors(),
        static=sums.errors(dynamic=0),
        dynamic=sums.errors(dynamic=1),
        clear=sums.errors(interior=1),
        by_range=sums.by_range(),
        point_to_point=ratio(*of_all),
        clear_point_to_point=ratio(*of_clear),
        left_out=str(left_out),
    )


class _HeldOutViews:
    """Draws the view of a sweep without what is left out."""

    def __init__(
        self, folder: RunFolder, camera: str | None, threads: int, left_out: LeftOut
    ) -> None:
        self._folder, self._threads, self._left_out = folder, threads, left_out
        self._trajectory, depths = folder.trajectory(), folder.depth_folder(camera)
        self._parameters = camera_parameters(folder, folder.camera_in(depths))
        self.camera, self._T_camera_lidar, _ = folder.calibration(depths)
        self._tracks = tracks_in(folder.path)
        self._sweeps: dict[tuple[int, bool, bool], RenderSweep] = {}

    def view(self, index: int) -> HeldOutView:
        """What is left out of sweep ``index``, and the depth map without it."""
        frame, classid = self._folder.classified_frame(index)
        view = self._left_out.view(frame)
        # The viewing direction of the camera, from the position of the LiDAR.
        T_camera_sensor = self._T_camera_lidar @ view.T_lidar_sensor
        T_camera_sensor[:3, 3] = 0
        truth, row = project(self.camera, T_camera_sensor, view.points)
        depth = self._depth_without(index, T_camera_sensor @ inverse(view.T_lidar_sensor))
        classes = np.where(row < 0, np.uint16(0), classid[row])
        poses = self._trajectory.poses
        neighbours = (
            Neighbour(self._folder.frame(k), inverse(poses[k]) @ poses[index])
            for k in (index - 1, index + 1)
        )
        clear = (row >= 0) & self._left_out.clear(frame, neighbours)[row]
        return HeldOutView(index, frame.name, depth, truth, classes, clear)

    def _depth_without(
        self, index: int, T_camera_lidar: NDArray[np.float64]
    ) -> NDArray[np.float32]:
        """The depth map at the pose of sweep ``index``."""
        trajectory = self._trajectory
        kept = np.arange(len(trajectory))
        if self._left_out.whole_sweep:
            kept = np.delete(kept, index)
        others = Trajectory(trajectory.times[kept], trajectory.poses[kept])
        time = int(trajectory.times[index])
        p, tracks = self._parameters, self._tracks
        needed = needed_sweeps(others, time, p.render, tracks)
        before = self._sweeps
        self._sweeps, sweeps = {}, {}
        for k, whole in sorted(needed.items()):
            own = int(kept[k])
            key = (own, whole, own == index)
            self._sweeps[key] = sweeps[k] = before.get(key) or self._sweep(*key)
        view = View(self.camera, T_camera_lidar @ inverse(trajectory.poses[index]), time)
        drawn = render_list(view, others, sweeps.__getitem__, p.render, tracks)
        return compose_depth(drawn, self._threads)

    def _sweep(self, index: int, whole: bool, evaluated: bool) -> RenderSweep:
        """Sweep ``index`` without what is left out of all sweeps, or of the evaluated one."""
        frame, _ = self._folder.classified_frame(index)
        if evaluated or self._left_out.lidar is not None:
            frame = frame.select(~self._left_out.rows(frame))
        p = self._parameters.render
        return prepare_sweep(frame, index, self._trajectory, p, self._tracks, whole)
