"""The sweeps of a drive, read when asked for and deskewed with the motion around each."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import overload

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.base import Dataset, Sweep
from docdepth.errors import InputError, OdometryError
from docdepth.odometry.deskewing import deskew


@dataclass(frozen=True)
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
        """Sweep ``index``, which the caller has read, deskewed.

        Rows, times, intensities and the sensor rig are kept. A sweep that is motion compensated
        already, or whose points have no times, is returned as it is.

        Raises
        ------
        OdometryError
            A usable point has no finite time.
        """
        if sweep.motion_compensated or sweep.relative_time is None or self.motion is None:
            return sweep
        try:
            points = deskew(sweep.points, sweep.relative_time, self.motion(index))
        except InputError as error:
            raise OdometryError(f"sweep {sweep.name} (frame {index}): {error}") from None
        return replace(sweep, points=points, motion_compensated=True)
