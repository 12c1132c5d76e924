"""Occupancy of a scene of boxes, one of which moves, against what is known of the scene."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from docdepth.geometry.camera import Camera
from docdepth.geometry.lidar_frame import LidarFrame
from docdepth.geometry.points import DYNAMIC, GROUND, STATIC
from docdepth.geometry.se3 import inverse
from docdepth.geometry.track import Tracks
from docdepth.render import occupancy
from docdepth.render.occupancy import CORNER, FREE, VOXEL, MountedCamera, Occupancy, OccupancyGrids
from exact_drive import nearest_box
from lidar_rays import scan_rays
from motion import moving_track, straight

SWEEPS, NOW, HEIGHT, EGO, SPEED, PERIOD = 11, 6, 1.8, 10.0, -9.0, 0.1
GROUND_BOX = (-200, -200, -9), (200, 200, 0)
WALL = (-30, 9.1, 0), (30, 10.9, 4.1)
MOVER = (4.0, 2.0, 2.5)
PATH = (6.0, 5.1)  # of the mover at the first sweep, beside the road: its middle [m]


def mover_at(second: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    middle = np.array([PATH[0] + SPEED * second, PATH[1], 0])
    half = np.multiply(MOVER, (0.5, 0.5, 0))
    return middle - half, middle + half + (0, 0, MOVER[2])


def measured(k: int) -> LidarFrame:
    """A sweep from (x, 0, HEIGHT); its rays are fired during a tenth of a second."""
    azimuths = np.linspace(np.pi, -np.pi, 720, endpoint=False)
    rays = scan_rays(np.radians(np.linspace(-30, 10, 60)), azimuths).reshape(-1, 3)
    seconds = np.tile(-azimuths / (2 * np.pi) * PERIOD, 60)
    origins = np.zeros_like(rays)
    origins[:, 0] = EGO * seconds
    world = origins + (EGO * PERIOD * k, 0, HEIGHT)
    still, which = nearest_box(
        world, rays, *(np.array(b) for b in zip(GROUND_BOX, WALL, strict=True))
    )
    # The mover stands still in its own frame, where the rays are displaced.
    late = seconds + PERIOD * k
    shifted = world - np.outer(SPEED * late, (1, 0, 0))
    low, high = mover_at(0)
    moving, _ = nearest_box(shifted, rays, low[None], high[None])
    distance = np.minimum(still, moving)
    seen = distance < 100
    points = (origins + rays * np.where(seen, distance, 0)[:, None])[seen].astype(np.float32)
    classid = np.where(moving < still, DYNAMIC, np.where(which == 0, GROUND, STATIC))[seen]
    instance = np.where(classid == DYNAMIC, 7, 0).astype(np.uint16)
    rows = np.arange(len(points), dtype=np.uint32)
    late = seconds[seen].astype(np.float32)
    return LidarFrame(
        points, rows, "", len(points), late, None, classid.astype(np.uint16), instance
    )


@pytest.fixture(scope="module")
def grids() -> OccupancyGrids:
    trajectory = straight(SWEEPS, EGO * PERIOD, HEIGHT)
    track = moving_track(trajectory, (*PATH, 0), (SPEED, 0, 0), MOVER, of=7)
    camera = Camera(np.array([[60.0, 0, 48], [0, 60, 20], [0, 0, 1]]), 96, 40)
    T_camera_lidar = np.eye(4)
    T_camera_lidar[:3, :3] = (0, -1, 0), (0, 0, -1), (1, 0, 0)
    sweeps = [measured(k) for k in range(SWEEPS)]
    cameras = [MountedCamera(camera, T_camera_lidar)]
    return OccupancyGrids(sweeps, trajectory, Tracks([track]), cameras)


@pytest.fixture(scope="module")
def found(grids: OccupancyGrids) -> Occupancy:
    return grids.at(NOW)


def centres(found: Occupancy) -> NDArray[np.float64]:
    """Of the voxels, in the world."""
    cells = np.stack(np.indices(found.semantics.shape), axis=-1)
    T = found.T_world_grid
    return (np.add(CORNER, VOXEL * (cells + 0.5))) @ T[:3, :3].T + T[:3, 3]


def holds(
    middles: NDArray[np.float64], low: object, high: object, margin: float
) -> NDArray[np.bool_]:
    """Which voxels lie in a box that is larger by a margin."""
    inside = (middles > np.subtract(low, margin)) & (middles < np.add(high, margin))
    return np.asarray(inside.all(axis=-1))


def test_the_grid_stands_on_the_ground(found: Occupancy) -> None:
    expected = np.eye(4)
    expected[0, 3] = EGO * PERIOD * NOW
    assert np.allclose(found.T_world_grid, expected, atol=0.01)


def test_surfaces_are_occupied_and_the_passage_of_what_moves_is_free(found: Occupancy) -> None:
    middles, occupied = centres(found), found.semantics != FREE
    half = VOXEL / 2 + 0.02
    solid = np.zeros(occupied.shape, bool)
    for low, high in (GROUND_BOX, WALL, mover_at(NOW * PERIOD)):
        near, deep = holds(middles, low, high, half), holds(middles, low, high, -half)
        solid |= near & ~deep
        assert not (found.mask_lidar & deep & (middles[..., 2] > 0)).any()  # no ray was inside
    assert not (occupied & ~solid).any()
    x, y, z = np.moveaxis(middles, -1, 0)
    way = (np.abs(x - EGO * PERIOD * NOW) < 15) & (np.abs(y - PATH[1]) < 2.5) & (z > 0.3) & (z < 2)
    free = way & ~holds(middles, *mover_at(NOW * PERIOD), half)
    assert found.mask_lidar[free].all()
    wall = (np.abs(x - EGO * PERIOD * NOW) < 15) & (np.abs(y - 9.1) < 0.15) & (z > 0) & (z < 3.5)
    assert (found.semantics[wall] == occupancy.STATIC).all()  # also where the mover hides it now
    beneath = (np.abs(x - EGO * PERIOD * NOW) < 10) & (np.abs(y) < 8) & (np.abs(z) < 0.1)
    below = beneath & ~holds(middles, *mover_at(NOW * PERIOD), half)
    assert (found.semantics[below & (np.hypot(x - EGO * PERIOD * NOW, y) > 4)] == 1).all()


def test_what_moves_is_where_it_is_now(found: Occupancy) -> None:
    middles, dynamic = centres(found), found.semantics == occupancy.DYNAMIC
    low, high = mover_at(NOW * PERIOD)
    side = holds(middles, low, high, 0.0) & (np.abs(middles[..., 1] - low[1]) < VOXEL / 2)
    side &= (middles[..., 2] > 0.3) & (middles[..., 2] < 2)
    assert side.sum() > 20
    assert dynamic[side].all()
    assert not dynamic[~holds(middles, low, high, VOXEL / 2 + 0.02)].any()
    assert np.array_equal(found.instance, np.where(dynamic, 7, 0))
    assert np.allclose(found.flow[dynamic], (SPEED, 0), atol=0.1)
    assert not found.flow[~dynamic].any()


def test_the_camera_sees_what_plain_lines_reach(grids: OccupancyGrids, found: Occupancy) -> None:
    cells, centre = np.argwhere(found.mask_lidar), np.array([0, 0, HEIGHT])
    way = np.add(CORNER, VOXEL * (cells + 0.5)) - centre
    with np.errstate(divide="ignore"):
        u, v = -60 * way[:, 1] / way[:, 0] + 48, -60 * way[:, 2] / way[:, 0] + 20
    inside = (way[:, 0] > 0) & (u > -0.5) & (u < 95.5) & (v > -0.5) & (v < 39.5)
    occupied, seen = found.semantics != FREE, np.zeros(found.semantics.shape, bool)
    for end in way[inside]:
        line = centre + np.linspace(0, 1, 700)[:, None] * end
        passed = ((line - CORNER) // VOXEL).astype(int)
        hits = np.flatnonzero(occupied[tuple(passed.T)])
        seen[tuple(passed[: hits[0] + 1 if len(hits) else None].T)] = True
    seen &= found.mask_lidar
    assert seen.sum() > 1000
    assert (seen & found.mask_camera).sum() > 0.98 * (seen | found.mask_camera).sum()
    assert not found.mask_camera[tuple(cells[way[:, 0] < -VOXEL].T)].any()
    # The road ahead, of which each voxel hides the middle of the next.
    x, y, z = np.moveaxis(np.add(CORNER, VOXEL * (np.argwhere(occupied) + 0.5)), -1, 0)
    road = np.argwhere(occupied)[(x > 6) & (x < 15) & (np.abs(y) < 2) & (np.abs(z) < VOXEL / 2)]
    assert len(road) > 50
    assert found.mask_camera[tuple(road.T)].mean() > 0.95


def test_rays_of_consecutive_sweeps_are_shared(grids: OccupancyGrids) -> None:
    T = inverse(grids.at(NOW).T_world_grid) @ grids.at(NOW + 1).T_world_grid
    assert np.allclose(T[:3, 3], (EGO * PERIOD, 0, 0), atol=1e-6)
    assert set(grids.around(NOW)) == set(grids.around(NOW + 1)) == set(range(SWEEPS))
