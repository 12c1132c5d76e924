"""Depth of large vehicles, from benchmarks/large_vehicles.py."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("embreex")


def test_a_tiny_drive_has_figures(tmp_path, capsys):
    import large_vehicles

    arguments = [str(tmp_path / "drives"), "-o", str(tmp_path / "out"), "--images", "1"]
    cells = large_vehicles.main([*arguments, "--sensors", "VLP-16", "--frames", "6"])
    (pixels, empty, world), (of_seen, *_) = cells["overtaking_VLP-16"].tolist()
    assert pixels > 10_000
    assert empty + world < pixels
    assert 0 < of_seen <= pixels
    assert "overtaking_VLP-16" in capsys.readouterr().out


def test_what_was_seen_and_what_lies_outside():
    """By hand: a lorry at 10 m/s along x, of which one return on its rear is known."""
    from large_vehicles import Vehicle

    from docdepth.geometry.track import Track

    poses = np.repeat(np.eye(4)[None], 2, 0)
    poses[1, 0, 3] = 1.0
    exact, points = np.zeros(2), np.zeros(2, np.int64)
    times, size = np.array([0, 100_000_000]), np.array((8.0, 2.0, 3.0))
    velocity = np.tile((10.0, 0, 0), (2, 1))
    lorry = Vehicle(Track(1, "vehicle", times, poses, velocity, size, points, exact, exact))
    lorry.add(np.array([(-4.0, 0, 1)]), 0)
    later = np.array([(-3.0, 0.15, 1), (-3.0, 0.3, 1), (-3.0, 0, 0.9), (-3.0, 0, 1.1)])
    front = np.array([(4.0, 0, 1)])
    assert lorry.has_seen(lorry.local(later, 100_000_000)).tolist() == [True, False, True, False]
    lorry.add(np.array([(-4.0, 0.25, 1.5)]), 0)  # higher, beside it
    assert lorry.has_seen(lorry.local(later, 100_000_000)).tolist() == [True, False, True, True]
    assert lorry.has_seen(front).tolist() == [False]
    local = np.array([(4.4, 0, 1), (4.6, 0, 1), (0, 1.6, 1), (0, 0, 3.4), (0, 0, 3.6)])
    assert lorry.is_outside(local).tolist() == [False, True, True, False, True]
