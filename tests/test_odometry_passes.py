"""Passes of odometry run at once: the same poses, and nothing left behind however it ends."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from docdepth import odometry as module
from docdepth import side_by_side
from docdepth.config import OdometryParameters
from docdepth.datasets import Sweep
from docdepth.errors import OdometryError
from docdepth.odometry import estimate_poses
from exact_drive import Drive

COUNT = 22
ROOT = Path(__file__).resolve().parent.parent


class Interrupted(Exception):
    pass


@pytest.fixture(scope="module")
def drive() -> Drive:
    measured = Drive(COUNT)
    for k in range(COUNT):
        measured.sweep(k)
    return measured


@pytest.fixture(scope="module")
def expected(drive: Drive) -> np.ndarray:
    """One pass after the other."""
    return estimate_poses(drive, threads=1)


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> list[subprocess.Popen]:
    """The processes that a test has started."""
    workers: list[subprocess.Popen] = []

    class Popen(subprocess.Popen):
        def __init__(self, *args: object, **more: object) -> None:
            super().__init__(*args, **more)
            workers.append(self)

    monkeypatch.setattr(side_by_side.subprocess, "Popen", Popen)
    return workers


@dataclass
class Spoilt(Drive):
    """A drive that does something else than reading one sweep, in the process of a pass."""

    deed: Callable[[], object] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        self.caller = os.getpid()

    def sweep(self, index: int) -> Sweep:
        if index == 12 and os.getpid() != self.caller and self.deed:
            self.deed()
        return super().sweep(index)


def die() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def stumble() -> None:
    raise EOFError("the file is too short")


def script(text: str) -> subprocess.CompletedProcess:
    """Run a script without a guard for ``__main__``; ends when all its processes have."""
    return subprocess.run(
        [sys.executable, "-c", "import sys; sys.path.insert(0, 'tests')\n" + text],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=120,
        start_new_session=True,
    )


# ---- the same poses


@pytest.mark.parametrize(("threads", "processes"), [(3, 2), (2, 1), (8, 2)])
def test_passes_at_once_give_the_same_bits(
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
    monkeypatch.setattr(module.os, "sched_getaffinity", lambda _: {0}, raising=False)
    monkeypatch.setattr(module.os, "cpu_count", lambda: 1)
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
    monkeypatch.setattr(side_by_side, "_LARGEST", 10_000)
    assert estimate_poses(drive, threads=3).tobytes() == expected.tobytes()
    assert started == []


def test_a_class_that_only_the_script_knows() -> None:
    result = script(
        "from exact_drive import Drive\n"
        "class Mine(Drive): pass\n"
        "from docdepth.odometry import estimate_poses\n"
        f"one, three = (estimate_poses(Mine({COUNT}), threads=t).tobytes() for t in (1, 3))\n"
        "assert one == three"
    )
    assert (result.returncode, result.stdout, result.stderr) == (0, "", "")


def test_warnings_are_logged_by_the_caller(caplog: pytest.LogCaptureFixture) -> None:
    drive = Drive(COUNT)
    good = drive.sweep(4)
    drive._sweeps[4] = Sweep(good.points * 0, good.name, good.time, fraction=good.fraction)
    estimate_poses(drive, threads=3)
    said = [r.getMessage() for r in caplog.records if r.name == "docdepth.registration"]
    assert len(said) == 3
    assert all("frame 4 has 0 usable points" in text for text in said)


# ---- ends before the end


def test_an_error_arrives_as_it_was_raised(started: list) -> None:
    drive = Drive(COUNT)
    drive.sweep(9).fraction[100:2000] = np.nan
    texts = []
    for threads in (1, 3):
        with pytest.raises(OdometryError, match=r"sweep 000009 \(frame 9\): .*no fin") as caught:
            estimate_poses(drive, threads=threads)
        texts.append(str(caught.value))
    assert texts[0] == texts[1]
    assert len(started) == 2
    with pytest.raises(EOFError, match="the file is too short"):
        estimate_poses(Spoilt(COUNT, deed=stumble), threads=3)


def test_a_killed_process_is_named(started: list) -> None:
    with pytest.raises(OdometryError, match=r"pass [12] was ended by signal 9.*--threads 1"):
        estimate_poses(Spoilt(COUNT, deed=die), threads=3)
    assert all(worker.returncode is not None for worker in started)


@pytest.mark.parametrize("end", ["os.kill(os.getpid(), 9)", "os.killpg(0, signal.SIGINT)"])
def test_no_process_outlives_the_caller(end: str) -> None:
    result = script(
        "import os, signal\n"
        "from exact_drive import Drive\n"
        "from docdepth.odometry import estimate_poses\n"
        "def end(done, *_):\n"
        f"    if done == 30: {end}\n"
        f"estimate_poses(Drive({COUNT}), progress=end, threads=3)"
    )
    assert result.returncode in (-signal.SIGKILL, -signal.SIGINT)
    assert result.stderr.count("Traceback") == (result.returncode == -signal.SIGINT)


# ---- going on


def test_passes_are_kept_the_moment_they_are_whole(
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


def test_an_interrupted_run_goes_on_after_the_last_whole_pass(tmp_path: Path) -> None:
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
