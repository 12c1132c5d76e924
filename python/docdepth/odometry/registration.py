"""Sweeps registered one after the other: kiss-icp finds the poses, small_gicp refines them."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from docdepth.config import OdometryParameters
from docdepth.datasets.base import Sweep
from docdepth.errors import OdometryError
from docdepth.geometry.se3 import inverse, nearest_rigid

log = logging.getLogger(__name__)

PreviousPoses = Callable[[int], NDArray[np.float64]]
"""``previous(k)`` gives poses (n, 4, 4) of the previous pass; the first k + 1 are known."""

FEWEST_POINTS = 50
"""A sweep with fewer usable points is not registered: its pose is predicted."""

_THREADS = 1  # sums of several threads come in any order: poses would differ from run to run

# kiss-icp: its own defaults.
_MAX_ITERATIONS = 500
_CONVERGENCE = 1e-4  # metres and radians of the last step
_POINTS_PER_VOXEL = 20
_FIRST_THRESHOLD = 2.0  # metres to a correspondence at the start
_LEAST_MOTION = 0.1  # metres; smaller deviations do not change the threshold

# small_gicp: voxels of 0.5 m resolve kerbs and posts, and still hold points enough for a normal.
_FINE_VOXEL = 0.5  # metres, edge of a voxel of the map
_FINE_SAMPLING = 0.5 * _FINE_VOXEL  # metres, edge of a voxel in which a sweep keeps one point
_NORMAL_NEIGHBORS = 10  # points that give the covariance of one
_ALIGN = {
    "max_correspondence_distance": 1.0,  # metres, to the mean of a voxel
    "num_threads": _THREADS,
    "max_iterations": 30,
    "rotation_epsilon": 1e-5,  # radians
    "translation_epsilon": 1e-4,  # metres
}

# The first motion is searched on a grid of forward speeds; ICP finds what lies between.
_FIRST_SWEEPS = 3
_STEPS = (0.0, 1.0, 2.0, 3.0, 4.0, 5.0)  # metres a sweep; 5 is 180 km/h at 10 sweeps a second
_FIRST_VOXEL = 1.0  # metres, of the map
_FIRST_SAMPLING = 0.5  # metres, of the sweeps
_CLEARLY_MORE = 1e-3  # share of inliers by which a faster start has to be better


class CoarseRegistration:
    """kiss-icp's map, adaptive threshold and point-to-point ICP."""

    def __init__(self, parameters: OdometryParameters) -> None:
        from kiss_icp.pybind import kiss_icp_pybind as kiss

        self._kiss = kiss
        self._parameters = parameters
        # kiss-icp keeps the first number of threads that a process asks for.
        self._icp = kiss._Registration(
            max_num_iterations=_MAX_ITERATIONS,
            convergence_criterion=_CONVERGENCE,
            max_num_threads=_THREADS,
        )
        self._map = kiss._VoxelHashMap(
            voxel_size=parameters.voxel_size,
            max_distance=parameters.max_range,
            max_points_per_voxel=_POINTS_PER_VOXEL,
        )
        self._threshold = kiss._AdaptiveThreshold(
            initial_threshold=_FIRST_THRESHOLD,
            min_motion_th=_LEAST_MOTION,
            max_range=parameters.max_range,
        )

    def add(self, near: NDArray[np.float64], guess: NDArray[np.float64]) -> NDArray[np.float64]:
        """Register one sweep from an initial guess (4, 4), and add it to the map."""
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


class FineRegistration:
    """small_gicp's map of voxels, each a normal distribution, and its VGICP."""

    def __init__(self) -> None:
        import small_gicp

        self._small_gicp = small_gicp
        self._map = small_gicp.GaussianVoxelMap(_FINE_VOXEL)
        self._empty = True

    def add(self, near: NDArray[np.float64], guess: NDArray[np.float64]) -> NDArray[np.float64]:
        """Register one sweep from an initial guess (4, 4), and add it to the map."""
        cloud, _ = self._small_gicp.preprocess_points(
            near, _FINE_SAMPLING, _NORMAL_NEIGHBORS, _THREADS
        )
        pose = guess.copy()
        if not self._empty:
            found = self._small_gicp.align(self._map, cloud, init_T_target_source=guess, **_ALIGN)
            # With too few inliers the pose of the previous pass stays.
            if found.num_inliers >= FEWEST_POINTS:
                pose = np.asarray(found.T_target_source, dtype=np.float64)
                pose = nearest_rigid(pose) if np.isfinite(pose).all() else pose
        if np.isfinite(pose).all():
            self._map.insert(cloud, pose)
            self._empty = False
        return pose


def register(
    sweeps: Sequence[Sweep], parameters: OdometryParameters, previous: PreviousPoses | None
) -> Iterator[NDArray[np.float64]]:
    """Register sweeps one after the other.

    Parameters
    ----------
    sweeps : sequence of Sweep
        Each is read once; without ``previous`` the first few are read twice.
    parameters : OdometryParameters
    previous : callable, optional
        Poses of the previous pass. Without them poses are found from scratch (kiss-icp), with them
        they are refined (small_gicp).

    Yields
    ------
    ndarray of float64, shape (4, 4)
        ``T_world_lidar`` of each sweep, in the frame of the first.

    Raises
    ------
    OdometryError
        A sweep cannot be registered.
    """
    registration: CoarseRegistration | FineRegistration
    step = np.eye(4)
    if previous is None:
        step = first_motion(sweeps, range(len(sweeps)), parameters)
        registration = CoarseRegistration(parameters)
    else:
        registration = FineRegistration()
    pose = np.eye(4)
    predicted: list[int] = []
    for k in range(len(sweeps)):
        guess = pose
        if k > 0:
            if previous is not None:
                known = previous(k)
                step = inverse(known[k - 1]) @ known[k]
            guess = pose @ step
        near = points_in_range(sweeps[k].points, parameters)
        if len(near) < FEWEST_POINTS:
            predicted.append(k)
            found = guess.copy()
        else:
            found = _register_sweep(registration, near, guess, k)
        # Row by row, as poses are stored: products of other layouts differ in the last bit.
        last, pose = pose, np.array(found, order="C")
        if k > 0:
            step = inverse(last) @ pose
        yield pose
    if predicted and previous is None:  # the other passes would say the same
        _warn_of_predicted(predicted, len(sweeps), parameters)


def _warn_of_predicted(predicted: list[int], count: int, parameters: OdometryParameters) -> None:
    """Log one warning of all sweeps that could not be registered."""
    log.warning(
        "%d of %d sweeps have less than %d usable points between %g and %g m, the first of them "
        "frame %d: their poses are predicted%s",
        len(predicted), count, FEWEST_POINTS, parameters.min_range, parameters.max_range,
        predicted[0],
        "" if 2 * len(predicted) < count else "; the points may not be in metres, their format may "
        "not be what it is taken for, or odometry.min_range and max_range leave too few",
    )  # fmt: skip


def _register_sweep(
    registration: CoarseRegistration | FineRegistration,
    near: NDArray[np.float64],
    guess: NDArray[np.float64],
    frame: int,
) -> NDArray[np.float64]:
    """Pose of a sweep by its points in range."""
    pose = registration.add(near, guess)
    if not np.isfinite(pose).all():
        raise OdometryError(
            f"frame {frame} could not be registered; bring poses (--poses) or try another "
            "odometry.voxel_size"
        )
    return pose


def first_motion(
    sweeps: Sequence[Sweep], frames: range, parameters: OdometryParameters
) -> NDArray[np.float64]:
    """Motion (4, 4) from the first of these frames to the next.

    Registration that starts from standstill at the speed of a motorway finds a wrong motion and
    keeps it. So the first sweeps are registered from several speeds, and the motion with most
    inliers wins.
    """
    import small_gicp

    clouds = []
    for k in frames[:_FIRST_SWEEPS]:
        near = points_in_range(sweeps[k].points, parameters)
        if len(near) < FEWEST_POINTS:
            break
        cloud, _ = small_gicp.preprocess_points(near, _FIRST_SAMPLING, _NORMAL_NEIGHBORS, _THREADS)
        clouds.append(cloud)
    best, most = np.eye(4), 0.0
    for speed in _STEPS if len(clouds) > 1 else ():
        voxel_map = small_gicp.GaussianVoxelMap(_FIRST_VOXEL)
        voxel_map.insert(clouds[0])
        step, pose, inliers = np.eye(4), np.eye(4), 0.0
        step[0, 3] = speed
        for cloud in clouds[1:]:
            found = small_gicp.align(voxel_map, cloud, init_T_target_source=pose @ step, **_ALIGN)
            if not np.isfinite(found.T_target_source).all():
                break
            next_pose = nearest_rigid(found.T_target_source)
            step, pose = inverse(pose) @ next_pose, next_pose
            inliers += found.num_inliers / cloud.size()
        if inliers > most * (1 + _CLEARLY_MORE):
            best, most = step, inliers
    return best


def points_in_range(
    points: NDArray[np.float32], parameters: OdometryParameters
) -> NDArray[np.float64]:
    """Finite points farther away than the vehicle itself and not too far to be of use."""
    low, high = parameters.min_range, parameters.max_range
    x, y, z = points.T
    with np.errstate(invalid="ignore", over="ignore"):
        squared = x * x + y * y + z * z
        inside = (squared > low * low) & (squared < high * high)
    # Half the time of points[inside], once in every pass.
    return np.compress(inside, points, axis=0).astype(np.float64)
