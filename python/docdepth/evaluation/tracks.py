"""Instances and tracks of moving objects against true ones."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from docdepth.errors import InputError
from docdepth.evaluation.label_counts import (
    MIN_TRAVEL,
    LabelCounts,
    SeenObject,
    each_object,
    ignored,
    instances,
    moving,
)
from docdepth.evaluation.tables import Figures, Table, number, percent
from docdepth.evaluation.track_overlaps import (
    Overlaps,
    TrackScores,
    over_drive,
    right_points,
    track_scores,
)
from docdepth.geometry.se3 import inverse
from docdepth.geometry.track import Track

Floats = NDArray[np.float64]

# Fewer returns in a sweep say neither how large an object is nor where it heads.
MIN_RETURNS = 10
# An object seen in fewer sweeps, half a second at ten a second, is not there to be followed.
MIN_SWEEPS = 5

# SemanticKITTI: bicyclist, person and motorcyclist in motion.
_PEOPLE = (253, 254, 255)
# Rows of the table, and the kinds of objects in them.
_ROWS = {"all": ("vehicle", "person"), "vehicle": ("vehicle",), "person": ("person",)}


ERRORS = ("along", "across", "up", "heading_deg", "velocity")
"""Of the centre of a box's bottom along its heading, across it and upward [m], of the heading
[deg] and of the velocity [m/s]."""


@dataclass(frozen=True)
class Spread(Figures):
    """Median and 95 % quantile of the sizes of errors; NaN without any."""

    median: float
    p95: float


class MatchedBox(NamedTuple):
    """A box at one time beside the true one, with the errors of :func:`box_errors`."""

    kind: str  # of the true object
    # true, made: their ids
    true: int
    made: int
    errors: tuple[float, ...]
    deviation: float  # that the track states [m]
    kind_right: bool


@dataclass(frozen=True)
class KindResult(Figures):
    """Objects of one kind.

    Attributes
    ----------
    objects, found : int
        Objects that count, and those that are found: matched by an instance, with an intersection
        over union above 0.5, in at least half of the sweeps that count.
    points : int
        Returns of these objects in the sweeps that count.
    right : float
        Share of them with the right instance: each object has one over the whole drive [%].
    boxes : int
        Boxes of found objects that could be compared.
    kind_right : float
        Share of these boxes whose track has the right kind [%].
    errors : dict of str to Spread
        By the names of :data:`ERRORS`.
    normalised_error : float
        Error of the path divided by the deviation that the track states, root mean square: 1 where
        tracks state how wrong they are, 2 where they are twice as wrong.
    """

    objects: int
    found: int
    points: int
    right: float
    boxes: int
    kind_right: float
    errors: dict[str, Spread]
    normalised_error: float
    derived = ("found_share",)

    @property
    def found_share(self) -> float:
        """Share of the objects that are found [%]."""
        return percent(self.found, self.objects)


@dataclass(frozen=True)
class TrackResult(Figures):
    """Figures of the tracks of a drive.

    Attributes
    ----------
    protocol, poses : str
        What was compared, and the source of the poses.
    kinds : dict of str to KindResult
        ``all``, ``vehicle`` and ``person``.
    """

    protocol: str
    poses: str
    sweeps: int
    scores: TrackScores
    kinds: dict[str, KindResult]
    flat = ("scores",)

    def table(self) -> Table:
        """One row for all objects, and one for each kind."""
        s, rows = self.scores, []
        scores = [number(v, 3) for v in (s.hota, s.det_a, s.ass_a, s.mota, s.s_assoc)]
        scores += [str(s.id_switches), number(s.purity, 1)]
        for name, kind in self.kinds.items():
            rows.append((
                name,
                f"{kind.objects}",
                number(kind.found_share, 1),
                number(kind.right, 1),
                *(scores if name == "all" else ["-"] * len(scores)),
                *(f"{e.median:.2f} ({e.p95:.2f})" if kind.boxes else "-"
                  for e in kind.errors.values()),
                number(kind.normalised_error, 2),
                number(kind.kind_right, 1),
            ))  # fmt: skip
        title = f"tracks: {self.protocol}; poses: {self.poses}; {self.sweeps} sweeps"
        return Table(title, ("objects", *HEADER), tuple(rows), NOTE)


def box_errors(
    true: Track, made: Track, time: int, T_true_lidar: Floats, T_made_lidar: Floats
) -> tuple[float, ...]:
    """Errors of a box at one time, in the order of :data:`ERRORS`; the first three have signs.

    Boxes are compared as the LiDAR sees them, so that errors of its poses do not count.

    Parameters
    ----------
    time : int
        [ns].
    T_true_lidar, T_made_lidar : ndarray of float64, shape (4, 4)
        Pose of the LiDAR in the world of either track.
    """
    boxes = [inverse(T) @ t.pose_at(time) for t, T in ((true, T_true_lidar), (made, T_made_lidar))]
    apart = inverse(boxes[0]) @ boxes[1]
    heading = abs(float(np.degrees(np.arctan2(apart[1, 0], apart[0, 0]))))
    there, here = T_true_lidar[:3, :3].T, T_made_lidar[:3, :3].T
    velocity = here @ made.velocity_at(time) - there @ true.velocity_at(time)
    return *apart[:3, 3].tolist(), heading, float(np.linalg.norm(velocity))


def spreads(boxes: Sequence[MatchedBox]) -> dict[str, Spread]:
    """Median and 95 % quantile of each error."""
    if not boxes:
        return dict.fromkeys(ERRORS, Spread(np.nan, np.nan))
    quantiles = np.quantile(np.abs([box.errors for box in boxes]), (0.5, 0.95), axis=0)
    return {name: Spread(*pair) for name, pair in zip(ERRORS, quantiles.T.tolist(), strict=True)}


def normalised_error(boxes: Sequence[MatchedBox]) -> float:
    """How the paths of tracks err beside the deviations that the tracks state.

    An object may never have been seen whole. So the centre of its box is off by as much in all
    sweeps, which no deviation tells: of each track the weighted mean of its offsets is taken away.
    What remains, divided by the deviation, is 1 in the root mean square where the deviation is
    right. Its square is known as NEES, the normalised estimation error squared. NaN without a track
    of two boxes.
    """
    tracks = defaultdict[tuple[int, int], list[tuple[float, ...]]](list)
    for box in boxes:
        tracks[box.true, box.made].append((*box.errors[:2], box.deviation))
    total, free = 0.0, 0
    for rows in tracks.values():
        along, across, deviation = np.array(rows).T
        if len(rows) < 2 or not (deviation > 0).all():
            continue
        weight = deviation**-2
        for offset in (along, across):
            total += float(weight @ (offset - weight @ offset / weight.sum()) ** 2)
        free += len(rows) - 1
    return float(np.sqrt(total / free)) if free else np.nan


class TrackEvaluation:
    """Compares instances and tracks with true ones, sweep by sweep in order of time.

    Parameters
    ----------
    true_tracks, tracks : sequence of Track
        Exact tracks and those of a run; without them boxes are not compared.
    poses : str
        Source of the poses; printed with the figures.
    """

    def __init__(
        self,
        true_tracks: Sequence[Track] = (),
        tracks: Sequence[Track] = (),
        poses: str = "not stated",
    ) -> None:
        self._true, self._made = ({t.id: t for t in ts} for ts in (true_tracks, tracks))
        self._poses = poses
        self._sweeps: list[tuple[Overlaps, int, Floats, Floats]] = []
        self._objects = defaultdict[int, SeenObject](SeenObject)
        self._kinds: dict[int, str] = {}
        self._with_speeds = 0

    def add(
        self,
        labels: NDArray[np.uint32],
        instance: NDArray[np.integer[Any]],
        speeds: NDArray[np.floating[Any]] | None = None,
        seconds: float = 0.1,
        time: int = 0,
        T_true_lidar: Floats | None = None,
        T_made_lidar: Floats | None = None,
    ) -> None:
        """Add one sweep.

        Parameters
        ----------
        labels : ndarray of uint32, shape (N,)
            True SemanticKITTI labels with instances.
        instance : ndarray of int, shape (N,)
            Instance of each point in the run; 0 = none.
        speeds : ndarray of float, shape (N,), optional
            Speed of each point's object at that moment [m/s]; for all sweeps or none. Without them
            all objects of a moving class count.
        seconds : float
            Time from sweep to sweep [s].
        time : int
            Stamp of the sweep [ns].
        T_true_lidar, T_made_lidar : ndarray of float64, shape (4, 4), optional
            Pose of the LiDAR in the worlds of the true and of the made tracks; identity if left
            out.
        """
        if len(instance) != len(labels) or (speeds is not None and len(speeds) != len(labels)):
            raise InputError(f"{len(labels)} labels need as many instances and speeds")
        number_of, moves = instances(labels).astype(np.int64), moving(labels)
        for key, rows in each_object(number_of.astype(np.uint32), moves & (number_of > 0)):
            person = int(labels[rows[0]] & 0xFFFF) in _PEOPLE
            self._kinds[key] = "person" if person else "vehicle"
            speed = np.inf if speeds is None else float(np.median(speeds[rows]))
            self._objects[key].add(speed, seconds, LabelCounts())
        # Points without a label, and moving ones of no object, say nothing.
        evaluated = ~ignored(labels) & ~(moves & (number_of == 0))
        true = np.where(moves, number_of, 0)[evaluated]
        overlaps = Overlaps.of(true, np.asarray(instance).astype(np.int64)[evaluated])
        there, here = (np.eye(4) if T is None else T for T in (T_true_lidar, T_made_lidar))
        self._sweeps.append((overlaps, time, there, here))
        self._with_speeds += speeds is not None

    def result(self) -> TrackResult:
        """Figures of all sweeps added so far."""
        if self._with_speeds not in (0, len(self._sweeps)):
            raise InputError("give the speeds of all sweeps or of none")
        often: Counter[int] = Counter()
        for o, *_ in self._sweeps:
            often.update(o.true[o.true_points >= MIN_RETURNS].tolist())
        counted = {k for k, n in often.items() if n >= MIN_SWEEPS and self._objects[k].seen_to_move}
        evaluated = []
        for o, *_ in self._sweeps:
            among = np.isin(o.true, sorted(counted)) & (o.true_points >= MIN_RETURNS)
            evaluated.append(o.without(~among, MIN_RETURNS))
        matches = [o.matches() for o in evaluated]
        matched = Counter(true for pairs in matches for true, _ in pairs)
        boxes = list(self._boxes(matches))
        drive = over_drive(evaluated)
        right, points = right_points(drive), dict(zip(drive.true, drive.true_points, strict=True))

        def row(among: tuple[str, ...]) -> KindResult:
            mine = [k for k in sorted(counted) if self._kinds[k] in among]
            own = [box for box in boxes if box.kind in among]
            total = sum(int(points[k]) for k in mine)
            return KindResult(
                objects=len(mine),
                found=sum(2 * matched[k] >= often[k] for k in mine),
                points=total,
                right=percent(sum(right[k] for k in mine), total),
                boxes=len(own),
                kind_right=percent(sum(box.kind_right for box in own), len(own)),
                errors=spreads(own),
                normalised_error=normalised_error(own),
            )

        protocol = (
            f"objects with {MIN_RETURNS} returns in {MIN_SWEEPS} sweeps that travel "
            f"{MIN_TRAVEL:g} m in view, matched by points"
        )
        rows = {name: row(among) for name, among in _ROWS.items()}
        return TrackResult(protocol, self._poses, len(evaluated), track_scores(evaluated), rows)

    def _boxes(self, matches: Sequence[list[tuple[int, int]]]) -> Iterator[MatchedBox]:
        """The boxes of matched objects that both have a track."""
        for pairs, (_, time, *worlds) in zip(matches, self._sweeps, strict=True):
            for true, made in pairs:
                if true in self._true and made in self._made:
                    kind, track = self._kinds[true], self._made[made]
                    errors = box_errors(self._true[true], track, time, *worlds)
                    told = track.deviation_at(time), track.kind == kind
                    yield MatchedBox(kind, true, made, errors, *told)


HEADER = (
    *("number", "found %", "right instance %"),
    *("HOTA", "DetA", "AssA", "MOTA", "S_assoc", "id switches", "purity %"),
    *("along m", "across m", "up m", "heading deg", "velocity m/s"),
    *("error / deviation", "kind right %"),
)
NOTE = (
    "found: matched in at least half of the sweeps that count; right instance: share of the points "
    "whose instance is the one of their object; HOTA, DetA, AssA, MOTA, id switches: Luiten et al. "
    "2021 and CLEAR, by intersection over union of points; S_assoc: association half of LSTQ; "
    "purity: share of the points of instances that belong to their main object; errors of "
    "matched boxes: median (95 %); error / deviation: root mean square of how far the path is "
    "off, over what the track states; 1 is right, above it the track claims too much"
)
