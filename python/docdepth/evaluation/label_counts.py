"""SemanticKITTI's labels, the confusion matrix of static and dynamic points, and moving objects."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import astuple, dataclass

import numpy as np
from numpy.typing import NDArray

from docdepth.errors import InputError
from docdepth.evaluation.tables import Figures, number, percent, ratio
from docdepth.geometry.points import MOVING_LABELS
from docdepth.io.labels import CLASS_NAMES

_OUTLIER = 1  # the last of SemanticKITTI's classes without a meaning


def class_name(number: int) -> str:
    """Name of a class; its number if SemanticKITTI has none."""
    return CLASS_NAMES.get(number, f"class {number}")


def moving(labels: NDArray[np.uint32]) -> NDArray[np.bool_]:
    """Which SemanticKITTI labels have a moving class, 251 to 259.

    Parameters
    ----------
    labels : ndarray of uint32, shape (N,)
        Class in the low 16 bits, instance in the high 16 bits.
    """
    return np.isin(classes_of(labels), MOVING_LABELS)


def ignored(labels: NDArray[np.uint32]) -> NDArray[np.bool_]:
    """Which SemanticKITTI labels are not evaluated: 0 (unlabelled) and 1 (outlier)."""
    return classes_of(labels) <= _OUTLIER


def classes_of(labels: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """SemanticKITTI class of each label, (N,)."""
    labels = np.asarray(labels)
    if labels.ndim != 1 or labels.dtype.kind not in "ui":
        raise InputError(
            f"labels must be integers of shape (N,), one per point; got {labels.dtype} "
            f"{labels.shape}"
        )
    return labels.astype(np.uint32, copy=False) & np.uint32(0xFFFF)


@dataclass(frozen=True)
class LabelCounts(Figures):
    """Confusion matrix of the classes static and dynamic.

    Attributes
    ----------
    static_kept, static_lost : int
        Static points labelled static, and static points labelled dynamic (false positives).
    dynamic_found, dynamic_missed : int
        Dynamic points labelled dynamic, and dynamic points labelled static (false negatives).
    """

    static_kept: int = 0
    static_lost: int = 0
    dynamic_found: int = 0
    dynamic_missed: int = 0
    derived = ("static", "dynamic", "sa", "da", "aa", "f1", "precision", "iou")

    @classmethod
    def of(cls, truth: NDArray[np.bool_], predicted: NDArray[np.bool_]) -> LabelCounts:
        """Count points from their true and predicted dynamic flags, shape (N,) each."""
        table = np.bincount(2 * truth.astype(np.int64) + predicted, minlength=4)
        return cls(*(int(n) for n in (table[0], table[1], table[3], table[2])))

    def __add__(self, other: LabelCounts) -> LabelCounts:
        return LabelCounts(*map(sum, zip(astuple(self), astuple(other), strict=True)))

    @property
    def static(self) -> int:
        """Number of static points in the ground truth."""
        return self.static_kept + self.static_lost

    @property
    def dynamic(self) -> int:
        """Number of dynamic points in the ground truth."""
        return self.dynamic_found + self.dynamic_missed

    @property
    def sa(self) -> float:
        """Static accuracy SA [%]: share of static points labelled static."""
        return percent(self.static_kept, self.static)

    @property
    def da(self) -> float:
        """Dynamic accuracy DA [%]: share of dynamic points labelled dynamic (recall)."""
        return percent(self.dynamic_found, self.dynamic)

    @property
    def f1(self) -> float:
        """Harmonic mean of SA and DA (HA of DynamicMap_Benchmark), 0..1."""
        return ratio(2 * self.sa * self.da, self.sa + self.da) / 100

    @property
    def aa(self) -> float:
        """Associated accuracy AA [%]: geometric mean of SA and DA."""
        return math.sqrt(self.sa * self.da)

    @property
    def precision(self) -> float:
        """Share of the points labelled dynamic that are dynamic, 0..1."""
        return ratio(self.dynamic_found, self.dynamic_found + self.static_lost)

    @property
    def iou(self) -> float:
        """Intersection over union of the dynamic class, 0..1 (LiDAR-MOS)."""
        return ratio(self.dynamic_found, self.dynamic + self.static_lost)

    def cells(self) -> list[str]:
        """Cells of a table row: numbers of points, then metrics."""
        return [
            f"{self.static:,}",
            f"{self.dynamic:,}",
            *(number(x, 2) for x in (self.sa, self.da, self.aa)),
            *(number(x, 4) for x in (self.f1, self.precision, self.iou)),
        ]


HEADER = ("static points", "dynamic points", "SA %", "DA %", "AA %", "F1", "precision", "IoU")
NOTE = (
    "SA, DA: static and dynamic accuracy, the share of static and of dynamic points labelled so; "
    "AA: associated accuracy, sqrt(SA DA); F1: harmonic mean of SA and DA, 0 to 1; "
    "precision: share of the points labelled dynamic that are; "
    "IoU: intersection over union of the dynamic points"
)

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
    """What the sweeps saw of one object; sweeps are added in order of time."""

    travel: float = 0.0  # metres travelled while it had returns
    # before, pauses, arrived: its standing points until it was first seen to move, between two
    # motions, and after the last one
    before: LabelCounts = LabelCounts()
    pauses: LabelCounts = LabelCounts()
    arrived: LabelCounts = LabelCounts()
    _moved: bool = False

    def add(self, speed: float, seconds: float, counts: LabelCounts) -> None:
        """Add a sweep: its speed [m/s], the time to the next one, and its standing points."""
        self.travel += speed * seconds
        if speed > MOVING_SPEED:
            self.pauses += self.arrived
            self.arrived, self._moved = LabelCounts(), True
        if self._moved:
            self.arrived += counts
        else:
            self.before += counts

    @property
    def departs(self) -> LabelCounts:
        """Its standing points before it was seen to move; none if it never was."""
        return self.before if self._moved else LabelCounts()

    @property
    def standing(self) -> LabelCounts:
        """All its standing points."""
        return self.before + self.pauses + self.arrived

    @property
    def seen_to_move(self) -> bool:
        return self.travel >= MIN_TRAVEL
