"""Poses of the sweeps, and sweeps as if measured in one instant (paper III-B).

Sweeps are registered twice over. kiss-icp finds the way, point to point, on sweeps as they come; it
is driven piece by piece, since its own loop deskews with the motion of the sweep before, which
oscillates, starts from standstill, takes settings from the environment and ends the process on odd
timestamps. small_gicp then refines the poses, distribution to distribution, on sweeps deskewed with
the motion around them: on exact synthetic drives that divides the error from sweep to sweep by five
or more.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from docdepth.config import OdometryParameters
from docdepth.datasets.base import Dataset, usable_points
from docdepth.errors import InputError, OdometryError
from docdepth.trajectory import Trajectory, check_rigid, inverse, rotation_exp, rotation_log

log = logging.getLogger(__name__)

Points = NDArray[np.float32]
Progress = Callable[[int, int, str], None]

_FEWEST_POINTS = 50  # below that a sweep cannot be registered
_START = 3  # sweeps that find the motion at the start
_SPEEDS = (0.0, 1.0, 2.0, 3.0, 4.0, 5.0)  # metres a sweep that are tried; 5 is 180 km/h at 10 Hz
# Of small_gicp: to a voxel's mean in metres; one thread, as for kiss-icp.
_ALIGN = {
    "max_correspondence_distance": 1.0,
    "num_threads": 1,
    "max_iterations": 30,
    "rotation_epsilon": 1e-5,
    "translation_epsilon": 1e-4,
}
_AROUND = 2  # sweeps on either side that tell the motion of one
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

            found = _register(_Deskewed(dataset, motions), len(dataset), parameters, poses, tell)
            kept.save(found)
        poses = found
    assert poses is not None
    return poses


# ---- deskewing


def deskew(points: Points, fraction: NDArray[np.float32], motion: ArrayLike) -> Points:
    """Move each point to where it was at the sweep's stamp, had the sensor measured it then.

    Parameters
    ----------
    points : ndarray of float32, shape (N, 3)
        In the sensor's frame at the time of each point.
    fraction : ndarray of float32, shape (N,)
        Time of each point after the stamp, in sweeps (:class:`~docdepth.datasets.base.Sweep`).
    motion : array_like of float64, shape (4, 4)
        The sensor's pose one sweep after the stamp, in its frame at the stamp. Turning and
        driving are taken to be constant meanwhile (a screw).

    Returns
    -------
    ndarray of float32, shape (N, 3)
        In the sensor's frame at the stamp. Rows without a usable return are kept as they are.

    Raises
    ------
    InputError
        Shapes do not fit, or a usable point has no time.
    """
    if points.ndim != 2 or points.shape[1] != 3 or fraction.shape != points.shape[:1]:
        raise InputError(
            f"deskewing needs points (N, 3) and fractions (N,), got {points.shape} and "
            f"{fraction.shape}"
        )
    usable = usable_points(points)
    if not np.isfinite(fraction[usable]).all():
        raise InputError("a usable point has no finite time; drop it or give it one")
    omega, velocity = twist(motion)
    angle = float(np.linalg.norm(omega))
    share = np.where(usable, fraction, 0).astype(np.float32)
    x, y, z = (np.where(usable, points[:, k], 0).astype(np.float32) for k in range(3))
    if angle < 1e-9:
        moved = [p + share * np.float32(v) for p, v in zip((x, y, z), velocity, strict=True)]
    else:
        # exp(share * twist) applied to p, sorted by what depends on the point's time:
        # p + sin a (A p + b) + (1 - cos a)(A A p + c) + share d, a = share * angle, A = [axis]x.
        axis = omega / angle
        A = _cross(axis)
        sine = np.sin(share * np.float32(angle))
        half = np.sin(share * np.float32(0.5 * angle))
        versine = np.float32(2) * half * half
        first, second = _rows(A), _rows(A @ A)
        b = (-A @ A @ velocity / angle).astype(np.float32)
        c = (A @ velocity / angle).astype(np.float32)
        d = (axis * (axis @ velocity)).astype(np.float32)
        moved = [
            p
            + sine * (m[0] * x + m[1] * y + m[2] * z + b[k])
            + versine * (n[0] * x + n[1] * y + n[2] * z + c[k])
            + share * d[k]
            for k, (p, m, n) in enumerate(zip((x, y, z), first, second, strict=True))
        ]
    result = points.copy()
    for k in range(3):
        np.copyto(result[:, k], moved[k], where=usable)
    return result


def centred_motion(
    poses: NDArray[np.float64], times: ArrayLike | None = None
) -> NDArray[np.float64]:
    """Motion of the sensor during one sweep around each stamp, fitted to the poses around it.

    A straight line of twists through the poses of up to two sweeps before and two after: of poses
    that jitter by a centimetre, half as much reaches the points as with one sweep on either side.

    Parameters
    ----------
    poses : ndarray of float64, shape (n, 4, 4)
        ``T_world_lidar`` at each stamp.
    times : array_like of int64, shape (n,), optional
        Nanoseconds; without them the sweeps follow each other evenly. The duration of a sweep is
        the median distance of stamps, so that a lost sweep does not double the motion.

    Returns
    -------
    ndarray of float64, shape (n, 4, 4)
        The motion of one sweep's duration.
    """
    n = len(poses)
    if n < 2:
        return np.repeat(np.eye(4)[None], n, axis=0)
    stamps = np.arange(n) if times is None else np.asarray(times, dtype=np.int64)
    sweeps = (stamps - stamps[0]) / float(np.median(np.diff(stamps)))
    motions = np.empty_like(poses)
    for k in range(n):
        around = np.arange(max(k - _AROUND, 0), min(k + _AROUND, n - 1) + 1)
        twists = np.array([np.concatenate(twist(inverse(poses[k]) @ poses[j])) for j in around])
        x = sweeps[around] - sweeps[around].mean()
        slope = x @ twists / (x @ x)
        motions[k] = exp(slope[:3], slope[3:])
    return motions


def twist(motion: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Rotation vector and velocity whose constant action for one unit of time is ``motion``."""
    motion = np.asarray(motion, dtype=np.float64)
    omega = rotation_log(motion[:3, :3])
    return omega, np.linalg.solve(_left_jacobian(omega), motion[:3, 3])


def exp(omega: NDArray[np.float64], velocity: NDArray[np.float64]) -> NDArray[np.float64]:
    """The motion (4, 4) of a constant twist after one unit of time."""
    result = np.eye(4)
    result[:3, :3] = rotation_exp(omega)
    result[:3, 3] = _left_jacobian(omega) @ velocity
    return result


def _left_jacobian(omega: NDArray[np.float64]) -> NDArray[np.float64]:
    angle = float(np.linalg.norm(omega))
    A = _cross(omega)
    if angle < 1e-6:
        return np.asarray(np.eye(3) + 0.5 * A + A @ A / 6.0)
    first = (1.0 - np.cos(angle)) / angle**2
    second = (angle - np.sin(angle)) / angle**3
    return np.asarray(np.eye(3) + first * A + second * (A @ A))


def _cross(v: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def _rows(matrix: NDArray[np.float64]) -> list[NDArray[np.float32]]:
    return list(matrix.astype(np.float32))


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


# ---- registration


class _Registration:
    """kiss-icp's map, threshold and point-to-point ICP, one sweep after the other."""

    def __init__(self, parameters: OdometryParameters) -> None:
        from kiss_icp.pybind import kiss_icp_pybind as kiss

        self._kiss = kiss
        self._parameters = parameters
        # One thread: the sums of more threads come in any order, and poses would differ from run
        # to run. kiss-icp keeps the first count that a process asks for.
        self._icp = kiss._Registration(
            max_num_iterations=500, convergence_criterion=1e-4, max_num_threads=1
        )
        self._map = kiss._VoxelHashMap(
            voxel_size=parameters.voxel_size,
            max_distance=parameters.max_range,
            max_points_per_voxel=20,
        )
        self._threshold = kiss._AdaptiveThreshold(
            initial_threshold=2.0, min_motion_th=0.1, max_range=parameters.max_range
        )

    def add(self, near: NDArray[np.float64], guess: NDArray[np.float64]) -> NDArray[np.float64]:
        """Register one sweep, starting at ``guess``, and merge it into the map."""
        voxel = self._parameters.voxel_size
        fine = self._kiss._voxel_down_sample(self._kiss._Vector3dVector(near), 0.5 * voxel)
        coarse = self._kiss._voxel_down_sample(fine, 1.5 * voxel)
        sigma = self._threshold._compute_threshold()
        pose: NDArray[np.float64] = np.asarray(
            self._icp._align_points_to_map(
                points=coarse,
                voxel_map=self._map,
                initial_guess=guess,
                max_correspondance_distance=3 * sigma,
                kernel=sigma,
            )
        )
        if np.isfinite(pose).all():
            self._threshold._update_model_deviation(model_deviation=inverse(guess) @ pose)
            self._map._update(fine, pose)
        return pose


class _Refinement:
    """small_gicp's map of voxels, each a normal distribution, and its registration (VGICP)."""

    def __init__(self, parameters: OdometryParameters) -> None:
        import small_gicp

        self._small = small_gicp
        self._sampling = 0.5 * parameters.refine_voxel_size
        self._map = small_gicp.GaussianVoxelMap(parameters.refine_voxel_size)
        self._empty = True

    def add(self, near: NDArray[np.float64], guess: NDArray[np.float64]) -> NDArray[np.float64]:
        """Register one sweep, starting at ``guess``, and merge it into the map."""
        cloud, _ = self._small.preprocess_points(near, self._sampling, 10, 1)
        pose = guess.copy()
        if not self._empty:
            found = self._small.align(self._map, cloud, init_T_target_source=guess, **_ALIGN)
            # Where hardly anything meets the map, what the pass before said stays.
            if found.num_inliers >= _FEWEST_POINTS:
                pose = np.asarray(found.T_target_source, dtype=np.float64)
                pose = _rigid(pose) if np.isfinite(pose).all() else pose
        if np.isfinite(pose).all():
            self._map.insert(cloud, pose)
            self._empty = False
        return pose


def _add(
    registration: _Registration | _Refinement,
    points: Points,
    guess: NDArray[np.float64],
    frame: int,
    parameters: OdometryParameters,
) -> NDArray[np.float64]:
    """Pose of a sweep; of one with too few points the guess."""
    near = _near(points, parameters)
    if len(near) < _FEWEST_POINTS:
        log.warning(
            "frame %d has %d usable points between %g and %g m: its pose is predicted",
            frame, len(near), parameters.min_range, parameters.max_range,
        )  # fmt: skip
        return guess.copy()
    pose = registration.add(near, guess)
    if not np.isfinite(pose).all():
        raise OdometryError(
            f"frame {frame} could not be registered; bring poses (--poses) or try another "
            "odometry.voxel_size"
        )
    return pose


def _register(
    points: Callable[[int], Points],
    count: int,
    parameters: OdometryParameters,
    before: NDArray[np.float64] | None,
    tell: Callable[[int], None],
) -> NDArray[np.float64]:
    """Poses of one pass; ``before`` are those of the pass before."""
    registration: _Registration | _Refinement
    if before is None:
        steps = None
        step = _first_motion(points, range(count), parameters)
        registration = _Registration(parameters)
    else:
        steps = inverse(before[:-1]) @ before[1:]
        registration = _Refinement(parameters)
    poses = np.repeat(np.eye(4)[None], count, axis=0)
    for k in range(count):
        guess = poses[0]
        if k > 0:
            guess = poses[k - 1] @ (step if steps is None else steps[k - 1])
        poses[k] = _add(registration, points(k), guess, k, parameters)
        if k > 0:
            step = inverse(poses[k - 1]) @ poses[k]
        tell(k + 1)
    return poses


def _first_motion(
    points: Callable[[int], Points], frames: range, parameters: OdometryParameters
) -> NDArray[np.float64]:
    """Motion of the first of these sweeps: of several speeds the one at which most points meet.

    A registration that starts from standstill locks in to a wrong motion at the speed of a
    motorway, and stays with it.
    """
    import small_gicp

    clouds = []
    for k in frames[:_START]:
        near = _near(points(k), parameters)
        if len(near) < _FEWEST_POINTS:
            break
        clouds.append(small_gicp.preprocess_points(near, 0.5, 10, 1)[0])
    best, most = np.eye(4), 0.0
    for speed in _SPEEDS if len(clouds) > 1 else ():
        known = small_gicp.GaussianVoxelMap(1.0)
        known.insert(clouds[0])
        step, pose, met = np.eye(4), np.eye(4), 0.0
        step[0, 3] = speed
        for cloud in clouds[1:]:
            found = small_gicp.align(known, cloud, init_T_target_source=pose @ step, **_ALIGN)
            if not np.isfinite(found.T_target_source).all():
                break
            next_pose = _rigid(found.T_target_source)
            step, pose = inverse(pose) @ next_pose, next_pose
            met += found.num_inliers / cloud.size()
        if met > most * (1 + 1e-3):
            best, most = step, met
    return best


def _near(points: Points, parameters: OdometryParameters) -> NDArray[np.float64]:
    """Points that are neither of the ego nor too far to be of use."""
    low, high = parameters.min_range, parameters.max_range
    with np.errstate(invalid="ignore", over="ignore"):
        squared = (points * points).sum(axis=1)
        near: NDArray[np.float64] = points[(squared > low * low) & (squared < high * high)].astype(
            np.float64
        )
    return near


def _rigid(pose: ArrayLike) -> NDArray[np.float64]:
    """The nearest rigid motion: rounding grows from sweep to sweep otherwise."""
    pose = np.array(pose, dtype=np.float64)
    u, _, vt = np.linalg.svd(pose[:3, :3])
    pose[:3, :3] = u @ vt
    return pose


# ---- poses brought along, and doubts


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
            step = np.linalg.norm(_first_motion(sweeps, frames, parameters)[:3, 3])
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


# ---- going on


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
        self._file.parent.mkdir(parents=True, exist_ok=True)
        part = self._file.with_suffix(".part")
        with part.open("wb") as stream:
            np.savez(stream, poses=poses, key=np.array(self._key))
            stream.flush()
            os.fsync(stream.fileno())
        part.replace(self._file)
