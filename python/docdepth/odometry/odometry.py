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

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from docdepth.concurrency import thread_count
from docdepth.config import OdometryParameters, Parameters
from docdepth.datasets.base import Dataset
from docdepth.geometry.trajectory import Trajectory
from docdepth.odometry.deskewing import centred_motion
from docdepth.odometry.parallel_passes import run_parallel
from docdepth.odometry.pose_checks import check_given_poses, warn_of_jumps
from docdepth.odometry.registration_pass import RegistrationPass
from docdepth.odometry.sweeps import DeskewedSweeps

Progress = Callable[[int, int, str], None]
"""Called with the sweeps done, all sweeps of all passes, and a description."""

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
        known = check_given_poses(dataset, poses, settings)
    else:
        known = estimate_poses(dataset, settings, progress, checkpoint, threads)
    trajectory = Trajectory(dataset.times, known)
    warn_of_jumps(trajectory)
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
