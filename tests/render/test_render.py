"""Composite rendering against a plain numpy rasteriser, exact scenes and a real drive."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from render_reference import (
    AXES,
    PAPER,
    TRIANGLES,
    compose_depth,
    drawing,
    drive,
    reference,
    render_sweep,
    small_camera,
)

from docdepth.config import RenderParameters
from docdepth.errors import CalibrationError, InputError
from docdepth.geometry.camera import Camera
from docdepth.render.selection import needed_sweeps, static_sweeps
from motion import straight


@pytest.mark.parametrize(
    ("seed", "sizes"),
    [(0, (50, 3, 80, 35)), (2, (9.3, 1, 14, 2.6)), (3, (1, 1, 1, 1))],
)
def test_equals_plain_numpy_pixel_for_pixel(seed, sizes):
    parameters = RenderParameters(
        primitive="splats",
        behind=0.5,
        ahead=100.0,
        step=0.2,
        static_size=sizes[:2],
        dynamic_size=sizes[2:],
    )
    camera = small_camera()
    time = 130_000_000
    trajectory, frames, clouds = drive(np.random.default_rng(seed), time, parameters)
    expected = reference(camera, clouds)
    one, two = (
        compose_depth(*drawing(frames, trajectory, time, parameters, camera=camera), threads=t)
        for t in (1, 2)
    )
    np.testing.assert_array_equal(one, expected)
    np.testing.assert_array_equal(two, expected)
    assert one.dtype == np.float32
    assert np.isfinite(one).mean() > 0


def one_point(points, classid=50):
    points = np.asarray(points, dtype=np.float32).reshape(-1, 3)
    return render_sweep(points, np.full(len(points), classid, np.uint16), PAPER)


@pytest.mark.parametrize("parameters", [PAPER, TRIANGLES])
def test_no_points_give_no_depth(parameters):
    empty = render_sweep(np.empty((0, 3), np.float32), np.empty(0, np.uint16), parameters)
    assert np.isnan(compose_depth(*drawing(empty, straight(2), 0, parameters))).all()


def test_bad_input_is_refused():
    with pytest.raises(InputError, match="outside the trajectory"):
        compose_depth(*drawing(one_point([5, 0, 0]), straight(2), -1, PAPER))
    with pytest.raises(InputError, match="not made for triangles"):
        compose_depth(*drawing(one_point([5, 0, 0]), straight(2), 0))
    with pytest.raises(CalibrationError, match="skew"):
        Camera(np.array([[9.0, 1, 5], [0, 9, 5], [0, 0, 1]]), 10, 10)


@pytest.mark.parametrize("parameters", [PAPER, TRIANGLES])
@pytest.mark.parametrize("time", [0, 130_000_000, 200_000_000, 500_000_000])
def test_needed_sweeps_are_those_that_are_asked_for(parameters, time):
    trajectory, frames, _ = drive(np.random.default_rng(7), 130_000_000, parameters)
    asked = set()

    def frame(index):
        asked.add(index)
        return frames[index]

    compose_depth(*drawing(frame, trajectory, time, parameters))
    assert asked == set(needed_sweeps(trajectory, time, parameters))


@pytest.mark.parametrize("parameters", [PAPER, TRIANGLES])
def test_the_crop_leaves_dynamic_points(parameters):
    """The paper crops static points only; returns that are not finite are never drawn."""
    near = parameters.model_copy(update={"crop": 10.0})
    y, z = np.meshgrid(np.linspace(-1, 1, 20), np.linspace(-1, 1, 20))
    board = np.stack([np.full(y.shape, 20.0), y, z], axis=-1).reshape(-1, 3)
    unusable = [[np.inf, 1, 0], [np.nan, 0, 1], [1e30, 0, 0]]
    points = np.concatenate([board, unusable]).astype(np.float32)
    for classid, drawn in ((50, False), (99, False), (100, True)):
        frame = render_sweep(points, np.full(len(points), classid, np.uint16), near)
        depth = compose_depth(*drawing(frame, parameters=near))
        assert np.isfinite(depth).any() == drawn
        np.testing.assert_allclose(depth[np.isfinite(depth)], 20, rtol=1e-5)


@pytest.mark.skipif("DOCDEPTH_KITTI_RAW" not in os.environ, reason="DOCDEPTH_KITTI_RAW is not set")
def test_equals_plain_numpy_on_real_sweeps():
    folder = Path(os.environ["DOCDEPTH_KITTI_RAW"]) / "2011_09_26/2011_09_26_drive_9001_sync"
    files = sorted((folder / "velodyne_points").rglob("*.bin"))[::20][:3]
    sweeps = [np.fromfile(f, np.float32).reshape(-1, 4)[:, :3].copy() for f in files]
    camera = Camera(
        np.array([[721.5377, 0, 609.5593], [0, 721.5377, 172.854], [0, 0, 1]]), 1242, 375
    )
    trajectory = straight(len(sweeps), spacing=5.0)
    # Every tenth point is dynamic, so that both sizes occur.
    classes = [np.where(np.arange(len(s)) % 10, 50, 100).astype(np.uint16) for s in sweeps]
    frames = [render_sweep(s, c, PAPER) for s, c in zip(sweeps, classes, strict=True)]
    time = 20_000_000
    T_camera_world = AXES @ np.linalg.inv(trajectory.interpolate(time)[0])
    clouds = []
    for i, (s, c) in enumerate(zip(sweeps, classes, strict=True)):
        pose = T_camera_world @ trajectory.poses[i]
        if i in static_sweeps(trajectory, time, PAPER):
            clouds.append((s[c < 100], pose, (50.0, 3.0)))
        if i == trajectory.nearest(time):
            clouds.append((s[c >= 100], pose, (80.0, 35.0)))
    depth = compose_depth(*drawing(frames, trajectory, time, PAPER, camera=camera))
    np.testing.assert_array_equal(depth, reference(camera, clouds))
    assert np.isfinite(depth).mean() > 0.5


@pytest.mark.parametrize("primitive", ["splats", "triangles"])
def test_scenes_of_700_metres(primitive):
    parameters = RenderParameters(primitive=primitive, crop=800, max_depth=700)
    y, z = np.meshgrid(np.arange(-60, 61, 2.0), np.arange(-60, 61, 2.0))
    far = np.stack([np.full(y.shape, 690.0), y, z], axis=-1).reshape(-1, 3).astype(np.float32)
    beyond = far + np.float32([30, 200, 0])
    points = np.concatenate([far, beyond])
    frame = render_sweep(points, np.full(len(points), 50, np.uint16), parameters)
    camera = Camera(np.array([[700.0, 0, 300], [0, 700, 60], [0, 0, 1]]), 601, 121)
    depth = compose_depth(*drawing(frame, parameters=parameters, camera=camera))
    wall = depth[30:90, 270:330]
    assert np.isfinite(wall).mean() > 0.9
    np.testing.assert_allclose(wall[np.isfinite(wall)], 690, rtol=1e-5)
    assert np.nanmax(depth) <= 700
