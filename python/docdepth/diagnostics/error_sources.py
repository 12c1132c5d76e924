"""Why held-out errors may be large: poses that jitter, sweeps that are not motion compensated."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from docdepth.concurrency import Progress, null_progress
from docdepth.datasets.point_times import sweep_seconds
from docdepth.errors import Finding
from docdepth.geometry.points import DYNAMIC
from docdepth.geometry.se3 import inverse, transform_points
from docdepth.geometry.trajectory import Trajectory
from docdepth.io.run_folder import RunFolder
from docdepth.odometry.deskewing import centred_motion, deskew

Points = NDArray[np.float32]
Floats = NDArray[np.float64]

SWEEPS = 12
"""Sweeps that are looked at, evenly chosen."""

_AROUND = 3  # sweeps before and after, with which one is aligned
_SAMPLING = 0.5  # metres, edge of a voxel in which a cloud keeps one point
_JITTER = 0.02  # metres; right poses reach 1 cm, and 4 cm along a motorway
_APART = (5.0, 15.0)  # metres between sweeps compared for compensation; nearer ones are alike
_NEAR = 1.0  # metres; farther points have no neighbour in the other sweep
_FASTER = 1.0  # metres a second; slower, sweeps need no compensation
_CLEARLY = 0.9  # of the distance as it is: another compensation has to lie this much closer


@dataclass(frozen=True)
class ErrorSources:
    """What the sweeps of a run say about its poses and its motion compensation.

    Attributes
    ----------
    jitter : float
        By how far poses are off their neighbours, in the median of the sweeps [m]: where a sweep
        lies when it is aligned with those before and those after it. NaN where nothing can be said.
    residual : dict of str to float
        Median distance between sweeps some metres apart [m]: ``as they are``, and if the points
        were moved by the motion during a sweep. Empty where the vehicle stands.
    """

    jitter: float
    residual: dict[str, float]

    @property
    def findings(self) -> list[Finding]:
        """What is wrong; empty if nothing is."""
        found = []
        if self.jitter > _JITTER:
            text = (
                f"the poses jitter: sweeps lie {100 * self.jitter:.0f} cm from where the sweeps "
                "before and after them say"
            )
            found.append(Finding("jitter", "", text, "use other poses, or docdepth's own"))
        best = min(self.residual, key=lambda name: self.residual[name], default=_AS_IS)
        if best != _AS_IS and self.residual[best] < _CLEARLY * self.residual[_AS_IS]:
            text = (
                f"the sweeps are not motion compensated as they should be: points of sweeps some "
                f"metres apart lie {100 * self.residual[_AS_IS]:.1f} cm from each other, and "
                f"{100 * self.residual[best]:.1f} cm {best}"
            )
            remedy = "check motion_compensated and the times of points"
            found.append(Finding("motion-compensation", "", text, remedy))
        return found


_AS_IS = "as they are"


def find_error_sources(
    run: Path | str | RunFolder, progress: Progress = null_progress
) -> ErrorSources:
    """Look for errors of poses and of motion compensation in the sweeps of a run.

    Parameters
    ----------
    run : Path, str or RunFolder
        With classified sweeps.
    """
    folder = RunFolder.open(run)
    trajectory = folder.trajectory()
    sweeps = _Sweeps(folder, trajectory)
    last = len(trajectory) - 1
    chosen = np.unique(np.linspace(0, last, SWEEPS + 2).round().astype(int)[1:-1]).tolist()
    shifts: list[Floats] = []
    pairs: list[dict[str, float]] = []
    for done, index in enumerate(chosen, 1):
        shift = _shift(sweeps, trajectory, index)
        shifts += [] if shift is None else [shift]
        pair = _residuals(sweeps, trajectory, index)
        pairs += [pair] if pair else []
        progress("poses and times", done, len(chosen))
    jitter = float(np.median(np.linalg.norm(shifts, axis=1))) if shifts else np.nan
    names = pairs[0] if pairs else {}
    return ErrorSources(jitter, {n: float(np.median([pair[n] for pair in pairs])) for n in names})


class _Sweeps:
    """The standing points of the sweeps of a run; those read last are kept."""

    def __init__(self, run: RunFolder, trajectory: Trajectory) -> None:
        self._run, self._kept = run, dict[int, tuple[Points, Points | None]]()
        self._period = sweep_seconds(trajectory.times)

    def __call__(self, index: int) -> tuple[Points, Points | None]:
        """Points, and their times after the stamp as shares of a sweep, or None."""
        if index not in self._kept:
            record, classid = self._run.classified_frame(index)
            standing = record.select(classid < DYNAMIC)
            late = standing.time_offset
            shares = None if late is None else late / np.float32(self._period)
            self._kept[index] = standing.points, shares
            for old in [k for k in self._kept if k < index - 40]:
                del self._kept[old]
        return self._kept[index]


def _shift(sweeps: _Sweeps, trajectory: Trajectory, index: int) -> Floats | None:
    """Where sweep ``index`` lies by those before and after it, in its frame (3,); the mean of both.

    Aligned with those before it alone, a sweep drifts along a street with what comes into view;
    aligned with those after it, the other way.
    """
    import small_gicp

    source, _ = small_gicp.preprocess_points(
        sweeps(index)[0].astype(np.float64), _SAMPLING, num_threads=1
    )
    found = []
    for step in (-1, 1):
        others = [index + step * k for k in range(1, _AROUND + 1)]
        if min(others) < 0 or max(others) >= len(trajectory):
            return None
        clouds = [_moved(sweeps(k)[0], trajectory, k, index) for k in others]
        target, tree = small_gicp.preprocess_points(
            np.concatenate(clouds), _SAMPLING, num_threads=1
        )
        aligned = small_gicp.align(target, source, tree, registration_type="GICP", num_threads=1)
        found.append(np.asarray(aligned.T_target_source)[:3, 3])
    return np.asarray(np.mean(found, axis=0))


def _residuals(sweeps: _Sweeps, trajectory: Trajectory, index: int) -> dict[str, float]:
    """Distance of two sweeps, as they are and moved by the motion during a sweep [m]."""
    other = _partner(trajectory, index)
    if other is None:
        return {}
    clouds: dict[str, list[Floats]] = {}
    for k in (index, other):
        points, shares = sweeps(k)
        motion = centred_motion(trajectory.poses, trajectory.times, [k])[0]
        for name, times in _ways(points, shares).items():
            moved = points if times is None else deskew(points, times, motion)
            clouds.setdefault(name, []).append(_moved(moved, trajectory, k, index))
    return {name: _distance(*pair) for name, pair in clouds.items()}


def _ways(points: Points, shares: Points | None) -> dict[str, Points | None]:
    """When points may have been measured, in words, if nobody compensated for it."""
    if shares is not None:
        return {
            _AS_IS: None,
            "moved once more by their times": shares,
            "moved back by their times": -shares,
        }
    turn = (np.arctan2(points[:, 1], points[:, 0]) / np.float32(2 * np.pi)).astype(np.float32)
    return {
        _AS_IS: None,
        "if a LiDAR measured them that turns clockwise": -turn,
        "if a LiDAR measured them that turns counterclockwise": turn,
    }


def _partner(trajectory: Trajectory, index: int) -> int | None:
    """The farthest sweep within reach; None where the vehicle stands or crawls."""
    apart = np.abs(trajectory.arc_length - trajectory.arc_length[index])
    inside = np.flatnonzero((apart > _APART[0]) & (apart < _APART[1]))
    if not len(inside) or np.linalg.norm(trajectory.velocity(index)) < _FASTER:
        return None
    return int(inside[np.argmax(apart[inside])])


def _moved(points: Points, trajectory: Trajectory, index: int, into: int) -> Floats:
    """Points of a sweep in the frame of another one."""
    T = inverse(trajectory.poses[into]) @ trajectory.poses[index]
    return transform_points(T, points.astype(np.float64))


def _distance(cloud: Floats, other: Floats) -> float:
    """Median distance of points to the planes of their neighbours in the other cloud [m]."""
    import small_gicp

    target, tree = small_gicp.preprocess_points(other, _SAMPLING / 2, num_threads=1)
    source, _ = small_gicp.preprocess_points(cloud, _SAMPLING / 2, num_threads=1)
    points = np.asarray(source.points())[:, :3]
    row, squared = (np.asarray(found) for found in tree.batch_nearest_neighbor_search(points))
    near = squared < _NEAR**2
    offset = points[near] - np.asarray(target.points())[row[near], :3]
    normal = np.asarray(target.normals())[row[near], :3]
    return float(np.median(np.abs(np.einsum("ij,ij->i", offset, normal)))) if near.any() else np.nan
