"""LiDARs mounted at any angle: a run turns their frame so that z is up."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pytest
import yaml

from command_line import cli
from docdepth.datasets import Sweep, open_dataset
from docdepth.datasets.sensor_pose import LevelledRecording, estimate_sensor_origin
from docdepth.errors import DatasetError
from docdepth.geometry.points import GROUND
from docdepth.geometry.se3 import inverse, poses_from, rotation_exp
from docdepth.io.poses import read_poses, write_kitti
from docdepth.io.run_folder import RunFolder
from docdepth.pipeline.run_inputs import find_ray_origin, find_up
from exact_drive import Drive
from motion import pose, straight
from small_drive import SWEEPS, write_small_drive
from walled_yard import scan

pytestmark = pytest.mark.usefixtures("whole_ground_search")

POSES = straight(SWEEPS, 0.5).poses


def turn(degrees: tuple[float, float, float]) -> np.ndarray:
    return poses_from([rotation_exp(np.radians(degrees))], [[0, 0, 0]])[0]


def mounted(folder: Path, degrees: tuple[float, float, float]) -> Path:
    """The small drive in a LiDAR frame that leans; poses.txt holds poses of that LiDAR."""
    write_small_drive(folder)
    T_lidar_level = turn(degrees)
    for file in (folder / "velodyne").iterdir():
        rows = np.fromfile(file, np.float32).reshape(-1, 4)
        rows[:, :3] = rows[:, :3].astype(np.float64) @ T_lidar_level[:3, :3].T
        rows.tofile(file)
    lines = (folder / "calib.txt").read_text().splitlines()
    Tr = np.vstack([np.array(lines[-1].split()[1:], float).reshape(3, 4), [0, 0, 0, 1]])
    numbers = (Tr @ inverse(T_lidar_level))[:3].ravel()
    lines[-1] = "Tr: " + " ".join(f"{x:.15g}" for x in numbers)
    (folder / "calib.txt").write_text("\n".join(lines) + "\n")
    write_kitti(folder.parent / f"{folder.name}.txt", POSES @ inverse(T_lidar_level))
    return folder


def run_of(drive: Path, *options: object) -> RunFolder:
    run = drive.parent / f"run of {drive.name}"
    poses = drive.parent / f"{drive.name}.txt"
    result = cli("run", drive, "-o", run, "--poses", poses, *options)
    assert result.exit_code == 0, result.stderr
    return RunFolder.open(run)


def ground_share(run: RunFolder) -> float:
    classes = [run.frame(k).classid for k in range(SWEEPS)]
    return float(np.mean([np.mean(c == GROUND) for c in classes if c is not None]))


@pytest.fixture(scope="module")
def level(tmp_path_factory) -> RunFolder:
    return run_of(mounted(tmp_path_factory.mktemp("level") / "drive", (0, 0, 0)))


@pytest.mark.parametrize("degrees", [(0, 20, 0), (45, 0, 0), (0, 90, 0), (180, 0, 0)])
def test_a_mount_that_leans_changes_no_result(level, tmp_path, degrees):
    run = run_of(mounted(tmp_path / "drive", degrees))
    up = np.array(run.manifest.derived.up)
    np.testing.assert_allclose(up, turn(degrees)[:3, 2], atol=0.02)
    assert abs(ground_share(run) - ground_share(level)) < 0.01
    assert ground_share(level) > 0.3
    path = run.trajectory().poses
    np.testing.assert_allclose(path[:, :3, 2], [[0, 0, 1]] * SWEEPS, atol=0.03)
    np.testing.assert_allclose(
        np.linalg.norm(np.diff(path[:, :3, 3], axis=0), axis=1), 0.5, atol=1e-6
    )
    for k in range(SWEEPS):
        classes = [of.frame(k).classid for of in (run, level)]
        assert np.mean(classes[0] != classes[1]) < 0.02
    for name in sorted(p.name for p in (level.path / "depth").glob("*.png"))[:3]:
        maps = [np.asarray(_depth(of.path / "depth" / name)) for of in (run, level)]
        both = (maps[0] > 0) & (maps[1] > 0)
        assert both.sum() > 0.95 * (maps[1] > 0).sum()
        assert np.median(np.abs(maps[0][both] / maps[1][both] - 1)) < 0.01


def test_a_virtual_camera_stands_in_the_frame_of_the_lidar_as_it_is_mounted(tmp_path):
    """At the place of the recorded camera it gives the recorded camera's map."""
    drive = mounted(tmp_path / "drive", (0, 20, 0))
    run = run_of(drive)
    assert run.manifest.derived.up
    stream = next(iter(open_dataset(drive).cameras.values()))
    np.savetxt(tmp_path / "pose.txt", inverse(stream.T_camera_lidar), "%.17g")
    K, camera = stream.camera.K, stream.camera
    described = f"{K[0, 0]},{K[1, 1]},{K[0, 2]},{K[1, 2]}", f"{camera.width}x{camera.height}"
    options = "--K", described[0], "--size", described[1]
    result = cli("render", run.path, "--pose", tmp_path / "pose.txt", *options)
    assert result.exit_code == 0, result.stderr
    for recorded in sorted((run.path / "depth").glob("*.png")):
        twin = run.path / "depth" / "virtual" / recorded.name
        depths = _depth(recorded), _depth(twin)
        assert np.mean(depths[0] != depths[1]) < 0.001  # of rounded extrinsics


def _depth(path: Path) -> np.ndarray:
    import cv2

    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert image is not None
    return image.astype(np.float64)


@pytest.mark.parametrize("degrees", [(0, 0, 0), (3, 0, 0), (0, -3, 0)])
def test_a_level_frame_stays_as_it_is(tmp_path, degrees):
    assert find_up(open_dataset(mounted(tmp_path / "drive", degrees))) is None


def test_a_level_run_is_of_the_sweeps_bit_for_bit(level):
    assert level.manifest.derived.up is None
    sweep = open_dataset(level.inputs.recording).sweep(1)
    np.testing.assert_array_equal(level.frame(1).points, sweep.points)
    np.testing.assert_array_equal(level.trajectory().poses, POSES)


def test_up_that_is_told_is_taken(tmp_path):
    drive = mounted(tmp_path / "drive", (0, 45, 0))
    about = drive / "docdepth.yaml"
    about.write_text(yaml.safe_dump({"up": [0, 0, 5]}))
    assert find_up(open_dataset(drive)) is None
    about.write_text(yaml.safe_dump({"up": [0, -2, 0]}))
    assert find_up(open_dataset(drive)) == (0, -1, 0)
    run = run_of(drive)
    assert run.manifest.derived.up == (0, -1, 0)
    about.write_text(yaml.safe_dump({"up": [0, 0, 1]}))
    other = cli("run", drive, "-o", run.path, "--poses", drive.parent / "drive.txt")
    assert other.exit_code == 2
    assert "its up is [0.0, -1.0, 0.0]" in str(other.exception)
    for wrong in ([0, 0, 0], [0, 1], "z", [0, "a", 1]):
        about.write_text(yaml.safe_dump({"up": wrong}))
        with pytest.raises(DatasetError, match=r"docdepth\.yaml: up must be \[x, y, z\]"):
            open_dataset(drive)


def test_what_was_found_holds_for_the_whole_run(tmp_path):
    drive = mounted(tmp_path / "drive", (30, 0, 0))
    run = run_of(drive)
    assert run_of(drive).manifest.derived == run.manifest.derived
    assert "done" in cli("status", run.path).stdout
    poses = tmp_path / "again.txt"
    assert cli("convert", run.path, poses, "--to", "kitti").exit_code == 0
    given = read_poses(tmp_path / "drive.txt", SWEEPS)
    again = read_poses(poses, SWEEPS)
    # Of the LiDAR as it is mounted, in a world that is level.
    np.testing.assert_allclose(inverse(again[0]) @ again, inverse(given[0]) @ given, atol=1e-6)


def test_a_world_that_leans_is_turned(level, tmp_path, caplog):
    """Poses of the LiDAR in a world whose axes are a camera's: x right, y down, z ahead."""
    drive = mounted(tmp_path / "drive", (0, 0, 0))
    axes = np.eye(4)
    axes[:3, :3] = [[0, -1, 0], [0, 0, -1], [1, 0, 0]]
    write_kitti(tmp_path / "drive.txt", axes @ POSES)
    run = run_of(drive)
    np.testing.assert_allclose(run.trajectory().poses[:, :3, 2], [[0, 0, 1]] * SWEEPS, atol=0.02)
    assert abs(ground_share(run) - ground_share(level)) < 0.01


class _Made:
    """Sweeps that were made here, as a recording."""

    name, poses, cameras, path = "made", None, {}, Path("made")

    def __init__(self, clouds: list[np.ndarray], ring: np.ndarray | None = None) -> None:
        self._clouds, self._ring = clouds, ring
        self.times = np.arange(len(clouds)) * 10**8
        self.lidars: dict = {}

    def __len__(self) -> int:
        return len(self._clouds)

    def sweep(self, index: int) -> Sweep:
        points = self._clouds[index].astype(np.float32)
        return Sweep(points, f"{index}", int(self.times[index]), ring=self._ring)

    def sweep_files(self, index: int) -> list[Path]:
        return []

    def labels(self, index: int) -> None:
        return None


def test_it_asks_where_nothing_tells_which_way_is_up(caplog):
    rng = np.random.default_rng(2)
    with caplog.at_level(logging.WARNING):
        assert find_up(_Made([rng.normal(0, 10, (4000, 3)) for _ in range(4)])) is None
    assert "say up: [x, y, z] in docdepth.yaml" in caplog.text


PLACE = np.array([1.2, -0.3, 1.7])


def test_where_the_rays_begin_is_found_for_points_in_the_frame_of_the_vehicle():
    clouds = [scan(pose(x=0.5 * k), -8.0 + k)[0] for k in range(2)]
    assert estimate_sensor_origin(_Made(clouds)) is None, "seen from the origin"
    found = estimate_sensor_origin(_Made([cloud + PLACE for cloud in clouds]))
    assert found is not None
    assert found.share > 0.9 > 0.75 > found.at_origin
    assert (np.abs(np.array(found.places[0]) - PLACE) < (0.2, 0.2, 0.8)).all(), (
        "a bare yard hardly tells height"
    )


def test_hundreds_of_points_do_not_tell_where_the_rays_begin():
    clouds = np.random.default_rng(0).normal(0, 10, (2, 600, 3))
    assert estimate_sensor_origin(_Made(list(clouds))) is not None


def test_rings_tell_where_the_rays_begin():
    """Height too, which neighbours hardly tell, and though the axis leans."""
    drive, turn = Drive(4), rotation_exp(np.radians([4.0, 9.0, 0.0]))
    ring = np.repeat(np.arange(24, dtype=np.uint16), 360)
    clouds = [drive.sweep(k).points for k in range(4)]
    moved = [np.where(c.any(axis=1)[:, None], c @ turn.T + PLACE, 0) for c in clouds]
    found = estimate_sensor_origin(_Made(moved, ring))
    assert found is not None
    np.testing.assert_allclose(found.places, [PLACE], atol=0.2)


def test_a_run_of_points_in_the_frame_of_the_vehicle(tmp_path, caplog):
    drive = mounted(tmp_path / "drive", (0, 0, 0))
    for file in (drive / "velodyne").iterdir():
        rows = np.fromfile(file, np.float32).reshape(-1, 4)
        rows[:, :3] += PLACE.astype(np.float32)
        rows.tofile(file)
    run = run_of(drive)
    rig = run.frame(0).sensor_rig
    assert rig is not None
    assert (np.abs(rig.T_lidar_sensor[0, :3, 3] - PLACE) < (0.3, 0.3, 0.8)).all()
    assert run.manifest.derived.sensor_origin == tuple(rig.T_lidar_sensor[0, :3, 3])
    assert "rays are taken to begin there" in caplog.text
    assert run_of(drive).manifest.derived == run.manifest.derived
    (drive / "docdepth.yaml").write_text(yaml.safe_dump({"sensor_origin": PLACE.tolist()}))
    other = cli("run", drive, "-o", run.path, "--poses", drive.parent / "drive.txt")
    assert "sensor_origin" in str(other.exception)


def test_nothing_is_found_where_returns_have_no_neighbours_from_anywhere():
    rng = np.random.default_rng(4)
    cloud = rng.uniform(-20, 20, (3000, 3))
    assert find_ray_origin(_Made([cloud] * 3)) is None


@pytest.mark.parametrize("degrees", [(90, 0, 0), (0, 90, 0)])
def test_the_mesh_is_drawn_around_the_axis_of_the_lidar(degrees):
    """A LiDAR that leans has its own frame; turned points of a level one do not."""
    T_level_lidar = turn(degrees)
    leans = _Made([scan(pose(x=0.5 * k) @ T_level_lidar, -8.0)[0][::3] for k in range(3)])
    level = [scan(pose(x=0.5 * k), -8.0)[0][::3] @ T_level_lidar[:3, :3] for k in range(3)]
    up = T_level_lidar[2, :3]
    own = LevelledRecording(leans, up).sweep(0)
    assert own.sensor_rig is not None
    np.testing.assert_allclose(own.sensor_rig.T_lidar_sensor[0, 2, :3], up, atol=1e-9)
    turned = LevelledRecording(_Made(level), up).sweep(0)
    assert turned.sensor_rig is None
    assert abs(np.median(turned.points[turned.points[:, 2] < -1.6][:, 2]) + 1.7) < 0.05
