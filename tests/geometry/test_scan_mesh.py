"""Meshes of sweeps against scipy's Delaunay, exact scenes and a real drive."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import Delaunay

import docdepth._core as _core
from docdepth.errors import InputError
from docdepth.geometry.scan_mesh import ScanMesh

UNIT = 2 * np.pi / 65536


def rays(azimuth_deg: NDArray, elevation_deg: NDArray) -> NDArray:
    a, e = np.radians(azimuth_deg).ravel(), np.radians(elevation_deg).ravel()
    return np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], axis=1)


def ring_rays(rings: int = 32, columns: int = 900, low: float = -25, high: float = 5) -> NDArray:
    azimuth = np.arange(columns) * 360.0 / columns - 180.0 + 0.03
    return rays(*np.meshgrid(azimuth, np.linspace(low, high, rings)))


def rosette_rays(count: int = 8000) -> NDArray:
    t = np.arange(count) * 0.0123
    radius = 17.0 * np.abs(np.sin(7.1 * t))
    return rays(2.0 * radius * np.cos(2.3 * t), radius * np.sin(2.3 * t))


def scatter_rays(count: int = 5000, half_width: float = 40.0) -> NDArray:
    random = np.random.default_rng(3)
    return rays(random.uniform(-half_width, half_width, count), random.uniform(-25, 15, count))


def units(points: NDArray) -> NDArray:
    x, y, z = points.astype(np.float64).T
    azimuth = np.rint(np.arctan2(y, x) / UNIT).astype(np.int64)
    azimuth[azimuth == 32768] = -32768
    return np.stack([azimuth, np.rint(np.arctan2(z, np.hypot(x, y)) / UNIT).astype(np.int64)], 1)


def signed_area(a: NDArray, b: NDArray, c: NDArray) -> NDArray:
    return (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]


ALL_GAPS = _core.MeshParameters()
ALL_GAPS.max_gap = float(np.radians(89.0))


@pytest.mark.parametrize("make", [ring_rays, rosette_rays, scatter_rays])
def test_it_is_the_delaunay_triangulation(make: Callable[[], NDArray]) -> None:
    points = (make() * 10).astype(np.float32)
    mesh = ScanMesh(points, parameters=ALL_GAPS)
    q = units(points)
    # Repeat the cylinder on both sides, triangulate the plane, keep one copy of every triangle.
    copies = np.concatenate([q, q - np.array([65536, 0]), q + np.array([65536, 0])])
    number = np.tile(np.arange(len(q)), 3)
    inside = np.abs(copies[:, 0]) < 32768 + 8000
    copies, number = copies[inside], number[inside]
    _, first = np.unique(copies, axis=0, return_index=True)
    copies, number = copies[np.sort(first)], number[np.sort(first)]
    reference = Delaunay(copies)
    corners = copies[reference.simplices]
    # Circles through scipy's triangles: ours must appear among them unless four lie on one circle,
    # and every inner one of theirs (circle well inside the field of view) among ours.
    a, b, c = (corners[:, i].astype(np.float64) for i in range(3))
    d = 2 * signed_area(a, b, c)
    with np.errstate(divide="ignore", invalid="ignore"):
        sq = [(v**2).sum(1) for v in (a, b, c)]
        center = (
            np.stack(
                [
                    sq[0] * (b - c)[:, 1] + sq[1] * (c - a)[:, 1] + sq[2] * (a - b)[:, 1],
                    sq[0] * (c - b)[:, 0] + sq[1] * (a - c)[:, 0] + sq[2] * (b - a)[:, 0],
                ],
                1,
            )
            / d[:, None]
        )
        radius = np.linalg.norm(a - center, axis=1)
    left = corners[:, :, 0].min(1)
    inner = (radius < 180) & (left >= -32768) & (left < 32768)
    # Near the border of the field of view guards stand: leave that border out.
    low, high = copies.min(axis=0), copies.max(axis=0)
    inner &= ((center - radius[:, None] > low) & (center + radius[:, None] < high)).all(axis=1)
    theirs = set(map(tuple, np.sort(number[reference.simplices[inner]], 1).tolist()))
    ours = set(map(tuple, np.sort(mesh.triangles, 1).tolist()))
    assert len(ours) == len(mesh.triangles)
    missing = theirs - ours
    # A missing triangle has a fourth return on its circle, exactly.
    for triangle in list(missing)[:200]:
        assert has_fourth_on_circle(q, triangle)
    if make is not ring_rays:  # regular grids are nothing but such ties
        assert len(missing) < 0.01 * len(theirs)


def has_fourth_on_circle(q: NDArray, triangle: tuple[int, int, int]) -> bool:
    base = q[triangle[0]]
    near = q - base
    near[:, 0] = (near[:, 0] + 32768) % 65536 - 32768
    near = near[(np.abs(near) < 720).all(1)].astype(object)
    a, b = (q[i] - base for i in triangle[1:])
    for v in (a, b):
        v[0] = (v[0] + 32768) % 65536 - 32768
    a, b = a.astype(object), b.astype(object)
    # In-circle determinant with the first corner at the origin.
    square = near[:, 0] ** 2 + near[:, 1] ** 2
    det = (
        square * (a[0] * b[1] - a[1] * b[0])
        - (a[0] ** 2 + a[1] ** 2) * (near[:, 0] * b[1] - near[:, 1] * b[0])
        - (b[0] ** 2 + b[1] ** 2) * (a[0] * near[:, 1] - a[1] * near[:, 0])
    )
    return int((det == 0).sum()) >= 4


@pytest.mark.parametrize("make", [ring_rays, rosette_rays, scatter_rays])
def test_triangles_tile_what_was_seen(make: Callable[[], NDArray]) -> None:
    points = (make() * 10).astype(np.float32)
    triangles = ScanMesh(points, parameters=ALL_GAPS).triangles
    q = units(points)
    corners = q[triangles]
    for i in (1, 2):  # unroll at the seam
        corners[:, i, 0] += (
            np.rint((corners[:, 0, 0] - corners[:, i, 0]) / 65536).astype(int) * 65536
        )
    area = signed_area(*(corners[:, i] for i in range(3)))
    assert (area > 0).all(), "every triangle turns counterclockwise"
    edges = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    _, uses = np.unique(edges, axis=0, return_counts=True)
    assert uses.max() <= 2
    if make is ring_rays:
        assert area.sum() == 2 * 65536 * np.diff(np.sort(q[:, 1])[[0, -1]])[0]


def test_row_order_changes_nothing_but_the_names() -> None:
    points = (scatter_rays(half_width=180.0) * 10).astype(np.float32)
    order = np.random.default_rng(0).permutation(len(points))
    first, second = ScanMesh(points), ScanMesh(points[order])
    a = set(map(tuple, np.sort(first.triangles, 1).tolist()))
    b = set(map(tuple, np.sort(order[second.triangles], 1).tolist()))
    # Ties on circles are broken by row: a few of thousands.
    assert len(a ^ b) < 0.005 * len(a)


def scene(directions: NDArray) -> tuple[NDArray, NDArray]:
    """Ranges of a street: ground 1.7 m below, a wall across at 15 m, a box before it; and what."""
    x, _, z = directions.T
    with np.errstate(divide="ignore", invalid="ignore"):
        ground = np.where(z < 0, -1.7 / z, np.inf)
        wall = np.where(x > 0, 15.0 / x, np.inf)
        box = np.where(x > 0, 8.0 / x, np.inf)
        side = box[:, None] * directions
        box = np.where((np.abs(side[:, 1]) < 1.0) & (np.abs(side[:, 2] + 0.7) < 0.8), box, np.inf)
    all_ranges = np.stack([ground, wall, box], axis=1)
    return all_ranges.min(axis=1), all_ranges.argmin(axis=1)


def test_a_box_before_a_wall_has_discontinuities_around_it() -> None:
    directions = ring_rays(32, 1800)
    ranges, what = scene(directions)
    seen = ranges < 80.0
    points = (directions * ranges[:, None])[seen].astype(np.float32)
    what = what[seen]
    mesh = ScanMesh(points)
    kinds = what[mesh.triangles]
    one = (kinds == kinds[:, :1]).all(axis=1)
    box_and_behind = (kinds == 2).any(axis=1) & (kinds != 2).any(axis=1)
    change = np.ptp(np.linalg.norm(points[mesh.triangles], axis=2), axis=1)
    assert mesh.discontinuity[box_and_behind & (change > 2.0)].all()
    assert mesh.discontinuity[one].mean() < 0.002, "planes stay whole, however grazing"
    assert not mesh.discontinuity[one & (kinds[:, 0] == 2)].any()


def test_nothing_joins_thin_posts_to_the_wall_behind() -> None:
    """A post one or two returns wide: the triangles to its left and right nearly share a plane."""
    directions = ring_rays(32, 2000)
    azimuth = np.degrees(np.arctan2(directions[:, 1], directions[:, 0]))
    noise = np.random.default_rng(2).normal(0, 0.015, len(directions))
    for width in (0.2, 0.38):
        post = (np.abs((azimuth + 5) % 10 - 5) < width / 2) & (np.abs(azimuth) < 40)
        ranges = np.where(post, 4.0, 9.0) + noise
        mesh = ScanMesh((directions * ranges[:, None]).astype(np.float32))
        kinds = post[mesh.triangles]
        joined = kinds.any(axis=1) & ~kinds.all(axis=1)
        assert joined.sum() > 500
        assert mesh.discontinuity[joined].all()


def test_a_sphere_is_continuous_and_its_rim_is_not() -> None:
    directions = scatter_rays(20000)
    center, radius = np.array([12.0, 0.0, 0.0]), 2.0
    along = directions @ center
    inside = along**2 - (center @ center - radius**2)
    ranges = np.where(inside > 0, along - np.sqrt(np.maximum(inside, 0)), 30.0)
    mesh = ScanMesh((directions * ranges[:, None]).astype(np.float32))
    on = (inside > 0)[mesh.triangles]
    steep = (inside < 0.8)[mesh.triangles].any(axis=1)  # within a few degrees of tangent
    assert not mesh.discontinuity[on.all(axis=1) & ~steep].any()
    assert mesh.discontinuity[on.any(axis=1) & ~on.all(axis=1)].all()


def test_wide_gaps_are_not_bridged() -> None:
    directions = ring_rays(32, 1800)
    hole = np.abs(np.arctan2(directions[:, 1], directions[:, 0])) > np.radians(10)
    points = (directions[hole] * 10).astype(np.float32)
    angle = np.arctan2(points[:, 1], points[:, 0])
    spans = np.ptp(angle[ScanMesh(points).triangles], axis=1)
    assert np.minimum(spans, 2 * np.pi - spans).max() < np.radians(4.1)


def test_a_surface_goes_on_across_missing_returns_only_where_it_is_flat() -> None:
    """A hedge and a post behind it, with nothing between them that returned, are no surface."""
    directions = ring_rays(64, 1800, low=-12, high=9)
    azimuth = np.degrees(np.arctan2(directions[:, 1], directions[:, 0]))
    seen = (np.abs(azimuth) < 20) & ((azimuth < 0) | (azimuth > 3))
    directions, beyond = directions[seen], azimuth[seen] > 3

    def over_the_gap(ranges: NDArray) -> NDArray:
        mesh = ScanMesh((directions * ranges[:, None]).astype(np.float32))
        of_both = beyond[mesh.triangles].any(axis=1) & ~beyond[mesh.triangles].all(axis=1)
        assert of_both.sum() > 60
        return mesh.discontinuity[of_both]

    # The gap is 1.05 m wide at 20 m.
    assert not over_the_gap(np.where(beyond, 20.5, 20.0)).any()
    assert over_the_gap(np.where(beyond, 21.5, 20.0)).all()
    oblique = np.array([np.sin(np.radians(20)), np.cos(np.radians(20)), 0])  # 70 degrees off ahead
    assert not over_the_gap(8.0 / (directions @ oblique)).any()


def test_isolated_returns_are_in_no_continuous_triangle() -> None:
    random = np.random.default_rng(5)
    points = (scatter_rays() * random.uniform(3, 60, 5000)[:, None]).astype(np.float32)
    mesh = ScanMesh(points)
    used = np.unique(mesh.triangles[~mesh.discontinuity])
    np.testing.assert_array_equal(mesh.isolated, np.setdiff1d(np.arange(len(points)), used))


def test_returns_in_one_direction() -> None:
    points = np.repeat((ring_rays(8, 60) * 10).astype(np.float32), 3, axis=0)
    points[1::3] *= 2
    mesh = ScanMesh(points, parameters=ALL_GAPS)
    assert (mesh.triangles % 3 == 0).all(), "the first of equal directions takes part"
    assert len(mesh.isolated) == 2 * 480


@pytest.mark.parametrize("count", [0, 1, 2, 3])
def test_few_points(count: int) -> None:
    points = np.array([[5, 0, 0], [5, 0.1, 0], [5, 0, 0.1]], dtype=np.float32)[:count]
    mesh = ScanMesh(points)
    assert len(mesh.triangles) == (count == 3)
    assert len(mesh.isolated) == (0 if count == 3 else count)


def test_points_at_the_origin_and_straight_up_change_nothing() -> None:
    points = (ring_rays(8, 60) * 10).astype(np.float32)
    points[::7] = 0
    points[1] = (0, 0, 5)
    points[2] = (0, 0, -5)
    mesh = ScanMesh(points, parameters=ALL_GAPS)
    assert not np.isin(np.arange(0, len(points), 7), mesh.triangles).any()
    assert not np.isin(mesh.isolated, np.arange(0, len(points), 7)).any()


def test_bad_input_is_refused() -> None:
    for points in (np.zeros((4, 2), np.float32), np.zeros((4, 3), complex)):
        with pytest.raises(InputError):
            ScanMesh(points)


def test_real_sweep_is_covered() -> None:
    root = os.environ.get("DOCDEPTH_KITTI_RAW")
    if not root:
        pytest.skip("DOCDEPTH_KITTI_RAW is not set")
    drive = Path(root, "2011_09_26", "2011_09_26_drive_0005_sync", "velodyne_points", "data")
    points = np.fromfile(drive / "0000000050.bin", dtype=np.float32).reshape(-1, 4)[:, :3].copy()
    mesh = ScanMesh(points)
    assert len(mesh.triangles) > 1.9 * len(points)
    assert len(mesh.isolated) < 0.04 * len(points)
    assert mesh.discontinuity.mean() < 0.2


def test_millions_of_returns_from_a_few_directions():
    """Steps from a return to itself looked like steps along thousands of rings, which crossed."""
    rng = np.random.default_rng(3)
    elevation = np.radians(0.4 * rng.integers(0, 64, 20_000) - 20)
    azimuth = rng.uniform(-np.pi, np.pi, len(elevation))
    level = 10 * np.cos(elevation)
    rays = [level * np.cos(azimuth), level * np.sin(azimuth), 10 * np.sin(elevation)]
    points = np.stack(rays, axis=1).astype(np.float32)
    alone = {tuple(sorted(t)) for t in ScanMesh(points).triangles.tolist()}
    triangles = ScanMesh(np.repeat(points, 100, axis=0)).triangles // 100
    repeated = {tuple(sorted(t)) for t in triangles.tolist()}
    assert repeated <= alone
    assert len(repeated) > 0.99 * len(alone), "but for slivers of the border"
