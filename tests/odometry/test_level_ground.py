"""Level ground is thinned, and the rings of a sparse LiDAR no longer hold it back on a motorway."""

from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest

from docdepth import open_dataset, register_drive
from docdepth.geometry.se3 import inverse, rotation_log
from docdepth.odometry.level_ground import thin_level_ground
from docdepth.synthetic import write_drive


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
        thinned, plain = thin_level_ground(points, edge), plainly_thinned(points, edge)
        assert len(thinned) == len(plain)
        order, plain_order = np.lexsort(thinned.T), np.lexsort(plain.T)
        np.testing.assert_allclose(thinned[order], plain[plain_order], atol=1e-12)
        assert np.count_nonzero(thinned[:, 2] > -1) == np.count_nonzero(wall[:, 2] > -1)
    assert len(thin_level_ground(points, 1.0)) < 0.6 * len(points)


def test_where_walls_are_most_of_a_sweep_all_points_stay() -> None:
    rng = np.random.default_rng(6)
    road = np.column_stack([rng.uniform(-20, 20, (900, 2)), rng.normal(-1.8, 0.02, 900)])
    wall = np.column_stack([rng.uniform(-9, 9, 1000), np.full(1000, 7.3), rng.uniform(-2, 3, 1000)])
    points = np.concatenate([road, wall])
    assert thin_level_ground(points, 1.0) is points


def test_no_points() -> None:
    assert thin_level_ground(np.empty((0, 3)), 1.0).shape == (0, 3)


@pytest.mark.parametrize("seed", [31, 3])
def test_sixteen_beams_on_a_motorway(tmp_path: Path, seed: int) -> None:
    """Registered on each other, the rings on the road would say that the vehicle stands."""
    write_drive(tmp_path, "highway", "VLP-16", 12, seed, skew=True)
    dataset = open_dataset(tmp_path / "sequences" / "00")
    poses, exact = register_drive(dataset).trajectory.poses, np.asarray(dataset.poses)
    steps, exact_steps = (inverse(p[:-1]) @ p[1:] for p in (poses, exact))
    assert exact_steps[:, 0, 3].min() > 2.5  # metres a sweep
    errors = np.linalg.norm((inverse(exact_steps) @ steps)[:, :3, 3], axis=1)
    assert errors.max() < 0.15


@pytest.mark.parametrize("scene", ["highway", "overtaking"])
@pytest.mark.parametrize("seed", [7, 31])
def test_a_narrow_view_of_a_motorway(tmp_path: Path, scene: str, seed: int) -> None:
    """Most of what an Avia sees there is road, and lorries that go along."""
    write_drive(tmp_path, scene, "Avia", 12, seed)
    dataset = open_dataset(tmp_path / "sequences" / "00")
    poses, exact = register_drive(dataset).trajectory.poses, np.asarray(dataset.poses)
    steps, exact_steps = (inverse(p[:-1]) @ p[1:] for p in (poses, exact))
    assert exact_steps[:, 0, 3].min() > 2  # metres a sweep
    errors = np.linalg.norm((inverse(exact_steps) @ steps)[:, :3, 3], axis=1)
    assert errors.max() < 0.1


def test_sixteen_beams_do_not_pitch(tmp_path: Path) -> None:
    """Normals of ten neighbours lean where these lie on one ring: a degree after 20 m."""
    write_drive(tmp_path, "city", "VLP-16", 20, 31, skew=True)
    dataset = open_dataset(tmp_path / "sequences" / "00")
    poses, exact = register_drive(dataset).trajectory.poses, np.asarray(dataset.poses)
    found, true = (inverse(p[0]) @ p[-1] for p in (poses, exact))
    turn = np.degrees(rotation_log(true[:3, :3].T @ found[:3, :3]))
    assert np.abs(turn).max() < 0.2
