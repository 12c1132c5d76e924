"""Synthetic drives against geometry that is computed by hand."""

from __future__ import annotations

import sys
from dataclasses import replace

import cv2
import numpy as np
import pytest
import scenes  # noqa: F401  adds its scenes
import yaml
from plain_scene import level_road, plain_scene

from docdepth import synthetic
from docdepth.errors import InputError, MissingExtraError
from docdepth.geometry.camera import Camera
from docdepth.io.tracks import read_tracks
from docdepth.synthetic import Actor, Drive, Pace, Paint, Part, Path, box, pose_of

pytest.importorskip("embreex")

WALL = Paint(50, (0.5, 0.5, 0.5), 5.0)
CAR = Paint(10, (0.5, 0.5, 0.5), 5.0)
HEIGHT = 1.73


def perfect(name="HDL-64", **changes):
    """A sensor that measures exactly."""
    return replace(synthetic.sensor(name), noise=0.0, bias=0.0, reach=1e6, **changes)


def moving_box(speed, departure=-np.inf):
    """A box of 4 x 2 x 1.5 m, 0.3 m above the ground, along y = 5 from x = 10."""
    road = level_road()
    path = Path(road, np.array([(10.0, 5.0), (11.0, 5.0)]), Pace(speed, departure=departure))
    return Actor("box", [Part(box((4, 2, 1.5), (0, 0, 1.05), CAR))], path, 10, 252)


def box_range(origin, direction, low, high):
    """Range at which rays enter a box (slab method); inf = no hit."""
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (low - origin) / direction, (high - origin) / direction
    enter, leave = np.minimum(a, b).max(axis=1), np.maximum(a, b).min(axis=1)
    return np.where((enter < leave) & (leave > 0), enter, np.inf)


def to_world(points, poses):
    return np.einsum("nij,nj->ni", poses[:, :3, :3], points.astype(np.float64)) + poses[:, :3, 3]


@pytest.mark.parametrize("name", list(synthetic.sensors()))
def test_standing_sensor_measures_plane_and_box_exactly(name):
    sensor = perfect(name)
    wall = box((1.0, 30.0, 12.0), (20.0, 0.0, 6.0), WALL)
    drive = Drive(plain_scene([wall]), sensor, 2)
    sweep, pattern = drive.sweep(1), sensor.pattern(1)
    directions = pattern.directions
    with np.errstate(divide="ignore"):
        plane = np.where(directions[:, 2] < 0, -HEIGHT / directions[:, 2], np.inf)
    low, high = np.array((19.5, -15.0, -HEIGHT)), np.array((20.5, 15.0, 12.0 - HEIGHT))
    solid = box_range(np.zeros(3), directions, low, high)
    expected = np.minimum(plane, solid)
    # The plane ends 100 m to the side, and a ray along an edge may fall on either side of it.
    inside = (expected < 90.0) & (expected > sensor.min_range)
    found = np.linalg.norm(sweep.points.astype(np.float64), axis=1)
    assert 0.985 * inside.sum() < len(found) < 1.1 * inside.sum() + 3000
    seen = directions[:, None] if len(directions) < 10 else directions
    assert len(seen) == len(pattern.which) == len(pattern.rings)
    flat = sweep.labels == 40
    assert np.abs(sweep.points[flat, 2] + HEIGHT).max() < 1e-3
    front = (sweep.labels == 50) & (found < 60)
    residual = np.minimum(
        np.abs(sweep.points[front] - low).min(axis=1),
        np.abs(sweep.points[front] - high).min(axis=1),
    )
    assert front.sum() > 100
    assert residual.max() < 1e-3
    unit = sweep.points / found[:, None]
    again = box_range(np.zeros(3), unit.astype(np.float64), low, high)
    assert (np.abs(again - found)[front] < 5e-3).mean() > 0.995


def test_compensated_static_points_lie_on_the_geometry_while_the_ego_drives():
    wall = box((40.0, 1.0, 8.0), (15.0, 8.0, 4.0), WALL)
    drive = Drive(plain_scene([wall], speed=15.0), perfect(), 6)
    for k in (0, 3, 5):
        sweep = drive.sweep(k)
        pose = drive.T_scene_world @ drive.poses[k]
        points = to_world(sweep.points, np.repeat(pose[None], len(sweep.points), axis=0))
        flat, solid = sweep.labels == 40, sweep.labels == 50
        assert solid.sum() > 5000
        assert np.abs(points[flat, 2]).max() < 2e-3
        assert np.abs(points[solid & (points[:, 1] < 7.6), 1] - 7.5).max() < 2e-3
    travelled = np.linalg.norm(drive.poses[5, :3, 3] - drive.poses[0, :3, 3])
    assert travelled == pytest.approx(7.5, abs=0.02)


def test_skewed_points_deskewed_with_the_exact_motion_are_the_compensated_ones():
    scene = synthetic.scene("residential", 1)
    raw = Drive(scene, synthetic.sensor("XT-32"), 4, skew=True)
    whole = Drive(scene, synthetic.sensor("XT-32"), 4)
    skewed, straight = raw.sweep(2), whole.sweep(2)
    assert len(skewed.points) == len(straight.points)
    times = raw.times[2] + np.round(skewed.relative_time.astype(np.float64) * 1e8).astype(np.int64)
    moments, which = np.unique(times, return_inverse=True)
    points = to_world(skewed.points, raw.pose_at(moments)[which])
    stamp = np.linalg.inv(raw.poses[2])
    points = points @ stamp[:3, :3].T + stamp[:3, 3]
    assert np.abs(points - straight.points).max() < 2e-3
    assert np.abs(skewed.points - straight.points).max() > 0.2
    # Clockwise from behind: forward is measured at the stamp.
    azimuth = np.arctan2(skewed.points[:, 1], skewed.points[:, 0])
    assert np.abs(0.5 - azimuth / (2 * np.pi) - (skewed.relative_time + 0.5)).max() < 1e-3


def test_moving_objects_are_hit_at_their_pose_at_the_time_of_each_ray():
    drive = Drive(plain_scene(actors=[moving_box(12.0)], speed=7.0), perfect(), 5)
    sweep = drive.sweep(3)
    mine = sweep.labels == (1 << 16 | 252)
    assert mine.sum() > 500
    np.testing.assert_allclose(sweep.speed[mine], 12.0, atol=1e-3)
    assert not sweep.speed[~mine].any()
    pose = drive.T_scene_world @ drive.poses[3]
    points = sweep.points[mine].astype(np.float64) @ pose[:3, :3].T + pose[:3, 3]
    seconds = 0.3 + 0.1 * sweep.relative_time[mine].astype(np.float64)
    local = points - np.stack([10 + 12 * seconds, 0 * seconds + 5, 0 * seconds + 1.05], axis=1)
    outside = np.abs(np.abs(local) - (2.0, 1.0, 0.75)).min(axis=1)
    assert outside.max() < 3e-3
    assert (np.abs(local) < (2.003, 1.003, 0.753)).all()
    assert np.ptp(seconds) > 0.003


def test_a_car_that_departs_later_has_the_moving_class_in_all_sweeps():
    scene = plain_scene(actors=[moving_box(5.0, departure=0.6)])
    drive = Drive(scene, perfect("XT-32"), 20)
    early, late = drive.sweep(1), drive.sweep(15)
    assert early.moving.any()
    assert not early.speed[early.moving].any()
    assert late.speed[late.moving].max() == pytest.approx(1.8 * 0.9, abs=0.1)
    short = Drive(scene, perfect("XT-32"), 4)
    assert not short.sweep(1).moving.any()
    assert (short.sweep(1).labels == (1 << 16 | 10)).any()


def test_noise_and_dropout_are_those_of_the_sensor():
    sensor = replace(synthetic.sensor("OS1-128"), max_range=60.0)
    wall = box((1.0, 60.0, 30.0), (15.0, 0.0, 10.0), Paint(50, (0.5, 0.5, 0.5), 0.4))
    scene = plain_scene([wall])
    sweep = Drive(scene, sensor, 2).sweep(0)
    on_wall = sweep.points[sweep.labels == 50].astype(np.float64)
    along = np.linalg.norm(on_wall, axis=1)
    error = (on_wall[:, 0] - 14.5) / (on_wall[:, 0] / along)
    front = np.abs(on_wall[:, 1]) < 20
    assert error[front].std() == pytest.approx(sensor.noise, rel=0.1)
    assert abs(error[front].mean()) < 1e-3
    exact = Drive(scene, replace(sensor, reach=1e6), 2).sweep(0)
    assert len(sweep.points) < 0.99 * len(exact.points)
    near, far = (np.linalg.norm(s.points, axis=1) > 30 for s in (sweep, exact))
    assert near.sum() < 0.8 * far.sum()


def test_camera_depth_of_plane_and_box():
    wall = box((2.0, 6.0, 3.0), (31.0, 0.0, 1.5), WALL)
    drive = Drive(plain_scene([wall]), perfect(), 2)
    camera = Camera(np.array([(300.0, 0, 200.0), (0, 310.0, 80.0), (0, 0, 1.0)]), 401, 161)
    T_world_camera = np.eye(4)
    T_world_camera[:3, :3] = np.array([(0, 0, 1.0), (-1.0, 0, 0), (0, -1.0, 0)])
    depth = drive.depth(camera, T_world_camera, 0)
    v, u = np.indices((161, 401))
    with np.errstate(divide="ignore"):
        expected = np.where(v > 80, HEIGHT * 310.0 / (v - 80.0), np.inf)
    x, y = (u - 200.0) / 300.0 * 30.0, (v - 80.0) / 310.0 * 30.0
    front = (np.abs(x) < 3.0) & (y < HEIGHT) & (y > HEIGHT - 3.0)
    expected = np.where(front, 30.0, expected)
    edge = np.abs(np.abs(x) - 3.0) < 0.1
    checked = ~edge & (expected < 90) & (np.abs(y - HEIGHT) > 0.1) & (np.abs(v - 80) > 3)
    np.testing.assert_allclose(depth[checked], expected[checked], rtol=1e-4)
    assert np.isnan(depth[:60][~(front | edge)[:60]]).all()


def test_image_between_sweeps_shows_moving_objects_at_its_own_time():
    drive = Drive(plain_scene(actors=[moving_box(-8.0 * -1)]), perfect(), 4)
    view, camera = drive.image(2), drive.rig.camera
    assert drive.times[2] < drive.camera_times[2] < drive.times[3]
    assert len(drive.camera_times) == 3
    mine = (view.labels & 0xFFFF) == 252
    assert mine.sum() > 500
    v, u = np.nonzero(mine)
    z = view.depth[mine].astype(np.float64)
    K = camera.K
    points = np.stack([(u - K[0, 2]) / K[0, 0] * z, (v - K[1, 2]) / K[1, 1] * z, z], axis=1)
    T_scene_camera = drive.T_scene_world @ drive.pose_at(drive.camera_times[2:3])[0]
    T_scene_camera = T_scene_camera @ np.linalg.inv(drive.rig.T_camera_lidar)
    points = points @ T_scene_camera[:3, :3].T + T_scene_camera[:3, 3]
    local = points - (10 + 8.0 * drive.camera_times[2] * 1e-9, 5, 1.05)
    assert np.abs(np.abs(local) - (2.0, 1.0, 0.75)).min(axis=1).max() < 2e-3


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=() if name in ("crossing", "fences") else pytest.mark.slow)
        for name in synthetic.SCENES
    ],
)
def test_scenes_have_ground_that_is_not_flat_and_traffic(name):
    scene = synthetic.scene(name, 0)
    drive = Drive(scene, synthetic.sensor("XT-32"), 50)
    moving = [a for a in scene.actors if a.moves_between(0, 4.9)]
    assert len(moving) >= {"fences": 4, "still_fences": 0}.get(name, 8)
    waits = [a for a in moving if not a.moves_between(-0.05, 1.5)]
    assert waits or name in ("arrivals", "highway", "overtaking", "fences", "still_fences")
    sweep = drive.sweep(10)
    classes = set((sweep.labels & 0xFFFF).tolist())
    assert {40, 70, *((51,) if "fences" in name else (80, 252))} <= classes
    assert len(sweep.points) > 20000
    assert np.isfinite(sweep.points).all()
    assert sweep.points.dtype == np.float32
    assert sweep.labels.dtype == np.uint32
    ground = np.isin(sweep.labels & 0xFFFF, (40, 44, 48, 72))
    near = ground & (np.linalg.norm(sweep.points, axis=1) < 8)
    assert abs(np.median(sweep.points[near, 2]) + HEIGHT) < 0.25
    assert sweep.points[ground, 2].std() > 0.03
    assert (sweep.speed > 0.3)[~sweep.moving].sum() == 0


def test_pedestrians_walk_on_moving_legs():
    scene = synthetic.scene("city", 0)
    walkers = [a for a in scene.actors if a.label == 30 and a.speed(3.0)[0] > 0.3]
    assert len(walkers) >= 8
    speeds = np.array([a.speed(3.0)[0] for a in walkers])
    assert ((speeds > 0.8) & (speeds < 1.6)).all()
    poses = np.array(walkers[0].part_poses(np.array([3.0, 3.3])))
    assert len(poses) == 5
    assert np.abs(poses[1, :, :3, :3] - poses[0, :, :3, :3]).max() > 0.05


@pytest.mark.slow
def test_same_seed_same_drive_in_any_order_of_requests():
    sensor = synthetic.sensor("VLP-16")
    one = Drive(synthetic.scene("city", 3), sensor, 6, seed=5)
    two = Drive(synthetic.scene("city", 3), sensor, 6, seed=5)
    two.sweep(0), two.image(1)
    first, second = one.sweep(4), two.sweep(4)
    for name in ("points", "intensity", "labels", "speed", "relative_time", "ring"):
        assert getattr(first, name).tobytes() == getattr(second, name).tobytes()
    other = Drive(synthetic.scene("city", 3), sensor, 6, seed=6).sweep(4)
    assert other.points.tobytes() != first.points.tobytes()
    moved = Drive(synthetic.scene("city", 4), sensor, 6, seed=5)
    assert moved.sweep(4).points.tobytes() != first.points.tobytes()


def test_rosette_never_repeats():
    sensor = synthetic.sensor("Avia")
    first, second = sensor.pattern(0), sensor.pattern(1)
    assert len(first.directions) == 24000
    assert np.abs(first.directions - second.directions).max() > 0.1
    x, y, z = first.directions.T
    assert np.degrees(np.ptp(np.arctan2(y, x))) == pytest.approx(70.4 + 1.0, abs=2.0)
    assert np.degrees(np.ptp(np.arcsin(z))) == pytest.approx(77.2 + 0.7, abs=2.0)


@pytest.mark.parametrize("skew", [pytest.param(False, marks=pytest.mark.slow), True])
def test_layout_on_disk(tmp_path, skew):
    steps = []
    folder = synthetic.write_drive(
        tmp_path, "crossing", "VLP-16", 4, 2, skew=skew, progress=lambda *at: steps.append(at)
    )
    assert folder == tmp_path / "sequences" / "00"
    assert steps == [("synth", k, 4) for k in (1, 2, 3, 4)]
    drive = Drive(synthetic.scene("crossing", 2), synthetic.sensor("VLP-16"), 4, 2, skew)
    calib = {
        line.split(":")[0]: np.array(line.split(":")[1].split(), float).reshape(3, 4)
        for line in (folder / "calib.txt").read_text().splitlines()
    }
    assert set(calib) == {"P0", "P1", "P2", "P3", "Tr"}
    Tr = np.vstack([calib["Tr"], (0, 0, 0, 1)])
    poses = np.loadtxt(folder / "poses.txt").reshape(-1, 3, 4)
    for k in range(4):
        pose = np.vstack([poses[k], (0, 0, 0, 1)])
        np.testing.assert_allclose(np.linalg.inv(Tr) @ pose @ Tr, drive.poses[k], atol=1e-9)
        sweep = drive.sweep(k)
        points = np.fromfile(folder / f"velodyne/{k:06d}.bin", np.float32).reshape(-1, 4)
        np.testing.assert_array_equal(points[:, :3], sweep.points)
        labels = np.fromfile(folder / f"labels/{k:06d}.label", np.uint32)
        np.testing.assert_array_equal(labels, sweep.labels)
        assert len(np.load(folder / f"speeds/{k:06d}.npy")) == len(points)
        times = folder / f"point_times/{k:06d}.bin"
        assert times.exists() == skew
        if skew:
            assert np.abs(np.fromfile(times, np.float32)).max() <= 0.5
            assert times.stat().st_size == 4 * len(points)
    np.testing.assert_allclose(np.loadtxt(folder / "times.txt"), drive.times * 1e-9, atol=1e-9)
    shutter = np.loadtxt(folder / "image_2/times.txt")
    np.testing.assert_allclose(shutter, drive.camera_times * 1e-9, atol=1e-9)
    assert (folder / "image_2/size.txt").read_text().split() == ["1242", "375"]
    names = sorted(path.stem for path in (folder / "image_2").glob("*.png"))
    assert names == ["000000", "000001", "000002"]
    assert cv2.imread(str(folder / "image_2/000001.png")).shape == (375, 1242, 3)
    depth, label = (np.load(folder / f"{n}/000001.npy") for n in ("depth_2", "class_2"))
    assert depth.shape == label.shape == (375, 1242)
    assert (depth.dtype, label.dtype) == (np.float32, np.uint32)
    np.testing.assert_array_equal(np.isnan(depth), label == 0)
    seen = np.array([np.bincount(drive.sweep(k).labels >> 16, minlength=2000) for k in range(4)])
    for track, true in zip(read_tracks(folder / "tracks.csv"), drive.tracks(), strict=True):
        assert (track.id, track.kind) == (true.id, true.kind)
        np.testing.assert_array_equal(track.times, drive.times)
        np.testing.assert_allclose(track.poses[:, :3, 3], true.poses[:, :3, 3], atol=1e-4)
        np.testing.assert_array_equal(track.points, seen[:, track.id])
    about = yaml.safe_load((folder / "docdepth.yaml").read_text())
    assert about["motion_compensated"] is not skew
    assert about["scene"] == "crossing"
    # P2 and Tr together are the camera that took the depth.
    seen = drive.sweep(1)
    static = ~seen.moving
    points = np.fromfile(folder / "velodyne/000001.bin", np.float32).reshape(-1, 4)[static, :3]
    camera = calib["P2"] @ Tr @ np.column_stack([points, np.ones(len(points))]).T
    if not skew:
        u, v = np.round(camera[:2] / camera[2]).astype(int)
        inside = (camera[2] > 2) & (u >= 0) & (u < 1242) & (v >= 0) & (v < 375)
        error = np.abs(depth[v[inside], u[inside]] - camera[2][inside])
        assert np.nanmedian(error) < 0.1


def test_mistakes_give_clear_errors(monkeypatch):
    with pytest.raises(InputError, match="unknown scene 'moon'"):
        synthetic.scene("moon")
    with pytest.raises(InputError, match="unknown sensor 'sonar'"):
        synthetic.sensor("sonar")
    with pytest.raises(InputError, match="long enough for 2 to"):
        Drive(plain_scene(), perfect(), 10_000)
    monkeypatch.setitem(sys.modules, "embreex.rtcore_scene", None)
    with pytest.raises(MissingExtraError, match=r"docdepth\[synth\]"):
        Drive(plain_scene(), perfect(), 2)
    assert pose_of(1.0, 2.0, 3.0).shape == (4, 4)
