"""Static and dynamic labels against the truth, point by identity (paper IV-A)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth.errors import InputError
from docdepth.evaluation.tables import Table, number, percent, plain, ratio

# Below this an object counts as standing at that moment [m/s].
_MOVING_SPEED = 0.3
# What goes less while the sensor sees it, nobody can see move [m].
_SEEN_WAY = 0.5

RANGE_BINS = (0.0, 10.0, 20.0, 30.0, 50.0, 80.0, math.inf)


def moving(labels: NDArray[np.uint32]) -> NDArray[np.bool_]:
    """Which SemanticKITTI labels are of a moving class, 251 to 259.

    Parameters
    ----------
    labels : ndarray of uint32, shape (N,)
        Low 16 bits class, high 16 bits instance.
    """
    classes = _classes(labels)
    return (classes >= 251) & (classes <= 259)


def ignored(labels: NDArray[np.uint32]) -> NDArray[np.bool_]:
    """Which SemanticKITTI labels do not count: 0 (unlabelled) and 1 (outlier)."""
    return _classes(labels) <= 1


def _classes(labels: NDArray[np.uint32]) -> NDArray[np.uint32]:
    labels = np.asarray(labels)
    if labels.ndim != 1 or labels.dtype.kind not in "ui":
        raise InputError(
            f"labels are integers of shape (N,), one a point; got {labels.dtype} {labels.shape}"
        )
    return labels.astype(np.uint32, copy=False) & np.uint32(0xFFFF)


@dataclass(frozen=True)
class LabelCounts:
    """How many points of each kind were called what.

    Attributes
    ----------
    static_kept, static_lost : int
        Static points called static, and dynamic (false alarms).
    dynamic_found, dynamic_missed : int
        Dynamic points called dynamic, and static.
    """

    static_kept: int = 0
    static_lost: int = 0
    dynamic_found: int = 0
    dynamic_missed: int = 0

    @classmethod
    def of(cls, truth: NDArray[np.bool_], predicted: NDArray[np.bool_]) -> LabelCounts:
        """Counts of points whose dynamic flags are ``truth`` and ``predicted``, shape (N,)."""
        table = np.bincount(2 * truth.astype(np.int64) + predicted, minlength=4)
        return cls(*(int(n) for n in (table[0], table[1], table[3], table[2])))

    def __add__(self, other: LabelCounts) -> LabelCounts:
        return LabelCounts(
            self.static_kept + other.static_kept,
            self.static_lost + other.static_lost,
            self.dynamic_found + other.dynamic_found,
            self.dynamic_missed + other.dynamic_missed,
        )

    @property
    def static(self) -> int:
        """Static points of the truth."""
        return self.static_kept + self.static_lost

    @property
    def dynamic(self) -> int:
        """Dynamic points of the truth."""
        return self.dynamic_found + self.dynamic_missed

    @property
    def sa(self) -> float:
        """Static accuracy [%]: static points called static."""
        return percent(self.static_kept, self.static)

    @property
    def da(self) -> float:
        """Dynamic accuracy [%]: dynamic points called dynamic, also recall."""
        return percent(self.dynamic_found, self.dynamic)

    @property
    def f1(self) -> float:
        """Harmonic mean of SA and DA (HA of DynamicMap_Benchmark), 0..1."""
        return ratio(2 * self.sa * self.da, self.sa + self.da) / 100

    @property
    def aa(self) -> float:
        """Geometric mean of SA and DA [%] (associated accuracy)."""
        return math.sqrt(self.sa * self.da)

    @property
    def precision(self) -> float:
        """Of the points called dynamic, the share that is, 0..1."""
        return ratio(self.dynamic_found, self.dynamic_found + self.static_lost)

    @property
    def iou(self) -> float:
        """Intersection over union of the dynamic class, 0..1 (LiDAR-MOS)."""
        return ratio(self.dynamic_found, self.dynamic + self.static_lost)

    def as_dict(self) -> dict[str, float]:
        """Counts and figures by name."""
        figures = {name: getattr(self, name) for name in _FIGURES}
        return {"static": self.static, "dynamic": self.dynamic, **figures, **asdict(self)}

    def cells(self) -> list[str]:
        """The row of a table: points, then figures."""
        shares = [self.sa, self.da, self.aa]
        rates = [self.f1, self.precision, self.iou]
        return [
            f"{self.static:,}",
            f"{self.dynamic:,}",
            *(number(x, 2) for x in shares),
            *(number(x, 4) for x in rates),
        ]


_FIGURES = ("sa", "da", "aa", "f1", "precision", "iou")
HEADER = ("static", "dynamic", "SA %", "DA %", "AA %", "F1", "precision", "IoU")


@dataclass(frozen=True)
class RangeCounts:
    """Counts of the points between two ranges [m]."""

    near: float
    far: float
    counts: LabelCounts


@dataclass(frozen=True)
class LabelResult:
    """Figures of a drive.

    Attributes
    ----------
    protocol : str
        What was compared, in words.
    poses : str
        Where the poses came from.
    sweeps : int
    counts : LabelCounts
        Static points against moving ones; where speeds are known, against points that move at
        that moment.
    with_standing : LabelCounts, optional
        The same with the temporarily static points among the dynamic ones: the rule of
        SemanticKITTI, whose moving classes hold for the whole drive. None without speeds.
    temporarily_static : LabelCounts, optional
        Only points of moving classes that stand at that moment. None without speeds.
    seen_to_move : LabelCounts, optional
        Those of them whose object goes half a metre or more while it has returns. Of the others no
        measurement tells that they move: a car may leave its place as the drive ends, or be out of
        sight by then.
    by_range : tuple of RangeCounts
        Empty when no ranges were given.
    ignored : int
        Points without a label.
    """

    protocol: str
    poses: str
    sweeps: int
    counts: LabelCounts
    with_standing: LabelCounts | None = None
    temporarily_static: LabelCounts | None = None
    seen_to_move: LabelCounts | None = None
    by_range: tuple[RangeCounts, ...] = field(default=())
    ignored: int = 0

    def as_dict(self) -> dict[str, Any]:
        """Everything by name, ready for JSON; what is undefined is None."""
        result: dict[str, Any] = {
            "protocol": self.protocol,
            "poses": self.poses,
            "sweeps": self.sweeps,
            "ignored": self.ignored,
            **self.counts.as_dict(),
        }
        if self.with_standing is not None and self.temporarily_static is not None:
            result["with_standing"] = self.with_standing.as_dict()
            result["temporarily_static"] = {
                "points": self.temporarily_static.dynamic,
                "da": self.temporarily_static.da,
            }
        if self.seen_to_move is not None:
            seen = self.seen_to_move
            result["seen_to_move"] = {"points": seen.dynamic, "da": seen.da}
        result["by_range"] = [
            {"near": row.near, "far": row.far, **row.counts.as_dict()} for row in self.by_range
        ]
        return dict(plain(result))

    def table(self) -> Table:
        """Rows of text for a terminal or a report."""
        rows = [("all", *self.counts.cells())]
        if self.with_standing is not None and self.temporarily_static is not None:
            rows = [("moving now", *self.counts.cells())]
            standing = self.temporarily_static
            cells = ["-", f"{standing.dynamic:,}", "-", number(standing.da, 2), *["-"] * 4]
            rows.append(("temporarily static", *cells))
            rows.append(("both", *self.with_standing.cells()))
        for row in self.by_range:
            far = "" if math.isinf(row.far) else f"{row.far:g}"
            rows.append((f"{row.near:g}..{far} m", *row.counts.cells()))
        title = f"labels: {self.protocol}; poses: {self.poses}; {self.sweeps} sweeps"
        return Table(title, ("points", *HEADER), tuple(rows))


class LabelEvaluation:
    """Labels of a drive against the truth, a sweep at a time.

    Parameters
    ----------
    poses : str
        Where the poses came from, printed with the figures.
    min_speed : float
        From here on an object moves at that moment [m/s].
    range_bins : sequence of float
        Borders of the ranges reported apart [m].
    """

    def __init__(
        self,
        poses: str = "not stated",
        min_speed: float = _MOVING_SPEED,
        range_bins: Sequence[float] = RANGE_BINS,
    ) -> None:
        self._poses = poses
        self._min_speed = min_speed
        self._bins = tuple(float(border) for border in range_bins)
        if len(self._bins) < 2 or any(a >= b for a, b in pairwise(self._bins)):
            raise InputError(f"range bins must increase, got {self._bins}")
        self._counts, self._standing = LabelCounts(), LabelCounts()
        self._by_range = [LabelCounts() for _ in self._bins[1:]]
        self._way: dict[int, float] = {}
        self._standing_of: dict[int, LabelCounts] = {}
        self._sweeps = self._ignored = self._with_speeds = self._with_ranges = 0

    def add(
        self,
        labels: NDArray[np.uint32],
        dynamic: NDArray[np.bool_],
        ranges: NDArray[np.floating[Any]] | None = None,
        speeds: NDArray[np.floating[Any]] | None = None,
        seconds: float = 0.1,
    ) -> None:
        """Count one sweep.

        Parameters
        ----------
        labels : ndarray of uint32, shape (N,)
            SemanticKITTI labels of the truth.
        dynamic : ndarray of bool, shape (N,)
            Points called dynamic, ``classid >= 100``.
        ranges : ndarray of float, shape (N,), optional
            Distance of each point from its sensor [m].
        speeds : ndarray of float, shape (N,), optional
            Speed over ground of each point's object at that moment [m/s]; for all sweeps or none.
        seconds : float
            Time from sweep to sweep, in which objects go on with that speed [s].

        Raises
        ------
        InputError
            The arrays do not belong to the same points.
        """
        truth, counted = moving(labels), ~ignored(labels)
        dynamic = _flags(dynamic, len(truth))
        standing = np.zeros_like(truth)
        if speeds is not None:
            speeds = _values("speeds", speeds, len(truth))
            standing = truth & counted & ~(speeds > self._min_speed)
            self._standing += LabelCounts.of(truth[standing], dynamic[standing])
            instance = np.asarray(labels).astype(np.uint32, copy=False) >> np.uint32(16)
            self._follow(instance, truth & counted, standing, dynamic, speeds * seconds)
        now = counted & ~standing
        self._counts += LabelCounts.of(truth[now], dynamic[now])
        if ranges is not None:
            ranges = _values("ranges", ranges, len(truth))
            for k, (near, far) in enumerate(pairwise(self._bins)):
                inside = now & (ranges >= near) & (ranges < far)
                self._by_range[k] += LabelCounts.of(truth[inside], dynamic[inside])
        self._sweeps += 1
        self._ignored += int(len(truth) - np.count_nonzero(counted))
        self._with_speeds += speeds is not None
        self._with_ranges += ranges is not None

    def _follow(
        self,
        instance: NDArray[np.uint32],
        truth: NDArray[np.bool_],
        standing: NDArray[np.bool_],
        dynamic: NDArray[np.bool_],
        way: NDArray[Any],
    ) -> None:
        """Count the way of each moving object, and its points while it stands."""
        for k in np.unique(instance[truth]).tolist():
            here = truth & (instance == k)
            motion_corrected = here & standing
            self._way[k] = self._way.get(k, 0.0) + float(np.median(way[here]))
            counts = LabelCounts.of(truth[motion_corrected], dynamic[motion_corrected])
            self._standing_of[k] = self._standing_of.get(k, LabelCounts()) + counts

    def result(self) -> LabelResult:
        """The figures of everything added so far.

        Raises
        ------
        InputError
            Speeds were given for some sweeps only.
        """
        if self._with_speeds not in (0, self._sweeps):
            raise InputError(
                f"speeds were given for {self._with_speeds} of {self._sweeps} sweeps; "
                "give them for all or for none"
            )
        speeds = self._with_speeds > 0
        protocol = "every labelled point by identity, classes 251..259 dynamic, 0 and 1 ignored"
        if speeds:
            protocol += f", moving now means above {self._min_speed:g} m/s"
        far = [of for k, of in self._standing_of.items() if self._way[k] >= _SEEN_WAY]
        seen = sum(far, LabelCounts())
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
            seen_to_move=seen if speeds else None,
            by_range=by_range,
            ignored=self._ignored,
        )


def _flags(dynamic: NDArray[np.bool_], points: int) -> NDArray[np.bool_]:
    dynamic = np.asarray(dynamic)
    if dynamic.dtype != bool or dynamic.shape != (points,):
        raise InputError(
            f"{points} labels need {points} bools that say dynamic, got {dynamic.dtype} "
            f"{dynamic.shape}; labels belong to the points in input order"
        )
    return dynamic


def _values(name: str, values: NDArray[Any], points: int) -> NDArray[Any]:
    values = np.asarray(values)
    if values.shape != (points,):
        raise InputError(f"{points} labels need {points} {name}, got {values.shape}")
    return values
