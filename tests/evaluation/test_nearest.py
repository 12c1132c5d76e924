"""Nearest neighbours against a comparison of all pairs."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from docdepth.evaluation.pixels import cloud_distance, nearest_neighbors


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("away", [0.0, 700.0])
def test_nearest_neighbors_equal_brute_force(dtype, away) -> None:
    random = np.random.default_rng(6)
    points = (away + random.uniform(-20, 20, (700, 3))).astype(dtype)
    others = away + random.uniform(-20, 20, (300, 3))
    queries = np.vstack([points[::7], others]).astype(dtype)
    index, distance = nearest_neighbors(points, queries)
    pairs = np.linalg.norm(queries[:, None].astype(float) - points[None].astype(float), axis=2)
    np.testing.assert_allclose(distance, pairs.min(axis=1), rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(index, pairs.argmin(axis=1))


def test_without_points_or_queries_there_are_no_neighbours() -> None:
    none, one = np.empty((0, 3), np.float32), np.ones((1, 3), np.float32)
    assert np.isinf(nearest_neighbors(none, one)[1]).all()
    assert len(nearest_neighbors(one, none)[0]) == 0


def test_distance_of_large_clouds_is_told_by_some_of_their_points() -> None:
    """Each way every third of 120,000 points asks; the sum and the number are of these."""
    random = np.random.default_rng(8)
    cloud = random.uniform(-20, 20, (120_000, 3))
    other = cloud[::-1] + random.normal(0, 0.02, cloud.shape)
    total, count = cloud_distance(cloud, other)
    assert count == 2 * 40_000
    trees = cKDTree(cloud), cKDTree(other)
    expected = trees[0].query(other[::3])[0].sum() + trees[1].query(cloud[::3])[0].sum()
    assert total == pytest.approx(expected, rel=1e-3)
    assert cloud_distance(cloud, cloud[:0]) == (0.0, 0)
