"""Poses of the sweeps, and the sweeps deskewed to their stamp (paper III-B).

Sweeps are registered twice over. kiss-icp finds the way, point to point, on sweeps as they come; it
is driven piece by piece, since its own loop deskews with the motion of the sweep before, which
oscillates, starts from standstill, takes settings from the environment and ends the process on odd
timestamps. small_gicp then refines the poses, distribution to distribution, on sweeps deskewed with
the motion around them: on exact synthetic drives that divides the error from sweep to sweep by five
or more.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from docdepth.concurrency import thread_count
from docdepth.config import OdometryParameters
from docdepth.datasets.base import Dataset
from docdepth.errors import InputError, OdometryError
from docdepth.geometry.se3 import check_rigid, inverse
from docdepth.geometry.trajectory import Trajectory
from docdepth.odometry.deskewing import centred_motion
from docdepth.odometry.parallel_passes import run_parallel
from docdepth.odometry.registration import first_motion
from docdepth.odometry.registration_pass import DeskewedSweeps, RegistrationPass

log = logging.getLogger(__name__)

Points = NDArray[np.float32]
Progress = Callable[[int, int, str], None]

_STEP = 0.15  # metres a sweep that are no standstill
_MANY = 20  # sweeps; fewer are registered before another process has started
_JUMP = 1.0  # metres; at 10 Hz a change of speed of ten times gravity


@dataclass(frozen=True)
class Odometry:
    """Where each sweep was taken, and the sweeps deskewed to that instant.

    Attributes
    ----------
    trajectory : Trajectory
        ``T_world_lidar`` at each sweep's time.
    points : callable
        ``points(i)`` reads sweep ``i`` again and deskews it: float32 (N, 3), one row for each row
        of the input; rows without a usable return stay as they are.
    """

    trajectory: Trajectory
    points: Callable[[int], Points]


def odometry(
    dataset: Dataset,
    parameters: OdometryParameters | None = None,
    poses: ArrayLike | None = None,
    progress: Progress | None = None,
    checkpoint: Path | None = None,
    threads: int = 0,
) -> Odometry:
    """Register the sweeps of a drive, or take poses brought along, and deskew the sweeps.

    Raw sweeps are registered as they are, deskewed with the motion around each, registered
    again, and so on (``parameters.passes``). Motion compensated sweeps are registered twice at
    most: their points do not change.

    Parameters
    ----------
    dataset : Dataset
    parameters : OdometryParameters, optional
    poses : array_like of float64, shape (n, 4, 4), optional
        ``T_world_lidar`` of each sweep from elsewhere; nothing is registered then.
    progress : callable, optional
        ``progress(done, total, what)`` after each sweep of each pass.
    checkpoint : Path, optional
        Folder that keeps the poses of each whole pass; a run that was interrupted goes on after the
        last of them. Passes that run at once also become whole almost at once: of a pass that was
        cut off nothing is kept, since its map is not.
    threads : int
        How many passes may run at once, each in a process of its own; 0 lets all, where there are
        two cores or more. The poses are the same.

    Raises
    ------
    OdometryError
        A sweep cannot be registered, or ``poses`` are impossible or not one a sweep.
    """
    parameters = parameters or OdometryParameters()
    if poses is not None:
        estimated = _given(dataset, poses, parameters)
    else:
        estimated = estimate_poses(dataset, parameters, progress, checkpoint, threads)
    trajectory = Trajectory(dataset.times, estimated)
    _warn_of_jumps(trajectory)
    motions = centred_motion(estimated, dataset.times)
    return Odometry(trajectory, DeskewedSweeps(dataset, motions.__getitem__))


def estimate_poses(
    dataset: Dataset,
    parameters: OdometryParameters | None = None,
    progress: Progress | None = None,
    checkpoint: Path | None = None,
    threads: int = 0,
) -> NDArray[np.float64]:
    """Poses ``T_world_lidar`` (n, 4, 4) in the frame of the first sweep; see :func:`odometry`."""
    parameters = parameters or OdometryParameters()
    first, count = dataset.sweep(0), len(dataset)
    raw = first.relative_time is not None and not first.motion_compensated
    number = parameters.passes if raw else min(parameters.passes, 2)
    number = number if count > 1 else 1
    files = [checkpoint and checkpoint / f"odometry_pass_{k + 1}.npz" for k in range(number)]
    passes = [RegistrationPass(k, dataset, parameters, file) for k, file in enumerate(files)]
    poses = None
    for one in reversed(passes):
        poses = one.load()
        if poses is not None:
            passes = passes[one.number + 1 :]
            break
    done, total = (number - len(passes)) * count, number * count

    def tell(what: str) -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(done, total, f"odometry, {what} of {number}")

    abreast = _abreast(threads, count)
    while passes:
        row = passes[:abreast]
        found = _run(row, poses, tell)
        if found is None:
            abreast = 1
        else:
            poses, passes = found, passes[len(row) :]
    assert poses is not None
    return poses


def _run(
    row: Sequence[RegistrationPass], poses: NDArray[np.float64] | None, tell: Callable[[str], None]
) -> NDArray[np.float64] | None:
    """Poses of the last pass of the row, None if its passes cannot run at once."""
    first, last = row[0].number + 1, row[-1].number + 1
    if len(row) > 1:
        return run_parallel(row, poses, lambda: tell(f"passes {first} to {last}"))
    before = None if poses is None else lambda _: poses
    return row[0].run(before, lambda *_: tell(f"pass {first}"))


def _abreast(threads: int, count: int) -> int:
    """How many passes run at once: one more than cores, since they wait for each other."""
    if threads == 0:
        cores = thread_count(0)
        threads = cores + 1 if cores > 1 else 1
    return threads if count >= _MANY else 1


def _given(
    dataset: Dataset, poses: ArrayLike, parameters: OdometryParameters
) -> NDArray[np.float64]:
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
    if len(given) > 1 and np.ptp(given, axis=0).max() < 1e-3:
        sweeps, n = DeskewedSweeps(dataset, None), len(dataset)
        for frames in (range(n), range(n // 2, n)):
            step = np.linalg.norm(first_motion(sweeps, frames, parameters)[:3, 3])
            if step > _STEP:
                log.warning(
                    "all poses are the same, yet near frame %d the LiDAR moves by %.2f m a sweep; "
                    "give T_world_lidar of each sweep, or no poses", frames[0], step,
                )  # fmt: skip
    steps = np.abs((inverse(given[:-1]) @ given[1:])[:, :3, 3])
    steps = steps[np.linalg.norm(steps, axis=1) > _STEP]
    if len(steps) and np.median(steps[:, 2]) > 2 * np.median(steps[:, 0]):
        log.warning(
            "along the poses the LiDAR moves upwards (z), not forwards (x): if they are poses of "
            "a camera, convert them by Tr^-1 T Tr"
        )
    return given


def _warn_of_jumps(trajectory: Trajectory) -> None:
    """A vehicle does not change its step by metres from one sweep to the next."""
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
