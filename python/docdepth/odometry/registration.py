"""Sweeps registered one after the other by small_gicp, distribution to distribution."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth.config import OdometryParameters
from docdepth.datasets.base import Sweep
from docdepth.errors import OdometryError
from docdepth.geometry.se3 import inverse, nearest_rigid, se3_exp, se3_log
from docdepth.odometry.deskewing import NEIGHBORS, centred_motion
from docdepth.odometry.level_ground import split_level_ground
from docdepth.odometry.registration_log import Found, RegistrationLog
from docdepth.odometry.smoothing import State, filtered, stamp_error_of
from docdepth.odometry.sweeps import ThinnedSweeps, deskewed_sweep
from docdepth.odometry.traffic import SEEN, Traffic

log = logging.getLogger(__name__)

KnownPoses = Callable[[int], NDArray[np.float64]]
"""``known(k)`` gives poses (n, 4, 4) of an earlier pass; the first k + 1 of them are known."""

FEWEST_POINTS = 50
"""A sweep with fewer usable points is not registered: its pose is predicted."""

FINE_SAMPLING = 0.25  # metres, edge of a voxel in which a sweep keeps one point

# Voxels of 0.5 m resolve kerbs and posts, and still hold points enough for a normal.
_FINE_VOXEL = 0.5  # metres, edge of a voxel of the map
_NEIGHBORS, _FINE_NEIGHBORS = 20, 15
"""Neighbours from which the normal of a point is taken, in the first pass and in the second. On a
road the nearest ones lie on the ring of one laser. By 16 beams, ten of them are a short arc, whose
bend is less than the noise along the rays. So the normal leans towards the LiDAR, and poses pitch
a little more with each sweep. Still more neighbours blur normals at edges."""

_THREADS = 1  # sums of several threads come in any order: poses would differ from run to run
_ALIGN = {
    "max_correspondence_distance": 1.0,  # metres, to the mean of a voxel
    "num_threads": _THREADS,
    "max_iterations": 30,
    "rotation_epsilon": 1e-4,  # radians
    "translation_epsilon": 5e-4,  # metres
}
_UNKNOWN = 1e2  # metres and radians; standard deviation of a pose that was not measured

_MARGIN = 15.0
"""Metres that points lie farther from a logged pose in the map than from the sensor when they were
measured: deskewing moves them by up to 10 m at 60 m/s, and the filter moves the pose."""

# A run warns if registration disagrees with the motion in a large share of the sweeps.
_DISAGREES = 0.3  # metres between a registered position and the predicted one
_MAX_DISAGREEING = 0.05  # share of the sweeps
_SETTLED = 4  # sweeps after which the filter knows the motion

# The first motion is searched on a grid of forward speeds; registration finds what lies between.
FIRST_SWEEPS = 3
_STEPS = (0.0, 1.0, 2.0, 3.0, 4.0, 5.0)  # metres a sweep; 5 is 180 km/h at 10 sweeps a second
_FIRST_VOXEL = 1.0  # metres, of the map
_FIRST_SAMPLING = 0.5  # metres, of the sweeps
_HIGH = 3.0  # metres above the LiDAR, or 5 above the road: nothing that drives is higher
_CLEARLY_MORE = 1e-3  # share of points by which a faster start has to be better


class Registration:
    """small_gicp's map of voxels, each a normal distribution, and its VGICP.

    Parameters
    ----------
    voxel_size : float
        Edge of a voxel of the map [m].
    sampling : float, optional
        Edge of a voxel in which a sweep keeps one point [m]; None where sweeps are thin enough.
    neighbors : int
        Points from which the normal of a point is taken.
    threads : int
        For the normals of a sweep.
    """

    def __init__(
        self, voxel_size: float, sampling: float | None, neighbors: int, threads: int
    ) -> None:
        import small_gicp

        self._small_gicp = small_gicp
        self._map = small_gicp.GaussianVoxelMap(voxel_size)
        self._voxel_size, self._sampling = voxel_size, sampling
        self._neighbors, self._threads = neighbors, threads
        self._empty, self._cloud, self._traffic = True, None, Traffic()

    def take(self, points: NDArray[np.float32], guess: NDArray[np.float64]) -> None:
        """Take the next deskewed sweep, without traffic: its points get their distributions.

        Parameters
        ----------
        points : ndarray of float32, shape (N, 3)
        guess : ndarray of float64, shape (4, 4)
            Where it was taken, about.
        """
        rising, road = _thinned(points.astype(np.float64), self._sampling, self._voxel_size)
        seen = rising if len(road) else np.zeros((0, 3))
        along = self._traffic.left_out(seen, guess)
        rising = rising[~along] if along.any() else rising
        self._cloud = _cloud(rising, road, self._neighbors, self._threads)

    def align(self, guess: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Register the sweep that was taken, from an initial guess (4, 4).

        Returns
        -------
        pose : ndarray of float64, shape (4, 4)
        covariance : ndarray of float64, shape (6, 6)
            Of its rotation [rad^2] and its position [m^2], about the axes of the world.
        """
        pose, covariance = guess.copy(), _UNKNOWN**2 * np.eye(6)
        if self._empty:
            covariance = np.zeros((6, 6))  # it is the frame of all poses
        else:
            found = self._small_gicp.align(
                self._map, self._cloud, init_T_target_source=guess, **_ALIGN
            )
            # With too few inliers the guess stays.
            if found.num_inliers >= FEWEST_POINTS and np.isfinite(found.T_target_source).all():
                # Row by row, as poses are stored: products of other layouts differ in the last bit.
                pose = np.array(nearest_rigid(found.T_target_source), order="C")
                covariance = _covariance(found.H, pose)
        return pose, covariance

    def insert(self, pose: NDArray[np.float64]) -> None:
        """Add the sweep that was taken to the map."""
        self._map.insert(self._cloud, pose)
        self._empty = False


def _thinned(
    points: NDArray[np.float64], sampling: float | None, voxel_size: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """One point in each voxel, for a map of such voxels; and level ground if it is most of them."""
    import small_gicp

    if sampling is not None:
        points = small_gicp.voxelgrid_sampling(points, sampling).points()[:, :3]
    return split_level_ground(points, voxel_size)


def _cloud(
    rising: NDArray[np.float64], road: NDArray[np.float64], neighbors: int, threads: int
) -> Any:
    """A small_gicp.PointCloud with the distribution of each point."""
    import small_gicp

    cloud = small_gicp.PointCloud(np.concatenate([rising, road]) if len(road) else rising)
    small_gicp.estimate_covariances(cloud, small_gicp.KdTree(cloud), neighbors, threads)
    return cloud


class LoggedRegistration:
    """A registration that goes on behind what a log holds.

    Parameters
    ----------
    registration : Registration
        With an empty map.
    kept : RegistrationLog
    count : int
        Sweeps of the drive.
    reach : float
        Farthest point that is registered [m].

    Attributes
    ----------
    first : int
        The first sweep that the map shows.
    """

    def __init__(
        self, registration: Registration, kept: RegistrationLog, count: int, reach: float
    ) -> None:
        self._registration, self._log = registration, kept
        # Two sweeps touch one voxel from either side.
        self.first = kept.first_needed(2 * (reach + _MARGIN)) if len(kept) < count else count
        # Traffic in the first sweep is told by those before it.
        self._read = max(0, self.first - SEEN) if len(kept) < count else count

    def align(self, index: int, deskewed: Callable[[], Sweep], guess: NDArray[np.float64]) -> Found:
        """What registration finds, or has found, of a sweep; it is read only if it is needed.

        Parameters
        ----------
        index : int
        deskewed : callable
            Reads the sweep.
        guess : ndarray of float64, shape (4, 4)
        """
        found = self._log.found(index)
        if found is not None and (index < self._read or not found.usable):
            return found
        points = deskewed().points
        usable = len(points) >= FEWEST_POINTS
        if usable:
            self._registration.take(points, guess)
        if found is None:
            unknown = _UNKNOWN**2 * np.eye(6)
            pose, covariance = self._registration.align(guess) if usable else (guess, unknown)
            if not np.isfinite(pose).all():
                raise OdometryError(
                    f"frame {index} could not be registered; bring poses (--poses) or try another "
                    "odometry.voxel_size"
                )
            found = Found(pose, covariance, usable)
            self._log.add(found)
        return found

    def insert(self, index: int, pose: NDArray[np.float64]) -> None:
        """Add a sweep to the map, where the map shows it still."""
        if index >= self.first:
            self._registration.insert(pose)


def _covariance(hessian: NDArray[np.float64], pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """Covariance (6, 6) about the axes of the world, of a Hessian about those of the LiDAR."""
    turn = np.kron(np.eye(2), pose[:3, :3])
    inverse_hessian = np.linalg.inv(np.asarray(hessian) + _UNKNOWN**-2 * np.eye(6))
    covariance: NDArray[np.float64] = turn @ inverse_hessian @ turn.T
    return covariance


def register(
    sweeps: ThinnedSweeps,
    parameters: OdometryParameters,
    known: KnownPoses | None,
    threads: int = 1,
    kept: RegistrationLog | None = None,
) -> Iterator[State]:
    """Register sweeps one after the other.

    Parameters
    ----------
    sweeps : ThinnedSweeps
    parameters : OdometryParameters
    known : callable, optional
        Poses of an earlier pass, which are refined: sweeps are deskewed with the motion around
        them. Without them poses are found from scratch: sweeps are deskewed with the motion of the
        sweep before.
    threads : int
    kept : RegistrationLog, optional
        What an interrupted pass found is taken from there, and what is found is added.

    Yields
    ------
    State
        ``T_world_lidar`` of each sweep in the frame of the first, and how it moves.

    Raises
    ------
    OdometryError
        A sweep cannot be registered.
    """
    count, times = len(sweeps), sweeps.times
    voxel = _FINE_VOXEL if known else parameters.voxel_size
    sampling = None if known else 0.5 * parameters.voxel_size
    neighbors = _FINE_NEIGHBORS if known else _NEIGHBORS
    registration = LoggedRegistration(
        Registration(voxel, sampling, neighbors, threads),
        RegistrationLog() if kept is None else kept,
        count,
        parameters.max_range + voxel,
    )
    motion = np.eye(4)
    if known is None and registration.first < 2:
        motion = first_motion(sweeps, range(count), parameters)
    period = float(np.median(np.diff(times))) if count > 1 else 1.0
    stamp_error = stamp_error_of(times)
    pose, predicted, disagreeing = np.eye(4), list[int](), 0
    state: State | None = None
    for k in range(count):
        last, elapsed = pose, float(times[k] - times[k - 1]) / period if k else 0.0
        if known is None:
            guess = last @ _power(motion, elapsed)
        else:
            poses = known(min(k + NEIGHBORS, count - 1))
            motion = centred_motion(poses, times, [k])[0]
            guess = last @ inverse(poses[k - 1]) @ poses[k] if k else last
        found = registration.align(k, partial(_deskewed, sweeps, k, motion), guess)
        seconds = elapsed * period * 1e-9
        state = filtered(state, found.pose, found.covariance, seconds, stamp_error)
        pose = state.pose
        off = np.linalg.norm(found.pose[:3, 3] - state.predicted[:3])
        disagreeing += bool(found.usable and k >= _SETTLED and off > _DISAGREES)
        if found.usable:
            registration.insert(k, pose)
        else:
            predicted.append(k)
        if k and known is None:
            # The filtered velocity: the last step would feed its error back by deskewing.
            motion = _power(inverse(last) @ pose, 1 / elapsed)
            motion[:3, 3] = 1e-9 * period * pose[:3, :3].T @ state.velocity
        yield state
    if predicted and known is None:  # the other passes would say the same
        _warn_of_predicted(predicted, count, parameters)
    if known is not None and disagreeing > _MAX_DISAGREEING * count:
        _warn_of_disagreement(disagreeing, count)


def _deskewed(sweeps: ThinnedSweeps, index: int, motion: NDArray[np.float64]) -> Sweep:
    return deskewed_sweep(sweeps[index], index, motion)


def _power(motion: NDArray[np.float64], share: float) -> NDArray[np.float64]:
    """The motion (4, 4) of a share of the time."""
    omega, velocity = se3_log(motion)
    return se3_exp(share * omega, share * velocity)


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


def _warn_of_disagreement(disagreeing: int, count: int) -> None:
    """Log a warning that registration and the motion do not fit together."""
    log.warning(
        "%d of %d sweeps were registered more than %g m from where the motion led; perhaps the "
        "LiDAR sees little that stands still, traffic goes along, or times are wrong; poses may be "
        "metres off: look at them, or bring better ones (--poses)", disagreeing, count, _DISAGREES,
    )  # fmt: skip


def first_motion(
    sweeps: Sequence[Sweep] | ThinnedSweeps, frames: range, parameters: OdometryParameters
) -> NDArray[np.float64]:
    """Motion (4, 4) from the first of these frames to the next.

    Registration that starts from standstill at the speed of a motorway finds a wrong motion and
    keeps it. So the first sweeps are registered from several speeds, and the result wins that
    brings most points near those of the first sweep. Lorries at the same speed, and rings on the
    road, would vote for standstill. So only points higher than any lorry count, if there are
    enough.
    """
    import small_gicp

    clouds = []
    for k in frames[:FIRST_SWEEPS]:
        near = points_in_range(sweeps[k].points, parameters)
        if len(near) < FEWEST_POINTS:
            break
        parts = _thinned(near, _FIRST_SAMPLING, _FIRST_VOXEL)
        clouds.append(_cloud(*parts, _NEIGHBORS, _THREADS))
    if len(clouds) < 2:
        return np.eye(4)
    counted = [cloud.points()[:, :3] for cloud in clouds]
    high = [points[points[:, 2] > _HIGH] for points in counted]
    if min(map(len, high)) >= FEWEST_POINTS:
        counted = high
    first = small_gicp.KdTree(clouds[0])
    best, most = np.eye(4), 0.0
    for speed in _STEPS:
        voxel_map = small_gicp.GaussianVoxelMap(_FIRST_VOXEL)
        voxel_map.insert(clouds[0])
        step, pose, share = np.eye(4), np.eye(4), 0.0
        step[0, 3] = speed
        for cloud, points in zip(clouds[1:], counted[1:], strict=True):
            found = small_gicp.align(voxel_map, cloud, init_T_target_source=pose @ step, **_ALIGN)
            if not np.isfinite(found.T_target_source).all():
                break
            next_pose = nearest_rigid(found.T_target_source)
            step, pose = inverse(pose) @ next_pose, next_pose
            there = points @ pose[:3, :3].T + pose[:3, 3]
            squared = np.asarray(first.batch_nearest_neighbor_search(there, _THREADS)[1])
            share += float(np.mean(squared < _FIRST_SAMPLING**2))
        if share > most * (1 + _CLEARLY_MORE):
            best, most = step, share
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
    # Half the time of points[inside].
    return np.compress(inside, points, axis=0).astype(np.float64)
