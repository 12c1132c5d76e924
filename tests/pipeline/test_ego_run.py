"""A run that leaves out points of the vehicle itself."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import docdepth
from command_line import cli
from docdepth.datasets import Sweep, open_dataset, usable_points
from docdepth.diagnostics.own_vehicle import OwnVehicle
from docdepth.errors import NOTE, RunError
from docdepth.io.inputs import DerivedInputs, RunInputs
from docdepth.io.poses import write_kitti
from docdepth.io.run_folder import RunFolder
from docdepth.pipeline import run_inputs
from docdepth.pipeline.plan import states
from docdepth.pipeline.run_inputs import open_inputs, recording_of
from motion import straight
from small_drive import SWEEPS, results, write_small_drive, write_sweep


def test_rows_in_boxes_are_labelled_as_no_returns(tmp_path):
    drive = write_small_drive(tmp_path / "drive")
    usable = [usable_points(open_dataset(drive).sweep(k).points) for k in range(SWEEPS)]
    write_kitti(tmp_path / "poses.txt", straight(SWEEPS, 0.5).poses)
    run = ("run", drive, "-o", tmp_path / "run", "--poses", tmp_path / "poses.txt")
    (drive / "docdepth.yaml").write_text("ego_boxes: [[0, 9], [-9, 9], [-3, 1]]\n")
    assert cli(*run).exit_code == 0
    for k, before in enumerate(usable):
        after = usable_points(open_dataset(drive).sweep(k).points)
        assert 0.02 < 1 - after.sum() / before.sum() < 0.9
        labels = np.fromfile(tmp_path / "run" / "labels" / f"{k:06d}.label", "<u4")
        np.testing.assert_array_equal(labels == 1, ~after)
        assert len(RunFolder.open(tmp_path / "run").frame(k).index) == after.sum()
    (drive / "docdepth.yaml").write_text("ego_boxes: [[0, 8], [-9, 9], [-3, 1]]\n")
    found = {s.name: s.state for s in states(RunFolder.open(tmp_path / "run"))}
    assert found["odometry"] == "out of date"


OWN = np.random.default_rng(4).uniform([1.2, -0.8, -0.9], [2.2, 0.8, -0.8], (40, 3))
DRIVEN = 26  # sweeps, half a metre apart


@pytest.fixture(scope="module")
def carried(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive whose LiDARs see the bonnet: the first rows of each of their sweeps."""
    drive = write_small_drive(tmp_path_factory.mktemp("own") / "drive", DRIVEN, images=False)
    with (drive / "calib.txt").open("a") as calib:
        calib.write("Tr_2: 0 -1 0 0.02 0 0 -1 -0.06 1 0 0 -0.9\n")  # 0.6 m behind the first
    (drive / "velodyne_2").mkdir()
    for k in range(DRIVEN):
        name = f"{k:06d}.bin"
        world = np.fromfile(drive / "velodyne" / name, "<f4").reshape(-1, 4)[:, :3]
        write_sweep(drive, k, np.concatenate([OWN, world]))
        second = np.concatenate([OWN[::2] + (0.6, 0, 0), world[::5] + (0.6, 0, 0)])
        rows = np.pad(second, ((0, 0), (0, 1))).astype("<f4")
        rows.tofile(drive / "velodyne_2" / name)
    return drive


def own_rows(sweep: Sweep) -> np.ndarray:
    """Which rows the two LiDARs see of the bonnet."""
    near = np.abs(sweep.points[:, None] - OWN[None].astype(np.float32)).max(axis=2).min(axis=1)
    return np.asarray(near < 1e-3)


def said(caplog: pytest.LogCaptureFixture) -> list[str]:
    return [line for line in caplog.messages if "the own vehicle" in line]


def test_a_run_finds_the_own_vehicle_once_and_keeps_what_it_found(
    carried, tmp_path, monkeypatch, caplog
):
    caplog.set_level(NOTE, "docdepth")
    folder = docdepth.run(carried, tmp_path / "run", camera="none").folder
    (line,) = said(caplog)
    assert " 60 returns a sweep" in line
    (box,) = folder.manifest.derived.ego_boxes
    assert (np.abs(np.transpose(box) - [OWN.min(axis=0), OWN.max(axis=0)]) < 0.15).all()
    for k in (0, DRIVEN - 1):
        sweep = open_dataset(carried).sweep(k)
        own = own_rows(sweep)
        assert own.sum() == 60
        labels = np.fromfile(folder.path / "labels" / f"{k:06d}.label", "<u4")
        np.testing.assert_array_equal(labels == 1, own | ~usable_points(sweep.points))
        assert len(folder.frame(k).index) == (usable_points(sweep.points) & ~own).sum()

    def refused(recording):
        raise AssertionError("it was found when the run began")

    monkeypatch.setattr(run_inputs, "find_own_vehicle", refused)
    before = results(folder.path)
    docdepth.run(carried, folder.path, camera="none")
    (folder.path / "classes" / "frame_000003.npy").unlink()
    docdepth.run(carried, folder.path, camera="none", jobs=2)
    assert results(folder.path) == before
    assert {stage.state for stage in states(RunFolder.open(folder.path))} == {"done"}
    assert not usable_points(recording_of(folder).sweep(1).points[:40]).any()
    assert len(said(caplog)) == 1


def test_it_can_be_kept(carried, tmp_path, monkeypatch):
    vehicle = OwnVehicle((((1.1, 2.3), (-1.0, 1.0), (-1.0, -0.7)),), 60, 2.4, mirrored=False)
    monkeypatch.setattr(run_inputs, "find_own_vehicle", lambda recording: vehicle)
    run = ("run", carried, "-o", tmp_path / "run", "--camera", "none", "--frames", "0:4")
    assert cli(*run, "--keep-ego").exit_code == 0
    folder = RunFolder.open(tmp_path / "run")
    assert folder.manifest.derived.ego_boxes is None
    assert len(folder.frame(0).index) == usable_points(open_dataset(carried).sweep(0).points).sum()
    with pytest.raises(RunError, match="its keep_ego is True, not False"):
        docdepth.run(carried, folder.path, camera="none", frames="0:4")
    again = cli(*run, "--force")
    assert again.exit_code == 0
    assert "note: " in again.output
    assert "--keep-ego keeps these returns" in again.output
    folder = RunFolder.open(tmp_path / "run")
    own = own_rows(open_dataset(carried).sweep(0))
    rest = usable_points(open_dataset(carried).sweep(0).points) & ~own
    assert len(folder.frame(0).index) == rest.sum()


@pytest.mark.parametrize("boxes", ["[]", "[[0, 9], [-9, 9], [-3, 1]]"])
def test_what_the_recording_says_of_it_holds(boxes, tmp_path, monkeypatch):
    def refused(recording):
        raise AssertionError("the recording tells")

    monkeypatch.setattr(run_inputs, "find_own_vehicle", refused)
    drive = write_small_drive(tmp_path / "drive", images=False)
    (drive / "docdepth.yaml").write_text(f"ego_boxes: {boxes}\nup: [0, 0, 1]\n")
    for frames in (None, "0:3"):
        opened = open_inputs(RunInputs(recording=drive, frames=frames, camera="none"))
        assert opened.derived.ego_boxes is None


def test_what_the_recording_says_is_known_through_its_views(tmp_path):
    """Up and masks are those of docdepth.yaml, whatever was found before them."""
    drive = write_small_drive(tmp_path / "drive")
    (drive / "docdepth.yaml").write_text(
        "up: [0, 0.5, 1]\nmasks: {image_2: [[0, 30], [95, 30], [95, 39]]}\n"
    )
    begun = DerivedInputs(ego_boxes=(((0, 9), (-9, 9), (-3, 1)),))
    opened = open_inputs(RunInputs(recording=drive, camera="image_2"), begun)
    np.testing.assert_allclose(opened.derived.up, np.array([0, 0.5, 1]) / np.sqrt(1.25))
    assert opened.cameras[0].camera.mask is not None
