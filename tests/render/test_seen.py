"""The layer ``seen``: exact scenes, and a plain search of all rays."""

from __future__ import annotations

import numpy as np
import pytest
from render_reference import (
    AXES,
    PAPER,
    TRIANGLES,
    compose_depth,
    compose_layers,
    drawing,
    followed,
    pixel_rays,
    render_sweep,
)

from docdepth.errors import InputError
from docdepth.geometry.camera import Camera
from docdepth.geometry.track import Tracks
from docdepth.render.layers import AGREED, CONTRADICTED, NOT_LOOKED_AT
from lidar_rays import scan_rays
from motion import moving_track, straight

GROUND, WALL = -1.7, 25.0
LOW, HIGH = -22.0, 6.0  # field of view [deg]
CAMERA = Camera(np.array([[200.0, 0, 80], [0, 200, 30], [0, 0, 1]]), 160, 90)
TIME = 50_000_000


def ranges_to(ray, x, post):
    """Along rays from (x, 0, 0): a road, a wall at 25 m, a post at 5 m; and which was hit."""
    with np.errstate(divide="ignore", invalid="ignore"):
        road = np.where(ray[..., 2] < 0, GROUND / ray[..., 2], np.inf)
        wall = np.where(ray[..., 0] > 0, (WALL - x) / ray[..., 0], np.inf)
        near = np.where(ray[..., 0] > 0, (5.0 - x) / ray[..., 0], np.inf)
        on_post = False if post is None else np.abs(near * ray[..., 1] - post) < 0.15
    near = np.where(on_post, near, np.inf)
    every = np.stack([road, wall, near])
    return every.min(axis=0), every.argmin(axis=0)


def sweep(x, post=0.0):
    """Points of a sensor that sees all around, and the unit normal at each."""
    elevations, azimuths = np.arange(LOW, HIGH, 0.5), np.arange(-180, 180, 0.4)
    ray = scan_rays(np.radians(elevations), np.radians(azimuths)).reshape(-1, 3)
    distance, which = ranges_to(ray, x, post)
    hit = distance < 60
    normal = np.where((which == 0)[:, None], (0.0, 0, 1), (1.0, 0, 0))
    return (ray[hit] * distance[hit, None]).astype(np.float32), normal[hit]


def seen_of(depth, frames, trajectory, T_camera_lidar=AXES, time=TIME, threads=0):
    scene = drawing(frames, trajectory, time, camera=CAMERA, T_camera_lidar=T_camera_lidar)
    return compose_layers(("seen",), depth.astype(np.float32), *scene, threads=threads)["seen"]


def street(post=0.0, n=4):
    sweeps = [sweep(float(i), post) for i in range(n)]
    frames = [render_sweep(p, np.full(len(p), 50, np.uint16), TRIANGLES) for p, _ in sweeps]
    return sweeps, frames, straight(n)


def true_depth(post=0.0, aside=0.0):
    """Of the camera at x = 0.5, ``aside`` to the right."""
    shifted = None if post is None else post + aside
    return ranges_to(pixel_rays(CAMERA), 0.5, shifted)


def test_exact_depth_agrees_and_wrong_depth_is_contradicted():
    _, frames, trajectory = street(post=None)
    exact, which = true_depth(post=None)
    elevation = np.degrees(np.arctan2(*np.moveaxis(pixel_rays(CAMERA), -1, 0)[[2, 0]]))
    inside = (elevation > LOW + 2) & (elevation < HIGH - 2) & (exact < 30)
    assert (seen_of(exact, frames, trajectory)[inside] == AGREED).mean() > 0.97
    wall = inside & (which == 1)
    # Rays pass through what is drawn before the wall, and the wall hides what is drawn behind.
    for factor in (0.6, 1.5):
        found = seen_of(exact * factor, frames, trajectory)[wall]
        assert (found == CONTRADICTED).mean() > 0.9, factor
    above = elevation > HIGH + 2
    assert above.sum() > 300
    assert (seen_of(exact, frames, trajectory)[above] == NOT_LOOKED_AT).all()
    nothing = np.full(exact.shape, np.nan)
    assert (seen_of(nothing, frames, trajectory) == 255).all()


def test_what_only_the_lidar_has_hidden_is_not_looked_at():
    """The camera stands 0.6 m to the right and sees past the post."""
    _, frames, trajectory = street()
    T_camera_lidar = AXES.copy()
    T_camera_lidar[0, 3] = -0.6
    exact, which = true_depth(aside=0.6)
    place = pixel_rays(CAMERA) * (WALL - 0.5)
    # Seen from the LiDAR the post, 0.3 m wide at 4.5 m, hides 1.6 m of the wall.
    hidden = (which == 1) & (np.abs(place[..., 1] - 0.6) < 0.4) & (np.abs(place[..., 2]) < 1)
    assert hidden.sum() > 50
    found = seen_of(exact, frames, trajectory, T_camera_lidar)
    assert (found[hidden] == NOT_LOOKED_AT).all()
    beside = (which == 1) & (np.abs(place[..., 1] - 0.6) > 2) & (np.abs(place[..., 2]) < 1)
    assert (found[beside] == AGREED).mean() > 0.97


def test_rays_long_before_or_after_the_image_do_not_count():
    points, _ = sweep(0.0, None)
    left = points[:, 1] > 0
    classid = np.full(len(points), 50, np.uint16)
    late = np.where(left, 0.12, 0.08).astype(np.float32)
    exact, _ = ranges_to(pixel_rays(CAMERA), 0.0, None)
    frame = render_sweep(points, classid, TRIANGLES, time_offset=late)
    found = seen_of(exact, [frame], straight(1), time=0)
    columns = np.arange(CAMERA.width)
    middle = slice(25, 60)
    assert (found[middle, columns > 84] == AGREED).mean() > 0.97
    assert (found[middle, columns < 76] == NOT_LOOKED_AT).all()


def plain_state(target, sweeps, reach):
    """State of a static point by all rays of all sweeps, whose normals are exact.

    target : (3,); sweeps : list of (points, normals, place of the sensor, shape (3,))
    """
    nearest = [(np.inf, None, None)] * 4
    for points, normals, origin in sweeps:
        p = target - origin
        r = np.linalg.norm(p)
        azimuth = np.arctan2(points[:, 1], points[:, 0]) - np.arctan2(p[1], p[0])
        azimuth = (azimuth + np.pi) % (2 * np.pi) - np.pi
        u = azimuth * np.hypot(p[0], p[1]) / r
        v = np.arcsin(points[:, 2] / np.linalg.norm(points, axis=1)) - np.arcsin(p[2] / r)
        near = np.flatnonzero((np.abs(u) <= reach) & (np.abs(v) <= reach))
        for i in near:
            quadrant = int(u[i] > 0) + 2 * int(v[i] > 0)
            squared = u[i] ** 2 + v[i] ** 2
            if squared < nearest[quadrant][0]:
                end = np.linalg.norm(points[i])
                margin = 0.1 + 0.03 * r
                before = normals[i] @ p / (normals[i] @ points[i])  # 1 on the plane, less before it
                if abs(end - r) < margin or r * abs(1 - before) < margin * before:
                    verdict = "ended"
                elif end > r + margin and before < 1:
                    verdict = "passed"
                else:
                    verdict = "before" if end < r - margin else "none"
                nearest[quadrant] = squared, verdict, end / r
    return min(nearest, key=lambda corner: corner[0])[2], [corner[1] for corner in nearest]


@pytest.mark.slow
def test_states_equal_a_plain_search_of_all_rays():
    sweeps, frames, trajectory = street(n=3)
    exact, _ = true_depth()
    rng = np.random.default_rng(0)
    depth = exact * rng.choice([0.5, 1, 1, 1.6], exact.shape)
    depth[exact > 40] = np.nan
    found = seen_of(depth, frames, trajectory)
    for threads in (1, 2):
        np.testing.assert_array_equal(seen_of(depth, frames, trajectory, threads=threads), found)
    points = pixel_rays(CAMERA) * depth[..., None]
    camera_at = np.array([0.5, 0, 0])
    around = [(p.astype(np.float64), n, np.array([float(i), 0, 0]))
              for i, (p, n) in enumerate(sweeps[:2])]  # fmt: skip
    # Four mean distances: a full turn times the elevations, over the returns of a sweep.
    reach = [4 * np.sqrt(2 * np.pi * np.radians(HIGH - 0.5 - LOW) / len(p)) for p, _ in sweeps[:2]]
    expected, compared = [], []
    for v in range(0, CAMERA.height, 3):
        for u in range(0, CAMERA.width, 3):
            if not np.isfinite(depth[v, u]):
                assert found[v, u] == 255
                continue
            ratio, verdicts = plain_state(points[v, u] + camera_at, around, min(reach))
            state = NOT_LOOKED_AT
            if set(verdicts) == {"ended"}:
                state = AGREED
            elif set(verdicts) == {"passed"}:
                state = CONTRADICTED
            elif set(verdicts) == {"before"}:
                _, before = plain_state(points[v, u] * ratio + camera_at, around, min(reach))
                state = CONTRADICTED if set(before) == {"ended"} else NOT_LOOKED_AT
            expected.append(state)
            compared.append(found[v, u])
    expected, compared = np.array(expected), np.array(compared)
    assert min((expected == state).sum() for state in (0, 1, 2)) > 100
    # The surface's normals at corners come from the mesh, here they are exact.
    assert (expected == compared).mean() > 0.97


def test_a_moving_box_is_compared_with_rays_that_move_with_it():
    """The box comes nearer by 2 m from sweep to sweep. Unmoved rays would not agree."""
    trajectory = straight(4, spacing=0.0)
    track = moving_track(trajectory, (16, 0, -1.6), (-20, 0, 0), (0.5, 3, 2))

    def frame(i):
        points, _ = sweep(0.0, None)
        far = np.linalg.norm(points, axis=1)
        ray = points / far[:, None]
        with np.errstate(divide="ignore"):
            near = (16.0 - 2 * i) / ray[:, 0]
        on_box = (np.abs(near * ray[:, 1]) < 1.5) & (np.abs(near * ray[:, 2] + 0.6) < 1)
        on_box &= (near > 0) & (near < far)
        distance = np.where(on_box, near, far)
        classid = np.where(on_box, 100, 50).astype(np.uint16)
        points = (ray * distance[:, None]).astype(np.float32)
        return followed(points, classid, i, trajectory, track, TRIANGLES)

    frames = [frame(i) for i in range(4)]
    scene = drawing(frames, trajectory, 150_000_000, camera=CAMERA)
    depth = compose_depth(*scene, tracks=Tracks([track]))
    found = compose_layers(("seen", "class"), depth, *scene, tracks=Tracks([track]))
    box = (found["class"] == 100) & (np.abs(depth - 13.0) < 0.1)
    assert box.sum() > 800
    assert (found["seen"][box] == AGREED).mean() > 0.8
    wrong = np.where(box, depth * np.float32(0.8), depth)
    again = compose_layers(("seen", "class"), wrong, *scene, tracks=Tracks([track]))
    shifted = box & (again["class"] == 100)
    assert shifted.sum() > 800
    assert (again["seen"][shifted] == CONTRADICTED).mean() > 0.8


def test_splats_have_no_such_layer():
    frame = render_sweep(np.ones((3, 3), np.float32), np.full(3, 50, np.uint16), PAPER)
    depth = np.full((CAMERA.height, CAMERA.width), np.nan, np.float32)
    for name in ("seen", "normal", "instance"):
        with pytest.raises(InputError, match=f"leave the layer {name} out"):
            compose_layers((name,), depth, *drawing(frame, parameters=PAPER, camera=CAMERA))
