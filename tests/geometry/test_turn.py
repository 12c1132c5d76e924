"""Times of points by the rotation of the LiDAR, told by the order of rows."""

from __future__ import annotations

import numpy as np
import pytest

from docdepth.geometry.turn import Turn, possible_turns
from docdepth.synthetic import sensor

ORDERS = ("columns", "rings", "rings backwards", "shuffled")


def sweep(order: str, clockwise: bool = True, seam_deg: float = 180.0, columns: int = 900):
    """Points, exact times after the start as shares, and rings: a room of 16 rings."""
    rng = np.random.default_rng(5)
    share, ring = ((a.ravel()) for a in np.meshgrid(np.arange(columns) / columns, np.arange(16)))
    azimuth = np.radians(seam_deg) + 2 * np.pi * share * (-1 if clockwise else 1)
    azimuth += np.radians(0.3) * (ring % 4)  # lasers of a column do not lie in one plane
    far = 8 + 3 * np.sin(azimuth) + rng.normal(0, 0.01, len(share))
    points = np.stack([np.cos(azimuth), np.sin(azimuth), np.tan(np.radians(2 * ring - 15))], 1)
    rows = {
        "columns": np.lexsort((ring, share)),
        "rings": np.lexsort((share, ring)),
        "rings backwards": np.lexsort((-share, ring)),
        "shuffled": rng.permutation(len(share)),
    }[order]
    rows = rows[rng.random(len(rows)) < 0.8]
    return (points * far[:, None]).astype(np.float32)[rows], share[rows], ring[rows].astype("u2")


@pytest.mark.parametrize("clockwise", [True, False])
@pytest.mark.parametrize("seam_deg", [180.0, 90.0, -37.0])
def test_rows_in_the_order_of_time_tell_direction_and_times(clockwise, seam_deg) -> None:
    points, share, _ = sweep("columns", clockwise, seam_deg)
    assert possible_turns(points) == [Turn(clockwise)]
    assert np.abs(Turn(clockwise).relative_time(points) + 0.5 - share).max() < 0.01


def test_a_sweep_that_goes_on_over_its_beginning_has_times_after_its_end() -> None:
    points, share, _ = sweep("columns")
    again = np.concatenate([points, points[:500]])
    times = Turn(True, before_stamp=0.0).relative_time(again)
    assert np.abs(times - np.concatenate([share, 1 + share[:500]])).max() < 0.01


def test_rows_without_a_return_count_as_rows_and_get_a_time() -> None:
    points, share, _ = sweep("columns")
    lost = slice(1000, 4000)
    points[lost] = np.nan
    assert possible_turns(points) == [Turn(True)]
    times = Turn(True).relative_time(points)
    seen = np.isfinite(points).all(axis=1)
    assert np.abs(times + 0.5 - share)[seen].max() < 0.01
    assert (times[~seen] == 0).all()


@pytest.mark.parametrize("order", ["rings", "rings backwards"])
def test_rings_leave_direction_and_seam_open(order: str) -> None:
    points, share, _ = sweep(order)
    turns = possible_turns(points)
    assert len(turns) == 8
    assert Turn(True, 180.0) in turns
    late = Turn(True, 180.0, before_stamp=0.0).relative_time(points) - share
    assert np.abs((late + 0.5) % 1 - 0.5).max() < 0.01


def test_shuffled_rows_need_numbers_of_rings() -> None:
    points, _, ring = sweep("shuffled")
    assert possible_turns(points) == []
    assert len(possible_turns(points, ring)) == 8


def test_lidars_that_do_not_spin_have_no_turn() -> None:
    rosette = sensor("Avia").pattern(0)
    ahead = (20 * rosette.directions).astype(np.float32)
    assert possible_turns(ahead, rosette.rings.astype(np.uint16)) == []
    wide = np.random.default_rng(0).normal(0, 5, (5000, 3)).astype(np.float32)
    assert possible_turns(wide) == []
    assert possible_turns(wide[:20]) == []


def test_a_part_of_a_revolution_is_not_stretched_to_a_whole_one() -> None:
    points, _, _ = sweep("columns")
    assert possible_turns(points[points[:, 0] > np.abs(points[:, 1])]) == []


def test_a_sweep_of_no_returns_has_times() -> None:
    for seam in (None, 0.0):
        assert not Turn(True, seam).relative_time(np.zeros((5, 3), np.float32)).any()
        assert len(Turn(True, seam).relative_time(np.zeros((0, 3), np.float32))) == 0
