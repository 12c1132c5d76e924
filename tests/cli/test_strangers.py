"""What new users do first: another folder, another disk, another file than was meant."""

from __future__ import annotations

import errno
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from command_line import cli
from docdepth.cli import app
from docdepth.cli.status import changes_since_start
from docdepth.config import replaced
from docdepth.io.frames import read_frame, write_frame
from docdepth.io.recorded_folder import STATE_DIR
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
    ahead = 700.123456789  # of which no digit is lost on the way back
    values = replaced(folder.parameters, {"render.ahead": ahead, "render.crop": 700.0})
    folder.manifest.parameters = values
    (sentence,) = changes_since_start(folder)
    was = folder.manifest.parameters_at_start.render
    assert (
        f"render.ahead is {ahead}, was {was.ahead:g}, render.crop is 700, was {was.crop:g}"
        in sentence
    )
    assert sentence.endswith(f"--set render.ahead={was.ahead:g} --set render.crop={was.crop:g}")


def test_paragraphs_of_help_are_broken_at_the_width_of_the_terminal_alone(docdepth, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    said = [line.strip() for line in docdepth("run", "-h").out.splitlines()]
    whole = "A run by itself takes other parameters, formats and layers."
    assert any(line.endswith(whole) for line in said)
    assert "docdepth run run --layers normal" in said


def test_a_folder_that_was_deleted_while_one_stands_in_it(docdepth, drive, tmp_path, monkeypatch):
    (tmp_path / "gone").mkdir()
    monkeypatch.chdir(tmp_path / "gone")
    (tmp_path / "gone").rmdir()
    ended = docdepth("run", drive, "-o", "run")
    monkeypatch.chdir(tmp_path)
    assert ended.code == 2
    assert "the current directory does not exist any more" in ended.err


def test_a_home_that_the_shell_did_not_write_out(docdepth, drive, tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    assert docdepth("run", drive, "--output=~/run", "--camera", "none", "-q").code == 0
    assert docdepth("status", "~/run").code == 0
    assert [file.name for file in tmp_path.iterdir()] == ["run"]


def test_unusable_points_are_kept_apart(drive, tmp_path):
    broken = tmp_path / "drive"
    shutil.copytree(drive, broken)
    path = broken / "velodyne" / "000002.bin"
    points = np.fromfile(path, np.float32).reshape(-1, 4)
    points[:50, 0] = np.nan
    points[50:90, 1] = np.inf
    points[90:110, :3] = 0
    points[110:120, :3] = 2e5  # where nothing returned
    points.tofile(path)
    run = tmp_path / "run"
    result = cli("run", broken, "-o", run)
    assert result.exit_code == 0, result.output
    frame = read_frame(run / "frames" / "frame_000002.ply")
    np.testing.assert_array_equal(frame.index, np.arange(120, len(points)))
    assert np.isfinite(frame.points).all()
    assert len(np.fromfile(run / "labels" / "000002.label", np.uint32)) == len(points)


@pytest.mark.slow
def test_every_verb_takes_a_folder_whose_name_is_no_text(docdepth, drive, tmp_path):
    named = tmp_path / os.fsdecode(b"\xe4")
    shutil.copytree(drive, named / "drive")
    run = named / "run"
    verbs = [
        ("run", named / "drive", "-o", run),
        ("run", run, "--set", "render.behind=30"),
        ("status", run),
        ("inspect", run, "-o", named / "page.html"),
        ("map", run),
        ("video", run),
        ("tune", run, "-o", named / "tune", "--vary", "render.behind=15,30"),
        *(("convert", run, named / to, "--to", to) for to in ("tum", "label", "pcd", "colmap")),
        *(("convert", run, named / to, "--to", to) for to in ("nerfstudio", "mcap", "occupancy")),
    ]
    for verb in verbs:
        ended = docdepth(*(os.fsencode(word) for word in verb))
        assert ended.code == 0, ended.err


def test_ctrl_c_while_modules_are_imported():
    """Delivered by an import hook, since nobody can time it."""
    code = (
        "import os, signal, sys\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"  # jobs of a shell ignore it
        "class Hook:\n"
        "    def find_spec(self, name, *_):\n"
        "        if name == MODULE: os.kill(os.getpid(), signal.SIGINT)\n"
        "sys.meta_path.insert(0, Hook())\n"
        "from docdepth.__main__ import main\n"
        "main()\n"
    )
    for module in ("numpy", "cv2", "docdepth._core", "docdepth.cli.tune"):
        ended = subprocess.run(
            [sys.executable, "-c", code.replace("MODULE", repr(module))],
            capture_output=True, text=True,
        )  # fmt: skip
        assert ended.returncode == 130
        assert ended.stderr == "stopped; the same command continues\n"


@pytest.mark.parametrize("number", [errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOSYS])
def test_a_file_system_without_locks(docdepth, copies, monkeypatch, number):
    def refuse(*_: object) -> None:
        raise OSError(number, os.strerror(number))

    above, run = copies
    monkeypatch.setattr("fcntl.flock", refuse)
    ended = [docdepth("run", above, "-o", run), docdepth("map", run)]
    assert [one.code for one in ended] == [0, 0]
    assert "".join(one.err for one in ended).count("lies on a file system without locks") == 1


FORMATS = ("tum", "label", "classid", "pcd", "proj_depth", "nerfstudio", "colmap", "map", "mcap")


@pytest.mark.parametrize("to", [*FORMATS, "occupancy"])
@pytest.mark.parametrize("there", [False, True])
def test_a_convert_that_fails_leaves_nothing(docdepth, finished, tmp_path, monkeypatch, to, there):
    run, out = finished[0], tmp_path / "out"
    if there := there and to != "tum":
        out.mkdir()
    fsync, calls = os.fsync, []

    def fill(descriptor: int) -> None:
        calls.append(descriptor)
        if len(calls) > (to in ("label", "nerfstudio")):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        fsync(descriptor)

    with monkeypatch.context() as full:
        full.setattr("os.fsync", fill)
        full.setattr("rosbags.rosbag2.Writer.write", lambda *_: fill(0))
        ended = docdepth("convert", run, out, "--to", to)
    assert ended.code == 2
    assert str(out) in ended.err
    assert list(out.rglob("*.*")) == []
    assert out.exists() == (there or to == "proj_depth")
    ended = docdepth("convert", run, out, "--to", to)
    assert ended.code == 0, ended.err


@pytest.mark.parametrize("place", ["frames/frame_000001.ply", "depth", ".docdepth/records", "x"])
@pytest.mark.parametrize("make", [Path.symlink_to, lambda path, _: os.mkfifo(path)])
def test_nothing_in_a_run_leads_elsewhere(docdepth, copies, tmp_path, place, make):
    (tmp_path / "kept" / "frames").mkdir(parents=True)
    above, run = copies
    if (run / place).is_dir():
        shutil.rmtree(run / place)
    (run / place).unlink(missing_ok=True)
    make(run / place, tmp_path / "kept")
    for verb in (("run", above, "-o", run), ("status", run), ("run", run)):
        ended = docdepth(*verb)
        assert ended.code == 2
        assert f"{run / place} is " in ended.err
    assert (tmp_path / "kept" / "frames").is_dir()


@pytest.mark.parametrize("value", [np.nan, 2e5])
def test_a_frame_that_no_lidar_has_seen(docdepth, copies, tmp_path, value):
    _, run = copies
    frame = read_frame(path := run / "frames" / "frame_000001.ply")
    frame.points[7, 1] = value
    write_frame(path, frame)
    ended = docdepth("convert", run, tmp_path / "grids", "--to", "occupancy")
    assert ended.code == 2
    assert "frame_000001.ply is damaged (a point is not finite, or 100 km away)" in ended.err


@pytest.mark.parametrize("name", [".docdepth/records/frames.jsonl", "frames/.x.ply.part"])
def test_what_is_added_to_has_no_second_name(docdepth, copies, tmp_path, name):
    above, run = copies
    (kept := tmp_path / "kept").write_text("of somebody else")
    (run / name).unlink(missing_ok=True)
    os.link(kept, run / name)
    ended = docdepth("run", above, "-o", run, "--force")
    assert ended.code == 2
    assert f"{run / name} is a second name of another file" in ended.err
    assert kept.read_text() == "of somebody else"


WRITE = {
    *("calibrate", "convert", "inspect", "map", "render", "run", "synth", "tune", "video"),
}
REFUSED = {"demo", "doctor", "evaluate", "parameters", "status", "view"}
"""Verbs that write nothing of their own, or no file that is there."""


def test_every_verb_is_known_to_write_or_not():
    known = {command.name or command.callback.__name__ for command in app.registered_commands}
    assert known | {group.name for group in app.registered_groups} == WRITE | REFUSED


@pytest.mark.slow
def test_no_verb_loses_what_somebody_wrote_or_changed(docdepth, copies, tmp_path):
    above, run = copies
    labels, out = run / "labels", tmp_path / "out"
    verbs = {
        "inspect": (above, "-o", out / "page.html"),
        "map": (run,),
        "video": (run,),
        "tune": (
            run,
            "--vary",
            "dynamics.tolerance=0.2,0.3",
            "-o",
            out / "tune",
            "--labels",
            labels,
        ),
        "calibrate": (run, "-o", out / "calibrate"),
        "convert": (run, out / "poses.txt", "--to", "tum"),
        "synth": (out / "synth", "--frames", "2", "--sensor", "VLP-16", "--force"),
        "render": (run, "--set", "render.behind=30"),
        "run": (run, "--set", "odometry.voxel_size=1.1"),
    }
    assert verbs.keys() == WRITE
    for verb in ("inspect", "map", "tune", "convert"):
        assert docdepth(verb, *verbs[verb]).code == 0
    for name in ("run/report/video.webm", "out/calibrate/image_2.jpg"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    files = [f for f in tmp_path.rglob("*") if f.is_file() and above not in f.parents]
    marks = {
        f: f"\n# of somebody {k}\n".encode()
        for k, f in enumerate(files)
        if STATE_DIR not in f.parts
    }
    for file, mark in marks.items():
        file.write_bytes(file.read_bytes() + mark)
    for verb, arguments in verbs.items():
        docdepth(verb, *arguments)
    kept = b"".join(f.read_bytes() for f in tmp_path.rglob("*") if f.is_file())
    assert [str(file) for file, mark in marks.items() if mark not in kept] == []
