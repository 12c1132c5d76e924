"""Sweeps registered one after the other: kiss-icp finds the way, small_gicp refines it."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import ArrayLike, NDArray

from docdepth.config import OdometryParameters
from docdepth.errors import OdometryError
from docdepth.geometry.se3 import inverse

log = logging.getLogger(__name__)

PreviousPoses = Callable[[int], NDArray[np.float64]]
"""``before(k)`` gives the poses (n, 4, 4) of the pass before, the first k + 1 of them at least."""

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


class CoarseRegistration:
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


class FineRegistration:
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
    registration: CoarseRegistration | FineRegistration,
    points: NDArray[np.float32],
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


def register(
    points: Callable[[int], NDArray[np.float32]],
    count: int,
    parameters: OdometryParameters,
    before: PreviousPoses | None,
) -> Iterator[NDArray[np.float64]]:
    """Poses of one pass, sweep by sweep; ``before`` are those of the pass before."""
    registration: CoarseRegistration | FineRegistration
    step = np.eye(4)
    if before is None:
        step = first_motion(points, range(count), parameters)
        registration = CoarseRegistration(parameters)
    else:
        registration = FineRegistration(parameters)
    pose = np.eye(4)
    for k in range(count):
        guess = pose
        if k > 0:
            if before is not None:
                known = before(k)
                step = inverse(known[k - 1]) @ known[k]
            guess = pose @ step
        # Row by row, as poses are stored: products of other layouts differ in the last bit.
        last, pose = pose, np.array(_add(registration, points(k), guess, k, parameters), order="C")
        if k > 0:
            step = inverse(last) @ pose
        yield pose


def first_motion(
    points: Callable[[int], NDArray[np.float32]], frames: range, parameters: OdometryParameters
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


def _near(points: NDArray[np.float32], parameters: OdometryParameters) -> NDArray[np.float64]:
    """Points that are neither of the ego nor too far to be of use."""
    low, high = parameters.min_range, parameters.max_range
    x, y, z = points.T
    with np.errstate(invalid="ignore", over="ignore"):
        squared = x * x + y * y + z * z
        near = (squared > low * low) & (squared < high * high)
    # Half the time of points[near], once in every pass.
    return np.compress(near, points, axis=0).astype(np.float64)


def _rigid(pose: ArrayLike) -> NDArray[np.float64]:
    """The nearest rigid motion: rounding grows from sweep to sweep otherwise."""
    pose = np.array(pose, dtype=np.float64)
    u, _, vt = np.linalg.svd(pose[:3, :3])
    pose[:3, :3] = u @ vt
    return pose
