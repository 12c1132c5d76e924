"""What tracking costs where all seems to move, from benchmarks/."""

from __future__ import annotations


def test_all_that_seems_to_move_is_tracked_and_measured(capsys):
    import track_cost

    rows = track_cost.main(["--objects", "4", "8", "--sweeps", "6"])
    assert [row[:3] for row in rows] == [
        ("cars", "4", "4"),
        ("cars", "8", "8"),
        ("fences", "4", "4"),
        ("fences", "8", "8"),
    ]
    assert all(float(row[5]) > 0 for row in rows[1::2])
    assert "growth" in capsys.readouterr().out
