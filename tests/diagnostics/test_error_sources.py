"""Poses that jitter and sweeps without motion compensation are named; right ones are not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from docdepth.config import Parameters
from docdepth.diagnostics.error_sources import ErrorSources, find_error_sources
from docdepth.geometry.lidar_frame import LidarFrame
from docdepth.geometry.trajectory import Trajectory
from docdepth.io.frames import write_trajectory
from docdepth.io.labels import classes_of_labels
from docdepth.io.run_folder import RunFolder

pytestmark = pytest.mark.slow

pytest.importorskip("embreex")
SWEEPS = 20


@pytest.fixture(scope="module")
def drives():
    """The same drive as it was measured, and motion compensated."""
    from docdepth.synthetic import Drive, scene, sensor

    made = {}
    for skew in (False, True):
        drive = Drive(scene("city", 3), sensor("XT-32"), SWEEPS, 3, skew)
        made[skew] = drive, [drive.sweep(k) for k in range(len(drive))]
    return made


def run_of(path: Path, drives, skew: bool, times: bool = False, off: float = 0.0) -> RunFolder:
    """A run with these sweeps as they are, and poses that are ``off`` by so many metres."""
    drive, sweeps = drives[skew]
    run = RunFolder.create(path, None, Parameters())
    run.save()
    poses = drive.poses.copy()
    away = np.random.default_rng(1).normal(size=(SWEEPS, 3))
    poses[:, :3, 3] += off * away / np.linalg.norm(away, axis=1, keepdims=True)
    trajectory = Trajectory(drive.times, poses)
    write_trajectory(run.trajectory_path, trajectory, np.arange(SWEEPS))
    for k, sweep in enumerate(sweeps):
        rows = np.arange(len(sweep.points), dtype=np.uint32)
        late = sweep.relative_time * np.float32(0.1) if times else None
        classid = classes_of_labels(sweep.labels)[0]
        frame = LidarFrame(
            sweep.points, rows, f"{k:06d}", len(rows), classid=classid, time_offset=late
        )
        run.write_frame(k, frame)
    return run


def test_right_sweeps_and_poses_are_not_blamed(tmp_path, drives) -> None:
    for times in (False, True):
        found = find_error_sources(run_of(tmp_path / str(times), drives, skew=False, times=times))
        assert found.findings == []
        assert found.jitter < 0.01
        assert min(found.residual, key=found.residual.get) == "as they are"


def test_poses_that_jitter_are_named_with_the_size_of_it(tmp_path, drives) -> None:
    seen = []
    found = find_error_sources(
        run_of(tmp_path / "run", drives, False, off=0.05), lambda *d: seen.append(d)
    )
    assert 0.03 < found.jitter < 0.08
    assert [f.code for f in found.findings] == ["jitter"]
    assert seen[-1][1] == seen[-1][2] == len(seen)


@pytest.mark.parametrize(
    ("times", "way"), [(False, "turns clockwise"), (True, "once more by their times")]
)
def test_sweeps_without_motion_compensation_are_named(tmp_path, drives, times, way) -> None:
    found = find_error_sources(run_of(tmp_path / "run", drives, skew=True, times=times))
    (finding,) = found.findings
    assert finding.code == "motion-compensation"
    assert way in finding.text


def test_a_standing_vehicle_and_a_short_drive_tell_nothing(tmp_path, drives) -> None:
    run = run_of(tmp_path / "run", drives, skew=True)
    drive = drives[True][0]
    standing = np.repeat(np.eye(4)[None], SWEEPS, axis=0)
    write_trajectory(run.trajectory_path, Trajectory(drive.times, standing), np.arange(SWEEPS))
    assert find_error_sources(run).residual == {}
    short = Trajectory(drive.times[:4], drive.poses[:4])
    write_trajectory(run.trajectory_path, short, np.arange(4))
    found = find_error_sources(run)
    assert np.isnan(found.jitter)
    assert found.findings == []


def test_small_differences_are_no_cause() -> None:
    assert ErrorSources(0.019, {"as they are": 0.030, "moved": 0.028}).findings == []
    assert len(ErrorSources(0.021, {"as they are": 0.030, "moved": 0.026}).findings) == 2
