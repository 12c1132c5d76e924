"""The ground of a drive, chunk by chunk (paper IV-A)."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from docdepth.concurrency import Progress, Timer, null_progress, prefetch, thread_count
from docdepth.config import GroundParameters, Parameters, given
from docdepth.datasets.point_times import sweep_seconds
from docdepth.geometry.points import spread, usable_points
from docdepth.geometry.trajectory import Trajectory
from docdepth.ground.ground_map import GroundMap
from docdepth.odometry.sweeps import AnySweep, lidar_frame

CHUNK_OVERLAP = 100.0
"""Path before and after a chunk that is merged with it: about the range of a LiDAR [m]."""


class Chunk(NamedTuple):
    """A part of the drive whose ground grows as a whole.

    Attributes
    ----------
    sweeps : list of int
        Sweeps that are labelled.
    merged : list of int
        Sweeps that are merged for it: also those on ``CHUNK_OVERLAP`` of path before and after,
        which see the ground of the first and the last sweeps from nearby.
    """

    sweeps: list[int]
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
    timer: Timer | None = None,
) -> Iterator[NDArray[np.bool_]]:
    """Ground labels of one chunk, sweep by sweep.

    Parameters
    ----------
    chunk : Chunk
    read : callable
        Gives the points of a sweep, float32 (N, 3), LiDAR frame, metres. It is called from several
        threads, and twice for sweeps that are labelled: labels are known when all sweeps have been
        merged, and a chunk's sweeps together are too large to be kept.
    trajectory : Trajectory
        Of the whole drive.
    parameters : GroundParameters
    threads : int
        0 for all cores.
    progress : callable, optional
        Called with the share of the chunk that is done.
    timer : Timer, optional
        Takes the times of its steps.

    Yields
    ------
    ndarray of bool, shape (N,)
        True for ground.
    """
    progress, timer = progress or (lambda share: None), timer or Timer()
    # Voxels are counted from the first pose of the drive, so labels do not depend on the chunks.
    ground_map = GroundMap(parameters, threads, trajectory.poses[0, :3, 3])

    def label(index: int) -> NDArray[np.bool_]:
        points = read(index)
        with timer("ground: label"):
            return ground_map.label(points, trajectory.poses[index])

    with ThreadPoolExecutor(thread_count(threads) + 1) as pool:
        for step, points in enumerate(prefetch(pool, read, chunk.merged)):
            with timer("ground: insert"):
                ground_map.insert(points, trajectory.poses[chunk.merged[step]])
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
    p = given(parameters).ground
    Trajectory.check(trajectory, sweeps)
    period = sweep_seconds(trajectory.times)
    usable: dict[int, NDArray[np.bool_]] = {}

    def read(index: int) -> NDArray[np.float32]:
        points = lidar_frame(sweeps[index], period).points
        usable[index] = usable_points(points)
        return points[usable[index]]

    labels: list[NDArray[np.bool_]] = []
    for chunk in chunks(trajectory, p):
        done = partial(_chunk_progress, progress or null_progress, chunk, len(trajectory))
        found = label_chunk(chunk, read, trajectory, p, threads, done)
        for index, of_usable in zip(chunk.sweeps, found, strict=True):
            rows = usable.pop(index)
            labels.append(spread(of_usable, rows, len(rows)))
        usable.clear()
    if progress:
        progress("ground", len(trajectory), len(trajectory))
    return labels


def _chunk_progress(progress: Progress, chunk: Chunk, total: int, share: float) -> None:
    """Report a share of a chunk as sweeps done of a drive of ``total`` sweeps."""
    progress("ground", chunk.sweeps[0] + int(share * len(chunk.sweeps)), total)
