"""Poses of a run against true ones, by the figures of evo and of KITTI's odometry benchmark."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator
from dataclasses import astuple, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets import Dataset, full_recording
from docdepth.datasets.sensor_pose import LevelledRecording
from docdepth.errors import InputError, OdometryError, log_findings
from docdepth.evaluation.tables import Figures, Table, number
from docdepth.geometry.se3 import inverse, nearest_rotation
from docdepth.geometry.trajectory import Trajectory
from docdepth.io.inputs import OWN_POSES
from docdepth.io.poses import read_timed_poses
from docdepth.io.run_folder import RunFolder
from docdepth.odometry.pose_checks import find_camera_poses, move_upwards
from docdepth.pipeline.given_poses import file_of_poses, read_given_poses
from docdepth.pipeline.plan import require
from docdepth.pipeline.run_inputs import open_recording

log = logging.getLogger(__name__)

Floats = NDArray[np.float64]

KITTI_LENGTHS = (100, 200, 300, 400, 500, 600, 700, 800)
"""Lengths of the parts of a path over which KITTI's benchmark measures drift [m]."""

_KITTI_STEP = 10  # poses from the beginning of one such part to that of the next


@dataclass(frozen=True)
class Errors(Figures):
    """Root mean square, mean, median and largest of some errors."""

    rmse: float
    mean: float
    median: float
    max: float

    @classmethod
    def of(cls, errors: Floats) -> Errors:
        """Of the sizes of errors, shape (n,)."""
        values = math.sqrt(np.mean(errors**2)), errors.mean(), np.median(errors), errors.max()
        return cls(*(float(value) for value in values))


@dataclass(frozen=True)
class TrajectoryResult(Figures):
    """Errors of poses.

    Attributes
    ----------
    poses : int
        Poses that are compared.
    length : float
        Length of the true path [m].
    source : str
        Where the poses of the run are from.
    ape : Errors
        Absolute pose error: distance of each position from the true one, after the path was moved
        and turned as a whole onto the true one [m].
    rpe, rpe_deg : Errors
        Relative pose error: of the motion from each pose to the next, [m] and [deg].
    drift, drift_deg : float
        KITTI's: errors of position and of rotation at the end of parts of 100 to 800 m, relative
        to their lengths [%] and [deg/100 m]; NaN for shorter drives.
    parts : int
        Number of these parts.
    """

    poses: int
    length: float
    source: str
    ape: Errors
    rpe: Errors
    rpe_deg: Errors
    drift: float
    drift_deg: float
    parts: int

    def table(self) -> Table:
        """A row for each kind of error."""
        shown = {
            "APE, position m": self.ape,
            "RPE from sweep to sweep, m": self.rpe,
            "RPE from sweep to sweep, deg": self.rpe_deg,
        }
        rows = [
            (name, *(number(value, 4) for value in astuple(errors)))
            for name, errors in shown.items()
        ]
        for unit, drift in (("%", self.drift), ("deg/100 m", self.drift_deg)):
            rows.append((f"drift over 100 to 800 m, {unit}", "-", number(drift, 4), "-", "-"))
        title = (
            f"trajectory: {self.poses} poses over {self.length:.0f} m, poses: {self.source}; "
            f"{self.parts} parts of 100 to 800 m"
        )
        return Table(title, ("error", "RMSE", "mean", "median", "largest"), tuple(rows), _NOTE)


_NOTE = (
    "APE: absolute pose error, after the path was moved and turned as a whole onto the true one, "
    "without a scale; RPE: relative pose error, of the motion from one sweep to the next; drift: "
    "KITTI's, error at the end of parts of the path relative to their length"
)


def compare_trajectories(
    truth: Trajectory, made: Trajectory, source: str = "not stated"
) -> TrajectoryResult:
    """Compare poses with true ones of the same sensor.

    Parameters
    ----------
    truth, made : Trajectory
        Where their times differ, the truth is interpolated; poses outside it are left out.
    source : str
        Where the poses are from; printed with the figures.
    """
    inside = truth.covers(made.times)
    if np.count_nonzero(inside) < 3:
        raise InputError(
            f"{np.count_nonzero(inside)} of {len(made)} poses lie within the times of the true "
            "ones; three are needed. Are they of this drive, and their times of the same clock?"
        )
    times, poses = made.times[inside], made.poses[inside]
    true = (
        truth if np.array_equal(truth.times, times) else Trajectory(times, truth.interpolate(times))
    )
    off, off_deg = _motion_errors(true.poses, poses, np.arange(len(poses) - 1), 1)
    parts = np.array(list(_parts(true.poses, poses))).reshape(-1, 2)
    drift = parts.mean(axis=0) if len(parts) else np.full(2, np.nan)
    return TrajectoryResult(
        poses=len(poses),
        length=float(_path(true.poses)[-1]),
        source=source,
        ape=Errors.of(_position_errors(true.poses, poses)),
        rpe=Errors.of(off),
        rpe_deg=Errors.of(off_deg),
        drift=100 * float(drift[0]),
        drift_deg=100 * float(drift[1]),
        parts=len(parts),
    )


def evaluate_trajectories(run: Path | str | RunFolder, poses: Path | str) -> TrajectoryResult:
    """Compare the poses of a run with true ones.

    Parameters
    ----------
    poses : Path or str
        As of ``docdepth run --poses``: a file of poses of the LiDAR, ``CAMERA:FILE``, or
        ``dataset`` for those of the recording. A file has a pose for each sweep of the recording;
        or the times of its poses, at any rate.
    """
    folder = RunFolder.open(run)
    require(folder, "odometry", frames=False)
    made = folder.trajectory()
    inputs = folder.inputs
    entry = inputs.but(poses=poses).poses or OWN_POSES
    file = file_of_poses(entry)
    recording = open_recording(inputs, folder.manifest.derived)
    timed = None if file is None else _of_other_rate(file, recording)
    truth = timed or Trajectory(made.times, read_given_poses(entry, recording))
    if not move_upwards(made.poses):
        log_findings(log, find_camera_poses(truth.poses))
    return compare_trajectories(truth, made, inputs.poses or "docdepth")


def _of_other_rate(file: Path, recording: Dataset) -> Trajectory | None:
    """The poses of a file with times that has no pose for each sweep; None of any other file."""
    whole = full_recording(recording)
    times, poses = read_timed_poses(file)
    if times is None or len(poses) == len(whole):
        return None
    if isinstance(whole, LevelledRecording):
        poses = poses @ inverse(whole.T_level_lidar)
    try:
        return Trajectory(times, poses)
    except InputError as error:
        raise OdometryError(f"{file}: {error}") from None


def _position_errors(true: Floats, made: Floats) -> Floats:
    """Distances of positions after the best rigid alignment (Umeyama 1991, without scale), (n,)."""
    target, source = true[:, :3, 3], made[:, :3, 3]
    middle, centre = target.mean(axis=0), source.mean(axis=0)
    rotation = nearest_rotation((target - middle).T @ (source - centre))
    return np.linalg.norm((source - centre) @ rotation.T - (target - middle), axis=1)


def _motion_errors(
    true: Floats, made: Floats, first: NDArray[np.int64], steps: int | NDArray[np.int64]
) -> tuple[Floats, Floats]:
    """Errors of the motions from some poses to those ``steps`` later, (k,): [m] and [deg]."""
    motions = [inverse(poses[first]) @ poses[first + steps] for poses in (true, made)]
    error = inverse(motions[0]) @ motions[1]
    skewed = error[:, :3, :3] - np.swapaxes(error[:, :3, :3], 1, 2)
    # The angle by sine and cosine: exact near 0 and near 180 degrees.
    sine = np.linalg.norm(skewed[:, (2, 0, 1), (1, 2, 0)], axis=1) / 2
    cosine = (np.trace(error[:, :3, :3], axis1=1, axis2=2) - 1) / 2
    return np.linalg.norm(error[:, :3, 3], axis=1), np.degrees(np.arctan2(sine, cosine))


def _path(poses: Floats) -> Floats:
    """Length of the path up to each pose [m], (n,), as KITTI's benchmark sums it."""
    steps = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])


def _parts(true: Floats, made: Floats) -> Iterator[tuple[float, float]]:
    """Errors of position and rotation [deg] at the end of each part, divided by its length."""
    path = _path(true)
    for first in range(0, len(path), _KITTI_STEP):
        for length in KITTI_LENGTHS:
            last = int(np.searchsorted(path, path[first] + length, side="right"))
            if last < len(path):
                off, off_deg = _motion_errors(true, made, np.array([first]), last - first)
                yield float(off[0]) / length, float(off_deg[0]) / length
