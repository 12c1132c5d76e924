"""KITTI's LiDAR: detected from points, the laser of each point, and what ray origins bring."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from docdepth.config import parameters
from docdepth.datasets import kitti_lidar, open_dataset
from docdepth.datasets.sensor_pose import ground_of
from docdepth.errors import NOTE
from docdepth.evaluation.runs import evaluate_depth
from docdepth.geometry.se3 import transform_points
from docdepth.io.frames import read_sensors
from docdepth.io.run_folder import RunFolder
from docdepth.pipeline import run_classify, run_odometry, run_render
from docdepth.pipeline.cameras import place_for_poses
from docdepth.synthetic import scene, sensor, sensors, write_drive
from docdepth.synthetic.drive import Drive

pytestmark = pytest.mark.usefixtures("whole_ground_search")

CITY = scene("city", 1)


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    return write_drive(tmp_path_factory.mktemp("drive"), "city", "HDL-64", frames=8, seed=5)


@pytest.fixture(scope="module")
def short(tmp_path_factory):
    folder = tmp_path_factory.mktemp("short")
    return write_drive(folder, "city", "HDL-64", frames=4, seed=5, images=False)


def test_real_sweeps_are_known_and_lie_on_the_cones(drive_0005):
    dataset = open_dataset(drive_0005)
    points, found = dataset.sweep(40).points, dataset.sweep(40).sensor_rig
    assert found is not None
    # Points come ring by ring: a new one begins where azimuth passes forward again.
    azimuth = np.mod(np.arctan2(points[:, 1], points[:, 0]), 2 * np.pi)
    ring = np.cumsum(np.diff(azimuth, prepend=0) < -np.pi)
    assert (found.index == ring.clip(0, 63)).mean() > 0.998
    distance = np.hypot(points[:, 0], points[:, 1])
    slopes = np.tan(np.arctan(kitti_lidar.SLOPES) + kitti_lidar.ELEVATION_ERROR)
    cone = kitti_lidar.HEIGHTS[found.index] + slopes[found.index] * distance
    assert np.median(np.abs(cone - points[:, 2])) < 1e-3


def test_neighbours_fire_evenly_only_as_seen_from_their_laser(drive_0005):
    """Across a depth jump the azimuth advances by whole steps if a laser's place is right."""
    sweep = open_dataset(drive_0005).sweep(40)
    points, found = sweep.points, sweep.sensor_rig
    azimuth = np.arctan2(points[:, 1], points[:, 0])
    nearness = 1 / np.maximum(np.hypot(points[:, 0], points[:, 1]), 0.1)
    step, jump = np.diff(azimuth), np.diff(nearness)
    same = (np.diff(found.index.astype(int)) == 0) & (np.abs(step) < 0.02) & (found.index[1:] < 40)
    often = np.median(step[same & (np.abs(jump) < 1e-3) & (step > 0.002) & (step < 0.0045)])
    same &= np.abs(jump) > 0.03
    rest = {}
    for way, aside in {
        "axis": 0 * jump,
        "laser": kitti_lidar.LATERAL_OFFSETS[found.index[1:]],
    }.items():
        steps = (step - aside * jump)[same] / often
        rest[way] = np.median(np.abs(steps - np.round(steps)))
    assert same.sum() > 500
    assert rest["laser"] < 0.05
    assert rest["axis"] > 0.2


def test_its_points_are_raised_and_the_camera_sees_them_where_they_were(drive_0005, caplog):
    """By 0.205 degrees about the horizontal axis across each ray, as KISS-ICP does."""
    with caplog.at_level("INFO"):
        dataset = open_dataset(drive_0005)
    assert "points are raised by the 0.205 degrees" in caplog.text
    raw = np.fromfile(dataset.sweep_files(40)[0], np.float32).reshape(-1, 4)[:, :3]
    axes = np.cross(raw, [0, 0, 1])
    axes *= np.radians(0.205) / np.maximum(np.linalg.norm(axes, axis=1), 1e-9)[:, None]
    raised = Rotation.from_rotvec(axes).apply(raw)
    np.testing.assert_allclose(dataset.sweep(40).points, raised, atol=1e-4)
    rows = {
        name: np.array(values.split(), float)
        for file in ("calib_velo_to_cam.txt", "calib_cam_to_cam.txt")
        for line in (drive_0005.parent / file).read_text().splitlines()
        for name, _, values in [line.partition(":")]
        if name in ("R", "T", "R_rect_00", "P_rect_02")
    }
    P, R = rows["P_rect_02"].reshape(3, 4), rows["R_rect_00"].reshape(3, 3)
    in_camera_0 = raw @ rows["R"].reshape(3, 3).T + rows["T"]
    before = in_camera_0 @ R.T + np.linalg.solve(P[:, :3], P[:, 3])
    after = transform_points(dataset.cameras["image_02"].T_camera_lidar, raised)
    ahead = (np.abs(raw[:, 1]) < 0.01 * raw[:, 0]) & (raw[:, 0] > 3)
    assert ahead.sum() > 100
    assert np.abs((after / after[:, 2:] - before / before[:, 2:])[ahead]).max() < 2e-4
    as_given = transform_points(place_for_poses(dataset, "image_02"), raw)
    np.testing.assert_allclose(as_given, before, atol=1e-4)


@pytest.mark.parametrize("name", sorted(sensors()))
def test_sweeps_of_other_lidars_are_not_taken_for_it(name):
    sweep = Drive(CITY, sensor(name), 4, 1).sweep(2)
    assert kitti_lidar.is_kitti_lidar([sweep.points]) == (name == "HDL-64")
    few = sweep.points[:20]
    assert kitti_lidar.is_kitti_lidar([few, sweep.points]) == (name == "HDL-64")
    assert not kitti_lidar.is_kitti_lidar([few])


def test_it_stands_upright_as_the_ground_says(drive_0005):
    dataset = open_dataset(drive_0005)
    assert dataset.up == (0, 0, 1)
    ground = ground_of(dataset)
    assert ground is not None
    assert ground.tilt_deg < 2


def test_the_laser_of_each_point_is_found():
    exact = replace(sensor("HDL-64"), noise=0.0, bias=0.0)
    sweep = Drive(CITY, exact, 4, 1, skew=True).sweep(2)
    found = kitti_lidar.sensor_rig(sweep.points)
    assert (found.index == sweep.ring).mean() > 0.999
    strange = np.full((3, 3), np.nan, np.float32)
    strange[1] = 0
    assert (kitti_lidar.sensor_rig(strange).index < 64).all()


@pytest.mark.nightly
def test_depth_is_better_than_as_if_seen_from_the_origin(drive, tmp_path):
    dataset, blind = open_dataset(drive), open_dataset(drive)
    see = blind.sweep
    blind.sweep = lambda k: replace(see(k), sensor_rig=None)
    error = {}
    for way, data in {"lasers": dataset, "origin": blind}.items():
        run = RunFolder.create(tmp_path / way, None, parameters())
        run_odometry(run, data, data.poses)
        run_classify(run)
        run_render(run, data.cameras["image_2"])
        error[way] = evaluate_depth(run.path, drive / "depth_2").all
    assert error["lasers"].edge_displacement < 0.85 * error["origin"].edge_displacement
    assert error["lasers"].too_far < 0.85 * error["origin"].too_far


@pytest.mark.slow
def test_azimuth_tells_when_a_compensated_sweep_saw_each_point(short):
    sweep = open_dataset(short).sweep(3)
    exact = Drive(scene("city", 5), sensor("HDL-64"), 4, 5).sweep(3).relative_time
    assert sweep.motion_compensated
    off = np.abs(sweep.relative_time - exact)
    off = np.minimum(off, 1 - off)  # the seam lies behind
    assert np.median(off) < 0.005
    assert off.max() < 0.05
    assert np.corrcoef(sweep.relative_time, exact)[0, 1] > 0.99


@pytest.mark.parametrize(("said", "width"), [("", 0.2), ("beam_width_deg: 0.1\n", 0.1)])
def test_its_beams_are_wide_unless_a_recording_says_otherwise(tmp_path, short, said, width):
    drive = tmp_path / "00"
    shutil.copytree(short, drive)
    assert open_dataset(drive).sweep(0).sensor_rig.beam_width == 0  # a simulated drive
    (drive / "docdepth.yaml").write_text("motion_compensated: true\n" + said)
    rig = open_dataset(drive).sweep(0).sensor_rig
    assert np.degrees(rig.beam_width) == pytest.approx(width)
    run = RunFolder(tmp_path / "run")
    run.write_sensors(rig, {})
    assert read_sensors(run.sensors_path, rig.index).beam_width == rig.beam_width


def test_points_of_another_format_that_are_raised_are_told(tmp_path, short, caplog):
    shutil.copytree(short / "velodyne", tmp_path / "sweeps")
    caplog.set_level(NOTE)
    told = tmp_path / "docdepth.yaml"
    told.write_text("sweeps: sweeps\nrate: 10\n")
    raised = open_dataset(tmp_path).sweep(0).points
    assert "lacks 0.205 degrees; they are raised by it" in caplog.text
    caplog.clear()
    told.write_text("sweeps: sweeps\nrate: 10\nsensor_origin: [0, 0, 0]\n")
    as_given = open_dataset(tmp_path).sweep(0).points
    assert "raised" not in caplog.text
    np.testing.assert_allclose(raised, kitti_lidar.raised(as_given, np.radians(0.205)), atol=1e-4)
