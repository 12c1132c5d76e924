"""The synthetic suite and IP-Basic, from benchmarks/."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from docdepth.geometry.camera import Camera

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture(scope="module", autouse=True)
def _benchmarks():
    sys.path.insert(0, str(BENCHMARKS))
    yield
    sys.path.remove(str(BENCHMARKS))


def test_points_are_projected_to_their_pixels_and_the_nearest_wins() -> None:
    from docdepth.evaluation.pixels import project

    camera = Camera(np.array([(100.0, 0, 10), (0, 100, 8), (0, 0, 1)]), 21, 17)
    T_camera_lidar = np.eye(4)
    T_camera_lidar[2, 3] = 1.0
    points = np.array([(0, 0, 4), (0, 0, 3), (0.2, -0.1, 4), (9, 0, 4), (0, 0, -3)], np.float32)
    depth, row = project(camera, T_camera_lidar, points)
    assert depth[8, 10] == 4
    assert depth[6, 14] == 5
    assert np.isfinite(depth).sum() == 2
    assert (row[8, 10], row[6, 14], (row >= 0).sum()) == (1, 2, 2)


def test_ip_basic_completes_a_plane() -> None:
    """A road seen by rings: every depth is that of a return a few rows away."""
    from ip_basic import ip_basic

    row = np.arange(120)[:, None]
    plane = np.broadcast_to(1.7 * 700 / (row + 20.0), (120, 300)).astype(np.float32)
    sparse = np.full_like(plane, np.nan)
    sparse[40::6, ::4] = plane[40::6, ::4]
    depth = ip_basic(sparse)
    assert depth.dtype == np.float32
    assert np.isfinite(depth[40:]).all()
    # Dilation brings nearer values from below, closing and blurring farther ones from above.
    inner = np.s_[45:105, 10:-10]
    assert (depth[inner] <= plane[41:101, 10:-10] * 1.001).all()
    assert (depth[inner] >= plane[52:112, 10:-10] * 0.999).all()
    # And the highest ones are carried to the top.
    np.testing.assert_allclose(depth[5], depth[30], rtol=1e-3)


def test_ip_basic_leaves_far_pixels_out_and_nothing_empty() -> None:
    from ip_basic import ip_basic

    sparse = np.full((60, 60), np.nan, np.float32)
    assert np.isnan(ip_basic(sparse)).all()
    sparse[30:, ::3] = 20
    sparse[40, 10] = 90
    np.testing.assert_allclose(ip_basic(sparse), 20, rtol=1e-6)


def test_table_has_the_mean_and_the_worst_of_each_metric() -> None:
    from suite import Column, table

    columns = [Column("f1", "F1", 2), Column("edge_displacement", "edge_displacement", 1, -1)]
    cells = {
        "a": {"t": {"f1": 0.9, "edge_displacement": 1.0}},
        "b": {"t": {"f1": 0.7, "edge_displacement": 2.0}},
        "c": {"t": {"f1": float("nan"), "edge_displacement": 3.0}},
    }
    rows = table("title", columns, cells).rows
    assert rows[0] == ("mean", "t", "0.80", "2.0")
    assert rows[1] == ("worst", "t", "0.70", "3.0")
    assert rows[4] == ("c", "t", "-", "3.0")


@pytest.mark.nightly
def test_suite_of_two_tiny_cells(tmp_path, monkeypatch) -> None:
    pytest.importorskip("embreex")
    import cells
    import suite

    tiny = [str(tmp_path / "drives"), "-o", str(tmp_path / "out"), "--frames", "6"]
    tiny += ["--scenes", "city", "crossing", "--sensors", "VLP-16", "--threads", "2"]
    labels = suite.main(tiny)
    assert set(labels) == {"city_VLP-16", "crossing_VLP-16"}
    assert all(rows["default"]["sa"] > 95 for rows in labels.values())
    depth = suite.main([*tiny, "--depth", "--images", "1"])
    for rows in depth.values():
        assert set(rows) == {t.name for t in suite.DEPTH_TRIALS} | {suite.IP_BASIC}
        assert (
            rows["default"]["all.edge_displacement"] < rows[suite.IP_BASIC]["all.edge_displacement"]
        )
    own = suite.main([*tiny, "--own", "--images", "1"])
    for cell, rows in own.items():
        assert set(rows) == {"default"}
        # What stands is drawn from the same points, whatever else the classes say.
        assert rows["default"]["all.edge_displacement"] == pytest.approx(
            depth[cell]["default"]["all.edge_displacement"], abs=0.2
        )
        assert rows["default"] != depth[cell]["default"]
    # Nothing is computed again: not even the scene is built.
    monkeypatch.setattr(cells, "Drive", None)
    monkeypatch.setattr(cells, "write_drive", None)
    assert suite.main([*tiny, "--depth", "--images", "1"]) == depth
    assert suite.main([*tiny, "--own", "--images", "1"]) == own
    stored = tmp_path / "out/depth/seed0/city_VLP-16/paper.json"
    assert json.loads(stored.read_text())["metrics"]["poses"] == "exact"
    with pytest.raises(cells.RunError, match="another drive"):
        suite.main([*tiny, "--frames", "5"])
