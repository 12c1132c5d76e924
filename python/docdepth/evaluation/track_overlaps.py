"""How the instances of a run overlap the true objects, and what HOTA, CLEAR and LSTQ say of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth.errors import MissingExtraError
from docdepth.evaluation.tables import Figures, percent, ratio

Ints = NDArray[np.int64]

# Two segments with a larger intersection over union belong together, and to no third one.
MATCH_IOU = 0.5


@dataclass(frozen=True)
class Overlaps:
    """Points that true objects and instances share in one sweep.

    Attributes
    ----------
    true, made : ndarray of int64, shape (n,) and (m,)
        True objects and instances of the run, ascending.
    shared : ndarray of int64, shape (n, m)
        Points of both.
    true_points, made_points : ndarray of int64, shape (n,) and (m,)
        Points of each, shared or not.
    """

    true: Ints
    made: Ints
    shared: Ints
    true_points: Ints
    made_points: Ints

    @classmethod
    def of(cls, true: Ints, made: Ints) -> Overlaps:
        """From the true object and the instance of each point, shape (N,); 0 = none."""
        pairs, counts = np.unique(np.stack([true, made], axis=1), axis=0, return_counts=True)
        rows, row = np.unique(pairs[:, 0], return_inverse=True)
        columns, column = np.unique(pairs[:, 1], return_inverse=True)
        table = np.zeros((len(rows), len(columns)), np.int64)
        table[row, column] = counts
        inner = table[rows > 0][:, columns > 0]
        true_points, made_points = table.sum(axis=1)[rows > 0], table.sum(axis=0)[columns > 0]
        return cls(rows[rows > 0], columns[columns > 0], inner, true_points, made_points)

    def without(self, left_out: NDArray[np.bool_], min_points: int) -> Overlaps:
        """The same without the points of some true objects, flags of shape (n,).

        Instances with fewer than ``min_points`` that touch none of the others are left out, too.
        """
        shared = self.shared[~left_out]
        made_points = self.made_points - self.shared[left_out].sum(axis=0)
        kept = (made_points >= min_points) | (shared.sum(axis=0) > 0)
        return Overlaps(
            self.true[~left_out],
            self.made[kept],
            shared[:, kept],
            self.true_points[~left_out],
            made_points[kept],
        )

    @property
    def iou(self) -> NDArray[np.float64]:
        """Intersection over union of each pair, shape (n, m)."""
        either = self.true_points[:, None] + self.made_points - self.shared
        return self.shared / np.maximum(either, 1)

    def matches(self) -> list[tuple[int, int]]:
        """Pairs (true object, instance) that belong together."""
        rows, columns = np.nonzero(self.iou > MATCH_IOU)
        return list(zip(self.true[rows].tolist(), self.made[columns].tolist(), strict=True))


@dataclass(frozen=True)
class TrackScores(Figures):
    """Figures of the instances of a whole drive.

    Attributes
    ----------
    hota, det_a, ass_a : float
        HOTA and its halves, detection and association accuracy, the mean over thresholds of the
        intersection over union from 0.05 to 0.95, 0..1.
    mota : float
        Multiple object tracking accuracy (CLEAR), 1 at best.
    id_switches : int
        Times that an object goes on under another id (CLEAR).
    s_assoc : float
        The association half of LSTQ, 0..1.
    purity : float
        Share of the points of instances that belong to the main object of their instance [%].
    """

    hota: float
    det_a: float
    ass_a: float
    mota: float
    id_switches: int
    s_assoc: float
    purity: float


def track_packages() -> tuple[Any, Any]:
    """``motrics``, for HOTA and CLEAR, and ``scipy.optimize``, which assigns instances."""
    try:
        import motrics
        from scipy import optimize
    except ImportError as error:
        raise MissingExtraError(
            f'tracks are evaluated with motrics and scipy: pip install "docdepth[tracks]" ({error})'
        ) from error
    return motrics, optimize


def track_scores(sweeps: Sequence[Overlaps]) -> TrackScores:
    """Figures of a drive, from the overlaps of each of its sweeps."""
    motrics, _ = track_packages()
    true, made = [o.true.tolist() for o in sweeps], [o.made.tolist() for o in sweeps]
    similarity = [o.iou.tolist() for o in sweeps]
    hota = motrics.compute_hota_from_similarity(true, made, similarity)
    clear = motrics.compute_clear_from_similarity(true, made, similarity, MATCH_IOU)
    drive = over_drive(sweeps)
    each = (drive.shared * drive.iou).sum(axis=1) / np.maximum(drive.true_points, 1)
    return TrackScores(
        *(hota.hota, hota.deta, hota.assa, clear.mota),
        id_switches=clear.num_switches,
        # Aygün et al., 4D Panoptic LiDAR Segmentation (CVPR 2021), equation 5.
        s_assoc=ratio(float(each.sum()), len(each)),
        purity=percent(
            int(drive.shared.max(axis=0, initial=0).sum()), int(drive.made_points.sum())
        ),
    )


def over_drive(sweeps: Sequence[Overlaps]) -> Overlaps:
    """The overlaps of all sweeps together."""
    true = np.unique(np.concatenate([o.true for o in sweeps] or [np.zeros(0, np.int64)]))
    made = np.unique(np.concatenate([o.made for o in sweeps] or [np.zeros(0, np.int64)]))
    shared = np.zeros((len(true), len(made)), np.int64)
    true_points, made_points = np.zeros(len(true), np.int64), np.zeros(len(made), np.int64)
    for o in sweeps:
        rows, columns = np.searchsorted(true, o.true), np.searchsorted(made, o.made)
        shared[np.ix_(rows, columns)] += o.shared
        true_points[rows] += o.true_points
        made_points[columns] += o.made_points
    return Overlaps(true, made, shared, true_points, made_points)


def right_points(drive: Overlaps) -> dict[int, int]:
    """Points of each true object that its instance has; one instance for each object.

    Of all such assignments the one with most points.
    """
    _, optimize = track_packages()
    rows, columns = optimize.linear_sum_assignment(drive.shared, maximize=True)
    right = dict(zip(drive.true[rows].tolist(), drive.shared[rows, columns].tolist(), strict=True))
    return {number: int(right.get(number, 0)) for number in drive.true.tolist()}
