"""Sweeps drawn as triangles, against exact scenes and a plain rasteriser."""

from __future__ import annotations

import numpy as np
import pytest
from render_reference import (
    AXES,
    TRIANGLES,
    compose_depth,
    drawing,
    followed,
    pixel_rays,
    render_sweep,
    small_camera,
)

from docdepth.geometry.lidar_frame import LidarFrame
from docdepth.geometry.track import Tracks
from docdepth.render import render_sweep as render_sweep_module
from lidar_rays import scan_rays
from motion import moving_track, straight


def spinning(rings=48, columns=1500):
    azimuths = np.arange(columns) * 2 * np.pi / columns - np.pi + 1e-3
    return scan_rays(np.radians(np.linspace(-25, 8, rings)), azimuths).reshape(-1, 3)


def meet(directions, planes):
    """Range of the nearest of the planes (n, d), n.x = d, along each ray, and its index."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ranges = np.stack([d / (directions @ np.array(n)) for n, d in planes])
    ranges[~(ranges > 0)] = np.inf
    return ranges.min(axis=0), ranges.argmin(axis=0)


GROUND, WALL, SIDE = ((0.02, 0.01, 1.0), -1.7), ((1.0, 0.1, 0.0), 14.0), ((0.05, 1.0, 0.0), 5.0)


@pytest.mark.parametrize("planes", [[GROUND], [GROUND, WALL, SIDE]])
def test_triangles_of_a_plane_are_that_plane_without_cracks(planes):
    directions = spinning()
    ranges, _ = meet(directions, planes)
    hit = ranges < 60
    points = (directions * ranges[:, None])[hit].astype(np.float32)
    camera = small_camera()
    frame = render_sweep(points, np.full(len(points), 50, np.uint16), TRIANGLES)
    depth = compose_depth(*drawing(frame, camera=camera))
    rays = pixel_rays(camera)
    exact, plane = meet(rays.reshape(-1, 3), planes)
    exact, plane = np.minimum(exact, 1e6).reshape(depth.shape), plane.reshape(depth.shape)
    # Pixels well within the returns: away from other planes and in the sensor's field of view.
    elevation = np.degrees(np.arctan2(rays[..., 2], np.hypot(rays[..., 0], rays[..., 1])))
    seen = (elevation > -24) & (elevation < 7) & (exact * np.linalg.norm(rays, axis=-1) < 25)
    for shift in range(-6, 7):
        for axis in (0, 1):
            seen &= np.roll(plane, shift, axis) == plane
    assert seen.sum() > 2000
    assert np.isfinite(depth[seen]).all()
    # Triangles are drawn 0.01 pixels larger, with inverse depth clamped to that of their corners;
    # a pixel beyond an acute corner is a few times that far outside. float32 adds 1e-5.
    bend = sum(np.abs(np.gradient(1 / exact, axis=axis)) for axis in (0, 1)) * exact
    assert (np.abs(depth - exact) / exact <= 0.05 * bend + 1e-5)[seen].all()


def draw_triangles(camera, vertices, triangles, threads=1):
    """Render triangles given in camera axes, none of them a depth jump."""
    import docdepth._core as _core

    frame = _core.MeshFrame(
        vertices.astype(np.float32),
        np.full(len(vertices), 50, np.uint16),
        triangles.astype(np.uint32),
        np.zeros(len(triangles), np.uint8),
        np.empty(0, np.uint32),
        0.01,
        np.zeros(len(vertices), np.uint16),
        np.zeros((0, 4), np.float32),
    )
    return _core.render_meshes(
        camera.K, camera.width, camera.height, [(frame, np.eye(4))], [], 12, threads
    )


@pytest.mark.parametrize("seed", range(2))
def test_triangles_equal_a_plain_rasteriser(seed):
    rng = np.random.default_rng(seed)
    camera = small_camera()
    vertices = rng.uniform([-12, -5, 2], [12, 5, 20], (60, 3)).astype(np.float32)
    vertices[:3, 2] = -1, 0.05, 3  # behind the camera; nearer than the near plane
    triangles = np.arange(60).reshape(-1, 3)
    depth = draw_triangles(camera, vertices, triangles)
    p = vertices.astype(np.float64)
    u = camera.K[0, 0] * p[:, 0] / p[:, 2] + camera.K[0, 2]
    v = camera.K[1, 1] * p[:, 1] / p[:, 2] + camera.K[1, 2]
    columns, rows = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    expected, border = np.full(depth.shape, np.inf), np.zeros(depth.shape, bool)
    for t in triangles[1:]:
        inside, near = np.ones(depth.shape, bool), np.zeros(depth.shape, bool)
        turn = (u[t[1]] - u[t[0]]) * (v[t[2]] - v[t[0]]) - (u[t[2]] - u[t[0]]) * (v[t[1]] - v[t[0]])
        order = t if turn > 0 else t[::-1]
        for a, b in zip(order, np.roll(order, -1), strict=True):
            du, dv = u[b] - u[a], v[b] - v[a]
            distance = (du * (rows - v[a]) - dv * (columns - u[a])) / np.hypot(du, dv)
            inside &= distance > 0
            near |= np.abs(distance) < 0.03
        normal = np.cross(p[t[1]] - p[t[0]], p[t[2]] - p[t[0]])
        rays = np.stack(
            [(columns - camera.K[0, 2]) / camera.K[0, 0], (rows - camera.K[1, 2]) / camera.K[1, 1]]
        )
        z = (normal @ p[t[0]]) / (normal[0] * rays[0] + normal[1] * rays[1] + normal[2])
        expected = np.where(inside & (z > 0), np.minimum(expected, z), expected)
        border |= near
    expected[np.isinf(expected)] = np.nan
    sure = ~border
    assert np.isfinite(expected[sure]).sum() > 500
    np.testing.assert_allclose(depth[sure], expected[sure], rtol=1e-3)
    np.testing.assert_array_equal(draw_triangles(camera, vertices, triangles, threads=3), depth)


@pytest.mark.parametrize(("is_followed", "time_offset"), [(0, None), (1, None), (1, 0.012)])
def test_a_moving_box_is_drawn_where_it_was_at_the_time_of_the_image(is_followed, time_offset):
    directions = spinning(columns=3000)
    camera, trajectory = small_camera(), straight(4)
    track = moving_track(trajectory, (8.8, 0, -1.5), (20, 0, 0), (1.6, 4, 2))

    def frame(index):  # a wall at 20 m, a box at 8 m; per sweep the ego moves 1 m, the box 2 m
        wall = (20.0 - index) / directions[:, 0]
        box = (8.0 + index + 20 * (time_offset or 0)) / directions[:, 0]
        side = box[:, None] * directions
        on_box = (wall > 0) & (np.abs(side[:, 1]) < 2) & (np.abs(side[:, 2] + 0.5) < 1)
        ranges = np.where(on_box, box, wall)
        seen = (ranges > 0) & (ranges < 60)
        points = (directions * ranges[:, None])[seen].astype(np.float32)
        classid = np.where(on_box[seen], 100, 50).astype(np.uint16)
        times = None if time_offset is None else np.full(len(points), time_offset, np.float32)
        if not is_followed:
            return render_sweep(points, classid, TRIANGLES, time_offset=times)
        return followed(points, classid, index, trajectory, track, TRIANGLES, times)

    frames = [frame(i) for i in range(4)]
    tracks = Tracks([track] if is_followed else [])
    depth = compose_depth(*drawing(frames, trajectory, 160_000_000, camera=camera), tracks=tracks)
    # Sweep 2 saw the box at 12 m; 40 ms before, it was at 11.2 m and the camera at 1.6 m.
    distance = 11.2 - 1.6 if is_followed else 12 - 1.6
    row, middle = 32, 79
    assert depth[row, middle] == pytest.approx(distance, abs=0.02)
    box = np.abs(depth[row] - distance) < 0.1
    assert abs(box.sum() - 4 / distance * 90) < 2.0  # 4 m wide; returns are 0.2 pixels apart
    assert np.nanmax(np.abs(depth[row, 20:140][~box[20:140]] - 18.4)) < 0.1


def test_other_sweeps_fill_the_part_of_a_moving_box_behind_a_post():
    """The box moves 1 m per sweep to the left; the camera is 0.6 m beside the LiDAR."""
    directions = spinning(columns=3000)
    T_camera_lidar = AXES.copy()
    T_camera_lidar[0, 3] = 0.6
    speed, post, box_at, wall = 10.0, 4.0, 10.0, 20.0
    standing = straight(7, spacing=0.0)
    track = moving_track(standing, (box_at + 1, -3.0, -1), (0, speed, 0), (2, 4, 2))

    def seen(index):
        ahead = directions[:, 0] > 0.1
        y, z = (directions[:, i] / np.where(ahead, directions[:, 0], 1) for i in (1, 2))
        on_box = (np.abs(y * box_at - speed * 0.1 * (index - 3)) < 2) & (np.abs(z * box_at) < 1)
        on_post = np.abs(y * post) < 0.08
        x = np.where(on_post, post, np.where(on_box, box_at, wall))
        points = (x[:, None] * np.stack([np.ones_like(y), y, z], axis=1))[ahead].astype(np.float32)
        return points, np.where(on_box & ~on_post, 100, 50)[ahead].astype(np.uint16)

    frames = [followed(*seen(i), i, standing, track, TRIANGLES) for i in range(7)]
    camera = small_camera(640, 240, 360.0)
    asked = drawing(frames, standing, 310_000_000, camera=camera, T_camera_lidar=T_camera_lidar)
    depth = compose_depth(*asked, tracks=Tracks([track]))
    _, side, up = np.moveaxis(pixel_rays(camera), -1, 0)
    y = 0.6 + side * box_at  # of the box's plane
    inside = (np.abs(y - speed * 0.01) < 1.8) & (np.abs(up * box_at) < 0.7)
    inside &= np.abs(0.6 + side * post) > 0.15
    hidden = inside & (
        np.abs(y - speed * 0.01) < 0.15
    )  # hidden by the post in the sweep nearest in time
    assert hidden.sum() > 50
    assert (np.abs(depth[hidden] - box_at) < 0.05).mean() > 0.95
    assert (np.abs(depth[inside] - box_at) < 0.05).mean() > 0.95
    frames[:] = [render_sweep(*seen(i), TRIANGLES) for i in range(7)]
    alone = compose_depth(*asked)
    assert not (np.abs(alone[hidden] - box_at) < 0.05).mean() > 0.9


def test_a_moving_box_ends_close_to_its_last_ring():
    """Rings are 0.42 m apart there; the box ends 4 cm above its last ring and moves sideways."""
    directions = spinning(rings=12, columns=3000)
    directions = directions[directions[:, 0] > 0.1]
    y, z = directions[:, 1] / directions[:, 0], directions[:, 2] / directions[:, 0]
    last = -8 * np.tan(np.radians(1.0))
    standing = straight(7, spacing=0.0)
    track = moving_track(standing, (9, -1.5, -1.1), (0, 5, 0), (2, 4, 1))

    def frame(index):
        on_box = (np.abs(y * 8 - 0.5 * (index - 3)) < 2) & (z * 8 < last + 0.04) & (z * 8 > -1.1)
        points = directions / directions[:, :1] * np.where(on_box, 8.0, 20.0)[:, None]
        classid = np.where(on_box, 100, 50).astype(np.uint16)
        return followed(points.astype(np.float32), classid, index, standing, track, TRIANGLES)

    frames, camera = [frame(i) for i in range(7)], small_camera(640, 240, 360.0)
    asked = drawing(frames, standing, 310_000_000, camera=camera)
    depth = compose_depth(*asked, tracks=Tracks([track]))
    _, side, up = np.moveaxis(8 * pixel_rays(camera), -1, 0)
    within = np.abs(side - 0.05) < 1.8
    on_box = np.abs(depth - 8) < 0.05
    assert on_box[within & (np.abs(up - last) < 0.04)].mean() > 0.99
    assert on_box[within & (up < last - 0.02) & (up > -0.9)].mean() > 0.99  # between rings as well
    # Between two rings the nearer one decides.
    assert not on_box[within & (up > last + 0.42 / 2 + 0.02)].any()


def test_an_isolated_return_is_a_small_diamond(monkeypatch):
    camera = small_camera()
    monkeypatch.setattr(render_sweep_module, "ISOLATED_SIZE_DEG", 3.0)
    frame = render_sweep(np.array([[10, 0, 0]], np.float32), np.array([50], np.uint16), TRIANGLES)
    depth = compose_depth(*drawing(frame, camera=camera))
    _, side, up = np.moveaxis(pixel_rays(camera), -1, 0)
    inside = np.abs(side) + np.abs(up) <= np.radians(3.0)
    assert inside.sum() > 40
    np.testing.assert_array_equal(np.isfinite(depth), inside)
    np.testing.assert_allclose(depth[inside], 10, rtol=1e-5)


@pytest.mark.parametrize(
    ("occupied", "free", "drawn"), [(0, 1, False), (2, 5, False), (2, 4, True)]
)
@pytest.mark.parametrize("classid", [50, 100])
def test_an_isolated_return_is_not_drawn_where_others_found_free_air(
    classid: int, occupied: int, free: int, drawn: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(render_sweep_module, "ISOLATED_SIZE_DEG", 3.0)
    frame = LidarFrame(
        points=np.array([[4, 0, 0]], np.float32),
        index=np.zeros(1, np.uint32),
        name="000000",
        input_points=1,
        classid=np.array([classid], np.uint16),
        votes_static=np.array([occupied], np.uint16),
        votes_dynamic=np.array([free], np.uint16),
    )
    sweep = render_sweep_module.RenderSweep(frame, TRIANGLES)
    depth = compose_depth(*drawing(sweep, camera=small_camera()))
    assert np.isfinite(depth).any() == (drawn or classid == 100)
