"""Composite rendering against a plain numpy rasteriser, exact scenes and a real drive."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from docdepth.config import RenderParameters
from docdepth.errors import CalibrationError, InputError
from docdepth.render import (
    Camera,
    Frame,
    dynamic_frame,
    needed_frames,
    render,
    static_frames,
)
from docdepth.trajectory import Trajectory

# Camera axes in the LiDAR frame: x right = -y, y down = -z, z forward = x.
AXES = np.array([[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]], dtype=np.float64)
PAPER = RenderParameters(surface="splats", behind=0.5, ahead=100.0, step=0.2)
TRIANGLES = RenderParameters()


def small_camera(width=160, height=60, focal=90.0):
    K = np.array([[focal, 0, width / 2 - 0.7], [0, focal * 1.1, height / 2 + 1.3], [0, 0, 1]])
    return Camera(K, width, height)


def straight(n, spacing=1.0, dt=100_000_000):
    poses = np.repeat(np.eye(4)[None], n, axis=0)
    poses[:, 0, 3] = np.arange(n) * spacing
    return Trajectory(np.arange(n) * dt, poses)


def reference(camera, clouds):
    """Every splat pixel by pixel. clouds: (points, 4x4 pose, (size_max, size_min))."""
    f = np.float32
    fx, fy, cx, cy = (f(v) for v in camera.K[[0, 1, 0, 1], [0, 1, 2, 2]])
    depth = np.full((camera.height, camera.width), np.inf, f)
    for points, pose, (size_max, size_min) in clouds:
        T = pose.astype(f)
        p, q, r = points.T
        with np.errstate(all="ignore"):
            x, y, z = (((T[i, 0] * p + T[i, 1] * q) + T[i, 2] * r) + T[i, 3] for i in range(3))
            u = np.floor((fx * x) / z + cx + f(0.5))
            v = np.floor((fy * y) / z + cy + f(0.5))
            squared = ((x * x + y * y) + z * z).astype(np.float64)
            sigma = np.where(
                squared < 1.65**2, size_max, np.maximum(size_max / np.log(squared), size_min)
            )
            inside = (z > f(0.1)) & (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
        size = np.floor(sigma[inside] + 0.5).astype(int)
        u, v, z = u[inside].astype(int), v[inside].astype(int), z[inside]
        for h in np.unique(size):
            reach = np.arange(-h, h + 1)
            du, dv = np.meshgrid(reach, reach)
            covered = 9 * du**2 + 4 * dv**2 <= h * h
            for a, b in zip(du[covered], dv[covered], strict=True):
                column, row = u[size == h] + a, v[size == h] + b
                ok = (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
                np.minimum.at(depth, (row[ok], column[ok]), z[size == h][ok])
    depth[np.isinf(depth)] = np.nan
    return depth


def scattered(rng, n):
    """Points all around a sensor, most of them near, some unusable."""
    direction = rng.normal(size=(n, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    points = (direction * rng.gamma(1.5, 12.0, size=(n, 1))).astype(np.float32)
    points[:3] = [[0, 0, 0], [np.nan, 1, 2], [np.inf, 0, 0]]
    points[3] = [0.5, 0.1, 0.1]
    return points


def drive(rng, camera_time, parameters, n=6):
    """Sweeps along a curve; returns what render() needs and what reference() needs."""
    trajectory = straight(n)
    angle = 0.05 * np.arange(n)
    poses = trajectory.poses.copy()
    poses[:, 0, 0] = poses[:, 1, 1] = np.cos(angle)
    poses[:, 1, 0], poses[:, 0, 1] = np.sin(angle), -np.sin(angle)
    trajectory = Trajectory(trajectory.times, poses)
    sweeps = [scattered(rng, 4000) for _ in range(n)]
    classes = [rng.choice([0, 50, 99, 100, 251], size=4000).astype(np.uint16) for _ in range(n)]
    frames = [Frame(s, c, parameters) for s, c in zip(sweeps, classes, strict=True)]

    T_camera_world = AXES @ np.linalg.inv(trajectory.interpolate(camera_time)[0])
    clouds = []
    for dynamic in (False, True):
        indices = static_frames(trajectory, camera_time, parameters)
        for i in [dynamic_frame(trajectory, camera_time)] if dynamic else indices:
            with np.errstate(invalid="ignore", over="ignore"):
                distance = np.linalg.norm(sweeps[i].astype(np.float64), axis=1)
            keep = (distance < parameters.crop) & ((classes[i] >= 100) == dynamic)
            pose = T_camera_world @ trajectory.poses[i]
            size = (
                (parameters.dynamic_size_max, parameters.dynamic_size_min)
                if dynamic
                else (parameters.static_size_max, parameters.static_size_min)
            )
            clouds.append((sweeps[i][keep], pose, size))
    return trajectory, frames, clouds


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("sizes", [(50.0, 3.0, 80.0, 35.0), (9.3, 1.0, 14.0, 2.6), (1, 1, 1, 1)])
def test_equals_plain_numpy_pixel_for_pixel(seed, sizes):
    names = ("static_size_max", "static_size_min", "dynamic_size_max", "dynamic_size_min")
    parameters = RenderParameters(
        surface="splats", behind=0.5, ahead=100.0, step=0.2, **dict(zip(names, sizes, strict=True))
    )
    camera = small_camera()
    time = 130_000_000
    trajectory, frames, clouds = drive(np.random.default_rng(seed), time, parameters)
    expected = reference(camera, clouds)
    one, two = (
        render(camera, AXES, trajectory, time, frames.__getitem__, parameters, threads=t)
        for t in (1, 2)
    )
    np.testing.assert_array_equal(one, expected)
    np.testing.assert_array_equal(two, expected)
    assert one.dtype == np.float32
    assert np.isfinite(one).mean() > 0


def frame_of(points, classid=50):
    points = np.asarray(points, dtype=np.float32).reshape(-1, 3)
    return Frame(points, np.full(len(points), classid, np.uint16), PAPER)


def test_a_single_splat_is_an_upright_ellipse_of_constant_depth():
    camera = Camera(np.array([[100.0, 0, 40], [0, 100, 30], [0, 0, 1]]), 81, 61)
    depth = render(camera, AXES, straight(1), 0, lambda _: frame_of([10, 0, 0]), PAPER)
    h = round(50 / np.log(100))  # 11 pixels high
    rows, columns = np.nonzero(np.isfinite(depth))
    assert (rows.min(), rows.max()) == (30 - h // 2, 30 + h // 2)
    assert (columns.min(), columns.max()) == (40 - h // 3, 40 + h // 3)
    assert np.unique(depth[np.isfinite(depth)]) == [10.0]
    assert np.isfinite(depth).sum() == sum(
        9 * a * a + 4 * b * b <= h * h for a in range(-h, h + 1) for b in range(-h, h + 1)
    )


def test_near_moving_wall_hides_far_static_wall():
    camera = small_camera()
    side, up = np.meshgrid(np.arange(-30, 30, 0.1), np.arange(-12, 12, 0.1))

    def wall(distance):
        return np.column_stack([np.full(side.size, distance), side.ravel(), up.ravel()])

    near = wall(8.0)[np.abs(side.ravel()) < 2]
    points = np.concatenate([wall(20.0), near]).astype(np.float32)
    classid = np.repeat(np.array([50, 100], np.uint16), [side.size, len(near)])
    frame = Frame(points, classid, PAPER)
    depth = render(camera, AXES, straight(1), 0, lambda _: frame, PAPER)
    assert set(np.unique(depth)) == {8.0, 20.0}
    assert (depth[:, 60:100] == 8.0).all()
    assert (depth[:, :30] == 20.0).all()
    assert (depth[:, -30:] == 20.0).all()


def test_points_behind_too_near_or_centred_outside_are_not_drawn():
    camera = small_camera()
    for point in ([-5, 0, 0], [0.1, 0, 0], [5, 5, 0], [5, -5, 0], [5, 0, 3], [5, 0, -3]):
        depth = render(camera, AXES, straight(1), 0, lambda _, p=point: frame_of(p), PAPER)
        assert np.isnan(depth).all(), point


def test_moving_points_come_from_the_sweep_nearest_in_time_only():
    trajectory = straight(4)
    asked = []

    def frames(i):
        asked.append(i)
        return frame_of([20 + i, 0, 0], classid=100)

    depth = render(small_camera(), AXES, trajectory, 160_000_000, frames, PAPER)
    # Sweep 2 stands at 2 m and sees its point at 22 m; the camera stands at 1.6 m.
    np.testing.assert_allclose(np.unique(depth[np.isfinite(depth)]), [22.4], rtol=1e-6)
    assert set(asked) == {2, 3}  # static points: those after 1.6 - 0.5


def test_static_frames_follow_the_path_window_and_step():
    trajectory = straight(200, spacing=0.5)
    taken = static_frames(trajectory, 5_000_000_000, PAPER)  # at 25 m
    assert taken[0] == 50  # -0.5 m is excluded
    assert taken[-1] == 199
    taken = static_frames(trajectory, 5_000_000_000, PAPER.model_copy(update={"ahead": 10.0}))
    assert (trajectory.arc_length[taken] < 35).all()
    coarse = static_frames(trajectory, 5_000_000_000, PAPER.model_copy(update={"step": 2.0}))
    assert (np.diff(trajectory.arc_length[coarse]) >= 2.0).all()


def test_a_standing_ego_is_drawn_from_the_sweep_nearest_in_time():
    poses = np.repeat(np.eye(4)[None], 30, axis=0)
    poses[:, 0, 3] = 1e-3 * np.sin(np.arange(30))
    trajectory = Trajectory(np.arange(30) * 100_000_000, poses)
    assert static_frames(trajectory, 1_730_000_000, PAPER).tolist() == [17]
    assert dynamic_frame(trajectory, 1_730_000_000) == 17


@pytest.mark.parametrize("parameters", [PAPER, TRIANGLES])
def test_no_points_give_no_depth(parameters):
    empty = Frame(np.empty((0, 3), np.float32), np.empty(0, np.uint16), parameters)
    assert np.isnan(render(small_camera(), AXES, straight(2), 0, lambda _: empty, parameters)).all()


def test_bad_input_is_refused():
    with pytest.raises(InputError, match="float32"):
        Frame(np.zeros((3, 3)), np.zeros(3, np.uint16))
    with pytest.raises(InputError, match="one for each point"):
        Frame(np.zeros((3, 3), np.float32), np.zeros(2, np.uint16))
    with pytest.raises(InputError, match="outside the trajectory"):
        render(small_camera(), AXES, straight(2), -1, lambda _: frame_of([5, 0, 0]), PAPER)
    with pytest.raises(InputError, match="not made for triangles"):
        render(small_camera(), AXES, straight(2), 0, lambda _: frame_of([5, 0, 0]), TRIANGLES)
    with pytest.raises(InputError, match="late"):
        Frame(np.zeros((3, 3), np.float32), np.zeros(3, np.uint16), late=np.zeros(2, np.float32))
    with pytest.raises(CalibrationError, match="skew"):
        Camera(np.array([[9.0, 1, 5], [0, 9, 5], [0, 0, 1]]), 10, 10)


def spinning(rings=48, columns=1500, low=-25.0, high=8.0):
    azimuth = np.arange(columns) * 2 * np.pi / columns - np.pi + 1e-3
    a, e = np.meshgrid(azimuth, np.radians(np.linspace(low, high, rings)))
    return np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], -1).reshape(-1, 3)


def meet(directions, planes):
    """Range of the first of the planes (n, d), n.x = d, that each ray meets, and which."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ranges = np.stack([d / (directions @ np.array(n)) for n, d in planes])
    ranges[~(ranges > 0)] = np.inf
    return ranges.min(axis=0), ranges.argmin(axis=0)


def pixel_rays(camera):
    """Directions in the LiDAR frame with unit depth, for AXES."""
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    x = (u - camera.K[0, 2]) / camera.K[0, 0]
    y = (v - camera.K[1, 2]) / camera.K[1, 1]
    return np.stack([np.ones_like(x), -x, -y], axis=-1)


GROUND, WALL, SIDE = ((0.02, 0.01, 1.0), -1.7), ((1.0, 0.1, 0.0), 14.0), ((0.05, 1.0, 0.0), 5.0)


@pytest.mark.parametrize("planes", [[GROUND], [WALL], [SIDE], [GROUND, WALL, SIDE]])
def test_triangles_of_a_plane_are_that_plane_without_cracks(planes):
    directions = spinning()
    ranges, _ = meet(directions, planes)
    hit = ranges < 60
    points = (directions * ranges[:, None])[hit].astype(np.float32)
    camera = small_camera()
    frame = Frame(points, np.full(len(points), 50, np.uint16), TRIANGLES)
    depth = render(camera, AXES, straight(1), 0, lambda _: frame, TRIANGLES)
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
    # Triangles are drawn 0.01 pixels larger, and nearness is clamped to that of their corners; a
    # pixel beyond an acute corner is a few times that far outside. float32 adds 1e-5.
    bend = sum(np.abs(np.gradient(1 / exact, axis=axis)) for axis in (0, 1)) * exact
    assert (np.abs(depth - exact) / exact <= 0.05 * bend + 1e-5)[seen].all()


def draw_triangles(camera, vertices, triangles, threads=1):
    """Triangles in camera axes as one whole surface."""
    from docdepth import _core

    frame = _core.SurfaceFrame(
        vertices.astype(np.float32),
        np.full(len(vertices), 50, np.uint16),
        triangles.astype(np.uint32),
        np.zeros(len(triangles), np.uint8),
        np.empty(0, np.uint32),
        0.01,
    )
    placed = (frame, np.eye(4))
    size = camera.width, camera.height
    return _core.render_surfaces(camera.K, *size, [placed], [(*placed, 0.0)], 0.0, 12, threads)


@pytest.mark.parametrize("seed", range(3))
def test_triangles_equal_a_plain_rasteriser(seed):
    rng = np.random.default_rng(seed)
    camera = small_camera()
    vertices = rng.uniform([-12, -5, 2], [12, 5, 20], (60, 3)).astype(np.float32)
    vertices[:3, 2] = -1, 0.05, 3  # behind the camera, too near
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


def test_triangles_do_not_depend_on_threads():
    trajectory, frames, _ = drive(np.random.default_rng(10), 130_000_000, TRIANGLES)
    one, two = (
        render(small_camera(250), AXES, trajectory, 130_000_000, frames.__getitem__, TRIANGLES, t)
        for t in (1, 2)
    )
    np.testing.assert_array_equal(one, two)
    assert np.isfinite(one).mean() > 0.1


@pytest.mark.parametrize(("max_speed", "late"), [(0.0, None), (50.0, None), (50.0, 0.012)])
def test_a_moving_box_is_carried_to_where_it_was_when_the_image_was_taken(max_speed, late):
    directions = spinning(columns=3000)
    camera = small_camera()
    parameters = TRIANGLES.model_copy(update={"max_speed": max_speed})

    def frame(index):  # sweeps a metre apart, a wall at 20 m, the box at 8 m goes 2 m a sweep
        wall = (20.0 - index) / directions[:, 0]
        box = (8.0 + index + 20 * (late or 0)) / directions[:, 0]
        side = box[:, None] * directions
        on_box = (wall > 0) & (np.abs(side[:, 1]) < 2) & (np.abs(side[:, 2] + 0.5) < 1)
        ranges = np.where(on_box, box, wall)
        seen = (ranges > 0) & (ranges < 60)
        points = (directions * ranges[:, None])[seen].astype(np.float32)
        classid = np.where(on_box[seen], 100, 50).astype(np.uint16)
        times = None if late is None else np.full(len(points), late, np.float32)
        return Frame(points, classid, parameters, late=times)

    frames = [frame(i) for i in range(4)]
    depth = render(camera, AXES, straight(4), 160_000_000, frames.__getitem__, parameters)
    # Sweep 2 saw the box at 12 m; 40 ms before, it was at 11.2 m and the camera at 1.6 m.
    distance = 12 - 1.6 if max_speed == 0 else 11.2 - 1.6
    row, middle = 32, 79
    assert depth[row, middle] == pytest.approx(distance, abs=0.02)
    box = np.abs(depth[row] - distance) < 0.1
    assert abs(box.sum() - 4 / distance * 90) < 2.0  # 4 m wide; returns are 0.2 pixels apart
    assert np.nanmax(np.abs(depth[row, 20:140][~box[20:140]] - 18.4)) < 0.1


def test_what_a_post_hides_of_a_moving_box_other_sweeps_have_seen():
    """The box goes a metre a sweep to the left; the camera looks past the post, 0.6 m beside it."""
    directions = spinning(columns=3000)
    T_camera_lidar = AXES.copy()
    T_camera_lidar[0, 3] = 0.6
    speed, post, box_at, wall = 10.0, 4.0, 10.0, 20.0

    def frame(index):
        ahead = directions[:, 0] > 0.1
        y, z = (directions[:, i] / np.where(ahead, directions[:, 0], 1) for i in (1, 2))
        on_box = (np.abs(y * box_at - speed * 0.1 * (index - 3)) < 2) & (np.abs(z * box_at) < 1)
        on_post = np.abs(y * post) < 0.08
        x = np.where(on_post, post, np.where(on_box, box_at, wall))
        points = (x[:, None] * np.stack([np.ones_like(y), y, z], axis=1))[ahead].astype(np.float32)
        return Frame(
            points, np.where(on_box & ~on_post, 100, 50)[ahead].astype(np.uint16), TRIANGLES
        )

    frames, camera = [frame(i) for i in range(7)], small_camera(640, 240, 360.0)
    time = 310_000_000
    still = straight(7, spacing=0.0)
    depth = render(camera, T_camera_lidar, still, time, frames.__getitem__, TRIANGLES)
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    side, up = ((u - camera.K[0, 2]) / camera.K[0, 0]), ((v - camera.K[1, 2]) / camera.K[1, 1])
    y = 0.6 - side * box_at  # of the box's plane
    inside = (np.abs(y - speed * 0.01) < 1.8) & (np.abs(up * box_at) < 0.7)
    inside &= np.abs(0.6 - side * post) > 0.15
    hidden = inside & (
        np.abs(y - speed * 0.01) < 0.15
    )  # by the post, for the sweep nearest in time
    assert hidden.sum() > 50
    assert (np.abs(depth[hidden] - box_at) < 0.05).mean() > 0.95
    assert (np.abs(depth[inside] - box_at) < 0.05).mean() > 0.95
    one = TRIANGLES.model_copy(update={"max_speed": 0.0})
    alone = render(camera, T_camera_lidar, still, time, frames.__getitem__, one)
    assert not (np.abs(alone[hidden] - box_at) < 0.05).mean() > 0.9


def test_a_moving_box_ends_close_to_the_last_ring_that_met_it():
    """Rings are 0.42 m apart there; the box, 4 cm higher than the last that met it, goes aside."""
    directions = spinning(rings=12, columns=3000)
    directions = directions[directions[:, 0] > 0.1]
    y, z = directions[:, 1] / directions[:, 0], directions[:, 2] / directions[:, 0]
    last = -8 * np.tan(np.radians(1.0))

    def frame(index):
        on_box = (np.abs(y * 8 - 0.5 * (index - 3)) < 2) & (z * 8 < last + 0.04) & (z * 8 > -1.1)
        points = directions / directions[:, :1] * np.where(on_box, 8.0, 20.0)[:, None]
        classid = np.where(on_box, 100, 50).astype(np.uint16)
        return Frame(points.astype(np.float32), classid, TRIANGLES)

    frames, camera = [frame(i) for i in range(7)], small_camera(640, 240, 360.0)
    still = straight(7, spacing=0.0)
    depth = render(camera, AXES, still, 310_000_000, frames.__getitem__, TRIANGLES)
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    side = -8 * (u - camera.K[0, 2]) / camera.K[0, 0]
    up = -8 * (v - camera.K[1, 2]) / camera.K[1, 1]
    within = np.abs(side - 0.05) < 1.8
    on_box = np.abs(depth - 8) < 0.05
    assert on_box[within & (np.abs(up - last) < 0.04)].mean() > 0.99
    assert on_box[within & (up < last - 0.02) & (up > -0.9)].mean() > 0.99  # rings or not
    assert not on_box[within & (up > last + 0.16)].any()


@pytest.mark.parametrize("parameters", [PAPER, TRIANGLES])
@pytest.mark.parametrize("time", [0, 130_000_000, 200_000_000, 260_000_000, 500_000_000])
def test_needed_frames_are_those_that_are_asked_for(parameters, time):
    trajectory, frames, _ = drive(np.random.default_rng(7), 130_000_000, parameters)
    asked = set()

    def frame(index):
        asked.add(index)
        return frames[index]

    render(small_camera(), AXES, trajectory, time, frame, parameters)
    assert asked == needed_frames(trajectory, time, parameters)


def test_a_return_alone_is_a_small_diamond():
    camera = small_camera()
    wide = TRIANGLES.model_copy(update={"loose_deg": 3.0})
    frame = Frame(np.array([[10, 0, 0]], np.float32), np.array([50], np.uint16), wide)
    depth = render(camera, AXES, straight(1), 0, lambda _: frame, wide)
    u, v = np.meshgrid(np.arange(160) - camera.K[0, 2], np.arange(60) - camera.K[1, 2])
    half = np.radians(3.0)
    inside = np.abs(u / camera.K[0, 0]) + np.abs(v / camera.K[1, 1]) <= half
    assert inside.sum() > 40
    np.testing.assert_array_equal(np.isfinite(depth), inside)
    np.testing.assert_allclose(depth[inside], 10, rtol=1e-5)


def test_sweeps_of_triangles_start_with_the_nearest_and_thin_out():
    trajectory = straight(300, spacing=0.5)
    far = TRIANGLES.model_copy(update={"ahead": 100.0})
    taken = static_frames(trajectory, 5_030_000_000, far)  # at 25.15 m
    ahead = trajectory.arc_length[taken] - 25.15
    assert taken[0] == 50
    assert len(set(taken.tolist())) == len(taken)
    assert (np.diff(np.abs(ahead[1:])) >= 0).all()
    assert ahead.min() > -far.behind
    assert ahead.max() > 0.7 * far.ahead
    ordered = np.sort(ahead[1:])
    assert np.diff(ordered)[np.abs(ordered[1:]) < 4].max() < 2.1
    assert np.diff(ordered)[ordered[1:] > 50].min() >= 8
    # The next images take the same sweeps, but for the nearest and a few that enter.
    following = static_frames(trajectory, 5_130_000_000, far)
    assert len(set(following.tolist()) - set(taken.tolist())) <= 3


@pytest.mark.parametrize("spacing", [0.5, 1.1, 2.8])
def test_sweeps_of_triangles_leave_no_gap_however_fast_the_ego_is(spacing):
    trajectory = straight(300, spacing=spacing)
    taken = static_frames(trajectory, int(trajectory.times[60]) + 30_000_000, TRIANGLES)
    ahead = np.sort(
        trajectory.arc_length[taken]
        - trajectory.arc_length_at(int(trajectory.times[60]) + 30_000_000)[0]
    )
    ahead = ahead[ahead > 0]
    # Spacings double, so the next sweep comes after twice the least distance at the most.
    assert (np.diff(ahead) < 2 * TRIANGLES.step_growth * ahead[1:] + spacing + 0.01).all()


@pytest.mark.skipif("DOCDEPTH_KITTI_RAW" not in os.environ, reason="DOCDEPTH_KITTI_RAW is not set")
def test_equals_plain_numpy_on_real_sweeps():
    folder = Path(os.environ["DOCDEPTH_KITTI_RAW"]) / "2011_09_26/2011_09_26_drive_9001_sync"
    files = sorted((folder / "velodyne_points").rglob("*.bin"))[::20][:3]
    sweeps = [np.fromfile(f, np.float32).reshape(-1, 4)[:, :3].copy() for f in files]
    camera = Camera(
        np.array([[721.5377, 0, 609.5593], [0, 721.5377, 172.854], [0, 0, 1]]), 1242, 375
    )
    trajectory = straight(len(sweeps), spacing=5.0)
    # Every tenth point moves, so that both sizes are met.
    classes = [np.where(np.arange(len(s)) % 10, 50, 100).astype(np.uint16) for s in sweeps]
    frames = [Frame(s, c, PAPER) for s, c in zip(sweeps, classes, strict=True)]
    time = 20_000_000
    T_camera_world = AXES @ np.linalg.inv(trajectory.interpolate(time)[0])
    clouds = []
    for i, (s, c) in enumerate(zip(sweeps, classes, strict=True)):
        pose = T_camera_world @ trajectory.poses[i]
        if i in static_frames(trajectory, time, PAPER):
            clouds.append((s[c < 100], pose, (50.0, 3.0)))
        if i == dynamic_frame(trajectory, time):
            clouds.append((s[c >= 100], pose, (80.0, 35.0)))
    depth = render(camera, AXES, trajectory, time, frames.__getitem__, PAPER)
    np.testing.assert_array_equal(depth, reference(camera, clouds))
    assert np.isfinite(depth).mean() > 0.5


@pytest.mark.parametrize("surface", ["splats", "triangles"])
def test_scenes_of_700_metres(surface):
    parameters = RenderParameters(surface=surface, crop=800, max_depth=700)
    y, z = np.meshgrid(np.arange(-60, 61, 2.0), np.arange(-60, 61, 2.0))
    far = np.stack([np.full(y.shape, 690.0), y, z], axis=-1).reshape(-1, 3).astype(np.float32)
    beyond = far + np.float32([30, 200, 0])
    points = np.concatenate([far, beyond])
    frame = Frame(points, np.full(len(points), 50, np.uint16), parameters)
    camera = Camera(np.array([[700.0, 0, 300], [0, 700, 60], [0, 0, 1]]), 601, 121)
    depth = render(camera, AXES, straight(1), 0, lambda _: frame, parameters)
    wall = depth[30:90, 270:330]
    assert np.isfinite(wall).mean() > 0.9
    np.testing.assert_allclose(wall[np.isfinite(wall)], 690, rtol=1e-5)
    assert np.nanmax(depth) <= 700
