"""What the tracker is given of a sweep: objects, borders, and what is refused."""

import numpy as np
import pytest
from things import CAR, POLE, WALL, Thing, detections_of, parked_at

import docdepth._core as _core
from docdepth.dynamics.voting import Votes
from docdepth.errors import InputError
from docdepth.geometry.scan_mesh import ScanMesh


def test_detections_are_the_objects_of_their_sweep():
    rng = np.random.default_rng(0)
    points = rng.uniform(-5, 5, (400, 3)).astype(np.float32)
    ground = rng.random(400) < 0.3
    objects = rng.integers(0, 6, 400).astype(np.uint32)
    objects = np.array([np.flatnonzero((objects == o) & ~ground)[0] for o in objects], np.uint32)
    objects[ground] = np.flatnonzero(ground)
    moving = rng.random(400) < 0.5
    T = np.eye(4)
    T[:3, 3] = 3, -2, 1
    ends = np.arange(400, dtype=np.int32)
    free, porous = rng.random((2, 400)) < 0.5
    mesh = ScanMesh(points).core
    made = _core.Detections(points, ground, objects, moving, free, porous, ends, ends, mesh, T)
    rows, samples, borders = made.arrays
    assert list(rows["first"]) == sorted(set(objects[~ground]))
    for row in rows:
        members, count = ~ground & (objects == row["first"]), row["points"]
        assert count == members.sum()
        assert row["dynamic_points"] == (members & moving).sum()
        world = points[members] + np.float32([3, -2, 1])
        np.testing.assert_array_equal(row["low"], world.min(0))
        np.testing.assert_array_equal(row["high"], world.max(0))
        squares = (points[members] ** 2).sum(1)
        np.testing.assert_allclose(row["area"], squares.sum(), rtol=1e-5)
        np.testing.assert_allclose(row["dynamic_area"], squares[moving[members]].sum(), rtol=1e-5)
        isolated = np.isin(np.flatnonzero(members), mesh.isolated).sum()
        freed = squares[free[members]].sum() if isolated <= 0.1 * count else 0
        np.testing.assert_allclose(row["free_area"], freed, rtol=1e-5)
        np.testing.assert_allclose(row["porous_area"], squares[porous[members]].sum(), rtol=1e-5)
        sweeps = np.sort(np.flatnonzero(members))
        assert row["first_occupied"] == sweeps[count // 2]
        quarters = [int(share * (int(count) - 1) + 0.5) for share in (0.25, 0.75)]
        assert [row["stands_since"], row["stands_until"]] == list(sweeps[quarters])
    normals = samples["normal"]
    assert rows["samples"].sum() == len(samples)
    assert rows["edges"].sum() + rows["hidden"].sum() == len(borders)
    assert ((np.abs(np.linalg.norm(normals, axis=1) - 1) < 1e-5) | ~normals.any(1)).all()
    assert rows["samples"].max() <= 100


def test_borders_tell_where_an_object_ends_and_where_it_is_hidden():
    """A car before a wall, with a pole before the car."""
    things = [
        Thing(CAR, parked_at(0, 8)),
        Thing(WALL, parked_at(0, 14)),
        Thing(POLE, parked_at(0.8, 4)),
    ]
    detections, rows = detections_of(things, 1)
    objects, _, borders = detections[0].arrays
    (k,) = np.flatnonzero(objects["first"] == rows[0][0])
    counts = np.stack([objects["edges"], objects["hidden"]], 1)  # of each in turn
    parts = np.split(borders["point"], np.cumsum(counts.ravel().astype(int)))
    edges, hidden = parts[2 * k], parts[2 * k + 1]
    front = 8 - CAR[1] / 2
    below = edges[:, 2] < 1.3  # the roof ends, too
    assert below.sum() >= 4
    np.testing.assert_allclose(np.abs(edges[below, 0]), CAR[0] / 2, atol=0.1)
    assert len(hidden) >= 4
    shadow = front * np.array([0.65 / 4.15, 0.95 / 3.85])  # of the pole, from the LiDAR
    assert np.quantile(np.abs(hidden[:, :1] - shadow).min(1), 0.8) < 0.15


def test_wrong_objects_are_refused():
    points, ground = np.ones((3, 3), np.float32), np.zeros(3, bool)
    objects, moving = np.array([0, 1, 1], np.uint32), np.zeros(3, bool)
    seen = (moving, moving, *np.zeros((2, 3), np.int32), ScanMesh(points).core, np.eye(4))
    with pytest.raises(ValueError, match="cluster_objects"):
        _core.Detections(points, ground, objects[::-1].copy(), moving, *seen)
    with pytest.raises(InputError, match="order"):
        Votes(*np.zeros((2, 3), np.uint16)).occupancy_by_sweep(np.arange(2), 2)
