"""``--poses``: files of the LiDAR's or a camera's poses, and those of the recording."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from command_line import cli
from docdepth.config import Parameters
from docdepth.datasets import FrameRange, open_dataset
from docdepth.errors import DatasetError, OdometryError
from docdepth.geometry.se3 import inverse
from docdepth.io.inputs import RunInputs
from docdepth.io.poses import write_kitti
from docdepth.io.run_folder import RunFolder
from docdepth.pipeline.check import check_inputs
from docdepth.pipeline.given_poses import read_given_poses
from docdepth.pipeline.plan import states
from docdepth.pipeline.run_inputs import known_poses, open_recording
from motion import straight
from small_drive import SPARSE, SWEEPS, write_small_drive
from walled_yard import scan

POSES = straight(SWEEPS, 0.5).poses


@pytest.fixture(scope="module")
def drive(tmp_path_factory) -> Path:
    """With KITTI's ``poses.txt``, of camera 0, which is camera 2 here."""
    folder = write_small_drive(tmp_path_factory.mktemp("poses") / "drive")
    T = open_dataset(folder).cameras["image_2"].T_camera_lidar
    write_kitti(folder / "poses.txt", T @ POSES @ inverse(T))
    write_kitti(folder.parent / "lidar.txt", POSES)
    return folder


def source(drive: Path, **more: object) -> RunInputs:
    return RunInputs(recording=drive, **more)


def poses_of(drive: Path, given: Path | str, **more: object) -> np.ndarray:
    entries = source(drive, poses=given, **more)
    poses = known_poses(entries, open_recording(entries))
    assert poses is not None
    return poses


def test_those_of_the_recording_are_taken(drive, tmp_path):
    np.testing.assert_allclose(poses_of(drive, "dataset"), POSES, atol=1e-9)
    np.testing.assert_allclose(poses_of(drive, "dataset", frames="1:3"), POSES[1:3], atol=1e-9)
    run = tmp_path / "run"
    assert cli("run", drive, "-o", run, "--poses", "dataset").exit_code == 0
    np.testing.assert_allclose(RunFolder.open(run).trajectory().poses, POSES, atol=1e-9)
    assert RunFolder.open(run).inputs.poses == "dataset"
    assert {state.state for state in states(RunFolder.open(run))} == {"done"}
    # The same inputs by run.yaml, and brought up to date without any.
    assert cli("run", "--config", run / "run.yaml", "-o", run).exit_code == 0
    assert cli("run", run).exit_code == 0
    assert cli("run", drive, "-o", run, "--poses", drive.parent / "lidar.txt").exit_code == 2


def test_poses_of_a_part_are_those_of_its_run(drive, tmp_path):
    """A run of a part writes poses of that part, and the same part takes them again."""
    write_kitti(tmp_path / "part.txt", POSES[1:4])
    np.testing.assert_allclose(poses_of(drive, tmp_path / "part.txt", frames="1:4"), POSES[1:4])
    whole = drive.parent / "lidar.txt"
    np.testing.assert_allclose(poses_of(drive, whole, frames="1:4"), POSES[1:4])
    for frames in ("1:3", ":"):
        with pytest.raises(OdometryError, match=f"3 poses for {SWEEPS} sweeps"):
            poses_of(drive, tmp_path / "part.txt", frames=frames)


def test_poses_of_a_part_with_a_gap_are_refused(drive, tmp_path):
    """Nothing tells which sweep was left out when the poses were written."""
    write_kitti(tmp_path / "some.txt", POSES[[0, 1, 3]])
    some = FrameRange(open_dataset(drive), without={2})
    with pytest.raises(OdometryError, match=f"3 poses for {SWEEPS} sweeps"):
        read_given_poses(str(tmp_path / "some.txt"), some)


def test_a_recording_without_poses_is_refused(tmp_path):
    folder = write_small_drive(tmp_path / "drive", images=False)
    with pytest.raises(DatasetError, match=r"drive has no poses of its own; give a file"):
        poses_of(folder, "dataset")
    refused = cli("run", folder, "--dry-run", "--image-size", "96x40", "--poses", "dataset")
    assert refused.exit_code == 2
    assert "no poses of its own" in str(refused.exception)


def test_poses_of_a_camera_are_told_by_its_name(drive):
    file = drive / "poses.txt"
    np.testing.assert_allclose(poses_of(drive, f"image_2:{file}"), POSES, atol=1e-9)
    later = poses_of(drive, f"image_2:{file}", frames="2:")
    np.testing.assert_allclose(later, POSES[2:], atol=1e-9)
    # Camera 3 sits half a metre beside: on a straight way all move alike.
    np.testing.assert_allclose(poses_of(drive, f"image_3:{file}"), POSES, atol=1e-9)
    with pytest.raises(DatasetError, match=r"no camera 'front'; it has image_2, image_3"):
        poses_of(drive, f"front:{file}")
    with pytest.raises(OdometryError, match=r"none.txt is missing"):
        poses_of(drive, f"image_2:{drive / 'none.txt'}")


def test_a_file_with_a_colon_in_its_name_is_a_file(drive, tmp_path):
    write_kitti(tmp_path / "image_2:lidar.txt", POSES)
    np.testing.assert_allclose(poses_of(drive, tmp_path / "image_2:lidar.txt"), POSES, atol=1e-11)


def test_poses_of_a_camera_given_as_the_lidar_s_are_refused(drive, tmp_path):
    file = drive / "poses.txt"
    refused = cli("run", drive, "-o", tmp_path / "run", "--poses", file)
    assert refused.exit_code == 2
    assert f"say which camera: `poses='image_2:{file}'`" in str(refused.exception)
    assert not (tmp_path / "run" / "frames").exists()
    assert cli("run", drive, "--dry-run", "--poses", f"image_2:{file}").exit_code == 0
    assert cli("run", drive, "--dry-run", "--poses", drive.parent / "lidar.txt").exit_code == 0


def test_an_unreadable_recording_is_told_before_its_poses(tmp_path):
    (tmp_path / "drive" / "velodyne").mkdir(parents=True)
    refused = cli("run", tmp_path / "drive", "--dry-run", "--poses", "dataset")
    assert refused.exit_code == 2
    assert "dataset cannot" not in str(refused.exception)
    assert "is missing; give the file of the poses" not in str(refused.exception)


@pytest.mark.parametrize("step", [0.1, 0.2, 0.5, 1.0])
@pytest.mark.parametrize("said", ["lidar", "world"])
@pytest.mark.parametrize("of", ["lidar", "world"])
def test_points_of_another_frame_on_a_way_of_metres(tmp_path, step: float, said: str, of: str):
    """Where the way is short, the middle of the points does not tell of which frame they are."""
    poses = straight(8, step).poses
    poses = inverse(poses[0]) @ poses
    (tmp_path / "sweeps").mkdir()
    for k, pose in enumerate(straight(8, step).poses):
        points = scan(pose, -8 + 1.5 * k, SPARSE)[0]
        if of == "world":
            points = points @ poses[k, :3, :3].T + poses[k, :3, 3]
        np.save(tmp_path / "sweeps" / f"{k:06d}.npy", points.astype("f4"))
    write_kitti(tmp_path / "poses.txt", poses)
    (tmp_path / "docdepth.yaml").write_text(
        f"sweeps: sweeps\nrate: 10\nposes: poses.txt\nframe: {said}\nmotion_compensated: true\n"
    )
    inputs = RunInputs(recording=tmp_path, camera="none")
    found = [one for one in check_inputs(inputs, Parameters()).findings if "frame" in str(one)]
    assert [one.severity for one in found] == ["error"] * (said != of)
    for one in found:
        assert f"the points are not in the frame {said!r}" in str(one)
        assert f"say frame: {of} in {tmp_path / 'docdepth.yaml'}" in str(one)
