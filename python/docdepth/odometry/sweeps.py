"""The sweeps of a drive, read when asked for: deskewed for frames, thinned for registration."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import overload

import numpy as np
from numpy.typing import NDArray

import docdepth._core as _core
from docdepth.config import OdometryParameters
from docdepth.datasets.base import Dataset, Sweep
from docdepth.datasets.tolerance import reading_a_frame
from docdepth.errors import InputError, OdometryError
from docdepth.odometry.deskewing import deskew

FINE_SAMPLING = 0.25  # metres, edge of a voxel in which a sweep keeps one point


@dataclass(frozen=True, repr=False)
class DeskewedSweeps(Sequence[Sweep]):
    """Sweeps of a dataset; item ``i`` reads sweep ``i`` once and deskews it to its stamp.

    Nothing is kept: asking twice reads twice. A slice is a list of its sweeps.

    Attributes
    ----------
    dataset : Dataset
    motion : callable, optional
        ``motion(i)`` is the sensor's pose one sweep after stamp ``i``, in its frame at the stamp,
        float64 (4, 4). Without it sweeps stay as they were measured.
    """

    dataset: Dataset
    motion: Callable[[int], NDArray[np.float64]] | None

    def __len__(self) -> int:
        return len(self.dataset)

    def __repr__(self) -> str:
        return f"<{len(self)} sweeps of {self.dataset!r}, deskewed when read>"

    @overload
    def __getitem__(self, index: int) -> Sweep: ...
    @overload
    def __getitem__(self, index: slice) -> list[Sweep]: ...
    def __getitem__(self, index: int | slice) -> Sweep | list[Sweep]:
        frames = range(len(self))[index]
        if isinstance(frames, range):
            return [self[frame] for frame in frames]
        return self.deskewed(frames, self.dataset.sweep(frames))

    def deskewed(self, index: int, sweep: Sweep) -> Sweep:
        """Sweep ``index``, which the caller has read, deskewed as :func:`deskewed_sweep` does."""
        if self.motion is None or not is_raw(sweep):
            return sweep
        return deskewed_sweep(sweep, index, self.motion(index))


class ThinnedSweeps:
    """Sweeps as registration takes them: one mean point and time for each occupied voxel.

    Only points in range are taken. The last sweeps that were asked for are kept, so that passes
    that follow each other read and thin a sweep once.

    Parameters
    ----------
    dataset : Dataset
    parameters : OdometryParameters
    voxel_size : float
        Edge of a voxel [m].
    kept : int
        Sweeps that are kept.
    """

    def __init__(
        self, dataset: Dataset, parameters: OdometryParameters, voxel_size: float, kept: int
    ) -> None:
        self.times, self._dataset, self._voxel_size = dataset.times, dataset, voxel_size
        self._range = parameters.min_range, parameters.max_range
        self._kept, self._recent = kept, dict[int, Sweep]()

    def __len__(self) -> int:
        return len(self._dataset)

    def __getitem__(self, index: int) -> Sweep:
        if index not in self._recent:
            if len(self._recent) == self._kept:
                del self._recent[next(iter(self._recent))]
            with reading_a_frame():
                sweep = self._dataset.sweep(index)
            self._recent[index] = self._thinned(sweep)
        return self._recent[index]

    def _thinned(self, sweep: Sweep) -> Sweep:
        times = sweep.relative_time
        if times is None:
            times = np.zeros(len(sweep.points), np.float32)
        points = np.ascontiguousarray(sweep.points)
        points, times = _core.thin_sweep(points, times, self._voxel_size, *self._range)
        relative_time = None if sweep.relative_time is None else times
        compensated = sweep.motion_compensated
        return Sweep(points, sweep.name, sweep.time, None, relative_time, None, compensated)


def is_raw(sweep: Sweep) -> bool:
    """Whether a sweep can and has to be deskewed."""
    return sweep.relative_time is not None and not sweep.motion_compensated


def deskewed_sweep(sweep: Sweep, index: int, motion: NDArray[np.float64]) -> Sweep:
    """Sweep ``index`` deskewed to its stamp; rows, times, intensities and the sensor rig are kept.

    A sweep that is motion compensated already, or whose points have no times, is returned as it is.

    Raises
    ------
    OdometryError
        A usable point has no finite time.
    """
    if sweep.relative_time is None or sweep.motion_compensated:
        return sweep
    try:
        points = deskew(sweep.points, sweep.relative_time, motion)
    except InputError as error:
        raise OdometryError(f"sweep {sweep.name} (frame {index}): {error}") from None
    return replace(sweep, points=points, motion_compensated=True)
