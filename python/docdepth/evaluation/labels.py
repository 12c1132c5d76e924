"""Static and dynamic labels against ground truth, point by point (the paper's SA, DA and F1)."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth.errors import InputError
from docdepth.evaluation.label_counts import (
    HEADER,
    NOTE,
    LabelCounts,
    class_name,
    classes_of,
    ignored,
    moving,
)
from docdepth.evaluation.objects import MOVING_SPEED, SeenObject, each_object, instances
from docdepth.evaluation.tables import Table, number, plain

# Points of objects that stand at that moment and move at another: names and headings.
_STANDING = (
    ("temporarily_static", "temporarily static"),
    ("seen_to_move", "  travel in view"),
    ("arrived", "    arrived"),
    ("departs", "    depart"),
)

_FOUND = "; an object is found if half of its moving points are labelled dynamic"

# Distances from the sensor that are reported apart [m].
RANGE_BINS = (0.0, 10.0, 20.0, 30.0, 50.0, 80.0, math.inf)


@dataclass(frozen=True)
class RangeCounts:
    """Counts of the points with ``near <= range < far`` [m]."""

    near: float
    far: float
    counts: LabelCounts


@dataclass(frozen=True)
class LabelResult:
    """Metrics of the labels of a drive.

    Attributes
    ----------
    protocol : str
        What was compared, as a sentence.
    poses : str
        Source of the poses.
    sweeps : int
    counts : LabelCounts
        Static points, and dynamic points of moving classes. With speeds, only those that move at
        that moment are dynamic; points of standing objects of a moving class are left out.
    with_standing : LabelCounts, optional
        All points of moving classes are dynamic, standing or not: the rule of SemanticKITTI, whose
        moving classes hold for the whole drive. None without speeds.
    temporarily_static : LabelCounts, optional
        Only the points of moving classes that stand at that moment. None without speeds.
    seen_to_move : LabelCounts, optional
        Of these, the points of objects that travel at least half a metre while they have returns.
        The others cannot be known to move: a parked car may leave as the drive ends, or out of
        sight. None without speeds.
    arrived, departs : LabelCounts, optional
        Of these, the points of objects that have been seen to move and stand from then on, and of
        those that have not been seen to move yet. The others pause. None without speeds.
    by_range : tuple of RangeCounts
        Empty without ranges.
    by_class : dict of str to LabelCounts
        Points of each true class: static ones, or those that move at that moment.
    objects, objects_found : int
        Number of moving objects, by the instances of the truth, and of those of which at least half
        of the moving points are labelled dynamic.
    ignored : int
        Number of points without a label.
    """

    protocol: str
    poses: str
    sweeps: int
    counts: LabelCounts
    with_standing: LabelCounts | None = None
    temporarily_static: LabelCounts | None = None
    seen_to_move: LabelCounts | None = None
    arrived: LabelCounts | None = None
    departs: LabelCounts | None = None
    by_range: tuple[RangeCounts, ...] = field(default=())
    by_class: Mapping[str, LabelCounts] = field(default_factory=dict)
    objects: int = 0
    objects_found: int = 0
    ignored: int = 0

    def as_dict(self) -> dict[str, Any]:
        """All metrics by name, ready for JSON; None replaces NaN."""
        result: dict[str, Any] = {
            "protocol": self.protocol,
            "poses": self.poses,
            "sweeps": self.sweeps,
            "ignored": self.ignored,
            **self.counts.as_dict(),
        }
        if self.with_standing is not None:
            result["with_standing"] = self.with_standing.as_dict()
        for name, _ in _STANDING:
            standing: LabelCounts | None = getattr(self, name)
            if standing is not None:
                result[name] = {"points": standing.dynamic, "da": standing.da}
        result["by_range"] = [
            {"near": row.near, "far": row.far, **row.counts.as_dict()} for row in self.by_range
        ]
        result["by_class"] = {name: counts.as_dict() for name, counts in self.by_class.items()}
        result["objects"], result["objects_found"] = self.objects, self.objects_found
        return dict(plain(result))

    def table(self) -> Table:
        """One row for all points, and one per range."""
        rows = [("all", *self.counts.cells())]
        if self.with_standing is not None:
            rows = [("moving now", *self.counts.cells())]
            for name, heading in _STANDING:
                standing: LabelCounts = getattr(self, name) or LabelCounts()
                cells = ["-", f"{standing.dynamic:,}", "-", number(standing.da, 2), *["-"] * 4]
                rows.append((heading, *cells))
            rows.append(("both", *self.with_standing.cells()))
        for row in self.by_range:
            far = "" if math.isinf(row.far) else f"{row.far:g}"
            rows.append((f"{row.near:g}..{far} m", *row.counts.cells()))
        for name, counts in self.by_class.items():
            sizes, shares = (counts.static, counts.dynamic), (counts.sa, counts.da)
            cells = [f"{size:,}" if size else "-" for size in sizes]
            rows.append((name, *cells, *(number(share, 2) for share in shares), *["-"] * 4))
        title = f"labels: {self.protocol}; poses: {self.poses}; {self.sweeps} sweeps"
        if self.objects:
            title += f"; {self.objects_found} of {self.objects} moving objects found"
        return Table(title, ("points", *HEADER), tuple(rows), NOTE + _FOUND * bool(self.objects))


class LabelEvaluation:
    """Compares labels with ground truth, sweep by sweep.

    Parameters
    ----------
    poses : str
        Source of the poses; printed with the metrics.
    min_speed : float
        Faster objects are moving at that moment [m/s].
    range_bins : sequence of float
        Borders of the ranges that are reported apart [m].

    Raises
    ------
    InputError
        The borders do not increase.
    """

    def __init__(
        self,
        poses: str = "not stated",
        min_speed: float = MOVING_SPEED,
        range_bins: Sequence[float] = RANGE_BINS,
    ) -> None:
        self._poses = poses
        self._min_speed = min_speed
        self._bins = tuple(float(border) for border in range_bins)
        if len(self._bins) < 2 or any(a >= b for a, b in pairwise(self._bins)):
            raise InputError(f"range bins must increase, got {self._bins}")
        self._counts, self._standing = LabelCounts(), LabelCounts()
        self._by_range = [LabelCounts() for _ in self._bins[1:]]
        self._by_class: dict[int, LabelCounts] = {}
        self._objects: dict[int, SeenObject] = {}
        self._moving = Counter[int]()  # points of each object while it moves, and those found
        self._found = Counter[int]()
        self._sweeps = self._ignored = self._with_speeds = self._with_ranges = 0

    def add(
        self,
        labels: NDArray[np.uint32],
        dynamic: NDArray[np.bool_],
        ranges: NDArray[np.floating[Any]] | None = None,
        speeds: NDArray[np.floating[Any]] | None = None,
        seconds: float = 0.1,
    ) -> None:
        """Add one sweep.

        Parameters
        ----------
        labels : ndarray of uint32, shape (N,)
            True SemanticKITTI labels.
        dynamic : ndarray of bool, shape (N,)
            Points labelled dynamic, ``classid >= 100``.
        ranges : ndarray of float, shape (N,), optional
            Distance of each point from its LiDAR [m].
        speeds : ndarray of float, shape (N,), optional
            Speed of each point's object over ground at that moment [m/s]; for all sweeps or none.
        seconds : float
            Time from sweep to sweep [s]; until the next one an object keeps its speed.

        Raises
        ------
        InputError
            The arrays do not belong to the same points.
        """
        truth, counted = moving(labels), ~ignored(labels)
        dynamic = _flags(dynamic, len(truth))
        numbers, standing = instances(labels), np.zeros_like(truth)
        if speeds is not None:
            speeds = _values("speeds", speeds, len(truth))
            standing = truth & counted & ~(speeds > self._min_speed)
            self._standing += LabelCounts.of(truth[standing], dynamic[standing])
            for key, rows in each_object(numbers, truth & counted):
                stands = rows[standing[rows]]
                counts = LabelCounts.of(truth[stands], dynamic[stands])
                found = self._objects.setdefault(key, SeenObject())
                found.add(float(np.median(speeds[rows])), seconds, counts, self._min_speed)
        now = counted & ~standing
        self._counts += LabelCounts.of(truth[now], dynamic[now])
        classes = classes_of(labels)
        for key in np.unique(classes[now]).tolist():
            inside = now & (classes == key)
            before = self._by_class.get(key, LabelCounts())
            self._by_class[key] = before + LabelCounts.of(truth[inside], dynamic[inside])
        for key, rows in each_object(numbers, now & truth & (numbers > 0)):
            self._moving[key] += len(rows)
            self._found[key] += int(np.count_nonzero(dynamic[rows]))
        if ranges is not None:
            ranges = _values("ranges", ranges, len(truth))
            for k, (near, far) in enumerate(pairwise(self._bins)):
                inside = now & (ranges >= near) & (ranges < far)
                self._by_range[k] += LabelCounts.of(truth[inside], dynamic[inside])
        self._sweeps += 1
        self._ignored += int(len(truth) - np.count_nonzero(counted))
        self._with_speeds += speeds is not None
        self._with_ranges += ranges is not None

    def result(self) -> LabelResult:
        """Metrics of all sweeps added so far.

        Raises
        ------
        InputError
            Only some sweeps had speeds.
        """
        if self._with_speeds not in (0, self._sweeps):
            raise InputError(
                f"speeds were given for {self._with_speeds} of {self._sweeps} sweeps; "
                "give them for all or for none"
            )
        speeds = self._with_speeds > 0
        protocol = "point by point, classes 251..259 dynamic, 0 and 1 ignored"
        if speeds:
            protocol += f", moving now means above {self._min_speed:g} m/s"
        travel = [o for o in self._objects.values() if o.seen_to_move]
        by_range: tuple[RangeCounts, ...] = ()
        if self._with_ranges:
            bins = zip(pairwise(self._bins), self._by_range, strict=True)
            by_range = tuple(RangeCounts(near, far, counts) for (near, far), counts in bins)
        return LabelResult(
            protocol=protocol,
            poses=self._poses,
            sweeps=self._sweeps,
            counts=self._counts,
            with_standing=self._counts + self._standing if speeds else None,
            temporarily_static=self._standing if speeds else None,
            seen_to_move=_sum(o.standing for o in travel) if speeds else None,
            arrived=_sum(o.arrived for o in travel) if speeds else None,
            departs=_sum(o.departs for o in travel) if speeds else None,
            by_range=by_range,
            by_class={class_name(key): self._by_class[key] for key in sorted(self._by_class)},
            objects=len(self._moving),
            objects_found=sum(2 * self._found[key] >= self._moving[key] for key in self._moving),
            ignored=self._ignored,
        )


def _sum(counts: Iterable[LabelCounts]) -> LabelCounts:
    return sum(counts, LabelCounts())


def _flags(dynamic: NDArray[np.bool_], points: int) -> NDArray[np.bool_]:
    dynamic = np.asarray(dynamic)
    if dynamic.dtype != bool or dynamic.shape != (points,):
        raise InputError(
            f"{points} labels need {points} bools (True: dynamic), got {dynamic.dtype} "
            f"{dynamic.shape}; give one per point, in input order"
        )
    return dynamic


def _values(name: str, values: NDArray[Any], points: int) -> NDArray[Any]:
    values = np.asarray(values)
    if values.shape != (points,):
        raise InputError(f"{points} labels need {points} {name}, got {values.shape}")
    return values
