"""Ground growing: voxels, seeds below the poses and a front that spreads (paper IV-A)."""

from __future__ import annotations

import itertools
import logging
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from docdepth import _core
from docdepth.concurrency import Watch, prefetch, thread_count, unwatched
from docdepth.config import GroundParameters, Parameters
from docdepth.errors import InputError
from docdepth.geometry.points import DeskewedSweep, points_of
from docdepth.geometry.se3 import check_rigid
from docdepth.geometry.trajectory import Trajectory

logger = logging.getLogger(__name__)

CHUNK_OVERLAP = 100.0
"""Path before and after a chunk that is merged with it: about the range of a LiDAR [m]."""

MIN_GROUND_SHARE = 0.01
"""Even a narrow street has several times this share of ground; with less the seeds failed [-]."""


class GroundMap:
    """The merged sweeps of a chunk of the drive, and the ground that grows in them.

    Sweeps are merged into voxels and not kept, so memory grows with the area seen and not with the
    number of sweeps.

    Parameters
    ----------
    parameters : GroundParameters, optional
    threads : int
        0 for all cores. The labels do not depend on it.

    Examples
    --------
    >>> ground_map = GroundMap()
    >>> for points, pose in zip(sweeps, poses):         # doctest: +SKIP
    ...     ground_map.insert(points, pose)
    >>> ground_map.grow()                              # doctest: +SKIP
    >>> ground = ground_map.label(sweeps[0], poses[0])  # doctest: +SKIP
    """

    def __init__(self, parameters: GroundParameters | None = None, threads: int = 0) -> None:
        self._map = _core.GroundMap(_core_parameters(parameters or GroundParameters()), threads)
        self._grown = False

    def __len__(self) -> int:
        """Number of voxels."""
        return len(self._map)

    def insert(self, points: NDArray[np.float32], T_world_lidar: NDArray[np.float64]) -> None:
        """Merge one sweep and its pose.

        Parameters
        ----------
        points : ndarray of float32, shape (N, 3)
            LiDAR frame, metres.
        T_world_lidar : ndarray of float64, shape (4, 4)
            A seed of the ground is chosen below this pose.

        Raises
        ------
        InputError
            An array has the wrong shape or holds NaN, or lies too far from the first pose.
        """
        points, pose = _checked(points, T_world_lidar)
        try:
            self._map.insert(points, pose)
        except IndexError as error:
            raise InputError(
                f"{error}: a map reaches a million voxels in each direction; start a new one for "
                "each chunk of the drive and leave out stray returns"
            ) from None
        self._grown = False

    def grow(self) -> int:
        """Choose seeds below every pose and grow over all that was inserted.

        The nearest returns may be the vehicle's own body. So with ``seed_quantile`` above 0, while
        less than one voxel in a hundred is ground, seeds are chosen twice as far away, up to 16 m.
        No plane leads over a kerb. So ground also continues in a square metre without ground whose
        lowest voxels lie within ``step_height`` of the ground beside it.

        Returns
        -------
        int
            Number of ground voxels. A warning is logged when there is almost none.
        """
        count: int = self._map.grow()
        self._grown = True
        logger.info("ground: %d of %d voxels", count, len(self))
        if count < MIN_GROUND_SHARE * len(self):
            logger.warning(
                "almost no ground was found (%d of %d voxels): the seeds may be outliers below "
                "the road, or the LiDAR's z axis does not point up",
                count,
                len(self),
            )
        return count

    def label(
        self, points: NDArray[np.float32], T_world_lidar: NDArray[np.float64]
    ) -> NDArray[np.bool_]:
        """Label points by their voxels.

        Parameters
        ----------
        points : ndarray of float32, shape (N, 3)
            LiDAR frame, metres; as inserted.
        T_world_lidar : ndarray of float64, shape (4, 4)

        Returns
        -------
        ndarray of bool, shape (N,)
            True for ground.

        Raises
        ------
        InputError
            As for :meth:`insert`, or nothing has been grown since the last sweep was inserted.
        """
        if not self._grown:
            raise InputError("there are no labels yet; call grow() after the last insert()")
        points, pose = _checked(points, T_world_lidar)
        ground: NDArray[np.bool_] = self._map.label(points, pose)
        return ground


class Chunk(NamedTuple):
    """A part of the drive whose ground grows as a whole.

    Attributes
    ----------
    frames : list of int
        Frames that are labelled.
    merged : list of int
        Frames that are merged for it: also those on ``CHUNK_OVERLAP`` of path before and after,
        which see the ground of the first and the last frames from nearby.
    """

    frames: list[int]
    merged: list[int]


def chunks(trajectory: Trajectory, parameters: GroundParameters | None = None) -> list[Chunk]:
    """Cut a drive into chunks of path length, in order (paper IV-A, l)."""
    p, arc = parameters or GroundParameters(), trajectory.arc_length
    number = arc // p.chunk_length
    starts = [0, *(np.flatnonzero(np.diff(number)) + 1).tolist(), len(arc)]
    found = []
    for begin, end in itertools.pairwise(starts):
        first = np.searchsorted(arc, arc[begin] - CHUNK_OVERLAP, "left")
        last = np.searchsorted(arc, arc[end - 1] + CHUNK_OVERLAP, "right")
        found.append(Chunk(list(range(begin, end)), list(range(int(first), int(last)))))
    return found


def label_chunk(
    chunk: Chunk,
    read: Callable[[int], NDArray[np.float32]],
    trajectory: Trajectory,
    parameters: GroundParameters,
    threads: int = 0,
    progress: Callable[[float], None] | None = None,
    watch: Watch = unwatched,
) -> Iterator[NDArray[np.bool_]]:
    """Ground labels of one chunk, frame by frame.

    Parameters
    ----------
    chunk : Chunk
    read : callable
        Gives the points of a frame, float32 (N, 3), LiDAR frame, metres. It is called from several
        threads, and twice for frames that are labelled: labels are known when all sweeps have been
        merged, and a chunk's sweeps together are too large to be kept.
    trajectory : Trajectory
        Of the whole drive.
    parameters : GroundParameters
    threads : int
        0 for all cores.
    progress : callable, optional
        Called with the share of the chunk that is done.
    watch : callable, optional
        Takes the times of its steps.

    Yields
    ------
    ndarray of bool, shape (N,)
        True for ground.
    """
    ground_map = GroundMap(parameters, threads)

    def label(index: int) -> NDArray[np.bool_]:
        points = read(index)
        with watch("ground: label"):
            return ground_map.label(points, trajectory.poses[index])

    progress = progress or (lambda share: None)
    with ThreadPoolExecutor(thread_count(threads) + 1) as pool:
        for step, points in enumerate(prefetch(pool, read, chunk.merged)):
            with watch("ground: insert"):
                ground_map.insert(points, trajectory.poses[chunk.merged[step]])
            progress(step / (2 * len(chunk.merged)))
        with watch("ground: grow"):
            ground_map.grow()
        for step, ground in enumerate(prefetch(pool, label, chunk.frames)):
            progress(0.5 + step / (2 * len(chunk.frames)))
            yield ground


def grow_ground(
    sweeps: Sequence[DeskewedSweep | NDArray[np.float32]],
    trajectory: Trajectory,
    parameters: Parameters | None = None,
    threads: int = 0,
    progress: Callable[[str, int, int], None] | None = None,
) -> list[NDArray[np.bool_]]:
    """Ground labels of a whole drive, chunk by chunk (paper IV-A).

    Parameters
    ----------
    sweeps : sequence of Sweep, or of ndarray of float32, shape (N_i, 3)
        Deskewed, LiDAR frame, metres.
    trajectory : Trajectory
        One pose a sweep.
    parameters : Parameters, optional
        Its ``ground`` is used.
    threads : int
        0 for all cores. The labels do not depend on it.
    progress : callable, optional
        Called with ``"ground"``, the sweeps done and their number.

    Returns
    -------
    list of ndarray of bool, shape (N_i,)
        True for ground.

    Raises
    ------
    InputError
        There are not as many poses as sweeps, or as for :meth:`GroundMap.insert`.
    """
    p = (parameters or Parameters()).ground
    if len(sweeps) != len(trajectory):
        raise InputError(
            f"{len(sweeps)} sweeps need as many poses; the trajectory has {len(trajectory)}"
        )

    def read(index: int) -> NDArray[np.float32]:
        return points_of(sweeps[index])

    labels: list[NDArray[np.bool_]] = []
    for chunk in chunks(trajectory, p):
        done = partial(chunk_progress, progress, chunk, len(trajectory))
        labels += label_chunk(chunk, read, trajectory, p, threads, done)
    if progress:
        progress("ground", len(trajectory), len(trajectory))
    return labels


def chunk_progress(
    progress: Callable[[str, int, int], None] | None, chunk: Chunk, total: int, share: float
) -> None:
    """Report a share of a chunk as sweeps done of a drive of ``total`` sweeps."""
    if progress:
        progress("ground", chunk.frames[0] + int(share * len(chunk.frames)), total)


def _core_parameters(parameters: GroundParameters) -> _core.GroundParameters:
    core = _core.GroundParameters()
    core.voxel_size = parameters.voxel_size
    core.seed_radius = parameters.seed_radius
    core.seed_quantile = parameters.seed_quantile
    if not parameters.seed_quantile:
        core.least_share = 0  # the paper does not widen the search for seeds
    core.step_height = parameters.step_height
    core.neighbors = parameters.neighbors
    core.plane_distance = parameters.plane_distance
    core.max_slope = float(np.radians(parameters.max_slope_deg))
    return core


def _checked(
    points: NDArray[np.float32], T_world_lidar: NDArray[np.float64]
) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    points = np.ascontiguousarray(points, dtype=np.float32)
    pose = np.ascontiguousarray(T_world_lidar, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError(f"points must have shape (N, 3); got {points.shape}")
    if pose.shape != (4, 4):
        raise InputError(f"T_world_lidar must have shape (4, 4); got {pose.shape}")
    check_rigid(pose[None])
    if not np.isfinite(points).all():
        row = int(np.flatnonzero(~np.isfinite(points).all(axis=1))[0])
        raise InputError(
            f"point {row} is {points[row].tolist()}; leave out what is no return "
            "(see docdepth.geometry.points.usable_points)"
        )
    return points, pose
