"""What the camera sees between the last beam that met a thing and the one that passed over it."""

from __future__ import annotations

import numpy as np
import pytest
from render_reference import (
    AXES,
    TRIANGLES,
    compose_depth,
    drawing,
    pixel_rays,
    render_sweep,
    small_camera,
)

from docdepth.geometry.lidar_frame import SensorRig
from docdepth.geometry.trajectory import Trajectory

BOX, WALL, GAP = 8.0, 40.0, 8 * np.tan(np.radians(1.0))
CAMERA = np.array([0.35, -0.25, -0.15])
"""In the frame of the LiDAR, whose beam at elevation 0 is the last one on the box."""


def first_met(origin, directions, top, wall_top):
    """x of what rays meet: a box 2 m wide that ends at height `top`, or a wall; else infinite."""
    x = np.full(directions.shape[:-1], np.inf)
    for plane, half, highest in ((WALL, 30.0, wall_top), (BOX, 1.0, top)):
        at = origin + directions * (plane - origin[0])
        x[(np.abs(at[..., 1]) < half) & (at[..., 2] < highest)] = plane
    return x


def frame(origin, top, wall_top, behind=False):
    """A sweep of 32 beams 1 degree apart; before it, if asked, that of a LiDAR that looks back."""
    azimuth = np.radians(np.arange(-60, 60, 0.18))
    a, e = np.meshgrid(azimuth, np.radians(np.arange(-16.0, 16.0)))
    directions = np.stack([np.ones_like(a), np.tan(a), np.tan(e) / np.cos(a)], axis=-1)
    x = first_met(origin, directions, top, wall_top) - origin[0]
    points = (directions * np.where(np.isfinite(x), x, 0)[..., None])[np.isfinite(x)]
    index = np.zeros(len(points), np.uint8)
    if behind:
        back = (directions * -20)[::2, ::9].reshape(-1, 3)
        points, index = np.concatenate([back, points]), np.append(np.zeros(len(back)), index + 1)
    rig = SensorRig(index.astype(np.uint8), np.repeat(np.eye(4)[None], 1 + behind, 0))
    classid = np.full(len(points), 50, np.uint16)
    return render_sweep(points.astype(np.float32), classid, TRIANGLES, sensor_rig=rig)


def seen(origins, top, wall_elevation, behind=False):
    """Depth, exact depth, and the height at the box of each pixel's ray that can meet the box."""
    wall_top = WALL * np.tan(np.radians(wall_elevation))
    poses = np.repeat(np.eye(4)[None], len(origins), axis=0)
    poses[:, :3, 3] = origins
    trajectory = Trajectory(np.arange(len(origins)) * 100_000_000, poses)
    frames = [frame(np.array(origin), top, wall_top, behind) for origin in origins]
    camera, T_camera_lidar = small_camera(300, 200, 720.0), AXES.copy()
    T_camera_lidar[:3, 3] = -AXES[:3, :3] @ CAMERA
    depth = compose_depth(
        *drawing(frames, trajectory, 0, camera=camera, T_camera_lidar=T_camera_lidar)
    )
    directions = pixel_rays(camera)
    exact = first_met(CAMERA, directions, top, wall_top) - CAMERA[0]
    at_box = CAMERA + directions * (BOX - CAMERA[0])
    height = np.where(np.abs(at_box[..., 1]) < 0.9, at_box[..., 2], np.nan)
    return depth, exact, height


@pytest.mark.parametrize("wall_elevation", [1.4, 12.0], ids=["isolated returns", "a wall"])
@pytest.mark.parametrize("behind", [False, True], ids=["one LiDAR", "the second LiDAR"])
def test_nothing_far_is_drawn_over_the_top_of_a_thing(wall_elevation, behind):
    depth, exact, height = seen([(0, 0, 0)], 0.45 * GAP, wall_elevation, behind)
    on_box = np.isfinite(height) & (np.abs(exact - (BOX - CAMERA[0])) < 1e-9)
    assert (on_box & (height > 0)).sum() > 200
    assert not (depth[on_box] > BOX).any()
    assert np.isfinite(depth[on_box & (height < -0.02)]).all()
    if wall_elevation > 2:  # nearer to the beam that passed, the wall is what is seen
        assert (np.abs(depth[height > 0.55 * GAP] - (WALL - CAMERA[0])) < 0.1).all()


def test_what_rays_of_another_sweep_passed_over_is_drawn():
    """The other sweep is taken from 8 cm higher: a ray of it passes the box that much higher."""
    one, _, height = seen([(0, 0, 0)], 0.01, 12.0)
    two, exact, _ = seen([(0, 0, 0), (1.0, 0, 0.08)], 0.01, 12.0)
    passed = (height > 0.05) & (height < 0.065)
    assert passed.sum() > 50
    assert np.isnan(one[passed]).all()
    assert (np.abs(two[passed] - exact[passed]) < 0.1).all()
