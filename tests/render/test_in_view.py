"""Objects that no image shows are not made ready, and no pixel changes by it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from render_reference import (
    AXES,
    TRIANGLES,
    compose_depth,
    drawing,
    frame_of,
    part_of,
    small_camera,
)
from test_moving_objects import wall_and_box

from docdepth.geometry.camera import View
from docdepth.geometry.se3 import inverse, rotation_exp
from docdepth.geometry.track import Track, Tracks
from docdepth.geometry.trajectory import Trajectory
from docdepth.render.dynamic_objects import dynamic_objects
from docdepth.render.object_views import MAX_NONRIGID_SECONDS, TracksInView, _in_view
from docdepth.render.render_sweep import RenderSweep
from motion import moving_track, straight

CAMERA = small_camera(focal=600)  # 15 degrees wide; the LiDAR sees 69


def image_times(trajectory: Trajectory) -> np.ndarray:
    return np.arange(trajectory.times[0], trajectory.times[-1], 70_000_000)


def views_of(trajectory: Trajectory) -> list[View]:
    times = image_times(trajectory)
    T_camera_world = AXES @ inverse(trajectory.interpolate(times))
    return [View(CAMERA, T, int(t)) for T, t in zip(T_camera_world, times, strict=True)]


def in_view_of(tracks: dict[int, Track], trajectory: Trajectory) -> TracksInView:
    return TracksInView(tracks, trajectory, views_of(trajectory))


@pytest.mark.parametrize("kind", ["vehicle", "person"])
def test_pixels_are_the_same_without_what_no_image_shows(kind: str) -> None:
    trajectory = straight(30, spacing=0.1)
    # To the left out of the image, but not out of what the LiDAR sees.
    track = moving_track(trajectory, (12, 0.5, -1), (0, 2.5, 0), (1, 1.6, 1.4), of=6, kind=kind)
    beside = moving_track(trajectory, (12, -7, -1), (0.3, 0, 0), (1, 1.6, 1.4), of=7, kind=kind)
    tracks = Tracks([track, beside])
    shown = in_view_of(tracks, trajectory)

    def frame(i: int, cropped: bool) -> RenderSweep:
        points, classid = wall_and_box(i, trajectory, track.poses[i, :2, 3] - (0.5, 0))
        others, other_class = wall_and_box(i, trajectory, beside.poses[i, :2, 3] - (0.5, 0))
        instance = np.where(classid >= 100, 6, np.where(other_class >= 100, 7, 0))
        points = np.where((other_class >= 100)[:, None], others, points)
        classid = np.maximum(classid, other_class)
        stamp, pose = int(trajectory.times[i]), trajectory.poses[i]
        is_drawn = shown.draws if cropped else None
        sweep = frame_of(points, classid, instance=instance.astype(np.uint16))
        of = dynamic_objects(sweep, stamp, pose, tracks)
        part = dynamic_objects(sweep, stamp, pose, tracks, is_drawn)
        np.testing.assert_array_equal(part.object_index, of.object_index)
        return RenderSweep(sweep, TRIANGLES, objects=part)

    whole = [frame(i, False) for i in range(30)]
    cropped = [frame(i, True) for i in range(30)]
    drawn = np.array(
        [dict(zip(f.objects.instances, f.objects.visible.tolist(), strict=True)) for f in cropped]
    )
    assert not any(of[7] for of in drawn)
    assert all(of[6] for of in drawn[:12])
    assert any(of.get(6) is False for of in drawn) == (kind == "person")
    for time in image_times(trajectory).tolist():
        expected, found = (
            compose_depth(*drawing(frames, trajectory, time, camera=CAMERA), 1, None, tracks)
            for frames in (whole, cropped)
        )
        np.testing.assert_array_equal(found, expected)


def test_nothing_that_an_image_draws_is_left_out() -> None:
    """Against the plain test of every image, for tracks that turn, lean, begin and end anywhere."""
    rng = np.random.default_rng(8)
    trajectory = straight(40, spacing=0.6)
    views = views_of(trajectory)
    drawn, kept = 0, []
    for number in range(1, 120):
        position = rng.uniform((-10, -25, -3), (50, 25, 3))
        moving = moving_track(
            trajectory, position, rng.normal(0, 6, 3) * (1, 1, 0.1), rng.uniform(0.3, 6, 3)
        )
        first = int(rng.integers(0, 35))
        rows = slice(first, int(rng.integers(first + 1, 41)))
        track = part_of(moving, rows)
        poses = track.poses.copy()
        poses[:, :3, :3] = [rotation_exp(rng.normal(0, 0.5, 3)) for _ in poses]
        kind = ("vehicle", "person", "other")[number % 3]
        track = replace(track, id=number, kind=kind, poses=poses)
        shown = in_view_of(Tracks([track]), trajectory)
        reach = 500_000_000  # images up to five sweeps away may draw it
        times = [
            view.time
            for view in views
            if track.times[0] - reach <= view.time <= track.times[-1] + reach
            and _in_view(CAMERA, view.T_camera_world @ track.pose_at(view.time), track)
        ]
        for stamp in track.times.tolist():
            near = any(abs(stamp - time) <= MAX_NONRIGID_SECONDS * 1e9 for time in times)
            if near or (times and track.kind == "vehicle"):
                assert shown.draws(number, stamp)
                drawn += 1
            kept.append(shown.draws(number, stamp))
    assert drawn > 100
    assert np.mean(kept) < 0.7
