"""A disk that fills up, a folder that cannot be written, a second process, Ctrl-C."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from full_disk import MOMENTS

from docdepth.io.run_folder import RunFolder
from docdepth.pipeline.plan import states
from docdepth.pipeline.run import run
from small_drive import results, write_small_drive

COUNT = 6


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_small_drive(tmp_path_factory.mktemp("faults") / "drive", COUNT)


@pytest.fixture(scope="module")
def whole(drive: Path) -> Path:
    """An undisturbed run."""
    run(drive, drive.parent / "whole", camera="image_2", threads=2)
    return drive.parent / "whole"


def test_a_disk_that_fills_up_again_and_again(drive: Path, whole: Path, tmp_path: Path) -> None:
    if subprocess.run(["unshare", "-rm", "true"], capture_output=True).returncode:
        pytest.skip("this machine lets nobody mount a file system of his own")
    (tmp_path / "disk").mkdir()
    script = Path(__file__).with_name("full_disk.py")
    command = ["unshare", "-rm", sys.executable, script, drive, tmp_path / "disk", tmp_path / "run"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout.splitlines()[-1])
    assert len(told) == len(MOMENTS)
    for entry in told:
        assert "RunError: cannot write" in entry["said"], entry
        assert "No space left on device; make room" in entry["said"], entry
        assert "it continues where it stopped" in entry["said"]
        assert entry["parts"] == []
    for stage in ("odometry", "classify", "render image_2"):  # nothing is lost
        frames = [entry["done"].get(stage, 0) for entry in told]
        assert frames == sorted(frames)
    assert told[-1]["done"]["classify"] == COUNT
    assert results(tmp_path / "run") == results(whole)


@pytest.mark.slow
def test_a_folder_that_cannot_be_written(drive: Path, whole: Path, tmp_path: Path) -> None:
    """Read-only, as a disk with errors becomes."""
    if subprocess.run(["unshare", "-rm", "true"], capture_output=True).returncode:
        pytest.skip("this machine lets nobody mount a file system of his own")
    shutil.copytree(whole, tmp_path / "run")
    (tmp_path / "run" / "depth" / "000002.png").unlink()
    script = (
        f"mount --bind {tmp_path}/run {tmp_path}/run; mount -o remount,ro,bind {tmp_path}/run; "
        f"{sys.executable} -m docdepth run {tmp_path}/run; echo $?; "
        f"{sys.executable} -m docdepth status {tmp_path}/run"
    )
    done = subprocess.run(["unshare", "-rm", "bash", "-c", script], capture_output=True, text=True)
    said = " ".join(done.stderr.split())
    assert "error: " in said
    assert "cannot be written" in said or "cannot write" in said
    assert "Traceback" not in said
    assert done.stdout.splitlines()[0] == "2"
    assert "depth/000002.png is missing" in done.stdout
    before = {p: p.stat().st_mtime_ns for p in (tmp_path / "run" / "labels").iterdir()}
    run(drive, tmp_path / "run", camera="image_2", threads=2)
    assert {p: p.stat().st_mtime_ns for p in (tmp_path / "run" / "labels").iterdir()} == before
    assert results(tmp_path / "run") == results(whole)


def start(drive: Path, output: Path) -> subprocess.Popen[str]:
    """A run that waits behind its second frame until the file ``go`` is there."""
    code = (
        "import os, signal, sys, time\n"
        # Jobs in the background of a shell ignore it, and so would what they start.
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "from docdepth.cli import main\n"
        "from docdepth.io.run_folder import RunFolder\n"
        "write, made = RunFolder.write_frame, []\n"
        "def slow(*arguments):\n"
        "    made.append(1)\n"
        f"    while len(made) > 2 and not os.path.exists({str(output.parent / 'go')!r}):\n"
        "        time.sleep(0.05)\n"
        "    return write(*arguments)\n"
        "RunFolder.write_frame = slow\n"
        "main()\n"
    )
    arguments = ["run", drive, "-o", output, "--camera", "image_2", "--threads", "2"]
    return subprocess.Popen(
        [sys.executable, "-c", code, *map(str, arguments)], stderr=subprocess.PIPE, text=True
    )


def wait_for(path: Path) -> None:
    for _ in range(6000):
        if path.exists():
            return
        time.sleep(0.01)
    raise AssertionError(f"{path} does not appear")


@pytest.mark.slow
def test_ctrl_c_leaves_a_clean_state(drive: Path, whole: Path, tmp_path: Path) -> None:
    process = start(drive, tmp_path / "run")
    wait_for(tmp_path / "run" / "frames" / "frame_000001.ply")
    process.send_signal(signal.SIGINT)
    said = process.communicate(timeout=120)[1]
    assert process.returncode == 130, said
    assert said.splitlines()[-1] == "stopped; the same command continues"
    assert not list((tmp_path / "run").rglob("*.part"))
    (state, *_) = states(RunFolder.open(tmp_path / "run"))
    assert state.state == "incomplete"
    assert state.frames >= 2
    assert state.why == "it was interrupted"
    run(drive, tmp_path / "run", camera="image_2", threads=2)
    assert results(tmp_path / "run") == results(whole)


def test_a_lost_file_of_the_recording_is_named(drive: Path, tmp_path: Path) -> None:
    """As when the network goes away: the run goes on when it is back."""
    shutil.copytree(drive, tmp_path / "drive")
    file = tmp_path / "drive" / "velodyne" / "000004.bin"

    def progress(stage: str, done: int, total: int) -> None:
        if (stage, done) == ("register", 1):
            file.rename(tmp_path / "away")

    with pytest.raises(Exception, match=r"000004\.bin \(frame 4\) is missing"):
        run(tmp_path / "drive", tmp_path / "run", camera="image_2", progress=progress, threads=2)
    os.rename(tmp_path / "away", file)
    folder = run(tmp_path / "drive", tmp_path / "run", camera="image_2", threads=2)
    assert {state.state for state in states(folder.folder)} == {"done"}
