"""Deskewing against scipy's matrix exponential, odometry against exact drives."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm, logm
from scipy.spatial.transform import Rotation

import docdepth._core as _core
from docdepth.config import OdometryParameters, Parameters
from docdepth.datasets import Sweep, open_dataset
from docdepth.errors import InputError, OdometryError
from docdepth.geometry.se3 import inverse, se3_exp, se3_log
from docdepth.io.poses import read_poses
from docdepth.io.run_folder import RunFolder
from docdepth.odometry import first_motion
from docdepth.odometry.deskewing import centred_motion, deskew
from docdepth.odometry.odometry import estimate_poses, register_drive
from docdepth.odometry.pose_checks import find_misfit
from docdepth.pipeline import run_odometry
from exact_drive import MOTION, Drive, pose_errors

# ---- deskewing


def generator_of(rotation, velocity) -> np.ndarray:
    """The matrix (4, 4) of a twist."""
    x, y, z = rotation
    return np.array([[0, -z, y, 0], [z, 0, -x, 0], [-y, x, 0, 0], [0] * 4]) + np.pad(
        np.array(velocity)[:, None], ((0, 1), (3, 0))
    )


@pytest.mark.parametrize(
    "rotation", [[0, 0, 0], [1e-12, 0, 0], [0, 1e-7, 1e-7], [0.01, -0.02, 0.1], [0.3, 2.0, -0.5]]
)
def test_deskew_is_the_matrix_exponential(rotation: list[float]) -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform(-60, 60, (200, 3)).astype(np.float32)
    relative_time = rng.uniform(-0.5, 1.0, 200).astype(np.float32)
    generator = generator_of(rotation, (1.3, -0.2, 0.1))
    expected = [
        (expm(float(f) * generator) @ np.append(p.astype(np.float64), 1))[:3]
        for p, f in zip(points, relative_time, strict=True)
    ]
    result = deskew(points, relative_time, expm(generator))
    assert result.dtype == np.float32
    np.testing.assert_allclose(result, expected, atol=3e-5)


def test_deskew_keeps_rows_that_are_no_returns() -> None:
    points = np.array(
        [[0, 0, 0], [np.nan, 1, 2], [np.inf, 0, 0], [0.1, 0, 0], [5, 5, 1]], dtype=np.float32
    )
    relative_time = np.array([0.5, np.nan, 0.5, np.inf, 0.5], dtype=np.float32)
    result = deskew(points, relative_time, MOTION)
    np.testing.assert_array_equal(result[:4], points[:4])
    assert (result[4] != points[4]).all()


def test_deskew_refuses_points_without_time() -> None:
    points = np.ones((4, 3), np.float32)
    with pytest.raises(InputError, match="no finite time"):
        deskew(points, np.array([0, 0, np.nan, 0], np.float32), MOTION)


def test_logarithm_and_exponential_are_scipys() -> None:
    for vector in Rotation.random(50, rng=np.random.default_rng(2)).as_rotvec():
        motion = expm(generator_of(vector, (1, 2, 3)))
        np.testing.assert_allclose(se3_exp(vector, np.array([1.0, 2, 3])), motion, atol=1e-12)
        omega, velocity = se3_log(motion)
        np.testing.assert_allclose(omega, vector, atol=1e-10)
        np.testing.assert_allclose(velocity, [1, 2, 3], atol=1e-10)


def test_centred_motion() -> None:
    rng = np.random.default_rng(1)
    poses = [np.eye(4)]
    for _ in range(6):
        step = se3_exp(rng.normal(0, 0.05, 3), rng.normal([1, 0, 0], 0.1))
        poses.append(poses[-1] @ step)
    poses = np.array(poses)
    motions = centred_motion(poses)
    for k in range(7):
        around = range(max(k - 2, 0), min(k + 2, 6) + 1)
        logarithms = [logm(np.linalg.inv(poses[k]) @ poses[j]).real.ravel() for j in around]
        slope = np.polyfit(list(around), np.array(logarithms), 1)[0].reshape(4, 4)
        np.testing.assert_allclose(motions[k], expm(slope), atol=1e-9)
    assert centred_motion(poses[:1]).tolist() == [np.eye(4).tolist()]


def test_a_lost_sweep_does_not_double_the_motion() -> None:
    kept = np.array([0, 1, 2, 3, 6, 7, 8, 9])
    poses = np.array([np.linalg.matrix_power(MOTION, k) for k in kept])
    np.testing.assert_allclose(
        centred_motion(poses, kept * 10**8), np.repeat(MOTION[None], 8, axis=0), atol=1e-9
    )


# ---- registration


def test_raw_sweeps_at_speed() -> None:
    """At 1.1 m a sweep from the start; registration that starts at standstill is 0.8 m off."""
    drive = Drive(12)
    result = register_drive(drive)
    errors = pose_errors(result.trajectory.poses, drive.exact)
    assert errors.max() < 0.01
    assert not result.findings
    np.testing.assert_array_equal(result.trajectory.times, drive.times)
    for k in (0, 5, 11):
        sweep = drive.sweep(k)
        points = result.sweeps[k].points
        assert points.shape == sweep.points.shape
        assert points.dtype == np.float32
        exact = deskew(sweep.points, sweep.relative_time, MOTION)
        near = np.linalg.norm(exact, axis=1) < 30
        assert np.abs(points - exact)[near].max() < 0.01


def test_compensated_sweeps_are_left_alone() -> None:
    drive = Drive(8, raw=False)
    calls: list[tuple[str, int, int]] = []
    result = register_drive(drive, progress=lambda *call: calls.append(call))
    assert pose_errors(result.trajectory.poses, drive.exact).max() < 0.01
    np.testing.assert_array_equal(result.sweeps[3].points, drive.sweep(3).points)
    assert calls == [("register", k + 1, 8) for k in range(8)]


def test_the_same_poses_bit_for_bit_whatever_threads_and_environment(tmp_path: Path) -> None:
    drive = Drive(14)
    for k in range(len(drive)):
        drive.sweep(k)
    (tmp_path / "drive").write_bytes(pickle.dumps(drive))
    script = (
        "import hashlib, pickle, sys; sys.path[:0] = ['tests']\n"
        "from docdepth.odometry.odometry import estimate_poses\n"
        "drive = pickle.load(open(sys.argv[2], 'rb'))\n"
        "poses = estimate_poses(drive, threads=int(sys.argv[1]))\n"
        "print(hashlib.sha256(poses.tobytes()).hexdigest())"
    )
    root = Path(__file__).resolve().parents[2]
    hashes = {
        subprocess.run(
            [sys.executable, "-c", script, threads, str(tmp_path / "drive")],
            env=os.environ | extra,
            cwd=root,
            check=True,
            capture_output=True,
            text=True,
        ).stdout
        for threads, extra in (("1", {}), ("3", {}), ("2", {"OMP_NUM_THREADS": "1"}))
    }
    assert len(hashes) == 1


def test_unusable_sweeps_do_not_end_the_process() -> None:
    drive = Drive(8)
    good = drive.sweep(4)
    spoilt = np.full_like(good.points, np.nan)
    spoilt[::3] = 0
    drive._sweeps[4] = Sweep(
        spoilt, good.name, good.time, relative_time=np.full_like(spoilt[:, 0], 7)
    )
    result = register_drive(drive)
    (found,) = result.findings
    assert (found.code, found.remedy) == ("predicted-poses", "")
    assert found.text.startswith("1 of 8 sweeps")
    assert pose_errors(result.trajectory.poses, drive.exact).max() < 0.3
    np.testing.assert_array_equal(result.sweeps[4].points, spoilt)


def test_a_point_without_time_is_named() -> None:
    drive = Drive(3)
    drive.sweep(1).relative_time[100:2000] = np.nan
    with pytest.raises(OdometryError, match=r"sweep 000001 \(frame 1\): .*no finite time"):
        register_drive(drive)


def test_a_single_sweep() -> None:
    result = register_drive(Drive(1))
    np.testing.assert_array_equal(result.trajectory.poses, [np.eye(4)])
    assert len(result.sweeps) == len(list(result.sweeps)) == 1


def test_sweeps_are_read_when_asked_for_and_once_each() -> None:
    drive = Drive(5)
    result = register_drive(drive, poses=drive.exact, poses_as_given=True)
    assert drive.read == []
    assert [sweep.name for sweep in result.sweeps] == [f"{k:06d}" for k in range(5)]
    assert drive.read == [0, 1, 2, 3, 4]
    drive.read.clear()
    last, measured = result.sweeps[-1], drive._sweeps[4]
    assert drive.read == [4]
    assert last.name == measured.name
    np.testing.assert_allclose(last.time_offset, 0.1 * measured.relative_time, 1e-6)
    np.testing.assert_array_equal(last.index, np.arange(last.input_points))
    assert [sweep.name for sweep in result.sweeps[1:4:2]] == ["000001", "000003"]
    with pytest.raises(IndexError):
        result.sweeps[5]


def test_all_passes_and_the_check_of_motion_read_each_sweep_once() -> None:
    drive = Drive(30)
    register_drive(drive)
    assert drive.read == [*range(30)]


# ---- thinning


def test_a_thinned_sweep_has_the_mean_of_each_voxel() -> None:
    rng = np.random.default_rng(3)
    points = rng.normal(0, 8, (5000, 3)).astype(np.float32)
    points[::50] = np.nan
    points[1::50] = 0
    points[2::50, 1] = np.inf
    times = rng.uniform(-0.5, 0.5, 5000).astype(np.float32)
    means: dict[tuple[int, ...], list[np.ndarray]] = {}
    for point, time in zip(points, times, strict=True):
        if 9 < (point * point).sum() < 400:
            voxel = tuple(np.floor(point / np.float32(0.8)).astype(int))
            means.setdefault(voxel, []).append(np.append(point, time))
    expected = np.array([np.mean(some, axis=0) for some in means.values()])
    thinned, when = _core.thin_sweep(points, times, 0.8, 3.0, 20.0)
    np.testing.assert_allclose(np.column_stack([thinned, when]), expected, atol=1e-5)
    assert 100 < len(thinned) < 4500


def test_a_run_reads_each_sweep_once(tmp_path: Path) -> None:
    """And once more the first, for where its sensors sit."""
    drive = Drive(5)
    run = RunFolder.create(tmp_path / "run", None, Parameters())
    run_odometry(run, drive, drive.exact)
    assert drive.read == [0, *range(5)]
    deskewed = register_drive(drive, poses=drive.exact).sweeps[3]
    frame = run.frame(3)
    np.testing.assert_array_equal(frame.points, deskewed.points[frame.index])
    np.testing.assert_array_equal(frame.time_offset, deskewed.time_offset[frame.index])
    drive.read.clear()
    run_odometry(run, drive, drive.exact)
    assert drive.read == [0], "nothing is left to do"


# ---- given poses


def test_given_poses_are_kept_and_used_for_deskewing() -> None:
    drive = Drive(6)
    result = register_drive(drive, poses=drive.exact, poses_as_given=True)
    assert drive.read == [], "nothing to register"
    np.testing.assert_array_equal(result.trajectory.poses, drive.exact)
    sweep = drive.sweep(3)
    expected = deskew(sweep.points, sweep.relative_time, MOTION)
    np.testing.assert_allclose(result.sweeps[3].points, expected, atol=1e-4)
    assert not result.findings


def test_refused_poses() -> None:
    drive = Drive(4)
    with pytest.raises(OdometryError, match="3 poses for 4 sweeps"):
        register_drive(drive, poses=drive.exact[:3])
    with pytest.raises(OdometryError, match="the pose of frame 2"):
        register_drive(
            drive,
            poses=drive.exact * [[1.0], [1], [1], [1]] * np.r_[1, 1, np.nan, 1][:, None, None],
        )
    with pytest.raises(OdometryError, match=r"\(n, 4, 4\)"):
        register_drive(drive, poses=drive.exact[:, :3])


def test_unlikely_poses_are_found() -> None:
    drive = Drive(8)
    (stand,) = register_drive(drive, poses=np.repeat(np.eye(4)[None], 8, axis=0)).findings[:1]
    camera = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
    upwards = register_drive(drive, poses=camera @ drive.exact @ inverse(camera)).findings
    jump = drive.exact.copy()
    jump[5:, 1, 3] += 3
    (jumps,) = register_drive(drive, poses=jump, poses_as_given=True).findings
    assert stand.code == "poses-stand"
    assert "poses-of-camera" in {found.code for found in upwards}
    assert jumps.code == "trajectory-jumps"


def test_nothing_is_found_where_all_stand() -> None:
    drive = Drive(8, motion=np.eye(4))
    assert not register_drive(drive, poses=np.repeat(np.eye(4)[None], 8, axis=0)).findings


@pytest.mark.parametrize("what", ["half as long", "inverse", "in another order", "right"])
def test_poses_that_do_not_fit_the_sweeps(what: str) -> None:
    drive = Drive(10)
    poses = drive.exact.copy()
    if what == "half as long":
        poses[:, :3, 3] /= 2
    elif what == "inverse":
        poses = inverse(poses)
    elif what == "in another order":
        poses = poses[np.random.default_rng(1).permutation(10)]
    deskewed = register_drive(drive, poses=drive.exact).sweeps
    found = find_misfit(lambda k: deskewed[k].points, poses, drive.times)
    assert [f.code for f in found] == ["poses-misfit"] * (what != "right")


@pytest.mark.parametrize("count", [1, 3, 4])
def test_short_drives_have_nothing_that_could_misfit(count: int) -> None:
    points, still = np.zeros((100, 3), np.float32), np.repeat(np.eye(4)[None], count, axis=0)
    assert find_misfit(lambda _: points, still, np.arange(count) * 10**8) == []


def test_sweeps_without_points_in_range_are_told_once() -> None:
    nowhere = Parameters(odometry=OdometryParameters(min_range=90, max_range=91))
    (found,) = register_drive(Drive(6), nowhere).findings
    assert found.code == "predicted-poses"
    assert found.remedy, "all of them"


def test_a_first_sweep_without_points_hides_no_motion(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(first_motion, "_DIRECTIONS", [0.0])
    drive = Drive(8)
    sweep = drive.sweep(0)
    drive._sweeps[0] = replace(sweep, points=np.zeros_like(sweep.points))
    found = register_drive(drive)
    assert pose_errors(found.trajectory.poses, drive.exact).max() < 0.05
    assert [finding.code for finding in found.findings] == ["predicted-poses"]


# ---- the real drive


@pytest.mark.slow
@pytest.mark.skipif("DOCDEPTH_KITTI_RAW" not in os.environ, reason="no KITTI drives")
def test_real_drive_agrees_with_another_registration() -> None:
    root = Path(os.environ["DOCDEPTH_KITTI_RAW"])
    dataset = open_dataset(root / "2011_09_26" / "2011_09_26_drive_0005_sync")
    reference = read_poses(dataset.path / "lidar_poses_tum.txt", len(dataset))
    poses = estimate_poses(dataset)
    assert pose_errors(poses, reference).max() < 0.5
    steps, expected = (inverse(p[:-1]) @ p[1:] for p in (poses, reference))
    assert np.linalg.norm((inverse(expected) @ steps)[:, :3, 3], axis=1).max() < 0.05
