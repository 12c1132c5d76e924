"""Figures of tracks against values worked out by hand and the formulas of HOTA and CLEAR."""

from __future__ import annotations

import json
import sys
from dataclasses import astuple, replace

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from command_line import cli
from docdepth.errors import InputError
from docdepth.evaluation import TrackEvaluation
from docdepth.evaluation.track_overlaps import Overlaps, over_drive, track_scores
from docdepth.evaluation.tracks import MatchedBox, box_errors, normalised_error
from docdepth.geometry.track import Track

pytest.importorskip("motrics")

CAR, PERSON, ROAD = 252, 254, 40


def label(kind, number):
    return kind | number << 16


def points(*groups):
    """Arrays of label and instance from groups (label, instance, count)."""
    columns = [np.repeat([g[k] for g in groups], [g[2] for g in groups]) for k in (0, 1)]
    return columns[0].astype(np.uint32), columns[1].astype(np.uint16)


def random_sweeps(seed, sweeps=12):
    random = np.random.default_rng(seed)
    for _ in range(sweeps):
        true = random.integers(0, 5, 300)
        made = np.where(random.random(300) < 0.8, (true * 3) % 7, random.integers(0, 7, 300))
        yield true, np.where(random.random(300) < 0.05 * true, 0, made)


def test_overlaps_equal_a_plain_loop():
    for true, made in random_sweeps(0):
        o = Overlaps.of(true, made)
        for i, t in enumerate(o.true):
            assert o.true_points[i] == (true == t).sum()
            for j, m in enumerate(o.made):
                both, either = (true == t) & (made == m), (true == t) | (made == m)
                assert o.shared[i, j] == both.sum()
                assert o.iou[i, j] == pytest.approx(both.sum() / either.sum())
        left = Overlaps.of(true[true != 2], made[true != 2])
        again = o.without(o.true == 2, 1)
        assert again.made.tolist() == left.made.tolist()
        np.testing.assert_array_equal(again.shared, left.shared)
        np.testing.assert_array_equal(again.made_points, left.made_points)


def hota_by_formula(sweeps):
    """HOTA, DetA and AssA of Luiten et al. (2021), equations 5 to 9."""
    trues = {t for o in sweeps for t in o.true.tolist()}
    mades = {m for o in sweeps for m in o.made.tolist()}
    size = {("t", t): sum(t in o.true for o in sweeps) for t in trues}
    size |= {("m", m): sum(m in o.made for o in sweeps) for m in mades}
    soft = dict.fromkeys([(t, m) for t in trues for m in mades], 0.0)
    for o in sweeps:
        s = o.iou
        for i, t in enumerate(o.true.tolist()):
            for j, m in enumerate(o.made.tolist()):
                either = s[i].sum() + s[:, j].sum() - s[i, j]
                soft[t, m] += s[i, j] / either if either > 0 else 0.0
    aligned = {(t, m): v / (size["t", t] + size["m", m] - v) for (t, m), v in soft.items()}
    found = []
    for alpha in np.arange(0.05, 0.99, 0.05):
        tp, pairs = 0, {}
        for o in sweeps:
            ids = [[(t, m) for m in o.made.tolist()] for t in o.true.tolist()]
            score = np.array([[aligned[p] for p in row] for row in ids]) * o.iou
            for i, j in zip(*linear_sum_assignment(-score), strict=True):
                if o.iou[i, j] >= alpha - 1e-12:
                    tp, pairs[ids[i][j]] = tp + 1, pairs.get(ids[i][j], 0) + 1
        misses = sum(len(o.true) for o in sweeps) - tp
        wrong = sum(len(o.made) for o in sweeps) - tp
        ass = sum(n * n / (size["t", t] + size["m", m] - n) for (t, m), n in pairs.items())
        found.append((tp / (tp + misses + wrong), ass / max(tp, 1)))
    det, ass = np.array(found).T
    return np.sqrt(det * ass).mean(), det.mean(), ass.mean()


def test_hota_is_that_of_the_paper():
    for seed in range(3):
        sweeps = [Overlaps.of(*pair) for pair in random_sweeps(seed)]
        scores = track_scores(sweeps)
        expected = hota_by_formula(sweeps)
        assert (scores.hota, scores.det_a, scores.ass_a) == pytest.approx(expected, abs=1e-9)
        assert 0.1 < scores.hota < 0.9


def test_two_objects_whose_ids_are_swapped_halfway():
    """10 sweeps; after 6 of them the ids are exchanged; a third id lies on the road."""
    evaluation = TrackEvaluation()
    for k in range(10):
        first, second = (1, 2) if k < 6 else (2, 1)
        labels, instance = points(
            (label(CAR, 7), first, 30), (label(CAR, 7), 0, 10), (label(PERSON, 9), second, 20),
            (ROAD, 0, 50), (ROAD, 3, 12),
        )  # fmt: skip
        evaluation.add(labels, instance, speeds=np.full(len(labels), 2.0))
    result = evaluation.result()
    scores, every = result.scores, result.kinds["all"]
    assert scores.id_switches == 2
    # All 20 detections are right, and there are 10 on the road.
    assert scores.mota == pytest.approx((20 - 10 - 2) / 20)
    assert (every.objects, every.found, every.points) == (2, 2, 600)
    assert every.right == pytest.approx(100 * (6 * 30 + 6 * 20) / 600)
    assert result.kinds["person"].right == pytest.approx(60.0)
    assert scores.purity == pytest.approx(100 * (180 + 120) / (500 + 120))
    # Tubes: 180 of 400 and 260 points; 120 with the other id of 240 points, and so on.
    car = 180 * 180 / (400 + 260 - 180) + 120 * 120 / (400 + 240 - 120)
    person = 80 * 80 / (200 + 260 - 80) + 120 * 120 / (200 + 240 - 120)
    assert scores.s_assoc == pytest.approx((car / 400 + person / 200) / 2)


def test_what_cannot_be_followed_is_not_asked_for():
    """A car that stands, one of few returns, one seen briefly: an id on them is no fault."""
    evaluation = TrackEvaluation()
    for k in range(12):
        groups = [(label(CAR, 1), 1, 20), (label(CAR, 2), 2, 40), (label(CAR, 3), 3, 9)]
        groups += [(label(CAR, 4), 4, 20)] * (k < 4)
        labels, instance = points(*groups)
        moving = np.isin(labels >> 16, (1, 3, 4))
        evaluation.add(labels, instance, speeds=np.where(moving, 5.0, 0.0))
    result = evaluation.result()
    assert result.kinds["all"].objects == result.kinds["all"].found == 1
    assert result.scores.mota == 1.0
    assert result.scores.hota == pytest.approx(1.0)
    assert result.scores.purity == 100.0


def test_half_of_the_sweeps_make_an_object_found():
    for hits, found in ((5, 1), (4, 0)):
        evaluation = TrackEvaluation()
        for k in range(10):
            # Else an instance has too few of its points.
            count = 30 if k < hits else 10
            evaluation.add(*points((label(CAR, 1), 5, count), (label(CAR, 1), 0, 40 - count)))
        assert evaluation.result().kinds["vehicle"].found == found


def track(number, kind, shift=(0.0, 0.0), yaw=0.0, speed=4.0):
    """Drives along y, with its centre moved along x and y; five sweeps."""
    times = 100_000_000 * np.arange(5)
    poses = np.repeat(np.eye(4)[None], 5, axis=0)
    heading = 0.5 * np.pi + yaw
    cos, sin = np.cos(heading), np.sin(heading)
    poses[:, :2, :2] = [(cos, -sin), (sin, cos)]
    poses[:, 0, 3] = shift[0]
    poses[:, 1, 3] = shift[1] + 4.0 * times * 1e-9
    velocities = np.tile([0.0, speed, 0.0], (5, 1))
    size = np.array([4.0, 1.8, 1.5])
    none = np.zeros(5)
    return Track(number, kind, times, poses, velocities, size, none.astype(np.int64), none, none)


def test_errors_of_boxes_are_along_and_across_their_heading_and_upward():
    true = track(1, "vehicle")
    level = track(2, "vehicle", (0.2, -0.5), np.radians(-10), 4.5)
    poses = level.poses.copy()
    poses[:, 2, 3] = -0.3
    made = replace(level, poses=poses)
    found = box_errors(true, made, 200_000_000, np.eye(4), np.eye(4))
    assert found == pytest.approx((-0.5, -0.2, -0.3, 10.0, 0.5))
    # Poses of the run that are shifted and turned move its boxes with them: no error.
    moved = np.eye(4)
    moved[:2, :2], moved[:2, 3] = [(0.6, -0.8), (0.8, 0.6)], (7.0, -3.0)
    turned = Track(
        *(2, "vehicle", made.times, moved @ made.poses, made.velocities @ moved[:3, :3].T),
        *(made.size, made.points, made.deviations, made.surface_deviations),
    )
    again = box_errors(true, turned, 200_000_000, np.eye(4), moved)
    assert again == pytest.approx(found)


def test_errors_by_kind():
    true = [track(1, "vehicle"), track(2, "person")]
    made = [track(5, "vehicle", (0.0, 0.3)), track(6, "vehicle", (0.4, 0.0))]
    evaluation = TrackEvaluation(true, made)
    for k in range(5):
        groups = points((label(CAR, 1), 5, 20), (label(PERSON, 2), 6, 20))
        evaluation.add(*groups, time=100_000_000 * k)
    kinds = evaluation.result().kinds
    assert astuple(kinds["vehicle"].errors["along"]) == pytest.approx((0.3, 0.3))
    assert astuple(kinds["vehicle"].errors["across"]) == pytest.approx((0.0, 0.0))
    assert astuple(kinds["person"].errors["across"]) == pytest.approx((0.4, 0.4))
    assert astuple(kinds["all"].errors["along"]) == pytest.approx((0.15, 0.3))
    assert (kinds["vehicle"].kind_right, kinds["person"].kind_right) == (100.0, 0.0)
    assert kinds["all"].boxes == 10


def boxes_of(true, offsets, deviations):
    """Boxes of one track, whose offsets along and across are given."""
    pairs = zip(offsets, deviations, strict=True)
    return [MatchedBox("vehicle", true, true + 5, tuple(offset), d, True) for offset, d in pairs]


def test_errors_of_a_path_are_divided_by_what_the_track_states():
    """The offset that all boxes share is taken away: nobody saw how long the object is."""
    assert np.isnan(normalised_error([]))
    first = boxes_of(1, ((1.3, 0.0), (0.7, 0.1), (1.0, -0.1)), [0.2] * 3)
    # Squares 0.09 + 0.09 and 0.01 + 0.01, over 0.2 squared and two boxes more than one mean.
    expected = np.sqrt(0.20 / 0.04 / 2)
    assert normalised_error(first) == pytest.approx(expected)
    # A box that is known ten times as well holds the mean; one box alone says nothing.
    second = boxes_of(2, ((0.0, 0.0), (0.2, 0.0)), (0.01, 0.1))
    assert np.isnan(normalised_error(second[:1]))
    mean = 0.2 * 100 / (100 + 10000)
    of_second = (mean / 0.01) ** 2 + ((0.2 - mean) / 0.1) ** 2
    assert normalised_error(second) == pytest.approx(np.sqrt(of_second))
    both = np.sqrt((2 * expected**2 + of_second) / 3)
    assert normalised_error(first + second) == pytest.approx(both)


def test_normalised_errors_of_honest_tracks_are_one():
    """Random paths, each with deviations of its own, and an offset that is not to count."""
    random, boxes = np.random.default_rng(0), []
    for number in range(200):
        deviation, shift = random.uniform(0.02, 0.5), random.normal(0, 2, 2)
        offsets = shift + random.normal(0, deviation / np.sqrt(2), (20, 2))
        boxes += boxes_of(number, offsets, [deviation] * 20)
    assert normalised_error(boxes) == pytest.approx(1, abs=0.03)


def test_a_drive_without_objects_or_instances_has_figures_that_json_can_hold():
    empty = TrackEvaluation()
    empty.add(*points((ROAD, 0, 30)))
    lost = TrackEvaluation()
    for _ in range(6):
        lost.add(*points((label(CAR, 1), 0, 30), (ROAD, 0, 10)))
    assert over_drive([]).shared.shape == (0, 0)
    for evaluation in (empty, lost):
        result = evaluation.result()
        assert json.loads(json.dumps(result.as_dict(), allow_nan=False))["purity"] is None
        assert "HOTA" in str(result.table())
    assert lost.result().kinds["all"].right == 0.0


def test_mistakes_are_refused():
    evaluation = TrackEvaluation()
    labels, instance = points((ROAD, 0, 30))
    with pytest.raises(InputError, match="30 labels"):
        evaluation.add(labels, instance[1:])
    evaluation.add(labels, instance, speeds=np.zeros(30))
    evaluation.add(labels, instance)
    with pytest.raises(InputError, match="all sweeps or of none"):
        evaluation.result()


def test_a_run_is_compared_with_its_drive(drive, finished):
    result = cli("evaluate", "tracks", finished[0], "--labels", drive, "--json")
    assert result.exit_code == 0, result.output
    found = json.loads(result.output[result.output.index("{") :])
    assert found["sweeps"] == 5
    assert found["kinds"]["all"]["objects"] >= 1
    assert "HOTA" in cli("evaluate", "tracks", finished[0], "--labels", drive).output


@pytest.mark.parametrize("package", ["motrics", "scipy"])
def test_what_to_install_is_told_before_all_sweeps_are_read(drive, finished, monkeypatch, package):
    monkeypatch.setitem(sys.modules, package, None)
    result = cli("evaluate", "tracks", finished[0], "--labels", drive)
    assert result.exit_code == 2
    assert 'pip install "docdepth[tracks]"' in str(result.exception)
    assert "1/5" not in result.output
