"""Checks of poses: those that a user brings, and trajectories that jump."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

import docdepth._core as _core
from docdepth.config import OdometryParameters
from docdepth.datasets.base import Dataset
from docdepth.errors import Finding, InputError, OdometryError
from docdepth.geometry.points import evenly
from docdepth.geometry.se3 import check_rigid, inverse, transform_points
from docdepth.geometry.trajectory import Trajectory, parts_of
from docdepth.odometry.clock import even_steps
from docdepth.odometry.deskewing import centred_motion
from docdepth.odometry.first_motion import FIRST_SWEEPS, checked_motion, first_motion
from docdepth.odometry.registration import FEWEST_POINTS, split_level_ground
from docdepth.odometry.sweeps import FINE_SAMPLING, ThinnedSweeps

_MOVING = 0.15  # metres from sweep to sweep; smaller steps may be errors of registration
_SAME_POSE = 1e-3  # metres, and entries of rotations; poses that differ less are one pose
_SAMPLES = 4  # sweeps that are held against those before them
_BEFORE = 3  # sweeps before each, as one map: a rosette sees other parts in each sweep
_SAMPLING = 0.5  # metres, edge of a voxel in which a cloud keeps one point
# Metres by which sweeps move when they are aligned with those before. Median of right poses: 0.003
# to 0.08, the most of a rosette; without motion, inverse, at half the scale or shuffled: 0.36 to 4.
MISFIT = 0.25
# Places of a drive where its poses are compared with points higher than any lorry. Three that have
# such points are enough.
_PLACES, _ENOUGH = 12, 3
_COLUMN = 1.0  # metres, edge of the columns that tell an open road
_OTHER = 0.5  # metres a sweep, between the motion of poses and that of high points
_PERIODS = (0.005, 5.0)  # seconds between sweeps
_APART = 5e5  # metres between a pose and the middle of all; no recording goes that far
_BRAKES = 10.0  # metres/s^2; no vehicle on a road brakes harder
_JUMP = 1.0  # metres by which the step from sweep to sweep changes; a vehicle cannot do that


def check_given_poses(dataset: Dataset, poses: ArrayLike) -> NDArray[np.float64]:
    """Check the poses that a user brings for a drive; see :func:`register_drive`."""
    given = np.ascontiguousarray(poses, dtype=np.float64)
    if given.ndim != 3 or given.shape[1:] != (4, 4):
        raise OdometryError(f"poses must be (n, 4, 4) matrices T_world_lidar, got {given.shape}")
    if len(given) != len(dataset):
        raise OdometryError(
            f"there are {len(given)} poses for {len(dataset)} sweeps",
            "bring one pose a sweep",
            code="number-of-poses",
        )
    try:
        check_rigid(given)
    except InputError as error:
        raise OdometryError(str(error)) from None
    positions = given[:, :3, 3]
    apart = np.linalg.norm(positions - np.median(positions, axis=0), axis=1)
    far = np.flatnonzero(apart > _APART)
    if len(far):
        raise OdometryError(
            f"{len(far)} of {len(given)} poses lie {1e-3 * apart[far[0]]:,.0f} km from the others, "
            f"the first of them that of frame {far[0]}",
            "leave these frames out (`frames`): a receiver that has no position yet gives the "
            "origin",
            code="poses-apart",
        )
    return given


def find_no_motion(
    dataset: Dataset, poses: NDArray[np.float64], parameters: OdometryParameters
) -> list[Finding]:
    """Whether all poses are the same though the sweeps move."""
    if len(poses) < 2 or np.ptp(poses, axis=0).max() >= _SAME_POSE:
        return []
    sweeps, n = ThinnedSweeps(dataset, parameters, FINE_SAMPLING, FIRST_SWEEPS), len(dataset)
    found = []
    for frames in (range(n), range(n // 2, n)):
        motion = first_motion(sweeps, frames)
        step = 0.0 if motion is None else float(np.linalg.norm(motion[:3, 3]))
        if step > _MOVING:
            text = (
                f"all poses are the same, yet near frame {frames[0]} the LiDAR moves by {step:.2f} "
                "m a sweep"
            )
            remedy = "give T_world_lidar of each sweep, or no poses"
            found.append(Finding("poses-stand", "", text, remedy))
    return found


def find_camera_poses(poses: NDArray[np.float64]) -> list[Finding]:
    """Whether poses look like those of a camera."""
    if not move_upwards(poses):
        return []
    text = "along the poses the LiDAR moves upwards (z), not forwards (x)"
    remedy = "if they are poses of a camera, say which: `poses='CAMERA:FILE'`"
    return [Finding("poses-of-camera", "", text, remedy)]


def check_period(dataset: Dataset) -> float:
    """The usual time between sweeps in seconds, of which the odometry makes velocities."""
    # Of 0.1 and 0.2 s: 0.1.
    period = float(np.quantile(np.diff(dataset.times), 0.5, method="lower")) * 1e-9
    if not _PERIODS[0] < period < _PERIODS[1]:
        raise OdometryError(
            f"{dataset.path}: sweeps are {period:.3g} s apart; a LiDAR takes 0.05 to 0.2 s. Are "
            "the times in seconds? Parts of sweeps are joined by sweep_duration in docdepth.yaml",
            code="sweep-period",
        )
    return period


def move_upwards(poses: NDArray[np.float64]) -> bool:
    """Whether poses lead along z rather than along x, as those of a camera do."""
    steps = np.abs((inverse(poses[:-1]) @ poses[1:])[:, :3, 3])
    steps = steps[np.linalg.norm(steps, axis=1) > _MOVING]
    return bool(len(steps) and np.median(steps[:, 2]) > 2 * np.median(steps[:, 0]))


def places_compared(count: int) -> list[int]:
    """Sweeps of so many at which :func:`find_other_motion` looks."""
    return np.unique(np.linspace(0, count - 1, _PLACES + 2)[1:-1].astype(int)).tolist()


def find_other_motion(sweeps: ThinnedSweeps, poses: NDArray[np.float64]) -> list[Finding]:
    """Whether points higher than any lorry show that, on a road, poses follow traffic."""
    compared, parts = 0, parts_of(sweeps.times)
    for k in places_compared(len(poses)):
        if not len(split_level_ground(sweeps[k].points.astype(np.float64), _COLUMN)[1]):
            continue
        motion = centred_motion(poses, sweeps.times, [k])[0]
        end = next(part.stop for part in parts if k in part)
        checked = checked_motion(sweeps, range(k, end), motion)
        if checked is None:
            continue
        if np.linalg.norm((checked - motion)[:3, 3]) > _OTHER:
            seen, followed = (np.linalg.norm(T[:3, 3]) for T in (checked, motion))
            text = (
                f"near frame {k} the LiDAR moves by {seen:.1f} m a sweep, but its poses by "
                f"{followed:.1f} m: they follow traffic, and labels and depth will be wrong"
            )
            remedy = "begin at another frame (`frames`), or bring better poses (`poses`)"
            return [Finding("poses-follow-traffic", "", text, remedy)]
        compared += 1
        if compared == _ENOUGH:
            break
    return []


def find_misfit(
    points: Callable[[int], NDArray[np.float32]],
    poses: NDArray[np.float64],
    times: NDArray[np.int64],
    parameters: OdometryParameters | None = None,
) -> list[Finding]:
    """Whether sweeps lie elsewhere than the sweeps before them, and the poses, say."""
    moved = misfit(points, poses, times, parameters)
    if moved is None or moved <= MISFIT:
        return []
    text = (
        f"the poses do not fit the sweeps: these lie {moved:.1f} m from where the sweeps before "
        "them are; the poses may belong to another frame or order of sweeps, or the sweeps may not "
        "follow each other"
    )
    return [Finding("poses-misfit", "", text)]


def misfit(
    points: Callable[[int], NDArray[np.float32]],
    poses: NDArray[np.float64],
    times: NDArray[np.int64],
    parameters: OdometryParameters | None = None,
    apart: int = 1,
    at: int | None = None,
) -> float | None:
    """How far points lie from where the sweeps before them, and the poses, say [m].

    A few sweeps are each aligned with three before, starting from the poses.

    Parameters
    ----------
    points : callable
        Points of a deskewed sweep, float32 (N, 3). Sixteen sweeps are asked for at most.
    poses : ndarray of float64, shape (n, 4, 4)
        ``T_world_lidar`` of every sweep.
    times : ndarray of int64, shape (n,)
        Stamps [ns]. Nothing is compared over a gap.
    apart : int
        How many sweeps later than the last of the three it is.
    at : int, optional
        The only sweep that is compared.

    Returns
    -------
    float, or None
        The median over sweeps; None where sweeps are too few or hold too few points.
    """
    p, moved = parameters or OdometryParameters(), []
    compared = [k for part in parts_of(times) for k in part[apart + _BEFORE - 1 :]]
    frames = [compared[k] for k in evenly(len(compared), _SAMPLES)] if at is None else [at]
    for frame in frames:
        shift = _shift_to_those_before(points, poses, frame, p, apart)
        moved += [] if shift is None else [shift]
    return float(np.median(moved)) if moved else None


def _shift_to_those_before(
    points: Callable[[int], NDArray[np.float32]],
    poses: NDArray[np.float64],
    frame: int,
    parameters: OdometryParameters,
    apart: int,
) -> float | None:
    """How far points move when a sweep is aligned with those before; None with too few points.

    Points, not the origin: where a turn is off by 0.1 degrees, they are 5 cm off at 30 m.
    """
    import small_gicp

    last = frame - apart
    frames = [*range(last - _BEFORE + 1, last + 1), frame]
    clouds = [_thinned(points(k), parameters) for k in frames]
    if min(len(cloud) for cloud in clouds) < FEWEST_POINTS:
        return None
    before = []
    for k, cloud in zip(frames[:-1], clouds, strict=False):
        T = inverse(poses[frame]) @ poses[k]
        before.append(transform_points(T, cloud))
    target, tree = small_gicp.preprocess_points(np.concatenate(before), _SAMPLING, num_threads=1)
    source, _ = small_gicp.preprocess_points(clouds[-1], _SAMPLING, num_threads=1)
    found = small_gicp.align(target, source, tree, registration_type="GICP", num_threads=1)
    if not found.num_inliers:  # nothing overlaps, so nothing moves either
        return float(np.linalg.norm((inverse(poses[last]) @ poses[frame])[:3, 3]))
    own, T = source.points()[:, :3], found.T_target_source
    shift = float(np.median(np.linalg.norm(transform_points(T, own) - own, axis=1)))
    return shift if np.isfinite(shift) else None


def _thinned(points: NDArray[np.float32], parameters: OdometryParameters) -> NDArray[np.float64]:
    """The points in range, one mean point for each voxel."""
    low, high = parameters.min_range, parameters.max_range
    thinned, _ = _core.thin_sweep(
        np.ascontiguousarray(points), np.zeros(len(points), np.float32), _SAMPLING, low, high
    )
    return np.asarray(thinned, np.float64)


def find_jumps(trajectory: Trajectory) -> list[Finding]:
    """Where the step from one sweep to the next changes by metres, but at gaps.

    That of stamps is told by :func:`~docdepth.odometry.clock.find_clock_steps`.
    """
    if len(trajectory) < 3:
        return []
    change = _changes(trajectory)
    worst = int(np.argmax(change))
    if change[worst] <= _JUMP:
        return []
    text = (
        f"the trajectory jumps: at frame {worst + 1} the step from sweep to sweep changes by "
        f"{change[worst]:.1f} m"
    )
    return [Finding("trajectory-jumps", "", text, "check the poses and times around it")]


def sudden_change(trajectory: Trajectory) -> int | None:
    """The last pose before the greatest change of velocity that no vehicle is capable of.

    Poses of SLAM change so where it recognises a place, those of GNSS where satellites come back.
    """
    if len(trajectory) < 3:
        return None
    change = _changes(trajectory)
    worst = int(np.argmax(change))
    period = float(np.median(np.diff(trajectory.times))) * 1e-9
    return worst if change[worst] > _BRAKES * period**2 else None


def _changes(trajectory: Trajectory) -> NDArray[np.float64]:
    """By how much the step to a pose and that from it differ (n - 2,) [m]; 0 at gaps."""
    seconds = even_steps(trajectory) * 1e-9
    velocity = np.diff(trajectory.poses[:, :3, 3], axis=0) / seconds[:, None]
    for part in trajectory.parts[1:]:
        velocity[part.start - 1] = np.nan
    change = np.linalg.norm(np.diff(velocity, axis=0), axis=1) * float(np.median(seconds))
    return np.nan_to_num(change)
