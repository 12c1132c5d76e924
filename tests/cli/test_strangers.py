"""What new users do first: another folder, another disk, another file than was meant."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from command_line import cli
from docdepth.cli.status import changes_since_start
from docdepth.config import replaced
from docdepth.io.frames import read_frame
from docdepth.io.run_folder import RunFolder


@pytest.fixture
def copies(drive: Path, finished: tuple[Path, str], tmp_path: Path) -> tuple[Path, Path]:
    """A folder that holds one recording, and a run of it."""
    shutil.copytree(drive, tmp_path / "above" / "00")
    shutil.copytree(finished[0], tmp_path / "run")
    return tmp_path / "above", tmp_path / "run"


def test_a_folder_above_may_be_given_again_and_again(docdepth, copies):
    above, run = copies
    for _ in range(2):
        ended = docdepth("run", above, "-o", run, "--force", "--dry-run")
        assert ended.code == 0, ended.err
    assert docdepth("run", above, "-o", run).code == 0
    ended = docdepth("run", above, "-o", run)
    assert ended.code == 0, ended.err


def test_contents_stay_compared_by_the_same_command_without_the_option(docdepth, drive, tmp_path):
    assert docdepth("run", drive, "-o", tmp_path / "run", "--hash-inputs").code == 0
    ended = docdepth("run", drive, "-o", tmp_path / "run")
    assert ended.code == 0, ended.err
    assert RunFolder.open(tmp_path / "run").inputs.hash_inputs is True


@pytest.mark.parametrize("verb", ["run", "render"])
def test_a_recording_that_was_moved_is_asked_for_and_remembered(docdepth, copies, verb):
    above, run = copies
    assert docdepth("run", above, "-o", run).code == 0
    moved = above.rename(above.with_name("elsewhere"))
    ended = docdepth(verb, run)
    assert ended.code == 2
    assert f"if it was moved, say where it is now: docdepth run RECORDING -o {run}" in ended.err
    assert docdepth("run", moved, "-o", run).code == 0
    ended = docdepth(verb, run)
    assert ended.code == 0, ended.err


def test_one_command_takes_back_all_changes_of_a_stage(finished):
    folder = RunFolder.open(finished[0])
    values = replaced(folder.parameters, {"render.ahead": 700.0, "render.crop": 700.0})
    folder.manifest.parameters = values
    (sentence,) = changes_since_start(folder)
    assert sentence.startswith("render.ahead is 700.0, was 80.0, render.crop is 700.0, was 300.0")
    assert sentence.endswith("--set render.ahead=80.0 --set render.crop=300.0")


def test_paragraphs_of_help_are_broken_at_the_width_of_the_terminal_alone(docdepth, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    said = [line.strip() for line in docdepth("run", "-h").out.splitlines()]
    whole = "makes again what is missing, damaged or out of date."
    assert any(line.endswith(whole) for line in said)
    assert "docdepth run --config run/run.yaml -o again" in said


def test_a_folder_that_was_deleted_while_one_stands_in_it(docdepth, drive, tmp_path, monkeypatch):
    (tmp_path / "gone").mkdir()
    monkeypatch.chdir(tmp_path / "gone")
    (tmp_path / "gone").rmdir()
    ended = docdepth("run", drive, "-o", "run")
    monkeypatch.chdir(tmp_path)
    assert ended.code == 2
    assert "was the folder that you stand in deleted?" in ended.err


def test_unusable_points_are_kept_apart(drive, tmp_path):
    broken = tmp_path / "drive"
    shutil.copytree(drive, broken)
    path = broken / "velodyne" / "000002.bin"
    points = np.fromfile(path, np.float32).reshape(-1, 4)
    points[:50, 0] = np.nan
    points[50:90, 1] = np.inf
    points[90:120, :3] = 0
    points.tofile(path)
    run = tmp_path / "run"
    result = cli("run", broken, "-o", run)
    assert result.exit_code == 0, result.output
    frame = read_frame(run / "frames" / "frame_000002.ply")
    np.testing.assert_array_equal(frame.index, np.arange(120, len(points)))
    assert np.isfinite(frame.points).all()
    assert len(np.fromfile(run / "labels" / "000002.label", np.uint32)) == len(points)
