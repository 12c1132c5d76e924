"""Several LiDARs on one vehicle: each sees what moves, and past it, from its own place."""

from __future__ import annotations

import numpy as np
import pytest
from render_reference import (
    compose_depth,
    compose_layers,
    drawing,
    frame_of,
    pixel_rays,
    render_sweep,
    small_camera,
)

from docdepth.geometry.lidar_frame import SensorRig
from docdepth.geometry.track import Tracks
from docdepth.render.dynamic_objects import dynamic_objects
from docdepth.render.render_sweep import RenderSweep
from motion import moving_track, straight

PLACES = ((0.0, 0.0, 0.0), (0.4, 1.3, -0.8))
"""On the roof, and in the left of the bumper [m]."""

WALL, WIDTH, LOW, HIGH = 25.0, 1.6, -1.4, 0.2
"""The wall ahead, and the flat back of the object before it [m]."""


def sweep_of(place, back, first_ray):
    """What one LiDAR measures, in the frame of the vehicle; 100 on the back, 50 on the wall."""
    azimuth, elevation = np.meshgrid(
        np.arange(-0.8, 0.8, 0.004) + first_ray, np.arange(-0.35, 0.2, 0.012)
    )
    ray = np.stack([np.ones_like(azimuth), np.tan(azimuth), np.tan(elevation)], -1).reshape(-1, 3)
    hit = place + ray * (back[0] - place[0])
    on_back = (np.abs(hit[:, 1] - back[1]) < WIDTH / 2) & (hit[:, 2] > LOW) & (hit[:, 2] < HIGH)
    points = np.where(on_back[:, None], hit, place + ray * (back[2] - place[0]))
    return points.astype(np.float32), np.where(on_back, 100, 50).astype(np.uint16)


def scene_of(trajectory, track, places, shown=range(9)):
    """Frames of a drive towards the wall; sweeps that are not `shown` miss the object."""
    T = np.repeat(np.eye(4)[None], len(places), 0)
    T[:, :3, 3] = places
    frames = []
    for i, (pose, time) in enumerate(zip(trajectory.poses, trajectory.times, strict=True)):
        x, y, _ = track.poses[i, :3, 3] - pose[:3, 3]
        back = (x - 0.5, y if i in shown else 99, WALL - pose[0, 3])
        seen = [sweep_of(np.array(place), back, 0.0013 * i) for place in places]
        points, classid = (np.concatenate(of) for of in zip(*seen, strict=True))
        index = np.repeat(np.arange(len(places), dtype=np.uint8), [len(of) for of, _ in seen])
        instance = np.where(classid == 100, track.id, 0).astype(np.uint16)
        rig = SensorRig(index, T) if len(places) > 1 else None
        frame = frame_of(points, classid, sensor_rig=rig, instance=instance)
        objects = dynamic_objects(frame, int(time), pose, Tracks([track]))
        frames.append(RenderSweep(frame, objects=objects))
    return frames


@pytest.fixture(scope="module")
def drive():
    trajectory = straight(9, spacing=0.6)
    track = moving_track(trajectory, (7, 0.9, LOW), (3, 0, 0), (1, WIDTH, HIGH - LOW), of=4)
    return trajectory, track, scene_of(trajectory, track, PLACES)


def test_what_moves_and_the_world_beside_it_are_drawn_whole(drive):
    """Past the object, each LiDAR sees the part of the wall that the other cannot see."""
    trajectory, track, frames = drive
    camera, time = small_camera(320, 160, 220.0), int(trajectory.times[4])
    depth = compose_depth(*drawing(frames, trajectory, time, camera=camera), tracks=Tracks([track]))
    x, y, _ = track.poses[4, :3, 3] - trajectory.poses[4, :3, 3]
    back, wall = x - 0.5, WALL - trajectory.poses[4, 0, 3]
    _, left, up = np.moveaxis(back * pixel_rays(camera), -1, 0)
    off = np.maximum(np.abs(left - y) - WIDTH / 2, np.maximum(up - HIGH, LOW - up))
    inside = off < -0.05
    assert inside.sum() > 1000
    assert np.mean(np.abs(depth[inside] - back) < 0.05) > 0.99
    _, left, up = np.moveaxis(wall * pixel_rays(camera), -1, 0)
    beside = (off > 0.15) & (np.abs(np.arctan(left / wall)) < 0.7)
    beside &= (up / wall > np.tan(-0.33)) & (up / wall < np.tan(0.17))
    assert beside.sum() > 5000
    assert np.mean(np.abs(depth[beside] - wall) < 0.1) > 0.97
    assert not np.any(depth[beside] < 0.9 * wall)


def test_layers_name_the_sweep_of_each_lidar(drive):
    trajectory, track, _ = drive
    frames = scene_of(trajectory, track, PLACES, shown=(3, 5))
    camera, time = small_camera(), int(trajectory.times[4]) + 20_000_000
    given = drawing(frames, trajectory, time, camera=camera)
    depth = compose_depth(*given, tracks=Tracks([track]))
    layers = compose_layers(["time", "class"], depth, *given, tracks=Tracks([track]))
    moving = layers["class"] == 100
    assert moving.sum() > 100
    for late in (-0.12, 0.08):
        moving &= ~np.isclose(layers["time"], late, atol=1e-6)
    assert not moving.any()


def test_the_lidar_with_most_returns_of_an_object_comes_first():
    points, classid = sweep_of(np.zeros(3), (6, 0, WALL), 0.0)
    rows = np.flatnonzero(classid == 100)
    T = np.repeat(np.eye(4)[None], 3, 0)
    T[:, 1, 3] = 0, 0.1, 0.2
    for share, order in ((0.0, [2]), (0.3, [2, 0]), (0.7, [0, 2]), (1.0, [0])):
        index = np.arange(len(points), dtype=np.uint8) % 3
        index[rows] = np.where(np.arange(len(rows)) < share * len(rows), 0, 2)
        assert render_sweep(points, classid, sensor_rig=SensorRig(index, T)).seen_by(1) == order
