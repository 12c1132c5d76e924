"""Points of moving objects: deskewed with their own motion, carried along their tracks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from render_reference import (
    AXES,
    TRIANGLES,
    compose_depth,
    drawing,
    followed,
    frame_of,
    pixel_rays,
    render_sweep,
    small_camera,
)

from docdepth.geometry.camera import View
from docdepth.geometry.se3 import inverse, rotation_exp
from docdepth.geometry.track import Track, Tracks
from docdepth.geometry.trajectory import Trajectory
from docdepth.render.dynamic_objects import TOUCH, dynamic_objects
from docdepth.render.object_views import (
    MAX_NONRIGID_SECONDS,
    MOST_VIEWS,
    boxes_in_view,
    object_views,
)
from docdepth.render.selection import (
    MOST_TRACK_SWEEPS,
    drawn_sweeps,
    near_vehicles,
    needed_sweeps,
    sweeps_of_track,
    track_sweeps,
)
from motion import moving_track, straight

CORNERS = np.array([(x, y, z) for x in (-2, 2) for y in (-0.9, 0.9) for z in (0, 1.5)])


def turning_track(count=5):
    """A car that drives 12 m/s on a circle of 20 m, and the pose at any time [s]."""
    rate, radius = 12 / 20, 20.0

    def pose(t):
        T = np.eye(4)
        T[:3, :3] = rotation_exp(np.array((0, 0, rate * t)))
        T[:3, 3] = 8 + radius * np.sin(rate * t), 3 - radius * np.cos(rate * t) + radius, -1.7
        return T

    times = 100_000_000 * np.arange(count, dtype=np.int64)
    poses = np.array([pose(t * 1e-9) for t in times])
    velocities = 12 * poses[:, :3, 0]
    size, points = np.array((4, 1.8, 1.5)), np.zeros(count, np.int64)
    return Track(3, "vehicle", times, poses, velocities, size, points, *np.zeros((2, count))), pose


def test_a_box_that_moves_and_turns_is_held_to_a_millimetre():
    """Each corner is measured at its own time, up to 10 ms from the stamp."""
    track, pose = turning_track()
    ego = np.eye(4)
    ego[:3, :3], ego[:3, 3] = rotation_exp(np.array((0.01, -0.02, 0.4))), (1, -2, 0.3)
    late = np.linspace(-0.01, 0.01, len(CORNERS)).astype(np.float32)
    stamp = int(track.times[2])
    world = np.array(
        [pose(stamp * 1e-9 + t) @ (*corner, 1) for t, corner in zip(late, CORNERS, strict=True)]
    )
    points = (world @ inverse(ego).T)[:, :3].astype(np.float32)
    classid, instance = np.full(8, 100, np.uint16), np.full(8, 3, np.uint16)
    frame = frame_of(points, classid, late, instance=instance)
    of = dynamic_objects(frame, stamp, ego, Tracks([track]))
    assert of.instances == (3,)
    assert of.times[0] == pytest.approx(stamp + 1e9 * late.astype(float).mean(), abs=10)
    held = np.c_[points + of.displacement, np.ones(8)] @ of.T_object_lidar[0].T
    np.testing.assert_allclose(held[:, :3], CORNERS, atol=1e-3)
    as_measured = np.c_[points, np.ones(8)] @ of.T_object_lidar[0].T
    assert np.abs(as_measured[:, :3] - CORNERS).max() > 0.05


def test_objects_of_a_sweep_equal_a_plain_loop():
    rng = np.random.default_rng(4)
    trajectory = straight(4)
    tracks = Tracks(
        moving_track(trajectory, (6.0 * k, 3 - k, 0), (k, -1, 0), (4, 2, 1.5), of=k)
        for k in (1, 2, 5)
    )
    points = rng.uniform((-5, -8, -1), (35, 8, 3), (4000, 3)).astype(np.float32)
    classid = rng.choice([0, 50, 100, 251], 4000).astype(np.uint16)
    instance = rng.choice([0, 1, 2, 5, 9], 4000, p=[0.8, 0.05, 0.05, 0.05, 0.05]).astype(np.uint16)
    stamp, pose = int(trajectory.times[2]), trajectory.poses[2]
    of = dynamic_objects(frame_of(points, classid, instance=instance), stamp, pose, tracks)
    carried = np.zeros(300)
    for i in range(len(points)):
        moving = classid[i] >= 100
        expected = int(instance[i]) if moving and instance[i] in tracks else 0
        if expected == 0 and classid[i] > 0:  # what is static must lie inside, not only touch
            for k, track in tracks.items():
                x, y, z, _ = inverse(track.pose_at(stamp)) @ pose @ (*points[i].astype(float), 1)
                half = track.size / 2 + (TOUCH if moving else 0)
                if (np.abs((x, y, z - track.size[2] / 2)) <= half).all():
                    expected = k
                    carried[classid[i]] += 1
                    break
        if moving or expected:
            assert of.instances[of.object_index[i] - 1] == expected
        else:
            assert of.object_index[i] == 0
    assert (carried[[50, 100, 251]] > 10).all()
    shuffled = rng.permutation(4000)
    frame = frame_of(points[shuffled], classid[shuffled], instance=instance[shuffled])
    again = dynamic_objects(frame, stamp, pose, tracks)
    np.testing.assert_array_equal(again.object_index, of.object_index[shuffled])
    assert again.instances == of.instances


def wall_and_box(index, trajectory, position, width=1.6):
    """A sweep of a wall at x = 30 with the flat back of a box before it, at ``position`` (x, y)."""
    azimuth, elevation = np.meshgrid(np.arange(-0.6, 0.6, 0.004), np.arange(-0.2, 0.1, 0.01))
    ray = np.stack([np.ones_like(azimuth), np.tan(azimuth), np.tan(elevation)], -1).reshape(-1, 3)
    x, y = position - trajectory.poses[index, :2, 3]
    box = (np.abs(ray[:, 1] * x - y) < width / 2) & (np.abs(ray[:, 2] * x + 0.3) < 0.7)
    ahead = np.where(box, x, 30 - trajectory.poses[index, 0, 3])
    classid = np.where(box, 100, 50).astype(np.uint16)
    return (ray * ahead[:, None]).astype(np.float32), classid


def frames_of(trajectory, track):
    """Sweeps that see the back of the box of a track."""
    backs = track.poses[:, :2, 3] - (0.5, 0)
    seen = [wall_and_box(i, trajectory, back) for i, back in enumerate(backs)]
    return [followed(*sweep, i, trajectory, track, TRIANGLES) for i, sweep in enumerate(seen)]


def back_of_box(camera, trajectory, track, time):
    """Distance of the back of the box, and where each pixel sees it, to the left and up."""
    here = track.pose_at(time)[0, 3] - 0.5 - trajectory.interpolate(time)[0][0, 3]
    return here, *np.moveaxis(here * pixel_rays(camera), -1, 0)[1:]


@pytest.mark.parametrize("kind", ["vehicle", "person"])
def test_object_views_are_placed_as_plain_matrices_say(kind):
    trajectory = straight(40, spacing=0.5)
    track = moving_track(trajectory, (10.5, -1, -1), (4, 0.5, 0), (1, 1.6, 1.4), of=6, kind=kind)
    frames, time = frames_of(trajectory, track), 530_000_000
    drawn = drawn_sweeps(trajectory, time, TRIANGLES)
    T_camera_world = AXES @ inverse(trajectory.interpolate(time)[0])
    view = View(small_camera(), T_camera_world, time)
    objects = object_views(view, trajectory, frames.__getitem__, drawn, Tracks([track]), 100)
    ((instance, around, others, rays),) = objects
    ((T_camera_box, size, velocity),) = boxes_in_view(view, trajectory, Tracks([track]))
    assert size == (*track.size[:2], 4.2 if kind == "vehicle" else 2.2)
    np.testing.assert_allclose(T_camera_box, T_camera_world @ track.pose_at(time))
    np.testing.assert_allclose(velocity, T_camera_world[:3, :3] @ (4, 0.5, 0))
    assert instance == 6
    if kind == "person":
        near = [
            i
            for i in drawn.dynamic
            if abs(trajectory.times[i] - time) <= MAX_NONRIGID_SECONDS * 1e9
        ]
        assert [drawn.with_objects[number - 100] for *_, number in around] == near
        assert not others
        assert len(rays) == len(near)
    else:
        assert [number - 100 for *_, number in around] == list(range(4))
        assert 0 < len(others) <= MOST_VIEWS - 4
    for core, object_index, T_camera_sensor, number in around + others:
        sweep = drawn.with_objects[number - 100]
        assert core is frames[sweep].parts[0][0]
        assert object_index == 1
        T_object_then = inverse(track.pose_at(int(trajectory.times[sweep])))
        expected = T_camera_world @ track.pose_at(time) @ T_object_then @ trajectory.poses[sweep]
        np.testing.assert_allclose(T_camera_sensor, expected, atol=1e-9)
    behind = AXES @ np.diag((-1.0, -1, 1, 1)) @ inverse(trajectory.interpolate(time)[0])
    view = view._replace(T_camera_world=behind)
    assert not object_views(view, trajectory, frames.__getitem__, drawn, Tracks([track]), 100)


def test_what_later_sweeps_saw_of_a_car_is_drawn_where_no_ray_looked():
    """The sweeps around the image see the lower half only: above, their rays returned nothing."""
    trajectory = straight(60, spacing=1.0)
    track = moving_track(trajectory, (12.5, 0, -1), (8, 0, 0), (1, 1.6, 1.4))
    frames = []
    for i in range(60):
        points, classid = wall_and_box(i, trajectory, track.poses[i, :2, 3] - (0.5, 0))
        if i < 20:
            # Nothing higher returned: the highest beam.
            low = points[:, 2] / points[:, 0] < -0.03
            points, classid = points[low], classid[low]
        frames.append(followed(points, classid, i, trajectory, track, TRIANGLES))
    camera, time = small_camera(320, 120, 180.0), 1_040_000_000
    asked = drawing(frames, trajectory, time, camera=camera)
    depth = compose_depth(*asked, tracks=Tracks([track]))
    here, y, z = back_of_box(camera, trajectory, track, time)
    upper = (np.abs(y) < 0.7) & (z > -0.1) & (z < 0.3)
    assert upper.sum() > 100
    assert (np.abs(depth[upper] - here) < 0.1).mean() > 0.95
    vague = replace(track, surface_deviations=np.full(len(track), 0.3))
    shifted = replace(track, deviations=np.full(len(track), 0.3))  # along itself
    for other in (replace(track, kind="person"), vague, shifted):
        alone = compose_depth(*asked, tracks=Tracks([other]))
        assert (np.abs(alone[upper] - here) < 0.1).mean() < 0.2


def test_through_a_window_the_car_is_not_drawn_where_rays_pass():
    """Around the image rays pass through the upper half to the wall; later the glass returns."""
    trajectory = straight(60, spacing=1.0)
    track = moving_track(trajectory, (12.5, 0, -1), (8, 0, 0), (1, 1.6, 1.4))
    clear = []
    for i in range(60):
        points, classid = wall_and_box(i, trajectory, track.poses[i, :2, 3] - (0.5, 0))
        if i < 20:
            upper = (classid == 100) & (points[:, 2] > -0.3)
            ahead = 30 - trajectory.poses[i, 0, 3]
            points[upper] *= ahead / points[upper, :1]
            classid[upper] = 50
        clear.append(followed(points, classid, i, trajectory, track, TRIANGLES))
    camera, time = small_camera(320, 120, 180.0), 1_040_000_000
    depth = compose_depth(*drawing(clear, trajectory, time, camera=camera), tracks=Tracks([track]))
    here, y, z = back_of_box(camera, trajectory, track, time)
    wall = 30 - trajectory.interpolate(time)[0][0, 3]
    window = (np.abs(y) < 0.7) & (z > -0.2) & (z < 0.3)
    body = (np.abs(y) < 0.7) & (z > -0.9) & (z < -0.4)
    assert window.sum() > 100
    assert (np.abs(depth[body] - here) < 0.1).mean() > 0.99
    assert not (np.abs(depth[window] - here) < 0.1).any()
    assert (np.isnan(depth[window]) | (np.abs(depth[window] - wall) < 0.1)).all()


def test_unassigned_points_stay_where_the_nearest_sweep_saw_them():
    rng = np.random.default_rng(0)
    trajectory = Trajectory(straight(3).times, straight(3, spacing=0.0).poses)
    points, classid = wall_and_box(1, trajectory, np.array((12.0, 1.0)))
    order = rng.permutation(len(points))
    depths = []
    for some in (np.arange(len(points)), order):
        frame = render_sweep(points[some], classid[some], TRIANGLES)
        asked = drawing(frame, trajectory, 130_000_000)
        depths.append(compose_depth(*asked))
    np.testing.assert_array_equal(*depths)
    assert (np.abs(depths[0] - 12) < 0.01).sum() > 40


def test_further_sweeps_show_a_vehicle_from_elsewhere_and_belong_to_its_track():
    trajectory = straight(200, spacing=2.0)
    track = moving_track(trajectory, (60, 3.5, -1.7), (16, 0, 0), (9, 2.5, 3.6), of=2)
    beside = 100_000_000 * 150  # 60 m ahead at first; the ego is 4 m/s faster
    found = track_sweeps(trajectory, beside, Tracks([track]))
    assert 4 <= len(found) <= MOST_TRACK_SWEEPS
    away = np.abs(60 + 1.6 * np.array(found) - 2.0 * np.array(found))
    assert away.max() == 60  # from where a beam reaches highest
    assert away.min() < 15
    assert track_sweeps(trajectory, beside + 130_000_000, Tracks([track])) == found
    assert not track_sweeps(trajectory, 0, Tracks([track]))  # far: the sweeps around see it whole
    person = replace(track, kind="person")
    assert not track_sweeps(trajectory, beside, Tracks([person]))
    seen = replace(track, points=np.where(np.arange(200) < 20, 0, 9))
    assert min(track_sweeps(trajectory, beside, Tracks([seen]))) >= 20
    drawn = drawn_sweeps(trajectory, beside, TRIANGLES, Tracks([track]))
    assert not {*drawn.tracked} & {*drawn.static, *drawn.dynamic}
    needed = needed_sweeps(trajectory, beside, TRIANGLES, Tracks([track]))
    assert {i for i, whole in needed.items() if not whole} == {*drawn.tracked}


def test_further_sweeps_are_those_that_looked_highest():
    """A bump lifts the view of one sweep by a degree; it is taken in place of its neighbours."""
    trajectory = straight(200, spacing=2.0)
    track = moving_track(trajectory, (60, 3.5, -1.7), (16, 0, 0), (9, 2.5, 3.6), of=2)
    time = 100_000_000 * 150
    level = sweeps_of_track(track, trajectory, time)
    poses = trajectory.poses.copy()
    poses[20, :3, :3] = rotation_exp(np.array((0, -np.radians(1.0), 0)))  # x turns up
    bumpy = sweeps_of_track(track, Trajectory(trajectory.times, poses), time)
    assert 0 in level
    assert 20 not in level
    assert 20 in bumpy
    assert 0 not in bumpy  # 60 m away, but 1.6 m lower than a degree more at 52 m


def test_a_vehicle_is_drawn_from_the_further_sweeps_of_its_own_track_alone():
    """Those that an image takes for a lorry show a car beside it from too far."""
    trajectory = straight(40, spacing=0.5)
    lorry = moving_track(trajectory, (10.5, -1, -1), (4, 0.5, 0), (1, 1.6, 1.4), of=6)
    time = 530_000_000
    own = sweeps_of_track(lorry, trajectory, time)
    view = View(small_camera(), AXES @ inverse(trajectory.interpolate(time)[0]), time)
    for track, wanted in ((lorry, {*own}), (replace(lorry, size=np.array((1, 1.6, 0.5))), set())):
        frames, drawn = frames_of(trajectory, track), drawn_sweeps(trajectory, time, TRIANGLES)
        drawn = drawn._replace(static=drawn.static[:1], tracked=[30, *own])
        of = object_views(view, trajectory, frames.__getitem__, drawn, Tracks([track]), 0)
        others = {drawn.with_objects[number] for *_, number in of[0][2]}
        assert others == wanted - {*drawn.dynamic}
    assert len(own) == 2
    assert 30 not in own


def test_near_a_vehicle_its_neighbours_are_kept_also_across_the_seam():
    rng = np.random.default_rng(2)
    trajectory = straight(2)
    track = moving_track(trajectory, (-10, 0, -1), (1, 0, 0), (4, 2, 2))
    points = rng.uniform((-40, -20, -2), (40, 20, 4), (5000, 3)).astype(np.float32)
    box = np.array([(-8, y, z) for y in (-1, 0, 1) for z in (-1, 1)], np.float32)
    points = np.concatenate([points, box])
    of_box = np.arange(len(points)) >= 5000
    classid = np.where(of_box, 100, 50).astype(np.uint16)
    frame = frame_of(points, classid, instance=of_box.astype(np.uint16))
    kept = near_vehicles(frame, Tracks([track]))
    across, up = np.abs(points[:, 1] / points[:, 0]), points[:, 2] / -points[:, 0]
    behind = points[:, 0] < 0
    assert kept[of_box].all()
    assert kept[behind & (across < 0.12) & (np.abs(up) < 0.12)].all()
    assert not kept[~behind].any()
    assert not kept[across > 0.2].any()
    assert not near_vehicles(replace(frame, instance=None), Tracks([track])).any()
