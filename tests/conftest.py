"""Shared fixtures: real recordings where there are any, and made-up ones."""

import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from command_line import cli
from docdepth.geometry import ground_plane
from docdepth.geometry.trajectory import Trajectory
from docdepth.odometry import first_motion
from motion import straight
from true_drive import write_true_drive
from walled_yard import scan

_NO_RECORDINGS = "DOCDEPTH_KITTI_RAW is not set: no real recordings"


def pytest_collection_modifyitems(items):
    """What runs at night is slow, too."""
    for item in items:
        if item.get_closest_marker("nightly"):
            item.add_marker(pytest.mark.slow)


def pytest_terminal_summary(terminalreporter):
    """Say which tests on real recordings were left out, and how to run them."""
    skipped = terminalreporter.stats.get("skipped", [])
    left_out = sorted({report.nodeid for report in skipped if "KITTI_RAW" in str(report.longrepr)})
    if left_out:
        terminalreporter.section("not run: tests on real recordings")
        for name in left_out:
            terminalreporter.line(f"  {name}")
        terminalreporter.line(
            f"{len(left_out)} tests were left out. They need KITTI raw drives: "
            "DOCDEPTH_KITTI_RAW=FOLDER make test, where FOLDER holds 2011_09_26"
        )


@pytest.fixture(scope="session")
def kitti() -> Path:
    """Folder 2011_09_26 of the real recordings, or skip."""
    root = os.environ.get("DOCDEPTH_KITTI_RAW")
    if not root:
        pytest.skip(_NO_RECORDINGS)
    return Path(root) / "2011_09_26"


@pytest.fixture(scope="session")
def recordings() -> Path:
    """Folder of real recordings of other sensors, or skip."""
    root = os.environ.get("DOCDEPTH_RECORDINGS")
    if not root:
        pytest.skip("DOCDEPTH_RECORDINGS is not set: no recordings of other sensors")
    return Path(root)


@pytest.fixture(scope="session")
def drive_0005(kitti: Path) -> Path:
    """City drive with labelled moving points."""
    return kitti / "2011_09_26_drive_0005_sync"


@pytest.fixture(scope="session")
def drive_9001(kitti: Path) -> Path:
    """Drive up to a red light, with images."""
    return kitti / "2011_09_26_drive_9001_sync"


@pytest.fixture(scope="session", autouse=True)
def coarse_search() -> Iterator[None]:
    """Seek first motions in four directions and steps of half a metre, and the ground among 400
    planes: else they are most of the time of a small run.

    Tests of the odometry seek motions in all directions.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(first_motion, "_DIRECTIONS", first_motion._DIRECTIONS[::9])
        patch.setattr(first_motion, "_SPEEDS", first_motion._SPEEDS[::2])
        patch.setattr(ground_plane, "_TRIALS", 400)
        yield


@pytest.fixture(scope="module")
def whole_ground_search() -> Iterator[None]:
    """For tests of the ground: seek it among all planes."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ground_plane, "_TRIALS", 2000)
        yield


@pytest.fixture(scope="session")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five small sweeps of a street, with their truth."""
    return write_true_drive(tmp_path_factory.mktemp("drive") / "sequences" / "00")


@pytest.fixture(scope="session")
def finished(drive: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """A finished run of the drive, and what it printed."""
    run = tmp_path_factory.mktemp("finished") / "run"
    result = cli("run", drive, "-o", run)
    assert result.exit_code == 0, result.output
    return run, result.output


@pytest.fixture(scope="session")
def yard() -> tuple[Trajectory, list[np.ndarray], list[np.ndarray]]:
    """Twelve sweeps of the walled yard: trajectory, points, what each point hit."""
    trajectory = straight(12, 0.5)
    scans = [scan(T, box_x=-8 + 1.5 * i) for i, T in enumerate(trajectory.poses)]
    return trajectory, [points for points, _ in scans], [what for _, what in scans]
