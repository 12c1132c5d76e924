"""Parallel passes of odometry: the same poses as in sequence, and no process is left behind."""

from __future__ import annotations

import copy
import hashlib
import os
import pickle
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from docdepth.config import OdometryParameters
from docdepth.datasets import Sweep
from docdepth.errors import OdometryError
from docdepth.odometry import parallel_passes
from docdepth.odometry.odometry import estimate_poses
from exact_drive import Drive

COUNT = 22
ROOT = Path(__file__).resolve().parents[2]


class Interrupted(Exception):
    pass


@pytest.fixture(scope="module")
def drive() -> Drive:
    measured = Drive(COUNT)
    for k in range(COUNT):
        measured.sweep(k)
    return measured


@pytest.fixture(scope="module")
def saved(drive: Drive, tmp_path_factory: pytest.TempPathFactory) -> str:
    """The same drive for scripts."""
    path = tmp_path_factory.mktemp("drive") / "drive.pickle"
    path.write_bytes(pickle.dumps(drive))
    return str(path)


@pytest.fixture(scope="module")
def expected(drive: Drive) -> np.ndarray:
    """Poses of the passes in sequence."""
    return estimate_poses(drive, threads=1)


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> list[subprocess.Popen]:
    """The processes that a test has started."""
    workers: list[subprocess.Popen] = []

    class Popen(subprocess.Popen):
        def __init__(self, *args: object, **more: object) -> None:
            super().__init__(*args, **more)
            workers.append(self)

    monkeypatch.setattr(parallel_passes.subprocess, "Popen", Popen)
    return workers


class Spoilt(Drive):
    """A drive that calls ``action`` at one sweep, in the process of a pass only."""

    def __init__(self, drive: Drive, action: Callable[[], object]) -> None:
        vars(self).update(vars(drive), action=action, caller=os.getpid())

    def sweep(self, index: int) -> Sweep:
        if index == 12 and os.getpid() != self.caller:
            self.action()
        return super().sweep(index)


class Handle(Drive):
    """A drive with an open file: it can be pickled, but not read in another process."""

    def __getstate__(self) -> dict:
        return {name: value for name, value in vars(self).items() if name != "_sweeps"}


def with_sweep(drive: Drive, index: int, **change: object) -> Drive:
    """The drive with one sweep changed."""
    other = copy.copy(drive)
    other._sweeps = drive._sweeps | {index: replace(drive.sweep(index), **change)}
    return other


def die() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def fail() -> None:
    raise EOFError("the file is too short")


def script(drive: str, *lines: str) -> subprocess.CompletedProcess:
    """Run a script without a guard for ``__main__``; ends when all its processes have."""
    head = (
        "import hashlib, os, pickle, signal, sys",
        "sys.path[:0] = ['tests', 'tests/odometry']",
        "from exact_drive import Drive",
        "from docdepth.odometry.odometry import estimate_poses",
        # Of tests that run in the background the shell may have taken Ctrl-C away.
        "signal.signal(signal.SIGINT, signal.default_int_handler)",
        f"drive = pickle.load(open({drive!r}, 'rb'))",
    )
    return subprocess.run(
        [sys.executable, "-c", "\n".join(head + lines)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=120,
        start_new_session=True,
    )


# ---- the same poses


@pytest.mark.parametrize(("threads", "processes"), [(3, 2), (2, 1)])
def test_parallel_passes_give_the_same_bits(
    drive: Drive, expected: np.ndarray, started: list, threads: int, processes: int
) -> None:
    calls: list[tuple[int, int, str]] = []
    poses = estimate_poses(drive, progress=lambda *call: calls.append(call), threads=threads)
    assert poses.tobytes() == expected.tobytes()
    assert len(started) == processes
    assert all(worker.returncode is not None for worker in started)
    assert [call[:2] for call in calls] == [(k + 1, 3 * COUNT) for k in range(3 * COUNT)]
    assert calls[0][2] == f"odometry, passes 1 to {processes + 1} of 3"


def test_one_core_starts_nothing(
    drive: Drive, expected: np.ndarray, started: list, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0}, raising=False)
    monkeypatch.setattr(os, "cpu_count", lambda: 1)
    assert estimate_poses(drive).tobytes() == expected.tobytes()
    estimate_poses(Drive(4), threads=3)  # over before another process has started
    assert started == []


def test_datasets_that_cannot_be_sent(
    drive: Drive, expected: np.ndarray, started: list, monkeypatch: pytest.MonkeyPatch
) -> None:
    drive.open = lambda: None  # type: ignore[attr-defined]
    try:
        assert estimate_poses(drive, threads=3).tobytes() == expected.tobytes()
    finally:
        del drive.open  # type: ignore[attr-defined]
    monkeypatch.setattr(parallel_passes, "_LARGEST_DATASET", 10_000)
    assert estimate_poses(drive, threads=3).tobytes() == expected.tobytes()
    assert started == []
    handle = Handle(COUNT)
    handle._sweeps = drive._sweeps
    assert estimate_poses(handle, threads=3).tobytes() == expected.tobytes()
    assert len(started) == 2


def test_a_class_that_only_the_script_knows(saved: str, expected: np.ndarray) -> None:
    result = script(
        saved,
        "class Mine(Drive): pass",
        "drive.__class__ = Mine",
        "print(hashlib.sha256(estimate_poses(drive, threads=3)).hexdigest())",
    )
    assert result.stdout.strip() == hashlib.sha256(expected).hexdigest()
    assert result.stderr == ""


def test_warnings_are_logged_by_the_caller(drive: Drive, caplog: pytest.LogCaptureFixture) -> None:
    estimate_poses(with_sweep(drive, 4, points=drive.sweep(4).points * 0), threads=3)
    said = [r.getMessage() for r in caplog.records if r.name == "docdepth.odometry.registration"]
    assert len(said) == 1
    assert "the first of them frame 4: their poses are predicted" in said[0]


# ---- errors, and processes that are killed


def test_an_error_in_a_process_is_raised_by_the_caller(drive: Drive, started: list) -> None:
    relative_time = drive.sweep(9).relative_time.copy()
    relative_time[100:2000] = np.nan
    with pytest.raises(OdometryError) as caught:
        estimate_poses(with_sweep(drive, 9, relative_time=relative_time), threads=3)
    assert str(caught.value) == (
        "sweep 000009 (frame 9): a usable point has no finite time; drop it or give it one"
    )
    assert len(started) == 2
    with pytest.raises(EOFError, match="the file is too short"):
        estimate_poses(Spoilt(drive, fail), threads=3)


def test_a_killed_process_is_named(drive: Drive, started: list) -> None:
    with pytest.raises(OdometryError, match=r"pass 1 was ended by signal 9.*--threads 1"):
        estimate_poses(Spoilt(drive, die), threads=3)
    assert all(worker.returncode is not None for worker in started)


@pytest.mark.parametrize("end", ["os.kill(os.getpid(), 9)", "os.kill(0, signal.SIGINT)"])
def test_no_process_outlives_the_caller(saved: str, end: str) -> None:
    result = script(
        saved,
        "def end(done, *_):",
        f"    if done == 30: {end}",
        "estimate_poses(drive, progress=end, threads=3)",
    )
    assert result.returncode in (-signal.SIGKILL, -signal.SIGINT)
    assert result.stderr.count("Traceback") == (result.returncode == -signal.SIGINT)


# ---- continuing


def test_each_finished_pass_is_saved_at_once(
    drive: Drive, expected: np.ndarray, started: list, tmp_path: Path
) -> None:
    first = tmp_path / "odometry_pass_1.npz"

    def interrupt(done: int, total: int, what: str) -> None:
        if done == total - 1:
            for _ in range(600):
                if first.is_file():
                    raise Interrupted
                time.sleep(0.1)

    with pytest.raises(Interrupted):
        estimate_poses(drive, progress=interrupt, checkpoint=tmp_path, threads=3)
    assert all(worker.returncode is not None for worker in started)
    (tmp_path / "odometry_pass_2.npz").unlink(missing_ok=True)
    calls: list[int] = []
    again = estimate_poses(
        drive, progress=lambda done, *_: calls.append(done), checkpoint=tmp_path, threads=3
    )
    assert calls == list(range(COUNT + 1, 3 * COUNT + 1))
    assert len(started) == 3, "two passes were left, one of them the caller's"
    assert again.tobytes() == expected.tobytes()
    assert len(list(tmp_path.iterdir())) == 3


def test_an_interrupted_run_continues_after_the_last_finished_pass(tmp_path: Path) -> None:
    drive = Drive(4)
    whole = estimate_poses(drive)
    drive.read.clear()

    def interrupt(done: int, total: int, what: str) -> None:
        if done == 10:
            raise Interrupted

    with pytest.raises(Interrupted):
        estimate_poses(drive, progress=interrupt, checkpoint=tmp_path / "run")
    calls: list[int] = []
    again = estimate_poses(
        drive, progress=lambda done, *_: calls.append(done), checkpoint=tmp_path / "run"
    )
    assert calls == [9, 10, 11, 12]
    np.testing.assert_array_equal(again, whole)
    other = OdometryParameters(voxel_size=1.5)
    calls.clear()
    estimate_poses(
        drive, other, progress=lambda done, *_: calls.append(done), checkpoint=tmp_path / "run"
    )
    assert calls == list(range(1, 13)), "other parameters, other poses"
