"""By how much the clocks of camera and LiDAR differ: points followed in the images of a run.

Points of standing things are followed over half a second of images. Their depth, and the motion of
the LiDAR meanwhile, tell where they must be seen; at which times that motion is taken, and from
where points are seen, depends on the offset. The offset is the one that fits what was followed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from docdepth.concurrency import Progress, null_progress
from docdepth.datasets import CameraStream
from docdepth.diagnostics.depth_edges import pixels_of_tracks
from docdepth.errors import CalibrationError
from docdepth.evaluation.camera_error import images_and_maps
from docdepth.evaluation.followed_points import Window, follow, predicted, smooth_pose
from docdepth.geometry.camera import View
from docdepth.geometry.points import evenly
from docdepth.geometry.se3 import inverse, rigid, rotation_exp, rotation_log
from docdepth.geometry.trajectory import Trajectory
from docdepth.io.depth import read_depth
from docdepth.io.run_folder import RunFolder
from docdepth.io.tracks import tracks_in
from docdepth.pipeline.cameras import fitted, open_cameras
from docdepth.pipeline.run_inputs import open_recording

Floats = NDArray[np.float64]

WORST_ERROR = 0.01
"""Standard deviation above which nothing is said [s]."""

LEAST_RATE = float(np.radians(2.0))
"""Deviation of the rate of turn over the drive [rad/s], below which nothing is said.

Straight ahead, an offset is no more than a camera farther ahead, and no errors show that.
"""

_SPAN = 0.5  # seconds that points are followed
_MOST_WINDOWS = 24
_FEWEST_WINDOWS, _FEWEST_POINTS = 5, 150
_FARTHEST = 0.2  # seconds that are tried
_GRID = 0.02  # seconds between them
_OUTLIER = 1.0  # pixels; a point that misses by more weighs less than half
_KNOWN = np.array([1.0, *np.radians([0.5] * 3), *[0.05] * 3])  # seconds; errors of the extrinsic
_STEPS = np.array([4e-3, *[1e-3] * 3, *[1e-2] * 3])  # of derivatives
_ROUNDS = 4


@dataclass(frozen=True)
class TimeOffset:
    """What to add to the times of the images.

    Attributes
    ----------
    seconds, error : float
        The offset and its standard deviation, by how windows disagree; an extrinsic that is off by
        0.5 degrees and 5 cm is taken into account.
    points, windows : int
        How many points were followed, and in how many half seconds.
    pixels : float
        By how much they miss with this offset, in the median.
    """

    seconds: float
    error: float
    points: int
    windows: int
    pixels: float

    @property
    def lines(self) -> list[str]:
        """The result in words."""
        ms, error = 1000 * self.seconds, 1000 * self.error
        verdict = f"the times of the images are right: they are off by {ms:.0f} +- {error:.0f} ms"
        if abs(ms) > 2 * error and abs(ms) > 5:
            verdict = (
                f"images are stamped {abs(ms):.0f} +- {error:.0f} ms too "
                f"{'early' if ms > 0 else 'late'}"
            )
        return [
            verdict,
            f"{self.points} points followed for {_SPAN:g} s, from {self.windows} images; they "
            f"miss by {self.pixels:.1f} px in the median",
        ]

    def corrected(self, times: NDArray[np.int64]) -> str:
        """Times of images [ns] with the offset, in seconds, a line each, for ``--camera-times``."""
        text = []
        for time in (times + round(1e9 * self.seconds)).tolist():
            seconds, rest = divmod(abs(time), 10**9)
            text.append(f"{'-' if time < 0 else ''}{seconds}.{rest:09d}\n")
        return "".join(text)

    @property
    def figures(self) -> dict[str, object]:
        """The result as plain values."""
        return {
            "offset_s": self.seconds,
            "error_s": self.error,
            "points": self.points,
            "windows": self.windows,
            "pixels": self.pixels,
        }


def time_offset(
    run: Path | str | RunFolder,
    camera: str | None = None,
    progress: Progress = null_progress,
) -> TimeOffset:
    """Estimate what is to be added to the times of the images of a run.

    Parameters
    ----------
    run : Path, str or RunFolder
        With depth maps, and images in its recording.
    camera : str, optional
        Its name; needed if the run has several.
    """
    folder = RunFolder.open(run)
    stream, maps = images_and_maps(folder, camera, "follow points in")
    windows = _windows(folder, stream, maps, progress)
    return offset_of(windows, stream, folder.trajectory(), folder.path)


def image_times(run: Path, camera: str | None = None) -> NDArray[np.int64]:
    """Times of all images of a camera of a run [ns], also of those beside its range of frames."""
    folder = RunFolder.open(run)
    inputs = folder.inputs.but(frames=None)
    name = folder.camera_in(folder.depth_folder(camera))
    recording = open_recording(inputs, folder.manifest.derived)
    stream = open_cameras(inputs, recording, [name])[0]
    return fitted(stream, folder.cameras[name].fit).times


def _windows(
    folder: RunFolder,
    stream: CameraStream,
    maps: dict[str, Path],
    progress: Progress,
) -> list[Window]:
    """Points followed from some images, none of which are followed at the same time."""
    trajectory, times = folder.trajectory(), stream.times
    tracks = tracks_in(folder.path)
    margin = round(1e9 * (_FARTHEST + 0.05))
    starts: list[tuple[int, int]] = []
    for first in range(len(times)):
        last = int(np.searchsorted(times, times[first] + round(0.95e9 * _SPAN)))
        free = not starts or first >= starts[-1][1]
        inside = times[first] - margin >= trajectory.times[0] and last < len(times)
        if free and inside and times[last] + margin <= trajectory.times[-1]:
            starts += [(first, last)] if stream.names[first] in maps else []
    chosen = [starts[k] for k in evenly(len(starts), _MOST_WINDOWS)]
    windows = []
    for done, (first, last) in enumerate(chosen, 1):
        time = int(times[first])
        view = View.at(stream.camera, stream.T_camera_lidar, trajectory, time)
        moving = pixels_of_tracks(tracks, view)
        images = []
        for index in range(first, last + 1):
            image = stream.rectified_image(index)
            assert image is not None
            images.append(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY))
        start, end = follow([np.asarray(image, np.uint8) for image in images], ~moving)
        depth = read_depth(maps[stream.names[first]])
        windows.append(Window(time, int(times[last]), start, end, depth))
        progress("time offset", done, len(chosen))
    return windows


def offset_of(
    windows: Sequence[Window], stream: CameraStream, trajectory: Trajectory, path: Path
) -> TimeOffset:
    """The offset that fits points that were followed; ``path`` is named in errors."""
    moved = _Motion(windows, stream, trajectory)
    if moved.count < _FEWEST_POINTS or moved.used < _FEWEST_WINDOWS:
        raise CalibrationError(
            f"{path}: {moved.count} points of standing things could be followed, in {moved.used} "
            f"half seconds; {_FEWEST_POINTS} in {_FEWEST_WINDOWS} are needed to compare clocks"
        )
    rate = moved.change_of_rate()
    if rate < LEAST_RATE:
        raise CalibrationError(
            f"{path} does not turn enough to compare the clocks of camera and LiDAR: its turns "
            f"change by {np.degrees(rate):.1f} degrees a second, "
            f"{np.degrees(LEAST_RATE):.0f} are needed; take a drive with bends"
        )
    state = np.zeros(7)
    for _ in range(2):  # depth belongs to the offset
        grid = np.arange(-_FARTHEST, _FARTHEST + _GRID / 2, _GRID)
        costs = [moved.cost(np.array([offset, *np.zeros(6)])) for offset in grid]
        state[0] = grid[int(np.argmin(costs))]
        moved.see_from(state[0])
    for _ in range(_ROUNDS):
        state, error, scatter = moved.step(state)
        moved.see_from(state[0])
    if abs(state[0]) > _FARTHEST:
        raise CalibrationError(
            f"{path}: the clocks of camera and LiDAR differ by more than {_FARTHEST:g} s, or the "
            "calibration is wrong",
            "compare the stamps (`docdepth.diagnostics.recording_report.inspect_recording()`)",
        )
    if not scatter < WORST_ERROR:
        raise CalibrationError(
            f"{path} tells the offset of the clocks of camera and LiDAR to "
            f"{1000 * scatter:.0f} ms only, {1000 * WORST_ERROR:.0f} ms are needed; take a longer "
            "drive with bends"
        )
    pixels = float(np.median(np.linalg.norm(error, axis=1)))
    return TimeOffset(float(state[0]), scatter, moved.count, moved.used, pixels)


class _Motion:
    """Where points of the windows are seen at their ends, for an offset and a change of extrinsic.

    A state is the offset [s], then turn [rad] and shift [m] of points in the camera's frame.
    """

    def __init__(
        self, windows: Sequence[Window], stream: CameraStream, trajectory: Trajectory
    ) -> None:
        self._windows, self._stream, self._trajectory = windows, stream, trajectory
        self._poses: dict[int, Floats] = {}
        self.see_from(0.0)

    @property
    def used(self) -> int:
        """Windows that have points."""
        return sum(len(points) > 0 for points, _ in self._points)

    @property
    def count(self) -> int:
        return sum(len(points) for points, _ in self._points)

    def change_of_rate(self) -> float:
        """Deviation of the rates of turn of the windows [rad/s]."""
        rates = []
        for window in self._windows:
            turn = inverse(self._pose(window.start)) @ self._pose(window.end)
            rates.append(rotation_log(turn[:3, :3]) / (1e-9 * (window.end - window.start)))
        return float(np.sqrt(np.var(rates, axis=0).sum()))

    def see_from(self, offset: float) -> None:
        """Take the depth of points from where the camera is with this offset."""
        T = self._stream.T_camera_lidar
        self._points = []
        for window in self._windows:
            there = self._pose(window.start + round(1e9 * offset))
            then = self._trajectory.interpolate(window.start)[0]
            motion = T @ inverse(there) @ then @ inverse(T)
            self._points.append(window.points(self._stream.camera, motion))

    def _pose(self, time: int) -> Floats:
        if time not in self._poses:
            self._poses[time] = smooth_pose(self._trajectory, time)
        return self._poses[time]

    def errors(self, state: Floats) -> list[Floats]:
        """Pixels by which points of each window miss, (n, 2)."""
        change = rigid(rotation_exp(state[1:4]), state[4:])
        T, offset = change @ self._stream.T_camera_lidar, round(1e9 * state[0])
        errors = []
        for window, (points, seen) in zip(self._windows, self._points, strict=True):
            start, end = (self._pose(time + offset) for time in (window.start, window.end))
            motion = T @ inverse(end) @ start @ inverse(T)
            errors.append(seen - predicted(points, motion, self._stream.camera))
        return errors

    def cost(self, state: Floats) -> float:
        errors = np.concatenate(self.errors(state))
        return float(np.log1p((errors**2).sum(axis=1) / _OUTLIER**2).sum())

    def step(self, state: Floats) -> tuple[Floats, Floats, float]:
        """One step of Gauss and Newton: the state, errors before it, deviation of the offset."""
        before = self.errors(state)
        slopes = []
        for k, size in enumerate(_STEPS):
            by = size * np.eye(7)[k]
            ahead, behind = self.errors(state + by), self.errors(state - by)
            slopes.append([(b - a) / (2 * size) for a, b in zip(ahead, behind, strict=True)])
        gradients, curves = [], []
        for k, error in enumerate(before):
            J = np.stack([slope[k] for slope in slopes], axis=-1)
            weight = 1 / (1 + (error**2).sum(axis=1) / _OUTLIER**2)
            gradients.append(np.einsum("n,nki,nk->i", weight, J, error))
            curves.append(np.einsum("n,nki,nkj->ij", weight, J, J))
        curve, meat = sum(curves), sum(np.outer(g, g) for g in gradients)
        # Windows err as a whole: they weigh less against what is known of the extrinsic.
        known = np.diag(1 / _KNOWN**2)
        noise = max(1.0, float(np.trace(np.linalg.pinv(curve) @ meat)) / len(state))
        pull = known * noise
        move = np.linalg.solve(curve + pull, sum(gradients) - pull @ state)
        left_out = [
            np.linalg.solve(curve + pull - one, g) for one, g in zip(curves, gradients, strict=True)
        ]
        spread = np.cov(np.array(left_out).T, bias=True) * (len(left_out) - 1)
        inverse_of = np.linalg.inv(curve + pull)
        spread = spread + inverse_of @ (pull * noise) @ inverse_of
        move[0] = np.clip(move[0], -_GRID, _GRID)
        return state + move, np.concatenate(before), float(np.sqrt(spread[0, 0]))
