"""Recordings without a camera: poses, labels, tracks and a report, and no depth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from command_line import cli
from docdepth import open_dataset, run
from docdepth.errors import ConfigError, DatasetError, RunError
from docdepth.io.run_folder import RunFolder
from small_drive import SWEEPS, write_small_drive


@pytest.fixture(scope="module")
def drive(tmp_path_factory) -> Path:
    return write_small_drive(tmp_path_factory.mktemp("drive") / "00")


def bare(drive: Path, folder: Path) -> Path:
    """The same sweeps as a folder without a camera."""
    folder.mkdir()
    (folder / "sweeps").symlink_to(drive / "velodyne")
    about = {"sweeps": "sweeps", "rate": 10, "motion_compensated": True}
    (folder / "docdepth.yaml").write_text(yaml.safe_dump(about))
    return folder


def test_labels_are_those_of_a_run_with_a_camera(drive, tmp_path) -> None:
    recording = bare(drive, tmp_path / "bare")
    with pytest.raises(DatasetError, match="`camera='none'` makes poses and labels alone"):
        run(recording, tmp_path / "run")
    result = cli("run", recording, "-o", tmp_path / "run", "--camera", "none")
    assert result.exit_code == 0, result.stderr
    made = RunFolder(tmp_path / "run")
    seen = run(drive, tmp_path / "seen").folder
    for k in range(SWEEPS):
        np.testing.assert_array_equal(made.frame(k).classid, seen.frame(k).classid)
        np.testing.assert_array_equal(made.frame(k).points, seen.frame(k).points)
    np.testing.assert_array_equal(made.trajectory().poses, seen.trajectory().poses)
    assert (made.path / "report" / "index.html").is_file()
    assert not (made.path / "depth").exists()
    assert not (made.path / "calib.json").exists()
    before = {file: file.stat().st_mtime_ns for file in made.path.rglob("*") if file.is_file()}
    assert cli("run", made.path).exit_code == 0
    after = {file: file.stat().st_mtime_ns for file in made.path.rglob("*") if file.is_file()}
    assert before == after, "nothing is left to do"
    status = cli("status", made.path)
    assert "render" not in status.stdout
    for command in (["video"], ["evaluate", "held-out"], ["calibrate"]):
        ended = cli(*command, made.path)
        assert isinstance(ended.exception, RunError), command
        assert "its run has no camera; name one" in str(ended.exception)
    assert cli("map", made.path).exit_code == 0


def test_a_camera_can_be_added_later(drive, tmp_path) -> None:
    made = run(drive, tmp_path / "run", camera="none").folder
    frame = made.frame_path(1).stat().st_mtime_ns
    made = run(drive, tmp_path / "run").folder
    assert list(made.cameras) == ["image_2"]
    assert made.frame_path(1).stat().st_mtime_ns == frame, "labels are kept"
    whole = run(drive, tmp_path / "whole")
    for file in sorted((whole.path / "depth").glob("*.png")):
        assert file.read_bytes() == (made.path / "depth" / file.name).read_bytes()
    again = cli("run", drive, "-o", made.path, "--camera", "none")
    assert again.exit_code == 0, "the camera stays"
    assert list(RunFolder(made.path).cameras) == ["image_2"]


def test_an_opened_recording_is_not_taken_for_its_path(drive, tmp_path) -> None:
    with pytest.raises(ConfigError, match="give that of its folder or file"):
        run(open_dataset(drive), tmp_path / "run")
    assert not (tmp_path / "run").exists()
