"""Errors of poses against values worked out by hand, evo and KITTI's own code."""

from __future__ import annotations

import json
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

from command_line import cli
from docdepth.errors import InputError, OdometryError
from docdepth.evaluation.trajectories import compare_trajectories, evaluate_trajectories
from docdepth.geometry.se3 import rotation_exp
from docdepth.geometry.trajectory import Trajectory
from docdepth.io.poses import write_tum
from docdepth.io.run_folder import RunFolder
from motion import straight


def drive(count: int, seed: int, off: float = 0.0) -> Trajectory:
    """A winding path at 10 m/s and 10 poses a second; ``off`` scales errors of each pose."""
    random, poses = np.random.default_rng(seed), np.repeat(np.eye(4)[None], count, axis=0)
    for k in range(1, count):
        step = np.eye(4)
        step[:3, :3] = rotation_exp([0, 0.002 * np.sin(k / 9), 0.02 * np.sin(k / 40)])
        step[:3, 3] = 1.0, 0.0, 0.01
        poses[k] = poses[k - 1] @ step
    noise = random.normal(size=(count, 6)) * off
    for pose, (*turn, x, y, z) in zip(poses, noise, strict=True):
        pose[:3, :3] = pose[:3, :3] @ rotation_exp(np.array(turn) / 20)
        pose[:3, 3] += x, y, z
    return Trajectory(np.arange(count) * 100_000_000, poses)


def test_a_path_that_begins_elsewhere_is_right() -> None:
    truth, T = drive(50, 0), np.eye(4)
    T[:3, :3], T[:3, 3] = rotation_exp([0.1, -2.0, 0.4]), (7, 8, 9)
    result = compare_trajectories(truth, Trajectory(truth.times, T @ truth.poses))
    errors = [result.ape.max, result.rpe.max, result.rpe_deg.max]
    np.testing.assert_allclose(errors, 0, atol=1e-6)


def test_errors_of_one_step_by_hand() -> None:
    """The last of four steps along a line is 30 cm too long, and turned by 3 degrees."""
    poses = straight(5).poses
    made = poses.copy()
    made[4, 0, 3] += 0.3
    made[4, :3, :3] = rotation_exp([0, 0, np.radians(3)])
    times = np.arange(5)
    result = compare_trajectories(Trajectory(times, poses), Trajectory(times, made))
    # The mean moves by 0.06, so four positions are 6 cm off and the last one 24 cm.
    off = np.array([0.06, 0.06, 0.06, 0.06, 0.24])
    assert result.ape.mean == pytest.approx(off.mean())
    assert result.ape.rmse == pytest.approx(np.sqrt(np.mean(off**2)))
    assert (result.ape.median, result.ape.max) == (pytest.approx(0.06), pytest.approx(0.24))
    assert (result.rpe.mean, result.rpe.max) == (pytest.approx(0.3 / 4), pytest.approx(0.3))
    assert result.rpe_deg.max == pytest.approx(3)
    assert result.rpe_deg.rmse == pytest.approx(1.5)
    assert result.length == 4
    assert result.parts == 0
    assert np.isnan(result.drift)


def test_drift_is_that_of_kittis_benchmark() -> None:
    metrics = pytest.importorskip("kiss_icp.metrics")
    truth, made = drive(500, 1), drive(500, 1, off=0.3)
    result = compare_trajectories(truth, made)
    expected = metrics.sequence_error(truth.poses, made.poses)
    assert result.parts > 50
    rotation = expected[1] * 3.14 / np.pi * 100  # KITTI's code takes 3.14 for pi
    np.testing.assert_allclose((result.drift, result.drift_deg), (expected[0], rotation), rtol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("off", [0.01, 1.0])
def test_pose_errors_are_those_of_evo(tmp_path: Path, off: float) -> None:
    """evo is under the GPL: it runs as a program of its own and is imported by nothing here."""
    pytest.importorskip("evo.cli.entry_points", reason="evo is not installed")
    truth, made = drive(200, 2), drive(200, 2, off)
    result = compare_trajectories(truth, made)
    for name, trajectory in (("truth", truth), ("made", made)):
        write_tum(tmp_path / name, trajectory)
    for program, options, errors in (
        ("ape", ["-a"], result.ape),
        ("rpe", [], result.rpe),
        ("rpe", ["-r", "angle_deg"], result.rpe_deg),
    ):
        found = evo(program, options, tmp_path)
        for name in ("rmse", "mean", "median", "max"):
            assert getattr(errors, name) == pytest.approx(found[name], rel=1e-4, abs=1e-6)


def evo(program: str, options: list[str], folder: Path) -> dict[str, float]:
    """What a program of evo says of the poses in two files."""
    out = folder / f"{program}{''.join(options)}.zip"
    code = f"from evo.cli.entry_points import {program}; {program}()"
    files = [str(folder / "truth"), str(folder / "made"), "--save_results", str(out)]
    command = [sys.executable, "-c", code, "tum", *files, *options, "--no_warnings", "--silent"]
    home = {"HOME": str(folder), "PATH": "", "MPLBACKEND": "agg"}
    subprocess.run(command, env=home, check=True, capture_output=True, cwd=folder)
    with zipfile.ZipFile(out) as results:
        return dict(json.loads(results.read("stats.json")))


def test_truth_of_another_rate_is_interpolated() -> None:
    truth = drive(50, 3)
    between = Trajectory(
        truth.times[5:40] + 30_000_000, truth.interpolate(truth.times[5:40] + 30_000_000)
    )
    assert compare_trajectories(truth, between).rpe.max < 1e-9
    early = Trajectory(between.times - 800_000_000, between.poses)
    assert compare_trajectories(truth, early).poses == 32


def test_poses_of_another_time_are_refused() -> None:
    truth = drive(50, 3)
    later = Trajectory(truth.times + 10**12, truth.poses)
    with pytest.raises(InputError, match="0 of 50 poses lie within the times"):
        compare_trajectories(truth, later)


def test_a_run_against_exact_poses(finished, drive: Path, tmp_path: Path, caplog) -> None:
    run, _ = finished
    result = evaluate_trajectories(run, "dataset")
    assert (result.poses, result.source) == (5, "docdepth")
    assert 0 < result.ape.rmse < 0.1
    printed = cli("evaluate", "trajectories", run, "--poses", "dataset", "--json")
    assert json.loads(printed.output)["ape"]["rmse"] == pytest.approx(result.ape.rmse)
    # The run's own poses, read again from files.
    trajectory = RunFolder.open(run).trajectory()
    write_tum(tmp_path / "own.tum", trajectory)
    assert evaluate_trajectories(run, tmp_path / "own.tum").ape.max < 1e-6
    times = np.arange(trajectory.times[0], trajectory.times[-1] + 1, 20_000_000)
    write_tum(tmp_path / "dense.tum", Trajectory(times, trajectory.interpolate(times)))
    assert evaluate_trajectories(run, tmp_path / "dense.tum").rpe.max < 1e-6
    assert not caplog.records
    cameras = drive / "poses.txt"  # as KITTI's are
    assert evaluate_trajectories(run, cameras).rpe.rmse > 0.5
    assert "say which: `poses='CAMERA:FILE'`" in caplog.text
    assert evaluate_trajectories(run, f"image_0:{cameras}").rpe.rmse < 0.1
    with pytest.raises(OdometryError, match=r"nowhere\.txt is missing"):
        evaluate_trajectories(run, tmp_path / "nowhere.txt")
