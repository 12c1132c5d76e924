"""Every way to end without a result: one sentence, one exit code, no traceback."""

from __future__ import annotations

import errno
import os
import re
import shutil
import subprocess
import sys

import pytest
import yaml

from docdepth.cli import failures
from docdepth.cli.failures import explain
from docdepth.errors import InputError

NO_TEXT = "b\udcff"  # a name with a byte that is no UTF-8


@pytest.fixture
def odd(tmp_path):
    """A folder with things that are not what their names promise."""
    (tmp_path / "file").write_text("hello\n")
    (tmp_path / "folder").mkdir()
    (tmp_path / "dangling").symlink_to(tmp_path / "nowhere")
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    (tmp_path / "binary").write_bytes(bytes(range(256)))
    return tmp_path


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (["-o", "x" * 300], "longer than the file system allows"),
        (["-o", "run", "--poses", "loop"], "leads back to itself"),
    ],
)
def test_a_mistake_of_run_is_a_sentence(docdepth, drive, odd, monkeypatch, options, named):
    monkeypatch.chdir(odd)
    before = sorted(os.listdir())
    ended = docdepth("run", drive, *options)
    assert ended.code == 2
    assert named in ended.err
    assert ended.err.startswith("error: ")
    assert "Traceback" not in ended.err
    assert sorted(os.listdir()) in (before, sorted([*before, "run"]))


@pytest.mark.parametrize("name", ["loop", "dangling", "x" * 300, NO_TEXT])
def test_a_recording_that_is_none_is_named(docdepth, odd, monkeypatch, name):
    monkeypatch.chdir(odd)
    ended = docdepth("run", name, "-o", "run")
    assert ended.code == 2
    shown = {NO_TEXT: r"b\xff", "dangling": "nowhere"}.get(name, name)
    assert shown in ended.err
    assert "Traceback" not in ended.err


@pytest.mark.parametrize("text", ["", "[", "- a\n"])
def test_a_broken_run_file_is_a_sentence(docdepth, finished, tmp_path, text):
    run = tmp_path / "run"
    shutil.copytree(finished[0], run)
    (run / "run.yaml").write_text(text)
    copy = run / ".docdepth" / "run.yaml"
    kept = copy.read_bytes()
    copy.write_text(text)
    ended = docdepth("video", run)
    assert ended.code == 2
    assert ended.err.startswith(f"error: {run / 'run.yaml'} is missing or damaged")
    # One of the two is enough.
    copy.write_bytes(kept)
    ended = docdepth("video", run)
    assert ended.code == 0, ended.err
    assert "its copy is used" in ended.err


def test_a_path_of_any_bytes_is_printed(docdepth, finished, tmp_path):
    for name in (NO_TEXT, "größe"):
        run = tmp_path / name
        shutil.copytree(finished[0], run)
        ended = docdepth("video", run)
        assert ended.code == 0, ended.err
        assert f"{run}/report/video.webm".replace(NO_TEXT, r"b\xff") in ended.out
        assert (run / "report" / "video.webm").stat().st_size > 1000


def test_a_terminal_that_knows_ascii_only_is_no_error(tmp_path):
    command = [sys.executable, "-m", "docdepth", "video", tmp_path / "größe\udcff"]
    surroundings = {**os.environ, "PYTHONIOENCODING": "ascii", "COLUMNS": "300"}
    ended = subprocess.run(command, capture_output=True, env=surroundings)
    assert ended.returncode == 2
    assert rb"gr\xf6\xdfe\xff holds no run" in ended.stderr


@pytest.mark.parametrize("code", sorted(failures._WRONG))
def test_every_error_of_the_system_names_path_and_remedy(code):
    failure = explain(OSError(code, os.strerror(code), "/data/a.bin"))
    assert re.match("/data/a.bin .*; ", str(failure))


def test_a_file_in_the_making_is_called_by_its_final_name():
    failure = explain(OSError(errno.ENOSPC, "full", "/data/run/.run.yaml.part"))
    assert str(failure).startswith("/data/run/run.yaml cannot be written: the disk is full")


def test_a_dangling_link_is_told_with_where_it_points(odd):
    with pytest.raises(FileNotFoundError) as caught:
        (odd / "dangling" / "x").read_text()
    failure = explain(caught.value) or ""
    assert f"{odd}/dangling is a link to {odd}/nowhere, which is not there" in failure


@pytest.mark.parametrize(
    ("error", "code", "words"),
    [
        (KeyboardInterrupt(), 130, "stopped; the same command continues"),
        (MemoryError("24 GB"), 2, "not enough memory (24 GB); reduce"),
        (InputError("frame 3"), 2, "frame 3"),
        (UnicodeDecodeError("utf-8", b"\xff", 0, 1, "bad"), 2, "binary file"),
        (UnicodeEncodeError("utf-8", "\udcff", 0, 1, "bad"), 2, "path"),
        (yaml.YAMLError("line 3"), 2, "line 3"),
        (OSError("no number"), 2, "no number"),
    ],
)
def test_other_errors_have_sentences(docdepth, monkeypatch, tmp_path, error, code, words):
    def fail(*arguments, **options):
        raise error

    monkeypatch.setattr("docdepth.io.run_folder.RunFolder.open", fail)
    ended = docdepth("video", tmp_path)
    assert ended.code == code
    assert words in ended.err
    assert len(ended.err.splitlines()) == 1


@pytest.mark.parametrize("verbose", [False, True])
def test_a_bug_is_admitted_and_its_traceback_kept(docdepth, monkeypatch, tmp_path, verbose):
    def fail(*arguments, **options):
        raise KeyError("stages")

    monkeypatch.setattr("docdepth.io.run_folder.RunFolder.open", fail)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    ended = docdepth("video", tmp_path, *["--verbose"] * verbose)
    assert ended.code == 1
    assert "docdepth has a bug: KeyError: 'stages'; please report it" in ended.err
    assert ("Traceback" in ended.err) == verbose
    kept = list(tmp_path.glob("docdepth-bug-*.txt"))
    assert len(kept) == (not verbose)
    for file in kept:
        assert str(file) in ended.err
        assert "Traceback" in file.read_text()


def test_a_reader_that_has_gone_is_no_error(finished):
    command = f"{sys.executable} -m docdepth parameters | head -1; exit ${{PIPESTATUS[0]}}"
    ended = subprocess.run(["bash", "-c", command], capture_output=True, text=True)
    assert ended.stderr == ""
    assert "odometry.max_range" in ended.stdout


def test_ctrl_c_is_one_line(docdepth, monkeypatch, drive, tmp_path):
    def stop(*arguments, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr("docdepth.pipeline.run.run_odometry", stop)
    ended = docdepth("run", drive, "-o", tmp_path / "run")
    assert (ended.code, ended.err) == (130, "stopped; the same command continues\n")
