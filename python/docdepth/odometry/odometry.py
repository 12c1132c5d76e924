"""LiDAR odometry: a pose for each sweep, and the sweeps deskewed to their stamps (paper III-B).

Registration takes several passes over the drive. In the first, kiss-icp registers the sweeps as
they were measured, point to point. In the others, small_gicp refines the poses, distribution to
distribution, on sweeps that are deskewed with the motion around them. On exact synthetic drives
this divides the error from sweep to sweep by five or more.

Only the map, the threshold and the ICP of kiss-icp are used. Its own loop deskews with the motion
of the previous sweep, which oscillates; it starts from standstill, reads settings from the
environment and ends the process on odd timestamps.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from docdepth.concurrency import thread_count
from docdepth.config import OdometryParameters, Parameters
from docdepth.datasets.base import Dataset
from docdepth.errors import InputError, OdometryError
from docdepth.geometry.se3 import check_rigid, inverse
from docdepth.geometry.trajectory import Trajectory
from docdepth.odometry.deskewing import centred_motion
from docdepth.odometry.parallel_passes import run_parallel
from docdepth.odometry.registration import first_motion
from docdepth.odometry.registration_pass import RegistrationPass
from docdepth.odometry.sweeps import DeskewedSweeps

log = logging.getLogger(__name__)

Progress = Callable[[int, int, str], None]
"""Called with the sweeps done, all sweeps of all passes, and a description."""

_MOVING = 0.15  # metres from sweep to sweep; smaller steps may be errors of registration
_SAME_POSE = 1e-3  # metres, and entries of rotations; poses that differ less are one pose
_JUMP = 1.0  # metres by which the step from sweep to sweep changes; a vehicle cannot do that
_FEWEST_PARALLEL = 20  # sweeps; fewer are registered before another process has started


@dataclass(frozen=True)
class Odometry:
    """Where each sweep was taken, and the sweeps deskewed to that instant.

    Attributes
    ----------
    trajectory : Trajectory
        ``T_world_lidar`` at each sweep's stamp.
    sweeps : sequence of Sweep
        Item ``i`` reads sweep ``i`` once and deskews it. It has a row for each row of the input;
        rows without a usable return stay as they are.
    """

    trajectory: Trajectory
    sweeps: DeskewedSweeps


def register_drive(
    dataset: Dataset,
    parameters: Parameters | None = None,
    poses: ArrayLike | None = None,
    progress: Progress | None = None,
    checkpoint: Path | None = None,
    threads: int = 0,
) -> Odometry:
    """Estimate the pose of each sweep of a drive, or take given poses, and deskew the sweeps.

    Parameters
    ----------
    dataset : Dataset
    parameters : Parameters, optional
        ``parameters.odometry`` is used.
    poses : array_like of float64, shape (n, 4, 4), optional
        ``T_world_lidar`` of each sweep from another SLAM; nothing is registered then.
    progress : callable, optional
        ``progress(done, total, what)`` after each sweep of each pass.
    checkpoint : Path, optional
        Folder for the poses of each finished pass. An interrupted estimation continues after the
        last of them; a pass that was interrupted starts again, since its map is not kept.
    threads : int
        Passes that may run at once, each in a process of its own; 0 runs all of them where there
        are two cores or more. The poses do not depend on it.

    Returns
    -------
    Odometry
        Poses are in the frame of the first sweep unless ``poses`` are given.

    Raises
    ------
    OdometryError
        A sweep cannot be registered, or ``poses`` are not rigid or not one for each sweep.
    """
    settings = (parameters or Parameters()).odometry
    if poses is not None:
        known = _check_given_poses(dataset, poses, settings)
    else:
        known = estimate_poses(dataset, settings, progress, checkpoint, threads)
    trajectory = Trajectory(dataset.times, known)
    _warn_of_jumps(trajectory)
    motions = centred_motion(known, dataset.times)
    return Odometry(trajectory, DeskewedSweeps(dataset, motions.__getitem__))


def estimate_poses(
    dataset: Dataset,
    parameters: OdometryParameters | None = None,
    progress: Progress | None = None,
    checkpoint: Path | None = None,
    threads: int = 0,
) -> NDArray[np.float64]:
    """Poses ``T_world_lidar`` (n, 4, 4) in the frame of the first sweep.

    The arguments are those of :func:`register_drive`. Motion compensated sweeps take two passes at
    most: their points do not change.
    """
    parameters = parameters or OdometryParameters()
    first, count = dataset.sweep(0), len(dataset)
    raw = first.relative_time is not None and not first.motion_compensated
    number = parameters.passes if raw else min(parameters.passes, 2)
    number = number if count > 1 else 1
    files = [checkpoint and checkpoint / f"odometry_pass_{k + 1}.npz" for k in range(number)]
    passes = [RegistrationPass(k, dataset, parameters, file) for k, file in enumerate(files)]
    poses = None
    for finished in reversed(passes):
        poses = finished.load()
        if poses is not None:
            passes = passes[finished.number + 1 :]
            break
    done, total = (number - len(passes)) * count, number * count

    def count_sweep(what: str) -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(done, total, f"odometry, {what} of {number}")

    at_once = _parallel_passes(threads, count)
    while passes:
        group = passes[:at_once]
        found = _run(group, poses, count_sweep)
        if found is None:
            at_once = 1
        else:
            poses, passes = found, passes[len(group) :]
    assert poses is not None
    return poses


def _run(
    passes: Sequence[RegistrationPass],
    previous: NDArray[np.float64] | None,
    count_sweep: Callable[[str], None],
) -> NDArray[np.float64] | None:
    """Poses of the last of these passes; None if they cannot run at once."""
    first, last = passes[0].number + 1, passes[-1].number + 1
    if len(passes) > 1:
        return run_parallel(passes, previous, lambda: count_sweep(f"passes {first} to {last}"))
    known = None if previous is None else lambda _: previous
    return passes[0].run(known, lambda *_: count_sweep(f"pass {first}"))


def _parallel_passes(threads: int, count: int) -> int:
    """How many passes run at once: one more than cores, since they wait for each other."""
    if threads == 0:
        cores = thread_count(0)
        threads = cores + 1 if cores > 1 else 1
    return threads if count >= _FEWEST_PARALLEL else 1


def _check_given_poses(
    dataset: Dataset, poses: ArrayLike, parameters: OdometryParameters
) -> NDArray[np.float64]:
    """Refuse poses that cannot be right, and warn of those that hardly are."""
    given = np.ascontiguousarray(poses, dtype=np.float64)
    if given.ndim != 3 or given.shape[1:] != (4, 4):
        raise OdometryError(f"poses must be (n, 4, 4) matrices T_world_lidar, got {given.shape}")
    if len(given) != len(dataset):
        raise OdometryError(
            f"there are {len(given)} poses for {len(dataset)} sweeps; bring one pose a sweep"
        )
    try:
        check_rigid(given)
    except InputError as error:
        raise OdometryError(str(error)) from None
    if len(given) > 1 and np.ptp(given, axis=0).max() < _SAME_POSE:
        _warn_of_motion(dataset, parameters)
    steps = np.abs((inverse(given[:-1]) @ given[1:])[:, :3, 3])
    steps = steps[np.linalg.norm(steps, axis=1) > _MOVING]
    if len(steps) and np.median(steps[:, 2]) > 2 * np.median(steps[:, 0]):
        log.warning(
            "along the poses the LiDAR moves upwards (z), not forwards (x): if they are poses of "
            "a camera, convert them by Tr^-1 T Tr"
        )
    return given


def _warn_of_motion(dataset: Dataset, parameters: OdometryParameters) -> None:
    """The given poses stand still: warn if the sweeps do not."""
    sweeps, n = DeskewedSweeps(dataset, None), len(dataset)
    for frames in (range(n), range(n // 2, n)):
        step = np.linalg.norm(first_motion(sweeps, frames, parameters)[:3, 3])
        if step > _MOVING:
            log.warning(
                "all poses are the same, yet near frame %d the LiDAR moves by %.2f m a sweep; "
                "give T_world_lidar of each sweep, or no poses", frames[0], step,
            )  # fmt: skip


def _warn_of_jumps(trajectory: Trajectory) -> None:
    """Warn where the step from one sweep to the next changes by metres."""
    if len(trajectory) < 3:
        return
    seconds = np.diff(trajectory.times) * 1e-9
    velocity = np.diff(trajectory.poses[:, :3, 3], axis=0) / seconds[:, None]
    change = np.linalg.norm(np.diff(velocity, axis=0), axis=1) * float(np.median(seconds))
    worst = int(np.argmax(change))
    if change[worst] > _JUMP:
        log.warning(
            "the trajectory jumps: at frame %d the way from sweep to sweep changes by %.1f m; "
            "look at its poses, or at its time", worst + 1, change[worst],
        )  # fmt: skip
