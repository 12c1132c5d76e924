"""The ground of a drive, chunk by chunk: voxels, seeds below the poses and a front (paper IV-A)."""

from __future__ import annotations

import itertools
import logging
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import docdepth._core as _core
from docdepth.concurrency import Progress, Timer, null_progress, prefetch, thread_count
from docdepth.config import GroundParameters, Parameters, checked_parameters
from docdepth.datasets.point_times import sweep_seconds
from docdepth.errors import InputError
from docdepth.geometry.points import spread, usable_points
from docdepth.geometry.trajectory import Trajectory
from docdepth.odometry.sweeps import AnySweep, lidar_frame

logger = logging.getLogger(__name__)

_SAME_AXES = 1e-6  # radians; rounded poses of a drive that begins at the identity
CHUNK_OVERLAP = 100.0
"""Path before and after a chunk that is merged with it: about the range of a LiDAR [m]."""


MIN_GROUND_SHARE = 0.01
"""Even a narrow street has several times this share of ground; with less the seeds failed [-]."""


class GroundMap:
    """The merged sweeps of a chunk of the drive, and the ground that grows in them.

    Sweeps are merged into voxels and not kept, so memory grows with the area seen and not with the
    number of sweeps. Maps with the same ``corner`` of some voxel, (3,) in the world [m], have the
    same voxels where they overlap; the labels do not depend on ``threads``.
    """

    def __init__(
        self,
        parameters: GroundParameters,
        threads: int = 0,
        corner: NDArray[np.float64] | None = None,
    ) -> None:
        self._map = _core.GroundMap(_core_parameters(parameters), threads, corner)
        self.label: Callable[[NDArray[np.float32], NDArray[np.float64]], NDArray[np.bool_]]
        self.label = self._map.label

    def insert(self, points: NDArray[np.float32], T_world_lidar: NDArray[np.float64]) -> None:
        """Merge usable points (N, 3) of a sweep; a seed of the ground is chosen below its pose."""
        try:
            self._map.insert(points, T_world_lidar)
        except IndexError as error:
            raise InputError(
                f"{error}: a map reaches a million voxels in each direction; start a new one for "
                "each chunk of the drive and leave out stray returns"
            ) from None

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
        count, voxels = self._map.grow(), len(self._map)
        logger.info("ground: %d of %d voxels", count, voxels)
        if count < MIN_GROUND_SHARE * voxels:
            logger.warning(
                "almost no ground was found (%d of %d voxels): the seeds may be outliers below "
                "the road, or the LiDAR's z axis does not point up",
                count,
                voxels,
            )
        return count


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


class Chunk(NamedTuple):
    """A part of the drive whose ground grows as a whole."""

    sweeps: list[int]  # sweeps that are labelled
    # sweeps that are merged for it: also those on ``CHUNK_OVERLAP`` of path before and after, which
    # see the ground of the first and the last sweeps from nearby
    merged: list[int]


def chunks(trajectory: Trajectory, parameters: GroundParameters) -> list[Chunk]:
    """Cut a drive into chunks of path length, in order (paper IV-A, l).

    None reaches over a gap: given poses may step there, and a step of a decimetre is a second road.
    """
    found = list[Chunk]()
    for part in trajectory.parts:
        arc = trajectory.arc_length[part.start : part.stop]
        cuts = np.flatnonzero(np.diff(arc // parameters.chunk_length)) + 1
        starts = [0, *cuts.tolist(), len(arc)]
        for begin, end in itertools.pairwise(starts):
            first = np.searchsorted(arc, arc[begin] - CHUNK_OVERLAP, "left")
            last = np.searchsorted(arc, arc[end - 1] + CHUNK_OVERLAP, "right")
            found.append(Chunk(list(part[begin:end]), list(part[int(first) : int(last)])))
    return found


def _northless(poses: NDArray[np.float64]) -> NDArray[np.float64]:
    """Poses in a world whose x axis points where the first one looks; z stays."""
    yaw = np.arctan2(poses[0, 1, 0], poses[0, 0, 0])
    if abs(yaw) < _SAME_AXES:
        return poses
    turn = np.eye(4)
    turn[:2, :2] = [[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]]
    return turn @ poses


def label_chunk(
    chunk: Chunk,
    read: Callable[[int], NDArray[np.float32]],
    trajectory: Trajectory,
    parameters: GroundParameters,
    threads: int,
    progress: Callable[[float], None],
    timer: Timer | None = None,
) -> Iterator[NDArray[np.bool_]]:
    """Ground labels of one chunk, sweep by sweep.

    Parameters
    ----------
    read : callable
        Gives the points of a sweep, float32 (N, 3), LiDAR frame, metres. It is called from several
        threads, and twice for sweeps that are labelled: labels are known when all sweeps have been
        merged, and a chunk's sweeps together are too large to be kept.
    trajectory : Trajectory
        Of the whole drive.
    threads : int
        0 for all cores.
    progress : callable
        Called with the share of the chunk that is done.
    timer : Timer, optional
        Takes the times of its steps.

    Yields
    ------
    ndarray of bool, shape (N,)
        True for ground.
    """
    timer = timer or Timer()
    # Voxels are counted from the first pose of the part and have its axes, so labels do not depend
    # on the chunks, nor on the world's origin and north.
    part = trajectory.part(chunk.sweeps[0])
    poses = dict(zip(part, _northless(trajectory.poses[part.start : part.stop]), strict=True))
    ground_map = GroundMap(parameters, threads, poses[part.start][:3, 3])

    def label(index: int) -> NDArray[np.bool_]:
        points = read(index)
        with timer("ground: label"):
            return ground_map.label(points, poses[index])

    with ThreadPoolExecutor(thread_count(threads) + 1) as pool:
        for step, points in enumerate(prefetch(pool, read, chunk.merged)):
            with timer("ground: insert"):
                ground_map.insert(points, poses[chunk.merged[step]])
            progress(step / (2 * len(chunk.merged)))
        with timer("ground: grow"):
            ground_map.grow()
        for step, ground in enumerate(prefetch(pool, label, chunk.sweeps)):
            progress(0.5 + step / (2 * len(chunk.sweeps)))
            yield ground


def grow_ground(
    sweeps: Sequence[AnySweep],
    trajectory: Trajectory,
    parameters: Parameters | None = None,
    threads: int = 0,
    progress: Progress | None = None,
) -> list[NDArray[np.bool_]]:
    """Ground labels of a whole drive, chunk by chunk (paper IV-A).

    Parameters
    ----------
    sweeps : sequence of LidarFrame, of Sweep, or of ndarray of float32, shape (N_i, 3)
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
        True for ground. Rows without a usable return, NaN or at the origin, are none.

    Raises
    ------
    InputError
        There are not as many poses as sweeps, or an array has a wrong shape or dtype.
    """
    p, threads = checked_parameters(parameters).ground, thread_count(threads)
    Trajectory.check(trajectory, sweeps)
    period = sweep_seconds(trajectory.times)
    usable: dict[int, NDArray[np.bool_]] = {}

    def read(index: int) -> NDArray[np.float32]:
        points = lidar_frame(sweeps[index], period).points
        usable[index] = usable_points(points)
        return points[usable[index]]

    tell, labels = progress or null_progress, list[NDArray[np.bool_]]()
    for chunk in chunks(trajectory, p):
        begin, length = chunk.sweeps[0], len(chunk.sweeps)

        def done(share: float, begin: int = begin, length: int = length) -> None:
            tell("ground", begin + int(share * length), len(trajectory))

        found = label_chunk(chunk, read, trajectory, p, threads, done)
        for index, of_usable in zip(chunk.sweeps, found, strict=True):
            rows = usable.pop(index)
            labels.append(spread(of_usable, rows, len(rows)))
        usable.clear()
    tell("ground", len(trajectory), len(trajectory))
    return labels
