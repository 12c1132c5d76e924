"""Two LiDARs on one vehicle, against exact synthetic drives of both."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

from docdepth.config import parameters
from docdepth.datasets import open_dataset
from docdepth.datasets.formats.docdepth_run import RunDataset
from docdepth.dynamics import voting
from docdepth.errors import CalibrationError, DatasetError, InputError
from docdepth.evaluation.runs import evaluate_depth, evaluate_labels
from docdepth.geometry.camera import Camera, View
from docdepth.geometry.lidar_frame import LidarFrame, SensorRig, lidar_views
from docdepth.geometry.scan_mesh import ScanMesh
from docdepth.geometry.trajectory import Trajectory
from docdepth.io.run_folder import RunFolder
from docdepth.pipeline import run_classify, run_odometry, run_render
from docdepth.render.depth_map import compose_depth, render_list
from docdepth.render.render_sweep import RenderSweep
from docdepth.synthetic import scene, sensor, write_drive
from docdepth.synthetic.drive import Drive
from motion import pose

HIGH, LOW = 1.73, 0.5  # metres above the ground
FRAMES = 8


def test_each_lidar_views_its_own_points_from_its_own_place():
    points = np.random.default_rng(0).uniform(-20, 20, (1000, 3)).astype(np.float32)
    T = np.array([pose(1, 2, 3), pose(-2, 0.5, 1, 0.7)])
    sensor_rig = SensorRig((np.arange(1000) % 2).astype(np.uint8), T)
    whole, joined = ScanMesh(points, sensor_rig=sensor_rig), []
    for k, view in enumerate(lidar_views(points, sensor_rig)):
        seen, T_lidar_sensor, _ = view
        assert view.ray_origins() is None
        rows = np.flatnonzero(sensor_rig.index == k)
        assert np.isnan(np.delete(seen, rows, axis=0)).all()
        back = seen[rows] @ T_lidar_sensor[:3, :3].T + T_lidar_sensor[:3, 3]
        np.testing.assert_allclose(back, points[rows], atol=1e-5)
        joined.append(rows[ScanMesh(seen[rows]).triangles])
    np.testing.assert_array_equal(whole.triangles, np.concatenate(joined))


def test_ray_origins_follow_a_driving_lidar():
    """The LiDAR passes a panel at 20 m/s; deskewed, returns beside the panel lie behind it."""
    angles = np.linspace(0.5, -2.5, 1500)  # forward on the left to backward on the right
    a, e = np.meshgrid(angles, np.radians(np.linspace(-8, 8, 9)))
    look = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], -1).reshape(-1, 3)
    time_offset = (-a.ravel() * 0.1 / (2 * np.pi)).astype(np.float32)
    ray_origins = time_offset[:, None] * (20.0, 0, 0)
    along = -1.5 / np.minimum(look[:, 1], -1e-6)
    panel = np.abs((ray_origins + along[:, None] * look)[:, 0] - 0.2) < 0.5
    ranges = np.where(panel, along, 12.0)
    points = (ray_origins + ranges[:, None] * look).astype(np.float32)
    standing = SensorRig.single((0, 0, 0), len(points))
    (view,) = lidar_views(
        points, standing.with_ego_motion((20, 0, 0), time_offset).select(slice(None))
    )
    np.testing.assert_allclose(view.ray_origins(), ray_origins, atol=1e-5)
    np.testing.assert_array_equal(view.points, points)

    def mixed(sensor_rig):
        """Triangles between returns of the panel and others; only its outline should have any."""
        corners = panel[ScanMesh(points, sensor_rig=sensor_rig).triangles]
        return int((corners.any(axis=1) & ~corners.all(axis=1)).sum())

    assert mixed(standing.with_ego_motion((20, 0, 0), time_offset)) == 2 * (
        9 + 9 - 2
    )  # at its two ends
    assert mixed(standing) > 500
    with pytest.raises(InputError, match=r"ego_displacement \(3, 3\)"):
        standing.with_ego_motion((20, 0, 0), time_offset[:3])
    # A frame that is told both begins there, too.
    classid, p = np.full(len(points), 50, np.uint16), parameters("default").render
    rows = np.arange(len(points), dtype=np.uint32)
    frame = LidarFrame(points, rows, "", len(rows), classid=classid)
    told = RenderSweep(replace(frame, time_offset=time_offset), p, velocity=(20, 0, 0))
    camera = Camera(np.array([[200.0, 0, 160], [0, 200, 60], [0, 0, 1]]), 320, 120)
    trajectory = Trajectory(np.array([0, 1]), np.repeat(np.eye(4)[None], 2, axis=0))
    right = np.eye(4)  # looks to the right, where the panel is
    right[:3, :3] = [[-1, 0, 0], [0, 0, -1], [0, -1, 0]]
    moving = standing.with_ego_motion((20, 0, 0), time_offset)
    view = View.at(camera, right, trajectory, 0)
    drawn = [
        compose_depth(render_list(view, trajectory, lambda _, sweep=sweep: sweep, p))
        for sweep in (told, RenderSweep(replace(frame, sensor_rig=moving), p),
                      RenderSweep(frame, p))
    ]  # fmt: skip
    np.testing.assert_array_equal(drawn[0], drawn[1])
    assert (drawn[0] != drawn[2])[np.isfinite(drawn[0])].any()


def test_rays_of_a_laser_begin_beside_the_axis():
    """A laser 5 cm left of an axis 0.2 m above the origin, looking everywhere."""
    angles = np.linspace(-3, 3, 50)
    look = np.column_stack([np.cos(angles), np.sin(angles), 0.1 * np.ones(50)])
    left = np.column_stack([-np.sin(angles), np.cos(angles), np.zeros(50)])
    ray_origins = 0.05 * left + (0, 0, 0.2)
    points = (ray_origins + 8 * look).astype(np.float32)
    T = np.array([pose(0, 0, 0.2), pose(0, 0, 0.1)])
    sensor_rig = SensorRig(np.zeros(50, np.uint8), T, np.array([0.05, 0]), np.zeros(2))
    (view,) = lidar_views(points, sensor_rig)
    seen, T_lidar_sensor, _ = view
    np.testing.assert_allclose(T_lidar_sensor, pose(0, 0, 0.15))
    np.testing.assert_allclose(seen, points - (0, 0, 0.15), atol=1e-6)
    np.testing.assert_allclose(view.ray_origins(), ray_origins - (0, 0, 0.15), atol=4e-4)
    assert len(ScanMesh(points, sensor_rig=sensor_rig).parts) == 1


@pytest.mark.parametrize(
    ("index", "T", "message"),
    [
        ([0, 2], [np.eye(4)] * 2, "sensor 2"),
        ([0, 1], np.eye(4), "shapes"),
        ([0, 1], [np.eye(4), np.diag([2.0, 1, 1, 1.0])], "rotation"),
    ],
)
def test_wrong_sensors_are_refused(index, T, message):
    with pytest.raises(InputError, match=message):
        SensorRig(np.array(index, np.uint8), np.array(T))
    with pytest.raises(InputError, match="each of 3 points"):
        ScanMesh(
            np.ones((3, 3), np.float32),
            sensor_rig=SensorRig(np.zeros(2, np.uint8), np.eye(4)[None]),
        )


@pytest.fixture(scope="module")
def two(tmp_path_factory):
    """A sequence of two LiDARs, one above the other: XT-32 on the roof and on the bumper."""
    root = tmp_path_factory.mktemp("two")
    folder = write_drive(root, scene="city", sensor="XT-32", frames=FRAMES, seed=4)
    street = scene("city", 4)
    low = Drive(street, replace(sensor("XT-32"), height=LOW), FRAMES, seed=9)
    (folder / "velodyne_2").mkdir()
    for k in range(FRAMES):
        sweep, name = low.sweep(k), f"{k:06d}"
        rows = np.column_stack([sweep.points, sweep.intensity])
        rows.tofile(folder / "velodyne_2" / f"{name}.bin")
        labels = np.fromfile(folder / "labels" / f"{name}.label", np.uint32)
        np.concatenate([labels, sweep.labels]).tofile(folder / "labels" / f"{name}.label")
        speeds = np.load(folder / "speeds" / f"{name}.npy")
        np.save(folder / "speeds" / f"{name}.npy", np.append(speeds, sweep.speed))
    T_camera0_lidar = Drive(street, sensor("XT-32"), FRAMES).rig.Tr
    Tr_2 = T_camera0_lidar @ pose(0, 0, LOW - HIGH)
    with (folder / "calib.txt").open("a") as stream:
        stream.write("Tr_2: " + " ".join(f"{v:.12e}" for v in Tr_2[:3].ravel()) + "\n")
    return folder


def run(dataset, path):
    folder = RunFolder.create(path, None, parameters(settings={"output.layers": ["time"]}))
    run_odometry(folder, dataset, dataset.poses)
    run_classify(folder)
    run_render(folder, dataset.cameras["image_2"])
    return folder


def grid(x, width, height):
    """A wall across the x axis, a return every 2 cm."""
    y, z = np.meshgrid(np.arange(-width, width, 0.02), np.arange(-height, height, 0.02))
    return np.stack([np.full(y.size, x), y.ravel(), z.ravel()], axis=1).astype(np.float32)


@pytest.mark.parametrize("vote_model", ["range_image", "surface"])
def test_each_lidar_votes_from_its_own_place(vote_model):
    """The second LiDAR stands behind the wall that the first one sees, and looks farther on."""
    p = parameters(settings={"dynamics.vote_model": vote_model}).dynamics
    ahead = pose(6, 0, 0)
    near, far = grid(5, 2, 1), grid(12, 3, 1.5)
    points = np.concatenate([near, far])
    sensor_rig = SensorRig(
        np.repeat(np.uint8([0, 1]), [len(near), len(far)]), np.array([np.eye(4), ahead])
    )
    asked = np.float32([[4, 0.1, 0.1], [5, 0.3, 0], [9, 0.1, 0.1], [12, 0.4, 0.2], [14, 0, 0.1]])
    frame = voting.KeyFrame(points, np.zeros(len(points), bool), p, None, sensor_rig)
    ground = np.zeros(len(asked), bool)
    votes = voting.vote(asked, ground, np.eye(4), [frame], np.eye(4)[None])
    assert votes.dynamic.tolist() == [1, 0, 1, 0, 0]
    assert votes.static.tolist() == [0, 1, 0, 1, 0]
    as_one = voting.KeyFrame(points, np.zeros(len(points), bool), p)
    votes = voting.vote(asked, ground, np.eye(4), [as_one], np.eye(4)[None])
    assert votes.dynamic[2] == 0  # hidden by the wall


@pytest.mark.nightly
def test_a_run_of_both(two, tmp_path):
    """As if one LiDAR had measured all, fewer pixels of a map are right."""
    dataset, blind = open_dataset(two), open_dataset(two)
    see = blind.sweep
    blind.sweep = lambda k: replace(see(k), sensor_rig=None)
    both, one = run(dataset, tmp_path / "both"), run(blind, tmp_path / "one")
    frame = RunDataset(both.path).sweep(3)
    np.testing.assert_array_equal(frame.sensor_rig.index, dataset.sweep(3).sensor_rig.index)
    time_offset = np.load(both.path / "layers" / "000003.npz")["time"]
    assert np.nanmedian(np.abs(time_offset)) < 0.1  # most of it was drawn from the nearest sweep
    assert evaluate_labels(both.path, two).counts.iou > 0.8
    right, less = (evaluate_depth(r.path, two / "depth_2").all for r in (both, one))
    assert right.too_near + right.too_far < less.too_near + less.too_far


@pytest.mark.slow
def test_inconsistent_lidars_are_named(two, tmp_path):
    broken = tmp_path / "00"
    shutil.copytree(two, broken)
    (broken / "velodyne_2" / "000005.bin").unlink()
    with pytest.raises(DatasetError, match=r"000005\.bin"):
        open_dataset(broken)
    shutil.copy(two / "velodyne_2" / "000004.bin", broken / "velodyne_2" / "000005.bin")
    assert open_dataset(broken).sweep(5).sensor_rig is not None
    lines = (broken / "calib.txt").read_text().splitlines()
    (broken / "calib.txt").write_text("\n".join(lines[:-1]) + "\n")
    with pytest.raises(CalibrationError, match="Tr_2"):
        open_dataset(broken)
