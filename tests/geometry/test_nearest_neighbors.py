"""Nearest neighbours between clouds, compared with a plain search."""

from __future__ import annotations

import numpy as np
import pytest

import docdepth._core as _core


def reference(points, queries):
    """In float32 and in the order of the k-d tree: ((dx^2 + dy^2) + dz^2), of equals the first."""
    d = queries[:, None] - points[None]
    squared = (d[..., 0] * d[..., 0] + d[..., 1] * d[..., 1]) + d[..., 2] * d[..., 2]
    index = squared.argmin(axis=1)
    return index, np.sqrt(squared[np.arange(len(queries)), index])


@pytest.mark.parametrize("grid", [None, 2.0])
@pytest.mark.parametrize("threads", [1, 3])
def test_neighbors_equal_a_plain_search(grid, threads):
    rng = np.random.default_rng(7)
    points = rng.normal(scale=8, size=(900, 3)).astype(np.float32)
    queries = rng.normal(scale=9, size=(1500, 3)).astype(np.float32)
    if grid:  # duplicates and ties
        points, queries = np.round(points / grid) * np.float32(grid), np.round(queries)
        points = points.astype(np.float32)
    index, distance = _core.nearest_neighbors(points, queries, threads=threads)
    assert index.dtype == np.uint32
    assert distance.dtype == np.float32
    expected, expected_distance = reference(points, queries)
    np.testing.assert_array_equal(index, expected)
    np.testing.assert_array_equal(distance, expected_distance)


def test_a_point_is_its_own_neighbor():
    points = np.repeat(np.arange(30, dtype=np.float32).reshape(10, 3), 3, axis=0)
    index, distance = _core.nearest_neighbors(points, points)
    np.testing.assert_array_equal(index, np.arange(30) // 3 * 3)  # of duplicates the first
    assert (distance == 0).all()


def test_clouds_that_have_no_answer():
    points, none = np.ones((4, 3), np.float32), np.empty((0, 3), np.float32)
    for cloud in (points, none):
        index, distance = _core.nearest_neighbors(cloud, none)
        assert index.shape == distance.shape == (0,)
    with pytest.raises(ValueError, match="no points to search in"):
        _core.nearest_neighbors(none, points)
    for bad in (np.nan, np.inf):
        broken = points.copy()
        broken[2, 1] = bad
        with pytest.raises(ValueError, match="points must be finite, but row 2 is not"):
            _core.nearest_neighbors(broken, points)
        with pytest.raises(ValueError, match="queries must be finite, but row 2 is not"):
            _core.nearest_neighbors(points, broken)
    with pytest.raises(ValueError, match=r"queries must be a float32 array of shape \(N, 3\)"):
        _core.nearest_neighbors(points, points[:, :2].copy())
    with pytest.raises(TypeError):
        _core.nearest_neighbors(points.astype(np.float64), points)
