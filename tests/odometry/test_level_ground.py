"""Level ground is thinned to one point for each column."""

from collections import defaultdict

import numpy as np

from docdepth.odometry.registration import split_level_ground


def plainly_thinned(points: np.ndarray, edge: float) -> np.ndarray:
    columns = defaultdict(list)
    for point in points:
        columns[tuple(np.floor(point[:2] / edge))].append(point)
    kept = {}
    means = []
    for column in columns.values():
        heights = [point[2] for point in column]
        if max(heights) - min(heights) < 0.1:
            means.append(np.mean(column, axis=0))
        else:
            kept.update({tuple(point): point for point in column})
    others = [point for point in points if tuple(point) in kept]
    return np.array(others + means)


def test_a_level_column_keeps_its_mean() -> None:
    rng = np.random.default_rng(5)
    road = np.column_stack([rng.uniform(-20, 20, (3000, 2)), rng.normal(-1.8, 0.02, 3000)])
    wall = np.column_stack([rng.uniform(-20, 20, 800), np.full(800, 7.3), rng.uniform(-2, 3, 800)])
    points = rng.permutation(np.concatenate([road, wall]))
    for edge in (0.5, 1.0):
        thinned = np.concatenate(split_level_ground(points, edge))
        plain = plainly_thinned(points, edge)
        assert len(thinned) == len(plain)
        order, plain_order = np.lexsort(thinned.T), np.lexsort(plain.T)
        np.testing.assert_allclose(thinned[order], plain[plain_order], atol=1e-12)
        assert np.count_nonzero(thinned[:, 2] > -1) == np.count_nonzero(wall[:, 2] > -1)
    assert sum(map(len, split_level_ground(points, 1.0))) < 0.6 * len(points)


def test_where_walls_are_most_of_a_sweep_all_points_stay() -> None:
    rng = np.random.default_rng(6)
    road = np.column_stack([rng.uniform(-20, 20, (900, 2)), rng.normal(-1.8, 0.02, 900)])
    wall = np.column_stack([rng.uniform(-9, 9, 1000), np.full(1000, 7.3), rng.uniform(-2, 3, 1000)])
    points = np.concatenate([road, wall])
    rising, road = split_level_ground(points, 1.0)
    assert rising is points
    assert len(road) == 0


def test_no_points() -> None:
    assert [part.shape for part in split_level_ground(np.empty((0, 3)), 1.0)] == [(0, 3), (0, 3)]
