"""Given poses that are decimetres off are refined, good ones kept, on an exact drive."""

from __future__ import annotations

import numpy as np
import pytest

from docdepth.errors import OdometryError
from docdepth.geometry.se3 import inverse, se3_exp
from docdepth.odometry.odometry import register_drive
from docdepth.odometry.refinement import noise_along
from exact_drive import Drive

SWEEPS = 24


@pytest.fixture(scope="module")
def drive() -> Drive:
    return Drive(SWEEPS)


def noisy(poses: np.ndarray, metres: float, degrees: float, scale: float = 1.0) -> np.ndarray:
    """Poses with errors of their own each, and of another length."""
    rng = np.random.default_rng(5)
    changed = poses.copy()
    changed[:, :3, 3] *= scale
    for k in range(len(poses)):
        turn = np.radians(rng.normal(0, degrees, 3))
        changed[k] = changed[k] @ se3_exp(turn, rng.normal(0, metres, 3))
    return changed


def errors_over(poses: np.ndarray, exact: np.ndarray, apart: int) -> np.ndarray:
    """Metres by which the motion over so many sweeps is wrong."""
    motions = [inverse(p[:-apart]) @ p[apart:] for p in (poses, exact)]
    return np.linalg.norm((inverse(motions[0]) @ motions[1])[:, :3, 3], axis=1)


@pytest.mark.parametrize(
    ("metres", "degrees", "scale", "severity"),
    [
        (0.01, 0, 1, "note"),
        (0.05, 0, 1, "note"),
        (0.2, 0, 1, "warning"),
        (0, 0.5, 1, "note"),
        (0.1, 0.1, 1.02, "warning"),
    ],
)
def test_poor_poses_are_refined_where_they_were_given(
    drive: Drive, metres: float, degrees: float, scale: float, severity: str
) -> None:
    world = se3_exp(np.array([0.0, 0, 0.7]), np.array([400.0, -300, 20]))
    given = noisy(world @ drive.exact, metres, degrees, scale)
    odometry = register_drive(drive, poses=given)
    assert [(f.code, f.severity) for f in odometry.findings] == [("poses-refined", severity)]
    refined = odometry.trajectory.poses
    assert errors_over(refined, drive.exact, 10).max() < 0.02
    assert errors_over(given, drive.exact, 10).max() > max(0.03, metres)
    # As a whole they lie where the given ones lie on average.
    off = (refined - given)[:, :3, 3].mean(axis=0)
    np.testing.assert_allclose(off, 0, atol=1e-6)


@pytest.mark.parametrize("at", [2, 13, SWEEPS - 3])
def test_a_single_jump_is_refined(drive: Drive, at: int) -> None:
    """As where SLAM recognises a place; the few pairs of sweeps that are compared do not see it."""
    given = drive.exact.copy()
    given[at:] = se3_exp(np.zeros(3), np.array([0.0, 0.3, 0.1])) @ given[at:]
    odometry = register_drive(drive, poses=given)
    assert [f.code for f in odometry.findings] == ["poses-refined"]
    assert errors_over(odometry.trajectory.poses, drive.exact, 10).max() < 0.02


def test_slow_errors_of_centimetres_are_refined(drive: Drive) -> None:
    """As of GNSS: they hardly change from sweep to sweep."""
    given = drive.exact.copy()
    given[:, :3, 3] += 0.08 * np.sin(0.3 * np.arange(SWEEPS)[:, None] + [0, 2, 4])
    odometry = register_drive(drive, poses=given)
    assert [f.code for f in odometry.findings] == ["poses-refined"]
    refined = odometry.trajectory.poses
    assert errors_over(refined, drive.exact, 10).max() < 0.02
    assert errors_over(refined, drive.exact, 1).max() < 0.01


@pytest.mark.parametrize("metres", [0.003, 0.01, 0.05])
def test_noise_along_the_way(metres: float) -> None:
    poses = np.repeat(np.eye(4)[None], 400, axis=0)
    times = np.arange(400) * 10**8 + np.random.default_rng(1).integers(-(10**6), 10**6, 400)
    seconds = 1e-9 * times
    poses[:, 0, 3] = 9 * seconds + 3 * np.sin(0.7 * seconds)  # it drives and brakes
    poses[:, 2, 3] = 0.005 * np.sin(12 * seconds)  # and heaves
    assert noise_along(poses, times) < 1e-4
    assert noise_along(noisy(poses, metres, 0), times) == pytest.approx(metres, rel=0.15)
    assert noise_along(poses[::5], times[::5]) == 0
    assert noise_along(poses[:3], times[:3]) == 0


def test_good_poses_are_kept_bit_for_bit(drive: Drive) -> None:
    for given in (drive.exact, noisy(drive.exact, 0.003, 0.01)):
        odometry = register_drive(drive, poses=given)
        assert odometry.findings == ()
        np.testing.assert_array_equal(odometry.trajectory.poses, given)


def test_stamps_that_jitter_are_no_errors_of_poses(drive: Drive) -> None:
    """At 11 m/s, 3 ms look like 2 cm along the way; registration finds nothing better."""
    late = np.random.default_rng(1).normal(0, 3e6, SWEEPS).astype(np.int64)
    jittering = Drive(SWEEPS)
    jittering.times = drive.times + late
    assert noise_along(drive.exact, jittering.times) > 0.02
    odometry = register_drive(jittering, poses=drive.exact)
    np.testing.assert_array_equal(odometry.trajectory.poses, drive.exact)
    assert "poses-refined" not in [f.code for f in odometry.findings]


def test_poses_are_kept_on_request_and_nothing_is_read(drive: Drive) -> None:
    drive.read.clear()
    given = noisy(drive.exact, 0.2, 0)
    kept = register_drive(drive, poses=given, poses_as_given=True).trajectory.poses
    np.testing.assert_array_equal(kept, given)
    assert drive.read == []


def test_poses_of_another_drive_are_kept_and_told(drive: Drive) -> None:
    given = drive.exact[np.random.default_rng(2).permutation(SWEEPS)]
    odometry = register_drive(drive, poses=given)
    np.testing.assert_array_equal(odometry.trajectory.poses, given)
    assert "poor-poses" in [f.code for f in odometry.findings]


def test_a_receiver_without_position_gives_the_origin(drive: Drive) -> None:
    given = drive.exact.copy()
    given[1:, :3, 3] += [500_000.0, 5_400_000, 100]
    with pytest.raises(OdometryError, match=r"^1 of 24 poses lie 5,423 km .* frame 0") as raised:
        register_drive(drive, poses=given)
    assert raised.value.code == "poses-apart"
    given[0, :3, 3] = given[1, :3, 3]
    register_drive(drive, poses=given, poses_as_given=True)
