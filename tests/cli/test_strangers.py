"""What new users do first: another folder, another disk, another file than was meant."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from docdepth.cli.status import changes_since_start
from docdepth.config import replaced
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


@pytest.mark.parametrize("what", ["labels", "depth"])
def test_a_run_is_no_truth_for_itself(docdepth, finished, what):
    ended = docdepth("evaluate", what, finished[0], f"--{what}", finished[0] / what)
    assert ended.code == 2
    assert "lies in the run" in ended.err


def test_truth_of_another_scale_is_told(docdepth, drive, finished, tmp_path):
    for file in (drive / "depth_2").glob("*.npy"):
        millimetres = np.clip(np.nan_to_num(np.load(file), posinf=0) * 1000, 0, 65535)
        cv2.imwrite(str(tmp_path / f"{file.stem}.png"), millimetres.astype(np.uint16))
    ended = docdepth("evaluate", "depth", finished[0], "--depth", tmp_path)
    assert "is 3.9" in ended.err
    assert "is the scale another?" in ended.err
    assert "warning:" not in docdepth("evaluate", "depth", finished[0], "--depth", drive).err


def test_a_name_that_stands_twice_in_a_settings_file(docdepth, drive, tmp_path):
    file = tmp_path / "c.yaml"
    file.write_text("dynamics: {tolerance: 0.3}\ndynamics: {window: 3}\n")
    ended = docdepth("run", drive, "-o", tmp_path / "run", "--config", file)
    assert ended.code == 2
    assert "'dynamics' stands twice" in ended.err


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


def test_more_threads_than_the_core_takes(docdepth, finished):
    ended = docdepth("render", finished[0], "--threads", "999")
    assert ended.code == 2
    assert "less than or equal to 256" in ended.err
