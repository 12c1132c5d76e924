"""Metrics of labels against values worked out by hand and against plain loops."""

import math

import numpy as np
import pytest

from docdepth.errors import InputError
from docdepth.evaluation import (
    LabelCounts,
    LabelEvaluation,
    ignored,
    moving,
)


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


def test_streaming_equals_a_plain_loop() -> None:
    random = np.random.default_rng(1)
    evaluation = LabelEvaluation(poses="made up")
    expected = {"now": [0] * 4, "near": [0] * 4, "far": [0] * 4, "standing": [0] * 4}
    for n in (1000, 1, 0, 777):
        labels = random.choice(np.array([0, 1, 9, 40, 251, 255], np.uint32), n)
        dynamic = random.random(n) < 0.3
        ranges = random.uniform(0, 40, n)
        speeds = random.choice([0.0, 0.2, 0.3, 0.31, 5.0], n)
        evaluation.add(labels, dynamic, ranges, speeds)
        for label, called, r, speed in zip(labels, dynamic, ranges, speeds, strict=True):
            if label < 2:
                continue
            truth = 251 <= label <= 259
            cell = 2 * truth + called
            if truth and speed <= 0.3:
                expected["standing"][cell] += 1
                continue
            expected["now"][cell] += 1
            if r < 10:
                expected["near"][cell] += 1
            elif r < 30:
                expected["far"][cell] += 1
    result = evaluation.result()

    def cells(counts: LabelCounts) -> list[int]:
        kept, lost = counts.static_kept, counts.static_lost
        return [kept, lost, counts.dynamic_missed, counts.dynamic_found]

    assert result.temporarily_static is not None
    assert result.with_standing is not None
    assert cells(result.counts) == expected["now"]
    assert cells(result.temporarily_static) == expected["standing"]
    assert cells(result.by_range[0].figures) == expected["near"]
    assert cells(result.by_range[1].figures + result.by_range[2].figures) == expected["far"]
    both = np.add(expected["now"], expected["standing"]).tolist()
    assert cells(result.with_standing) == both
    assert result.as_dict()["temporarily_static"]["da"] == pytest.approx(
        100 * expected["standing"][3] / sum(expected["standing"])
    )
    assert "made up" in str(result.table())
    assert "temporarily static" in result.table().markdown()


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
