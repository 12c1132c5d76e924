"""Objects of a moving class, sweep by sweep: how far they travel and when they stand."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from docdepth.evaluation.label_counts import LabelCounts

# Slower objects are standing at that moment [m/s].
MOVING_SPEED = 0.3
# An object that travels less while it has returns cannot be seen to move [m].
MIN_TRAVEL = 0.5


def instances(labels: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """Number of the object of each SemanticKITTI label, shape (N,); 0 = none."""
    return np.asarray(labels).astype(np.uint32, copy=False) >> np.uint32(16)


def each_object(
    instance: NDArray[np.uint32], among: NDArray[np.bool_]
) -> Iterator[tuple[int, NDArray[np.int64]]]:
    """Every object and the indices of its points, of those that are ``among``."""
    rows = np.flatnonzero(among)
    rows = rows[np.argsort(instance[rows], kind="stable")]
    numbers, first = np.unique(instance[rows], return_index=True)
    yield from zip(numbers.tolist(), np.split(rows, first[1:]), strict=False)


@dataclass
class SeenObject:
    """What the sweeps saw of one object; sweeps are added in order of time.

    Attributes
    ----------
    travel : float
        Metres travelled while it had returns.
    departs, pauses : LabelCounts
        Its standing points before it was first seen to move, and between two motions.
    """

    travel: float = 0.0
    departs: LabelCounts = field(default_factory=LabelCounts)
    pauses: LabelCounts = field(default_factory=LabelCounts)
    _moved: bool = False
    _waiting: LabelCounts = field(default_factory=LabelCounts)

    def add(self, speed: float, seconds: float, counts: LabelCounts, min_speed: float) -> None:
        """Add a sweep: its speed [m/s], the time to the next one, and its standing points."""
        self.travel += speed * seconds
        if speed > min_speed:
            if self._moved:
                self.pauses += self._waiting
            else:
                self.departs = self._waiting
            self._waiting, self._moved = LabelCounts(), True
        self._waiting += counts

    @property
    def arrived(self) -> LabelCounts:
        """Its standing points after it was last seen to move, until the end."""
        return self._waiting if self._moved else LabelCounts()

    @property
    def standing(self) -> LabelCounts:
        """All its standing points."""
        return self.departs + self.pauses + self._waiting

    @property
    def seen_to_move(self) -> bool:
        return self.travel >= MIN_TRAVEL
