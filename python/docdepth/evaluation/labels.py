"""Static and dynamic labels against ground truth, point by point (the paper's SA, DA and F1)."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth.errors import InputError
from docdepth.evaluation.label_counts import (
    HEADER,
    MOVING_SPEED,
    NOTE,
    LabelCounts,
    SeenObject,
    class_name,
    classes_of,
    each_object,
    ignored,
    instances,
    moving,
)
from docdepth.evaluation.tables import Band, Figures, Table, number, plain

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
class LabelResult(Figures):
    """Metrics of the labels of a drive.

    Attributes
    ----------
    protocol : str
        What was compared, as a sentence.
    poses : str
        Source of the poses.
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
    by_range : tuple of Band
        Points with ``near <= range < far`` [m]; empty without ranges.
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
    with_standing: LabelCounts | None
    temporarily_static: LabelCounts | None
    seen_to_move: LabelCounts | None
    arrived: LabelCounts | None
    departs: LabelCounts | None
    by_range: tuple[Band[LabelCounts], ...]
    by_class: dict[str, LabelCounts]
    objects: int
    objects_found: int
    ignored: int
    flat = ("counts",)

    def as_dict(self) -> dict[str, object]:
        """All metrics by name, ready for JSON; None replaces NaN."""
        result = super().as_dict()
        for name, _ in _STANDING:
            if name in result:
                counts = plain(getattr(self, name))
                result[name] = {"points": counts["dynamic"], "da": counts["da"]}
        return result

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
        rows += [(f"{band} m", *band.figures.cells()) for band in self.by_range]
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
    """

    def __init__(self, poses: str = "not stated") -> None:
        self._poses = poses
        self._counts, self._standing = LabelCounts(), LabelCounts()
        self._by_range = defaultdict[tuple[float, float], LabelCounts](LabelCounts)
        self._by_class = defaultdict[int, LabelCounts](LabelCounts)
        self._objects = defaultdict[int, SeenObject](SeenObject)
        self._moving = Counter[int]()  # points of each object while it moves, and those found
        self._found = Counter[int]()
        self._sweeps = self._ignored = self._with_speeds = 0

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
        """
        truth, counted = moving(labels), ~ignored(labels)
        dynamic = np.asarray(dynamic)
        if dynamic.dtype != bool or dynamic.shape != truth.shape:
            raise InputError(
                f"{len(truth)} labels need {len(truth)} bools (True: dynamic), got "
                f"{dynamic.dtype} {dynamic.shape}; give one per point, in input order"
            )
        ranges, speeds = (None if v is None else np.asarray(v) for v in (ranges, speeds))
        for name, values in (("ranges", ranges), ("speeds", speeds)):
            if values is not None and values.shape != truth.shape:
                raise InputError(f"{len(truth)} labels need as many {name}, got {values.shape}")

        def count(chosen: NDArray[np.bool_] | NDArray[np.int64]) -> LabelCounts:
            return LabelCounts.of(truth[chosen], dynamic[chosen])

        numbers, standing = instances(labels), np.zeros_like(truth)
        if speeds is not None:
            standing = truth & counted & ~(speeds > MOVING_SPEED)
            self._standing += count(standing)
            for key, rows in each_object(numbers, truth & counted):
                speed = float(np.median(speeds[rows]))
                self._objects[key].add(speed, seconds, count(rows[standing[rows]]))
        now = counted & ~standing
        self._counts += count(now)
        classes = classes_of(labels)
        for key in np.unique(classes[now]).tolist():
            self._by_class[key] += count(now & (classes == key))
        for key, rows in each_object(numbers, now & truth & (numbers > 0)):
            self._moving[key] += len(rows)
            self._found[key] += int(np.count_nonzero(dynamic[rows]))
        if ranges is not None:
            for near, far in pairwise(RANGE_BINS):
                self._by_range[near, far] += count(now & (ranges >= near) & (ranges < far))
        self._sweeps += 1
        self._ignored += int(np.count_nonzero(~counted))
        self._with_speeds += speeds is not None

    def result(self) -> LabelResult:
        """Metrics of all sweeps added so far."""
        if self._with_speeds not in (0, self._sweeps):
            raise InputError(
                f"speeds were given for {self._with_speeds} of {self._sweeps} sweeps; "
                "give them for all or for none"
            )
        protocol = "point by point, classes 251..259 dynamic, 0 and 1 ignored"
        if self._with_speeds:
            protocol += f", moving now means above {MOVING_SPEED:g} m/s"
        travel = [o for o in self._objects.values() if o.seen_to_move]
        none = LabelCounts()
        apart = {
            "with_standing": self._counts + self._standing,
            "temporarily_static": self._standing,
            "seen_to_move": sum((o.standing for o in travel), none),
            "arrived": sum((o.arrived for o in travel), none),
            "departs": sum((o.departs for o in travel), none),
        }
        return LabelResult(
            protocol=protocol,
            poses=self._poses,
            sweeps=self._sweeps,
            counts=self._counts,
            **(apart if self._with_speeds else dict.fromkeys(apart)),
            by_range=tuple(Band(*borders, counts) for borders, counts in self._by_range.items()),
            by_class={class_name(key): self._by_class[key] for key in sorted(self._by_class)},
            objects=len(self._moving),
            objects_found=sum(2 * self._found[key] >= self._moving[key] for key in self._moving),
            ignored=self._ignored,
        )
