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
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from docdepth.config import OdometryParameters
from docdepth.datasets.base import Dataset
from docdepth.deskewing import centred_motion, deskew
from docdepth.errors import InputError, OdometryError
from docdepth.io.atomic import write_atomically
from docdepth.registration import first_motion, register
from docdepth.trajectory import Trajectory, check_rigid, inverse

log = logging.getLogger(__name__)

Points = NDArray[np.float32]
Progress = Callable[[int, int, str], None]

_STEP = 0.15  # metres a sweep that are no standstill
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
        Folder that keeps the poses of each whole pass; a run that was interrupted goes on there.

    Raises
    ------
    OdometryError
        A sweep cannot be registered, or ``poses`` are impossible or not one a sweep.
    """
    parameters = parameters or OdometryParameters()
    if poses is not None:
        estimated = _given(dataset, poses, parameters)
    else:
        estimated = estimate_poses(dataset, parameters, progress, checkpoint)
    trajectory = Trajectory(dataset.times, estimated)
    _warn_of_jumps(trajectory)
    return Odometry(trajectory, _Deskewed(dataset, centred_motion(estimated, dataset.times)))


def estimate_poses(
    dataset: Dataset,
    parameters: OdometryParameters | None = None,
    progress: Progress | None = None,
    checkpoint: Path | None = None,
) -> NDArray[np.float64]:
    """Poses ``T_world_lidar`` (n, 4, 4) in the frame of the first sweep; see :func:`odometry`."""
    parameters = parameters or OdometryParameters()
    raw = dataset.sweep(0).fraction is not None
    passes = parameters.passes if raw else min(parameters.passes, 2)
    passes = passes if len(dataset) > 1 else 1
    poses: NDArray[np.float64] | None = None
    for number in range(passes):
        kept = _Checkpoint(checkpoint, dataset, parameters, number)
        found = kept.load()
        if found is None:
            motions = None if poses is None else centred_motion(poses, dataset.times)
            what = f"odometry, pass {number + 1} of {passes}"

            def tell(done: int, number: int = number, what: str = what) -> None:
                if progress is not None:
                    progress(number * len(dataset) + done, passes * len(dataset), what)

            found = register(_Deskewed(dataset, motions), len(dataset), parameters, poses, tell)
            kept.save(found)
        poses = found
    assert poses is not None
    return poses


@dataclass(frozen=True)
class _Deskewed:
    """Sweeps read when asked for and deskewed with the motion at their stamp."""

    dataset: Dataset
    motions: NDArray[np.float64] | None

    def __call__(self, index: int) -> Points:
        sweep = self.dataset.sweep(index)
        if sweep.fraction is None or self.motions is None:
            return sweep.points
        try:
            return deskew(sweep.points, sweep.fraction, self.motions[index])
        except InputError as error:
            raise OdometryError(f"sweep {sweep.name} (frame {index}): {error}") from None


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
        sweeps, n = _Deskewed(dataset, None), len(dataset)
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


class _Checkpoint:
    """Poses of one whole pass on disk, valid for the same drive and parameters."""

    def __init__(
        self, folder: Path | None, dataset: Dataset, parameters: OdometryParameters, number: int
    ) -> None:
        self._file = folder / f"odometry_pass_{number + 1}.npz" if folder is not None else None
        settings = parameters.model_dump_json(exclude={"passes"})
        self._key = f"{Path(dataset.path).resolve()} {len(dataset)} {settings}"

    def load(self) -> NDArray[np.float64] | None:
        if self._file is None or not self._file.is_file():
            return None
        with np.load(self._file) as kept:
            if str(kept["key"]) != self._key:
                return None
            poses: NDArray[np.float64] = kept["poses"]
        log.info("odometry goes on after %s", self._file.name)
        return poses

    def save(self, poses: NDArray[np.float64]) -> None:
        if self._file is None:
            return
        write_atomically(
            self._file, lambda stream: np.savez(stream, poses=poses, key=np.array(self._key))
        )
