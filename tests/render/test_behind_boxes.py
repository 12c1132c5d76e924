"""Behind the box of a moving object the world is drawn only where the LiDAR saw it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from render_reference import (
    AXES,
    TRIANGLES,
    compose_depth,
    compose_layers,
    followed,
    part_of,
    pixel_rays,
    render_sweep,
)

from docdepth.errors import BackendError
from docdepth.geometry.camera import Camera, View
from docdepth.geometry.se3 import rotation_exp
from docdepth.geometry.track import Tracks
from docdepth.geometry.trajectory import Trajectory
from docdepth.render import backends
from docdepth.render.layers import AGREED
from docdepth.render.object_views import HEIGHT_MARGIN, VEHICLE_HEIGHT, boxes_in_view
from docdepth.render.selection import seen_to_its_top
from lidar_rays import scan_rays
from motion import moving_track, straight

CAMERA = Camera(np.array([[200.0, 0, 160], [0, 200, 80], [0, 0, 1]]), 320, 120)
VIEW = View(CAMERA, AXES, 0)
WALL, AHEAD = 36.0, 6.0  # places of the wall, and of the object before the ego [m]
HIGHEST = 8.0  # beam [deg]


def scene(
    top,
    azimuths=(-180.0, 180.0),
    gap=None,
    objects=True,
    ahead=AHEAD,
    tracked=True,
    known=None,
    across=0.0,
    image=6.0,
):
    """Sweeps 2 m apart before a wall; from sweep 3 on an object drives ahead at our speed.

    The image is taken at sweep 6. Sweeps before it saw the wall above the highest beam of it.
    The object and the box of its track are 2 m wide; it ends ``top`` above the LiDAR [m].
    gap : azimuths without rays since sweep 3 [deg]
    known : height of the box, if it is not that of the object [m]
    across : speed of the object to the left [m/s]; the gap goes with it
    image : sweeps before the image
    """
    trajectory = straight(9, spacing=2.0)
    start = (ahead, -0.6 * across, -1.7)  # in front of the LiDAR at sweep 6
    track = moving_track(trajectory, start, (20, across, 0), (0.5, 2.0, known or top + 1.7))
    elevations, azimuths = np.arange(-20, HIGHEST, 0.4), np.arange(*azimuths, 0.3)
    rays = scan_rays(np.radians(elevations), np.radians(azimuths))
    frames = []
    for i in range(9):
        ray = rays.reshape(-1, 3)
        if gap is not None and i >= 3:
            left = np.degrees(np.arctan(across * (0.1 * i - 0.6) / ahead))
            fired = (azimuths < gap[0] + left) | (azimuths > gap[1] + left)
            ray = rays[:, fired].reshape(-1, 3)
        with np.errstate(divide="ignore"):
            ground = np.where(ray[:, 2] < 0, -1.7 / ray[:, 2], np.inf)
            wall = np.where(ray[:, 0] > 0, (WALL - 2 * i) / ray[:, 0], 20.0)
            near = np.where(ray[:, 0] > 0, ahead / ray[:, 0], np.inf)
        far = np.minimum(ground, wall)
        beside = np.abs(near * ray[:, 1] - across * (0.1 * i - 0.6))
        hit = (beside < 1) & (near * ray[:, 2] < top) & (near < far)
        hit &= objects and i >= 3
        points = (ray * np.where(hit, near, far)[:, None]).astype(np.float32)
        classid = np.where(hit, 100, 50).astype(np.uint16)
        frame = followed(points, classid, i, trajectory, track, TRIANGLES)
        frames.append(frame if tracked else render_sweep(points, classid, TRIANGLES))
    return {
        "view": View.at(CAMERA, AXES, trajectory, round(image * 1e8)),
        "trajectory": trajectory,
        "sweeps": frames.__getitem__,
        "parameters": TRIANGLES,
        "tracks": Tracks([track] if tracked and objects else []),
    }


_, LEFT, UP = np.moveaxis(pixel_rays(CAMERA), -1, 0)
RIGHT = -LEFT
ABOVE = (np.tan(np.radians(HIGHEST)) + 0.01 < UP) & (UP < 0.17)
BEHIND = np.abs(RIGHT) < 0.9 / AHEAD
BESIDE = np.abs(RIGHT) > 1.2 / AHEAD


def test_the_world_above_a_truck_that_the_highest_beam_cuts_is_empty():
    depth = compose_depth(**scene(top=2.0))
    assert np.isfinite(compose_depth(**scene(top=2.0, objects=False))[ABOVE]).mean() > 0.95
    assert np.isnan(depth[ABOVE & BEHIND]).all()
    assert np.isfinite(depth[ABOVE & BESIDE & (np.abs(RIGHT) < 0.5)]).mean() > 0.95


def test_a_low_object_hides_nothing_above_it():
    depth = compose_depth(**scene(top=-0.2))
    assert np.isfinite(depth[ABOVE & BEHIND]).mean() > 0.95
    assert np.nanmin(depth[ABOVE & BEHIND]) > 20


def test_what_is_not_followed_has_no_box():
    depth = compose_depth(**scene(top=2.0, tracked=False))
    assert np.isfinite(depth[ABOVE & BEHIND]).mean() > 0.95


def test_no_road_vehicle_is_higher_than_it_may_be():
    """A bridge's pier cannot be a truck: 4.2 m above the road the world is seen again."""
    ahead, columns = 16.0, np.abs(RIGHT) < 0.05
    depth = compose_depth(**scene(top=9.0, ahead=ahead, known=3.9))
    highest = (4.2 - 1.7) / ahead  # 1.7 m is the height of the sensor
    hidden = columns & (np.tan(np.radians(HIGHEST)) + 0.003 < UP) & (highest - 0.004 > UP)
    above = columns & (highest + 0.01 < UP) & (UP < 0.19)
    assert min(hidden.sum(), above.sum()) >= 20
    assert np.isnan(depth[hidden]).all()
    assert np.isfinite(depth[above]).mean() > 0.95


def test_the_world_beside_what_a_narrow_sensor_cuts_is_empty():
    """The sensor looks 30 degrees to each side, but since sweep 3 only 1 degree to the right."""
    narrow = {"azimuths": (-30.0, 30.0), "gap": (-30.0, -1.0), "top": 0.0}
    depth, without = (
        compose_depth(**scene(**narrow)),
        compose_depth(**scene(**narrow, objects=False)),
    )
    level = np.abs(UP + 0.1) < 0.08
    hidden = level & (RIGHT > 0.06) & BEHIND
    assert np.isfinite(without[hidden]).mean() > 0.9
    assert np.isnan(depth[hidden]).all()
    # To the left the sensor looked.
    left = level & (RIGHT < -1.2 / AHEAD) & (RIGHT > -0.4)
    assert np.isfinite(depth[left]).mean() > 0.95


def test_a_gap_inside_an_object_does_not_show_the_world():
    """A rosette has gaps of degrees; other sweeps saw the wall there before the object came."""
    gap = {"azimuths": (-30.0, 30.0), "gap": (-6.0, -2.0), "top": 0.0}
    depth, without = compose_depth(**scene(**gap)), compose_depth(**scene(**gap, objects=False))
    level = np.abs(UP + 0.1) < 0.08
    inside = level & (np.tan(np.radians(2.5)) < RIGHT) & (np.tan(np.radians(5.5)) > RIGHT)
    assert (without[inside] > AHEAD + 1).mean() > 0.9
    assert not (depth[inside] > AHEAD + 1).any()
    # Beside the box the world is drawn, whether the sensor looked there or not.
    gap |= {"gap": (-18.0, -10.5)}
    beside = level & (RIGHT > 1.15 / AHEAD) & (np.tan(np.radians(17)) > RIGHT)
    assert np.isfinite(compose_depth(**scene(**gap))[beside]).mean() > 0.9


LEVEL = np.abs(UP + 0.1) < 0.08


@pytest.mark.parametrize("with_an_empty_box", [False, True])
def test_a_camera_beside_the_lidar_is_shown_no_world_through_an_object(
    with_an_empty_box, monkeypatch
):
    """The left of the object gives no returns. From the LiDAR the wall behind it is in view."""
    beside = scene(top=1.0, ahead=3.0, gap=(8.0, 18.2))  # without returns from 0.42 to 0.99 m
    if with_an_empty_box:  # farther off, where rays passed; each box is looked at by itself
        empty = moving_track(
            beside["trajectory"], (10, 5.2, -1.7), (20, 0, 0), (0.5, 3.4, 3.0), of=2
        )
        beside["tracks"] = Tracks([empty, *beside["tracks"].values()])
    T_camera_lidar = AXES.copy()
    T_camera_lidar[0, 3] = -0.8
    beside["view"] = View.at(CAMERA, T_camera_lidar, beside["trajectory"], beside["view"].time)
    hidden = LEVEL & (RIGHT > -0.57) & (RIGHT < -0.43)
    depth = compose_depth(**beside)
    monkeypatch.setattr("docdepth.render.depth_map.boxes_in_view", lambda *_: [])
    whole = compose_depth(**beside)
    assert (whole[hidden] > 8).all()
    assert (compose_layers(("seen",), whole, **beside)["seen"][hidden] == AGREED).mean() > 0.9
    assert np.isnan(depth[hidden]).all()


@pytest.mark.parametrize("image", [6.3, 6.5, 6.7])
def test_rays_are_asked_where_the_object_was_when_they_were_fired(image, monkeypatch):
    """The object crosses at 10 m/s. Half a sweep ago the wall was in view where it is now."""
    crossing = scene(top=1.0, gap=(4.0, 9.0), across=10.0, image=image)
    left = -RIGHT * AHEAD - (image - 6.0)  # of the middle of the object [m]
    without_returns = LEVEL & (left > 0.5) & (left < 0.85)
    assert np.isnan(compose_depth(**crossing)[without_returns]).all()

    def standing(*args):
        return [(T, size, (0.0, 0.0, 0.0)) for T, size, _ in boxes_in_view(*args)]

    monkeypatch.setattr("docdepth.render.depth_map.boxes_in_view", standing)
    assert np.isfinite(compose_depth(**crossing)[without_returns]).any()


def test_a_crossing_object_hides_no_more_than_itself():
    """Its box is 2 m higher than the object: rays passed there."""
    depth = compose_depth(**scene(top=-0.5, known=3.2, across=10.0, image=6.5))
    above = (np.abs(UP - 0.05) < 0.08) & (np.abs(RIGHT * AHEAD + 0.5) < 0.9)
    assert np.isfinite(depth[above]).mean() > 0.95
    assert np.nanmin(depth[above]) > 15


def test_only_pixels_behind_the_box_that_rays_do_not_agree_with_are_emptied(monkeypatch):
    cut = scene(top=2.0)
    box, emptied = cut["tracks"][1], compose_depth(**cut)
    monkeypatch.setattr("docdepth.render.depth_map.boxes_in_view", lambda *_: [])
    whole = compose_depth(**cut)
    seen = compose_layers(("seen",), whole, **cut)["seen"]
    missing = np.isnan(emptied) & np.isfinite(whole)
    assert missing.sum() > 500
    # Rays that agree are enough but for the pixel at the outline: some rays ended on the object.
    outline = np.abs(np.abs(RIGHT) - 1 / AHEAD) * CAMERA.K[0, 0] < 1
    assert not (missing & (seen == AGREED) & ~outline).any()
    # Points along the ray of each pixel, in the frame of the box.
    T_box_world = np.linalg.inv(box.pose_at(cut["view"].time))
    T = T_box_world @ cut["trajectory"].poses[6] @ np.linalg.inv(AXES)
    z = np.linspace(0.1, 1, 2000)[:, None] * whole[missing]
    rays = np.stack([RIGHT[missing] * z, -UP[missing] * z, z], -1) @ T[:3, :3].T + T[:3, 3]
    low, high = np.array((-0.25, -1, 0)) - 0.06, np.array((0.25, 1, 4.2)) + 0.06
    assert ((low < rays) & (rays < high)).all(-1).any(0).all()


@pytest.mark.parametrize(
    ("slope", "speed", "known"), [(0, 20, False), (-4, 20, True), (0, 80, True), (4, 80, False)]
)
def test_a_lidar_that_is_tilted_downhill_looks_less_high(slope, speed, known):
    level = straight(9, spacing=2.0)
    tilt = np.eye(4)
    tilt[:3, :3] = rotation_exp(np.radians((0, slope, 0)))
    tilted = Trajectory(level.times, level.poses @ tilt)
    track = moving_track(level, (6, 0, -1.7), (speed, 0, 0), (4, 2, 2.2))
    assert seen_to_its_top(track, tilted) == known
    (box,) = boxes_in_view(VIEW, tilted, Tracks([track]))
    np.testing.assert_allclose(box[1], (4, 2, 2.2 + HEIGHT_MARGIN if known else VEHICLE_HEIGHT))


def test_the_box_of_an_object_is_there_before_the_lidar_sees_it():
    """It comes over a hill at 20 m/s towards us: 2 s before its first return it is 40 m farther."""
    trajectory = straight(50, spacing=0.0)
    whole = moving_track(trajectory, (80, 0, -1.7), (-20, 0, 0), (4, 2, 1.5))
    seen = part_of(whole, slice(25, None))
    for seconds, expected in ((0.5, 70.0), (0.1, 78.0)):
        view = VIEW._replace(time=round(seconds * 1e9))
        ((T_camera_box, *_),) = boxes_in_view(view, trajectory, Tracks([seen]))
        np.testing.assert_allclose(T_camera_box[:3, 3], (0, 1.7, expected), atol=1e-9)
    late = replace(seen, times=seen.times + 200_000_000)
    assert not boxes_in_view(VIEW, trajectory, Tracks([late]))


def test_a_box_that_holds_the_camera_or_the_lidar_hides_nothing():
    """A lost track goes on through the place of the vehicle; its map was all but empty."""
    trajectory = straight(50, spacing=0.0)
    whole = moving_track(trajectory, (8, 0.3, -1.7), (-20, 0, 0), (4, 2, 1.5))
    seen = part_of(whole, slice(3))
    # The camera looks from 3 m behind the LiDAR.
    behind = VIEW.T_camera_world.copy()
    behind[2, 3] = 3.0
    level = VIEW.T_camera_world
    # After 0.2 s the box is still ahead; then it holds the camera or the LiDAR.
    for seconds, T in ((0.2, level), (0.2, behind), (0.4, level), (0.4, behind), (0.55, behind)):
        view = VIEW._replace(time=round(seconds * 1e9), T_camera_world=T)
        found = boxes_in_view(view, trajectory, Tracks([seen]))
        assert len(found) == (seconds == 0.2), seconds
    cut = scene(top=0.0)
    lost = moving_track(cut["trajectory"], (0.5, 0.2, -1.7), (20, 0, 0), (4, 2, 1.5))
    drawn = compose_depth(
        **cut | {"tracks": Tracks([*cut["tracks"].values(), replace(lost, id=9)])}
    )
    np.testing.assert_array_equal(drawn, compose_depth(**cut))


def test_a_box_that_may_be_anywhere_hides_nothing():
    trajectory = straight(9, spacing=2.0)
    track = moving_track(trajectory, (6, 0, -1.7), (20, 0, 0), (4, 2, 2.2))
    for metres, hides in ((3.9, True), (4.1, False)):
        unsure = replace(track, deviations=np.full(len(track), metres))
        assert bool(boxes_in_view(VIEW, trajectory, Tracks([unsure]))) == hides


@pytest.mark.parametrize("name", ["egl", "osmesa"])
def test_every_renderer_empties_the_same_pixels(name):
    try:
        renderer = backends.Renderer(name)
    except BackendError as error:
        pytest.skip(str(error))
    cut = scene(top=2.0)
    depth, expected = compose_depth(**cut, renderer=renderer), compose_depth(**cut)
    assert np.isnan(expected[ABOVE & BEHIND]).all()
    assert (np.isnan(depth) == np.isnan(expected)).mean() > 0.999


def test_the_result_does_not_depend_on_threads():
    cut = scene(top=2.0)
    one, three = (compose_depth(**cut, threads=t) for t in (1, 3))
    np.testing.assert_array_equal(one, three)
