"""Metrics of labels against values worked out by hand and against plain loops."""

import math
from dataclasses import astuple

import numpy as np
import pytest

from docdepth.errors import InputError
from docdepth.evaluation import LabelCounts, LabelEvaluation, ignored, moving


def test_moving_classes_are_251_to_259_whatever_the_instance() -> None:
    labels = np.array([0, 1, 9, 250, 251, 252, 259, 260, 40], np.uint32) | np.uint32(7 << 16)
    assert moving(labels).tolist() == [False] * 4 + [True] * 3 + [False] * 2
    assert ignored(labels).tolist() == [True, True] + [False] * 7


def test_metrics_worked_out_by_hand() -> None:
    # 90 of 100 static kept, 30 of 40 dynamic found.
    counts = LabelCounts(static_kept=90, static_lost=10, dynamic_found=30, dynamic_missed=10)
    assert counts.sa == pytest.approx(90.0)
    assert counts.da == pytest.approx(75.0)
    assert counts.f1 == pytest.approx(2 * 0.9 * 0.75 / 1.65)
    assert counts.aa == pytest.approx(math.sqrt(90 * 75))
    assert counts.precision == pytest.approx(30 / 40)
    assert counts.iou == pytest.approx(30 / 50)


def test_what_is_undefined_is_nan() -> None:
    none = LabelCounts()
    assert all(none.as_dict()[k] is None for k in ("sa", "da", "f1", "aa", "precision", "iou"))
    no_dynamic = LabelCounts(static_kept=5)
    assert no_dynamic.sa == 100.0
    assert math.isnan(no_dynamic.da)
    assert math.isnan(no_dynamic.f1)
    nothing_right = LabelCounts(static_lost=5, dynamic_missed=5)
    assert math.isnan(nothing_right.f1)
    assert nothing_right.precision == 0.0


def test_ranges_and_standing_points_of_a_sweep_by_hand() -> None:
    evaluation = LabelEvaluation(poses="made up")
    labels = np.array([40, 40, 0, 251, 255, 252], np.uint32)
    dynamic = np.array([False, True, True, True, False, True])
    ranges, speeds = np.array([5.0, 10, 5, 30, 5, 5]), np.array([0, 0, 0, 0.31, 0.3, 0.2])
    evaluation.add(labels, dynamic, ranges, speeds)
    result = evaluation.result()
    assert astuple(result.counts) == (1, 1, 1, 0)
    assert astuple(result.temporarily_static) == (0, 0, 1, 1)
    assert astuple(result.with_standing) == (1, 1, 2, 1)
    bands = {band.near: astuple(band.figures) for band in result.by_range}
    assert [bands[near] for near in (0, 10, 20, 30)] == [
        (1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 0, 0), (0, 0, 1, 0)
    ]  # fmt: skip
    assert result.ignored == 1
    assert "made up" in str(result.table())
    assert "temporarily static" in result.table().markdown()


def test_lists_are_arrays() -> None:
    evaluation = LabelEvaluation()
    evaluation.add(np.array([251, 251], np.uint32), np.ones(2, bool), [5.0, 5.0], [9.0, 0.0])
    assert astuple(evaluation.result().counts) == (0, 0, 1, 0)


def test_labels_of_other_points_are_refused() -> None:
    evaluation = LabelEvaluation()
    labels = np.full(5, 9, np.uint32)
    with pytest.raises(InputError, match="5 labels need 5 bools"):
        evaluation.add(labels, np.zeros(4, bool))
    with pytest.raises(InputError, match="as many speeds"):
        evaluation.add(labels, np.zeros(5, bool), speeds=np.zeros(6))
    with pytest.raises(InputError, match="integers"):
        evaluation.add(labels.astype(np.float32), np.zeros(5, bool))
    evaluation.add(labels, np.zeros(5, bool))
    evaluation.add(labels, np.zeros(5, bool), speeds=np.zeros(5))
    with pytest.raises(InputError, match="1 of 2 sweeps"):
        evaluation.result()


def test_objects_that_travel_in_view_are_counted_apart():
    """Two cars stand in sweeps 0 to 5; then one drives 1 m/s, the other 0.4 m/s for 0.2 s."""
    labels = np.array([252 | 1 << 16, 252 | 1 << 16, 252 | 2 << 16, 40], np.uint32)
    evaluation = LabelEvaluation()
    for i in range(12):
        speeds = np.array([1.0, 1.0, 0.4 * (i >= 10), 0]) * (i >= 6)
        found = np.array([True, i < 2, False, False])
        evaluation.add(labels, found, speeds=speeds, seconds=0.1)
    result = evaluation.result()
    assert result.temporarily_static.dynamic == 6 * 3 + 4
    assert result.seen_to_move.dynamic == 6 * 2
    assert result.seen_to_move.da == pytest.approx(100 * 8 / 12)
    assert result.as_dict()["seen_to_move"] == {"points": 12, "da": result.seen_to_move.da}


def test_standing_points_before_between_and_after_motion_are_counted_apart():
    """Car 1 departs, pauses and arrives; car 2 arrives; car 3 only stands; car 4 creeps."""
    sweeps = {  # speed of each car, sweep by sweep
        1: [0, 0, 2, 2, 0, 2, 2, 0, 0, 0],
        2: [3, 3, 3, 0, 0, 0, 0, 0, 0, 0],
        3: [0] * 10,
        4: [0.2] * 10,
    }
    labels = np.repeat([252 | k << 16 for k in sweeps], [1, 3, 5, 7]).astype(np.uint32)
    evaluation = LabelEvaluation()
    for i in range(10):
        speeds = np.repeat([v[i] for v in sweeps.values()], [1, 3, 5, 7]).astype(float)
        evaluation.add(labels, np.full(16, i == 9), speeds=speeds, seconds=0.5)
    result = evaluation.result()
    assert result.seen_to_move.dynamic == (2 + 1 + 3) + 3 * 7 + 7 * 10
    assert (result.departs.dynamic, result.departs.dynamic_found) == (2, 0)
    assert (result.arrived.dynamic, result.arrived.dynamic_found) == (3 + 3 * 7, 1 + 3)
    written = result.as_dict()
    assert written["arrived"] == {"points": 24, "da": pytest.approx(100 * 4 / 24)}
    assert written["departs"] == {"points": 2, "da": 0.0}
    assert any(row[0].strip() == "arrived" for row in result.table().rows)
