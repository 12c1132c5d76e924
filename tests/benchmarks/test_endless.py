"""A drive without end: each sweep by its number alone, on a street that is one everywhere."""

from dataclasses import replace

import numpy as np
import pytest
from scenes.endless import EndlessDrive
from scenes.endless_street import PIECE, TILE, EndlessStreet, endless_road

from docdepth.synthetic import sensor
from docdepth.synthetic.casting import Rays

pytestmark = pytest.mark.slow

FIRST_MOVING = 252


def lidar():
    """A VLP-16 with every twentieth column."""
    whole = sensor("VLP-16")
    pattern = whole.pattern(0)
    rows = np.flatnonzero(pattern.which % 20 == 0)
    few = replace(pattern, directions=pattern.directions[rows], which=pattern.which[rows],
                  rings=pattern.rings[rows])  # fmt: skip
    return replace(whole, pattern=lambda index: few)


def test_a_sweep_depends_on_its_number_alone():
    long, short = EndlessDrive(lidar(), 3000, 4), EndlessDrive(lidar(), 80, 4)
    for index in (70, 3, 69):
        one, other = (drive.sweep(index) for drive in (long, short))
        for name in ("points", "labels", "speed", "relative_time"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    moving = (one.labels & 0xFFFF) >= FIRST_MOVING
    assert moving.any()
    assert not one.speed[~moving].any()


def static_ranges(drive, piece, rays):
    """Ranges of what stands, as it is made while the ego is on a piece."""
    hits = drive._make_world(piece).cast(rays, drive.sensor.max_range)
    moves = (hits.labels & 0xFFFF) >= FIRST_MOVING
    return np.where(moves, np.nan, hits.range)


def test_pieces_join_without_a_seam():
    """What both worlds know is the same, and nothing within reach is missing in one of them."""
    drive = EndlessDrive(lidar(), 200, 1)
    piece = 2
    second = PIECE * (piece + 1) / 9.0
    pose = drive._scene_poses(np.array([second]))[0]
    directions = lidar().pattern(0).directions @ pose[:3, :3].T
    origins = np.broadcast_to(pose[:3, 3], directions.shape)
    rays = Rays(origins, directions, np.array([second]), np.zeros(len(directions), np.int64))
    one, other = (static_ranges(drive, piece + k, rays) for k in (0, 1))
    both = ~np.isnan(one) & ~np.isnan(other)
    assert both.mean() > 0.9
    np.testing.assert_allclose(one[both], other[both], atol=1e-3)


def test_the_street_comes_back():
    road = endless_road(2 * np.pi / 3)
    s, d = np.array([0.0, 250.0, 599.0]), np.array([1.0, -8.0, 30.0])
    np.testing.assert_allclose(road.point(s + 3 * TILE, d), road.point(s, d), atol=1e-6)
    step = np.diff(road.point(np.linspace(590, 610, 201), 0.0), axis=0)
    np.testing.assert_allclose(np.linalg.norm(step, axis=1), 0.1, atol=2e-3)
    drive = EndlessDrive(lidar(), 10, 1, tiles=3)
    first, again = drive.street.static(1), drive.street.static(31)
    np.testing.assert_array_equal(first.vertices, again.vertices)
    names = [[(p.instance, p.begin) for p in drive.street.passers(k)] for k in (1, 31)]
    assert not set(names[0]) & set(names[1])


def test_a_street_that_is_built_alike_stands_elsewhere():
    street = EndlessStreet(4, 2, 175.0)
    first, again = street.static(3), street.static(23)
    start, end = (street.road.upright(s, 0.0) for s in (3 * PIECE, 23 * PIECE))
    moved = first.moved(end @ np.linalg.inv(start))
    assert np.linalg.norm((end - start)[:3, 3]) > 30
    np.testing.assert_allclose(again.vertices, moved.vertices, atol=1e-3)
    np.testing.assert_array_equal(again.faces, first.faces)
