"""The sweeps of a drive, read when asked for: deskewed for frames, thinned for registration."""

from __future__ import annotations

from collections.abc import Callable, Set
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

import docdepth._core as _core
from docdepth.config import OdometryParameters
from docdepth.datasets.base import Dataset, ReadSequence, Sweep
from docdepth.datasets.files import suggest_skipping
from docdepth.datasets.point_times import sweep_seconds
from docdepth.errors import InputError, OdometryError
from docdepth.geometry.lidar_frame import LidarFrame
from docdepth.geometry.points import check_points
from docdepth.odometry.deskewing import deskew

FINE_SAMPLING = 0.25  # metres, edge of a voxel in which a sweep keeps one point


AnySweep: TypeAlias = LidarFrame | Sweep | NDArray[np.float32]
"""A deskewed sweep as a caller may have it."""


def lidar_frame(sweep: AnySweep, period: np.float32) -> LidarFrame:
    """A sweep that is deskewed to its stamp, or an array of its points, as a frame of all its rows.

    Here alone shares of a sweep (:attr:`Sweep.relative_time`) become seconds.

    Parameters
    ----------
    sweep : LidarFrame, Sweep, or an array that :func:`check_points` takes
        An array was measured from its origin. A frame is returned as it is.
    period : float32
        Seconds of a sweep (:func:`~docdepth.datasets.point_times.sweep_seconds`).
    """
    if isinstance(sweep, LidarFrame):
        return sweep
    is_array = hasattr(sweep, "__array__") or hasattr(sweep, "__dlpack__")
    points = sweep if is_array else getattr(sweep, "points", None)
    if points is None:
        raise InputError(
            "a sweep is a docdepth.Sweep or a float32 array of shape (N, 3), "
            f"not {type(sweep).__name__}"
        )
    points = check_points(points)
    shares = getattr(sweep, "relative_time", None)
    return LidarFrame(
        points,
        np.arange(len(points), dtype=np.uint32),
        getattr(sweep, "name", ""),
        len(points),
        None if shares is None else period * shares,
        getattr(sweep, "sensor_rig", None),
    )


@dataclass(frozen=True, repr=False)
class DeskewedSweeps(ReadSequence[LidarFrame]):
    """Sweeps of a dataset; item ``i`` reads sweep ``i`` once and deskews it to its stamp.

    A frame has a row for each row of its sweep. Nothing is kept: asking twice reads twice. A slice
    is a list of its frames.
    """

    dataset: Dataset
    # ``motion(i)`` is the sensor's pose one sweep after stamp ``i``, in its frame at the stamp,
    # float64 (4, 4). Without it sweeps stay as they were measured
    motion: Callable[[int], NDArray[np.float64]] | None

    def __len__(self) -> int:
        return len(self.dataset)

    def __repr__(self) -> str:
        return f"<{len(self)} sweeps of {self.dataset!r}, deskewed when read>"

    def read(self, index: int) -> LidarFrame:
        """Read sweep ``index`` and deskew it."""
        return self.deskewed(index, self.dataset.sweep(index))

    @cached_property
    def _period(self) -> np.float32:
        return sweep_seconds(self.dataset.times)

    def deskewed(self, index: int, sweep: Sweep) -> LidarFrame:
        """Sweep ``index``, which the caller has read, deskewed as :func:`deskewed_points` does."""
        frame = lidar_frame(sweep, self._period)
        if self.motion is None:
            return frame
        return replace(frame, points=deskewed_points(sweep, index, self.motion(index)))


class ThinnedSweeps:
    """Sweeps as registration takes them: one mean point and time for each occupied voxel.

    Only points in range are taken. The last sweeps that were asked for are kept, so that passes
    that follow each other read and thin a sweep once.

    Parameters
    ----------
    voxel_size : float
        Edge of a voxel [m].
    kept : int
        Last sweeps that are kept.
    needed_later : set of int
        Sweeps that are kept until the end, once they are read.
    """

    def __init__(
        self,
        dataset: Dataset,
        parameters: OdometryParameters,
        voxel_size: float,
        kept: int,
        needed_later: Set[int] = frozenset(),
    ) -> None:
        self.times, self._dataset, self._voxel_size = dataset.times, dataset, voxel_size
        self._range = parameters.min_range, parameters.max_range
        self._kept, self._recent = kept, dict[int, Sweep]()
        self._needed_later, self._until_end = needed_later, dict[int, Sweep]()

    def __len__(self) -> int:
        return len(self._dataset)

    def __getitem__(self, index: int) -> Sweep:
        sweeps = self._until_end if index in self._needed_later else self._recent
        if index not in sweeps:
            if sweeps is self._recent and len(sweeps) == self._kept:
                del sweeps[next(iter(sweeps))]
            with suggest_skipping():
                sweep = self._dataset.sweep(index)
            sweeps[index] = self._thinned(sweep)
        return sweeps[index]

    def _thinned(self, sweep: Sweep) -> Sweep:
        moved_by = motion_times(sweep)
        times = np.zeros(len(sweep.points), np.float32) if moved_by is None else moved_by
        points = np.ascontiguousarray(sweep.points)
        points, times = _core.thin_sweep(points, times, self._voxel_size, *self._range)
        relative_time = None if moved_by is None else times
        return Sweep(points, sweep.name, sweep.time, None, relative_time)


class SweepPart:
    """Some sweeps that follow each other without a gap, counted from the first of them."""

    def __init__(self, sweeps: ThinnedSweeps, frames: range) -> None:
        self.times, self.first = sweeps.times[frames.start : frames.stop], frames.start
        self.total, self._sweeps, self._frames = len(sweeps), sweeps, frames

    def __len__(self) -> int:
        return len(self._frames)

    def __getitem__(self, index: int) -> Sweep:
        return self._sweeps[self._frames[index]]


def motion_times(sweep: Sweep) -> NDArray[np.float32] | None:
    """By how long the motion has to move each point to the stamp, as shares of a sweep.

    None where a sweep is compensated to its stamp, or its points have no times.
    """
    return sweep.compensated_to if sweep.motion_compensated else sweep.relative_time


def deskewed_points(sweep: Sweep, index: int, motion: NDArray[np.float64]) -> NDArray[np.float32]:
    """The points of sweep ``index``, deskewed to its stamp, (N, 3).

    Those of a sweep that is motion compensated already, or whose points have no times, are returned
    as they are.
    """
    times = motion_times(sweep)
    if times is None:
        return sweep.points
    try:
        return deskew(sweep.points, times, motion)
    except InputError as error:
        raise OdometryError(f"sweep {sweep.name} (frame {index}): {error}") from None
