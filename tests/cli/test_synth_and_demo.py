"""Synthetic drives overwrite nothing that is not theirs."""

from __future__ import annotations

import hashlib
import shutil

import pytest
import yaml

from docdepth.errors import DatasetError
from docdepth.synthetic import write_drive

pytest.importorskip("embreex")

SMALL = {"sensor": "VLP-16", "frames": 3, "seed": 1, "images": False}
COMMAND = ["--sensor", "VLP-16", "--frames", "3"]


def contents(folder):
    files = sorted(p for p in folder.rglob("*") if p.is_file())
    return {str(p.relative_to(folder)): hashlib.sha1(p.read_bytes()).hexdigest() for p in files}


@pytest.fixture
def copied(drive, tmp_path):
    """A finished synthetic drive in tmp_path / "d"."""
    folder = tmp_path / "d" / "sequences" / "00"
    shutil.copytree(drive, folder)
    about = {"scene": "city", "sensor": "VLP-16", "seed": 1, "frames": 5}
    (folder / "docdepth.yaml").write_text(yaml.safe_dump(about | {"motion_compensated": True}))
    return folder


def test_synth_does_not_overwrite_a_drive(docdepth, copied, tmp_path):
    before = contents(tmp_path)
    ended = docdepth("synth", tmp_path / "d", *COMMAND)
    assert ended.code == 2
    assert "holds a synthetic drive (city, VLP-16, 5 frames, seed 1)" in ended.err
    assert contents(tmp_path) == before


@pytest.mark.parametrize("force", [[], ["--force"]])
def test_synth_does_not_touch_a_folder_of_the_user(docdepth, tmp_path, force):
    (tmp_path / "velodyne").mkdir()
    (tmp_path / "velodyne" / "000000.bin").write_bytes(b"1234")
    (tmp_path / "notes.txt").write_text("mine")
    before = contents(tmp_path)
    ended = docdepth("synth", tmp_path, *COMMAND, *force)
    assert ended.code == 2
    assert f"{tmp_path} is not empty: it holds notes.txt, velodyne" in ended.err
    assert contents(tmp_path) == before


@pytest.mark.slow
def test_force_replaces_a_synthetic_drive_and_keeps_other_files(docdepth, copied, tmp_path):
    folder = copied
    (folder / "velodyne" / "mine.txt").write_text("mine")
    ended = docdepth("synth", tmp_path / "d", *COMMAND, "--force", "-q")
    assert ended == (0, "", "")
    assert len(list((folder / "velodyne").glob("*.bin"))) == 3
    assert len(list((folder / "labels").glob("*.label"))) == 3
    assert (folder / "velodyne" / "mine.txt").read_text() == "mine"


def test_force_does_not_take_a_recording_for_a_synthetic_drive(docdepth, copied, tmp_path):
    (copied / "docdepth.yaml").write_text("motion_compensated: true\nsensor: hdl64\n")
    before = contents(tmp_path)
    assert docdepth("synth", tmp_path / "d", *COMMAND, "--force").code == 2
    assert contents(tmp_path) == before


@pytest.mark.slow
def test_an_interrupted_drive_is_made_whole_by_the_same_call(tmp_path):
    def stop(stage, done, total):
        if done == 2:
            raise KeyboardInterrupt

    whole = write_drive(tmp_path / "whole", **SMALL)
    with pytest.raises(KeyboardInterrupt):
        write_drive(tmp_path / "d", **SMALL, progress=stop)
    with pytest.raises(DatasetError, match="holds a synthetic drive"):
        write_drive(tmp_path / "d", **{**SMALL, "seed": 2})
    assert contents(write_drive(tmp_path / "d", **SMALL)) == contents(whole)


def test_a_file_in_the_way_is_named(docdepth, tmp_path):
    (tmp_path / "file").write_text("mine")
    (tmp_path / "link").symlink_to(tmp_path / "nowhere")
    for name in ("file", "link"):
        ended = docdepth("synth", tmp_path / name, *COMMAND)
        assert ended.code == 2
        assert f"{tmp_path / name} is no folder" in ended.err


def test_the_demo_of_another_length_or_preset_is_not_taken(docdepth, drive, tmp_path):
    folder = tmp_path / "demo" / "drive" / "sequences" / "00"
    shutil.copytree(drive, folder)
    about = {"scene": "city", "sensor": "HDL-64", "seed": 0, "frames": 5}
    (folder / "docdepth.yaml").write_text(yaml.safe_dump(about))
    command = ["demo", "-o", tmp_path / "demo"]
    assert docdepth(*command, "--frames", "5", "-q").code == 0
    before = contents(tmp_path)
    other = docdepth(*command, "--frames", "4")
    assert other.code == 2
    assert "holds the demo of another drive (city, HDL-64, 5 frames, seed 0)" in other.err
    preset = docdepth(*command, "--frames", "5", "--preset", "paper")
    assert preset.code == 2
    assert "'default', not 'paper'" in preset.err
    assert contents(tmp_path) == before
    shown = docdepth(*command, "--frames", "5")
    assert shown.code == 0
    assert f"more figures: docdepth evaluate labels {tmp_path / 'demo' / 'run'}" in shown.out
    assert f"open {tmp_path / 'demo' / 'run' / 'report' / 'index.html'}" in shown.out
    assert "\ninterior " in shown.out
    assert "0..10 m" not in shown.out
