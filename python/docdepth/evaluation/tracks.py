"""Instances and tracks of moving objects against true ones."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth.errors import InputError
from docdepth.evaluation.label_counts import LabelCounts, ignored, moving
from docdepth.evaluation.objects import (
    MIN_TRAVEL,
    MOVING_SPEED,
    SeenObject,
    each_object,
    instances,
)
from docdepth.evaluation.tables import Table, number, percent, plain
from docdepth.evaluation.track_errors import ErrorSums, Floats, PathErrors, box_errors, offset_of
from docdepth.evaluation.track_overlaps import (
    Overlaps,
    TrackScores,
    over_drive,
    right_points,
    track_scores,
)
from docdepth.geometry.track import Track

# Fewer returns in a sweep say neither how large an object is nor where it heads.
MIN_RETURNS = 10
# An object seen in fewer sweeps, half a second at ten a second, is not there to be followed.
MIN_SWEEPS = 5

# SemanticKITTI: bicyclist, person and motorcyclist in motion.
_PEOPLE = (253, 254, 255)
# Rows of the table, and the kinds of objects in them.
_ROWS = {"all": ("vehicle", "person"), "vehicle": ("vehicle",), "person": ("person",)}


@dataclass(frozen=True)
class KindResult:
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
    errors : dict
        Median and 95 % quantile along, across, upward [m], of the heading [deg] and of the velocity
        [m/s].
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
    errors: dict[str, tuple[float, float]]
    normalised_error: float


@dataclass(frozen=True)
class TrackResult:
    """Figures of the tracks of a drive.

    Attributes
    ----------
    protocol, poses : str
        What was compared, and the source of the poses.
    sweeps : int
    scores : TrackScores
    kinds : dict of str to KindResult
        ``all``, ``vehicle`` and ``person``.
    """

    protocol: str
    poses: str
    sweeps: int
    scores: TrackScores
    kinds: dict[str, KindResult]

    def as_dict(self) -> dict[str, Any]:
        """All figures by name, ready for JSON; None replaces NaN."""
        kinds = {name: self._with_share(kind) for name, kind in self.kinds.items()}
        head = {"protocol": self.protocol, "poses": self.poses, "sweeps": self.sweeps}
        return dict(plain({**head, **asdict(self.scores), "kinds": kinds}))

    @staticmethod
    def _with_share(kind: KindResult) -> dict[str, Any]:
        errors = {n: {"median": m, "p95": p} for n, (m, p) in kind.errors.items()}
        return {**asdict(kind), "found_share": percent(kind.found, kind.objects), "errors": errors}

    def table(self) -> Table:
        """One row for all objects, and one for each kind."""
        rows = []
        for name, kind in self.kinds.items():
            s = self.scores
            scores = [number(v, 3) for v in (s.hota, s.det_a, s.ass_a, s.mota, s.s_assoc)]
            scores += [str(s.id_switches), number(s.purity, 1)]
            errors = [
                "-" if not kind.boxes else f"{median:.2f} ({high:.2f})"
                for median, high in kind.errors.values()
            ]
            rows.append((
                name,
                f"{kind.objects}",
                number(percent(kind.found, kind.objects), 1),
                number(kind.right, 1),
                *(scores if name == "all" else ["-"] * len(scores)),
                *errors,
                number(kind.normalised_error, 2),
                number(kind.kind_right, 1),
            ))  # fmt: skip
        title = f"tracks: {self.protocol}; poses: {self.poses}; {self.sweeps} sweeps"
        return Table(title, ("objects", *HEADER), tuple(rows), NOTE)


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
        self._objects: dict[int, SeenObject] = {}
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

        Raises
        ------
        InputError
            The arrays do not belong to the same points.
        """
        if len(instance) != len(labels) or (speeds is not None and len(speeds) != len(labels)):
            raise InputError(f"{len(labels)} labels need as many instances and speeds")
        number_of, moves = instances(labels).astype(np.int64), moving(labels)
        for key, rows in each_object(number_of.astype(np.uint32), moves & (number_of > 0)):
            person = int(labels[rows[0]] & 0xFFFF) in _PEOPLE
            self._kinds[key] = "person" if person else "vehicle"
            speed = np.inf if speeds is None else float(np.median(speeds[rows]))
            seen = self._objects.setdefault(key, SeenObject())
            seen.add(speed, seconds, LabelCounts(), MOVING_SPEED)
        # Points without a label, and moving ones of no object, say nothing.
        judged = ~ignored(labels) & ~(moves & (number_of == 0))
        true = np.where(moves, number_of, 0)[judged]
        overlaps = Overlaps.of(true, np.asarray(instance).astype(np.int64)[judged])
        there, here = (np.eye(4) if T is None else T for T in (T_true_lidar, T_made_lidar))
        self._sweeps.append((overlaps, time, there, here))
        self._with_speeds += speeds is not None

    def result(self) -> TrackResult:
        """Figures of all sweeps added so far.

        Raises
        ------
        InputError
            Only some sweeps had speeds.
        MissingExtraError
            motrics or scipy is not installed.
        """
        if self._with_speeds not in (0, len(self._sweeps)):
            raise InputError("give the speeds of all sweeps or of none")
        often: Counter[int] = Counter()
        for o, *_ in self._sweeps:
            often.update(o.true[o.true_points >= MIN_RETURNS].tolist())
        counted = {k for k, n in often.items() if n >= MIN_SWEEPS and self._objects[k].seen_to_move}
        judged = [o.without(~_counts(o, counted), MIN_RETURNS) for o, *_ in self._sweeps]
        errors, paths, matched, kinds = self._compare_boxes(judged)
        drive = over_drive(judged)
        right, points = right_points(drive), dict(zip(drive.true, drive.true_points, strict=True))

        def row(among: tuple[str, ...]) -> KindResult:
            mine = [k for k in sorted(counted) if self._kinds[k] in among]
            total = sum(int(points[k]) for k in mine)
            told = [k for kind in among for k in kinds[kind]]
            return KindResult(
                objects=len(mine),
                found=sum(2 * matched[k] >= often[k] for k in mine),
                points=total,
                right=percent(sum(right[k] for k in mine), total),
                boxes=len(told),
                kind_right=percent(sum(told), len(told)),
                errors=errors.of(among),
                normalised_error=paths.normalised(among),
            )

        protocol = (
            f"objects with {MIN_RETURNS} returns in {MIN_SWEEPS} sweeps that travel "
            f"{MIN_TRAVEL:g} m in view, matched by points"
        )
        rows = {name: row(among) for name, among in _ROWS.items()}
        return TrackResult(protocol, self._poses, len(judged), track_scores(judged), rows)

    def _compare_boxes(
        self, judged: Sequence[Overlaps]
    ) -> tuple[ErrorSums, PathErrors, Counter[int], dict[str, list[bool]]]:
        """Errors of matched boxes and paths, matched sweeps of objects, which kinds are right."""
        errors, paths, matched = ErrorSums(), PathErrors(), Counter[int]()
        kinds: dict[str, list[bool]] = {"vehicle": [], "person": []}
        for overlaps, (_, time, *worlds) in zip(judged, self._sweeps, strict=True):
            for true, made in overlaps.matches():
                matched[true] += 1
                if true in self._true and made in self._made:
                    kind, track = self._kinds[true], self._made[made]
                    errors.add(kind, box_errors(self._true[true], track, time, *worlds))
                    offset = offset_of(self._true[true], track, time, *worlds)
                    paths.add(kind, true, made, offset, track.deviation_at(time))
                    kinds[kind].append(track.kind == kind)
        return errors, paths, matched, kinds


def _counts(overlaps: Overlaps, counted: set[int]) -> NDArray[np.bool_]:
    """Which true objects of a sweep count in it."""
    among: NDArray[np.bool_] = np.isin(overlaps.true, sorted(counted))
    return among & (overlaps.true_points >= MIN_RETURNS)


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
