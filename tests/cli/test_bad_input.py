"""Bad input to a whole run: an error that names what is wrong, and nothing lost."""

from __future__ import annotations

import shutil
import subprocess
import sys

import numpy as np
import pytest

from command_line import cli
from docdepth.errors import DatasetError
from docdepth.io.frames import read_frame
from docdepth.io.run_folder import RunFolder


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--pose", "0,0"], "needs --pose, --K and --size"),
        (["--pose", "0,0", "--K", "9,9,4,3", "--size", "9x7"], "must be rigid"),
        (["--pose", "0,0,0,0,0,0,0", "--K", "9,9,4,3", "--size", "9x7"], "must be rigid"),
        (["--pose", "0,0,1", "--K", "9,9,4", "--size", "9x7"], "fx,fy,cx,cy"),
        (["--pose", "0,0,1", "--K", "9,9,4,3", "--size", "9"], "WIDTHxHEIGHT"),
        (["--pose", "0,0,1", "--K", "9,9,4,3", "--size", "9x7", "--name", "a/b"], "a folder"),
        (["--pose", "0,0,1", "--K", "9,9,4,3", "--size", "9x7", "--name", "1.png"], "a folder"),
        (["--name", "wide"], "needs --pose, --K and --size"),
        (["--camera-times", "times.txt"], "needs --pose, --K and --size"),
        (["--camera", ""], "an empty name"),
    ],
)
def test_mistakes_with_virtual_cameras(finished, arguments, message):
    result = cli("render", finished[0], *arguments)
    assert result.exit_code == 2
    assert message in str(result.exception)


@pytest.mark.parametrize(
    ("verb", "setting"),
    [("render", "render.max_depth=700"), ("render", "render.ahead=-1"), ("odometry", "x.y=1")],
)
def test_a_refused_setting_is_not_kept(finished, verb, setting):
    manifest = finished[0] / "run.yaml"
    before = manifest.read_text()
    assert cli(verb, finished[0], "--set", setting).exit_code == 2
    assert manifest.read_text() == before
    assert cli("render", finished[0]).exit_code == 0


def test_progress_in_a_log_file_is_lines(finished):
    result = cli("evaluate", "held-out", finished[0], "--every", "2")
    lines = [line for line in result.stderr.splitlines() if line.startswith("held out ")]
    assert len(lines) > 1
    assert lines[-1].split()[-1].split("/")[0] == lines[-1].split("/")[-1]


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda content: content + b"ab", "bytes; labels are one uint32"),
        (lambda content: content[:-8], "labels for a sweep of"),
        (None, "cannot be read: No such file"),
    ],
)
@pytest.mark.parametrize("verb", ["labels", "tracks"])
def test_true_labels_that_are_damaged_are_named(finished, drive, tmp_path, verb, spoil, message):
    shutil.copytree(drive / "labels", tmp_path / "labels")
    file = sorted((tmp_path / "labels").glob("*.label"))[2]
    content = file.read_bytes()
    file.unlink()
    if spoil:
        file.write_bytes(spoil(content))
    tracks = ["--tracks", drive / "tracks.csv"] if verb == "tracks" else []
    result = cli("evaluate", verb, finished[0], "--labels", tmp_path / "labels", *tracks)
    assert result.exit_code == 2
    assert f"{file} (frame 2)" in str(result.exception)
    assert message in str(result.exception)


@pytest.mark.parametrize("what", ["labels", "depth"])
def test_a_folder_of_truth_that_is_not_there_is_named(finished, tmp_path, what):
    folder = tmp_path / "nowhere"
    result = cli("evaluate", what, finished[0], f"--{what}", folder)
    assert result.exit_code == 2
    assert str(result.exception) == f"{folder} is not there"


def test_truncated_sweep_keeps_what_was_computed(drive, tmp_path):
    broken = tmp_path / "drive"
    shutil.copytree(drive, broken)
    sweep = broken / "velodyne" / "000003.bin"
    whole = sweep.read_bytes()
    sweep.write_bytes(whole[:-5])
    result = cli("run", broken, "-o", tmp_path / "run")
    assert result.exit_code == 2
    assert "000003.bin" in str(result.exception)
    sweep.write_bytes(whole)
    assert cli("run", broken, "-o", tmp_path / "run").exit_code == 0


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


def test_a_sweep_without_usable_points_is_named(drive, tmp_path):
    broken = tmp_path / "drive"
    shutil.copytree(drive, broken)
    np.zeros((1000, 4), np.float32).tofile(broken / "velodyne" / "000002.bin")
    result = cli("run", broken, "-o", tmp_path / "run")
    assert result.exit_code == 2
    assert "000002" in str(result.exception)


def test_folder_with_another_run(drive, finished):
    result = cli("run", drive, "-o", finished[0], "--set", "dynamics.tolerance=0.3")
    assert result.exit_code == 2
    assert "another run" in str(result.exception)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--set", "dynamics.tau=1"], "unknown parameter"),
        (["--camera", "image_9"], "image_9"),
        (["--image-size", "100x100"], "asked for is 100 x 100"),
        (["--image-size", "100"], "WIDTHxHEIGHT"),
    ],
)
def test_mistakes_on_the_command_line(drive, tmp_path, arguments, message):
    result = cli("run", drive, "-o", tmp_path / "run", *arguments)
    assert result.exit_code == 2
    assert message in str(result.exception)


def test_no_image_inside_the_sweeps(drive, finished, tmp_path):
    run = tmp_path / "run"
    shutil.copytree(finished[0], run)
    times = tmp_path / "times.txt"
    times.write_text("1000\n2000\n")
    folder = RunFolder(run)
    folder.manifest.inputs = folder.inputs.but(camera_times=times)
    folder.save()
    result = cli("render", run)
    assert result.exit_code == 2
    assert isinstance(result.exception, DatasetError)


def test_as_a_module_mistakes_end_with_a_sentence_too(tmp_path):
    command = [
        sys.executable,
        "-m",
        "docdepth",
        "run",
        tmp_path / "nowhere",
        "-o",
        tmp_path / "run",
    ]
    ended = subprocess.run(command, capture_output=True, text=True)
    assert ended.returncode == 2
    assert "nowhere" in ended.stderr
    assert "Traceback" not in ended.stderr
