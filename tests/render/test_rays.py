"""Visibility along measured rays: against plain numpy, and its effect at depth edges."""

from __future__ import annotations

import numpy as np
import pytest
from render_reference import compose_depth, drawing, pixel_rays, render_sweep

import docdepth._core as _core
from docdepth.config import RenderParameters
from docdepth.geometry.camera import Camera
from lidar_rays import TURN, directions, scan_rays
from motion import straight

F = np.float32


def dot(a, b):
    return (a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1]) + a[:, 2] * b[:, 2]


def reference(points, normals, places, ray_origins=None):
    """Visibility of each place by brute force: every return in the nine cells around it."""
    ray_origins = np.zeros_like(points) if ray_origins is None else ray_origins
    sights = points - ray_origins
    azimuth, elevation = directions(sights)
    unit = F(6.283185307179586) / F(TURN)
    flat = np.sqrt(sights[:, 0] * sights[:, 0] + sights[:, 1] * sights[:, 1])
    aside = ray_origins[:, 1] * sights[:, 0] - ray_origins[:, 0] * sights[:, 1]
    along = ray_origins[:, 0] * sights[:, 0] + ray_origins[:, 1] * sights[:, 1]
    lift = ray_origins[:, 2] * flat - along * sights[:, 2] / flat
    left = aside / flat / unit
    up = lift / np.sqrt(flat * flat + sights[:, 2] * sights[:, 2]) / unit
    low, high = elevation.min(), elevation.max()
    side = int(1.6 * np.sqrt(TURN * (high - low + 1) / len(points)))
    columns, rows = TURN // side, (high - low) // side + 1
    column = (azimuth + TURN // 2) * columns // TURN
    row = (elevation - low) // side
    to_azimuth, to_elevation = directions(places)
    to_column = (to_azimuth + TURN // 2) * columns // TURN
    to_row = (to_elevation - low) // side
    range_ = np.sqrt(dot(places, places))
    narrowed = np.sqrt(places[:, 0] ** 2 + places[:, 1] ** 2) / range_
    squared_range = dot(points, points)
    ends = np.sqrt(squared_range)
    offset = dot(normals, points)
    known = np.abs(offset) > F(0.02) * np.sqrt(dot(normals, normals)) * ends
    with np.errstate(all="ignore"):
        planes = np.where(
            known[:, None], normals / offset[:, None], points / squared_range[:, None]
        )
    balance = np.zeros(len(places), F)
    for i in range(len(places)):
        apart = (column - to_column[i] + 1) % columns  # 0, 1, 2 from left to right
        near = np.flatnonzero((apart < 3) & (np.abs(row - to_row[i]) <= 1))
        if not len(near) or not -1 <= to_row[i] <= rows:
            continue
        u = ((azimuth[near] - to_azimuth[i] + TURN // 2) % TURN - TURN // 2).astype(F) * narrowed[i]
        u = u + left[near] * (F(1) / range_[i])
        v = (elevation[near] - to_elevation[i]).astype(F) + up[near] * (F(1) / range_[i])
        squared = u * u + v * v
        # Of equal returns the first in memory counts: cell after cell.
        least = near[squared == squared.min()]
        k = min(least, key=lambda n: (column[n], row[n], n))
        miss = (np.sqrt(squared.min()) * (F(6.283185307179586) / F(TURN))) * range_[i] + F(0.02)
        margin = F(0.1) + F(0.03) * range_[i]
        before = dot(planes[k : k + 1], places[i : i + 1])[0]
        on_plane = range_[i] * np.abs(1 - before) < margin * before
        if np.abs(ends[k] - range_[i]) < margin or on_plane:
            balance[i] = 1 / (miss * miss)
        elif ends[k] > range_[i] + margin and before < 1:
            balance[i] = -1 / (miss * miss)
    return balance


@pytest.mark.parametrize("beside", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_rays_equal_plain_numpy(seed, beside):
    rng = np.random.default_rng(seed)
    points = rng.normal(scale=(12, 12, 1.5), size=(3000, 3)).astype(F)
    normals = rng.normal(size=(3000, 3)).astype(F)
    normals[::3] = 0
    places = rng.normal(scale=(10, 10, 1.5), size=(4000, 3)).astype(F)
    places[:1000] = points[:1000] * rng.uniform(0.8, 1.2, (1000, 1))
    ray_origins = rng.normal(scale=0.05, size=(3000, 3)).astype(F) if beside else None
    balance = _core.Rays(points, normals, ray_origins).query_visibility(places)
    expected = reference(points, normals, places, ray_origins)
    assert (expected > 0).sum() > 200
    assert (expected < 0).sum() > 200
    assert (expected == 0).sum() > 200
    np.testing.assert_array_equal(balance, expected)


def test_without_rays_visibility_is_unknown():
    none = np.empty((0, 3), F)
    assert (_core.Rays(none, none).query_visibility(np.ones((5, 3), F)) == 0).all()
    zero = np.zeros((2, 3), F)
    assert (_core.Rays(zero, zero).query_visibility(np.ones((5, 3), F)) == 0).all()
    with pytest.raises(ValueError, match="as many"):
        _core.Rays(zero, none)
    with pytest.raises(ValueError, match="as many"):
        _core.Rays(zero, zero, none)


def fence_and_wall(directions, x):
    """Ranges along rays from (x, 0, 0): bars 0.3 m wide and 0.9 m apart at 12 m, a wall at 20 m."""
    with np.errstate(divide="ignore"):
        fence, wall = (12 - x) / directions[..., 0], (20 - x) / directions[..., 0]
    side = fence * directions[..., 1]
    hit = (fence > 0) & ((side % 0.9) < 0.3) & (np.abs(side) < 4)
    return np.where(hit, fence, wall)


def test_bars_of_a_fence_are_where_most_sweeps_measured_them():
    # Returns are 0.8 degrees apart, 7 pixels; a bar is 15 to 20 pixels wide.
    elevations, azimuths = np.arange(-12, 12, 0.8), np.arange(-60, 60, 0.8)
    directions = scan_rays(np.radians(elevations), np.radians(azimuths)).reshape(-1, 3)
    trajectory = straight(12, 0.53)
    camera = Camera(np.array([[500.0, 0, 250], [0, 500, 50], [0, 0, 1]]), 501, 101)
    truth = fence_and_wall(pixel_rays(camera), 0.0)
    # wrong: share of the drawn pixels; missed: share of all pixels that are wrong or empty
    drawn, wrong, missed = {}, {}, {}
    cases = {"one sweep": {"ahead": 0.1}, "without rays": {"visibility_sweeps": 0}, "with rays": {}}
    for case, settings in cases.items():
        parameters = RenderParameters(step=0.5, behind=0.0, **settings)
        frames = []
        for pose in trajectory.poses:
            ranges = fence_and_wall(directions, pose[0, 3])
            points = (directions * ranges[:, None])[(ranges > 0) & (ranges < 80)].astype(F)
            frames.append(render_sweep(points, np.full(len(points), 50, np.uint16), parameters))
        depth = compose_depth(*drawing(frames, trajectory, 0, parameters, camera=camera), 1)
        known = np.isfinite(depth)
        drawn[case] = known.mean()
        wrong[case] = (np.abs(depth - truth) > 0.05 * truth)[known].mean()
        missed[case] = (~(np.abs(depth - truth) <= 0.05 * truth)).mean()
        threaded = compose_depth(*drawing(frames, trajectory, 0, parameters, camera=camera), 3)
        np.testing.assert_array_equal(threaded, depth)
    # One sweep leaves pixels between bar and wall empty; others fill them, with more errors.
    assert drawn["one sweep"] < 0.8
    assert wrong["one sweep"] < 0.01
    assert wrong["without rays"] > 0.03
    assert drawn["without rays"] > 0.95
    assert drawn["with rays"] > 0.95
    assert 0.05 < missed["one sweep"] < 0.3
    assert missed["with rays"] < 0.65 * missed["one sweep"]
    assert 0.05 < missed["without rays"] < 0.3
    assert missed["with rays"] < missed["without rays"]
    assert wrong["with rays"] < 0.8 * wrong["without rays"]
    # Rays also limit how far a bar extends beyond the returns of a single sweep.
    assert wrong["with rays"] < 0.6 * wrong["without rays"]
    assert missed["with rays"] < 0.7 * missed["without rays"]
