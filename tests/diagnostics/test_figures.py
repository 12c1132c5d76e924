"""Figures of sweeps and poses against numbers that were put into them."""

from __future__ import annotations

import numpy as np
import pytest
import scenes  # noqa: F401  adds its scenes
from drives import Recorded, right_poses, turned

from docdepth.datasets import usable_points
from docdepth.diagnostics.lidar_figures import (
    beams_by_elevation,
    horizontal_field,
    row_shares,
    shared_rays,
    spacing,
)
from docdepth.diagnostics.poses import Window, explain_misfit, pose_figures, share_on, windows_of
from docdepth.geometry.ground_plane import find_ground, level_turn
from docdepth.geometry.se3 import inverse
from motion import pose
from walled_yard import scan

pytestmark = pytest.mark.usefixtures("whole_ground_search")


def _street() -> np.ndarray:
    points = Recorded().sweep(0).points
    return np.asarray(points[usable_points(points)])


TILTS = [(0, -20, 0), (0, 45, 30), (90, 0, 0)]


@pytest.mark.parametrize("tilt", TILTS)
@pytest.mark.parametrize("place", ["street", "yard"])
def test_up_of_a_lidar_that_is_mounted_at_any_angle(
    tilt: tuple[float, float, float], place: str
) -> None:
    points = _street() if place == "street" else scan(pose(), -8.0)[0]
    R = turned(tilt)[:3, :3]
    ground = find_ground([(points @ R.T).astype(np.float32)])
    assert ground is not None
    error = np.degrees(np.arccos(np.clip(ground.up @ R[:, 2], -1, 1)))
    assert error < 1.0
    np.testing.assert_allclose(ground.height, 1.8 if place == "street" else 1.7, atol=0.05)
    np.testing.assert_allclose(level_turn(ground.up) @ ground.up, [0, 0, 1], atol=1e-9)
    assert np.linalg.det(level_turn(ground.up)) > 0


def test_a_wall_alone_and_a_cloud_without_a_plane_are_no_ground() -> None:
    rng = np.random.default_rng(3)
    assert find_ground([rng.normal(0, 10, (5000, 3)).astype(np.float32)]) is None
    assert find_ground([np.zeros((0, 3), np.float32)]) is None
    assert find_ground([]) is None


@pytest.mark.slow
def test_the_bank_of_a_road_is_no_ground() -> None:
    """A bank beside a motorway is as large as the road, from which the ground falls on its side."""
    pytest.importorskip("embreex")
    from docdepth.synthetic import Drive, scene, sensor

    motorway = Drive(scene("overtaking", 10), sensor("VLP-16"), 10, 10, True)
    points = motorway.sweep(0).points
    ground = find_ground([points[usable_points(points)]])
    assert ground is not None
    assert ground.tilt_deg < 2
    np.testing.assert_allclose(ground.height, 1.7, atol=0.1)


def test_sweeps_must_agree_on_the_ground() -> None:
    level, tilted = (
        (_street() @ turned((angle, 0, 0))[:3, :3].T).astype(np.float32) for angle in (0, 40)
    )
    common = find_ground([level, level, tilted])
    assert common is not None
    assert common.tilt_deg < 2
    assert find_ground([level, tilted]) is None
    nothing = np.zeros((0, 3), np.float32)
    assert find_ground([level, nothing, nothing]) is None


def test_the_ground_stays_where_it_is_and_a_wall_does_not() -> None:
    """A wall that is larger than the ground is nearer in one sweep and farther in another."""
    rng = np.random.default_rng(5)
    sweeps = []
    for away in np.linspace(2, 16, 8):
        ground = np.column_stack([*rng.uniform(-12, 12, (2, 3000)), rng.normal(-1.7, 0.02, 3000)])
        wall = rng.uniform([-20, 0, -1.7], [20, 0, 18], (9000, 3)) - (0, away, 0)
        sweeps.append(np.concatenate([ground[ground[:, 1] > -away], wall]).astype(np.float32))
    turn = turned((90, 0, 0))[:3, :3]
    found = find_ground([(sweep @ turn.T).astype(np.float32) for sweep in sweeps])
    assert found is not None
    np.testing.assert_allclose(found.up, turn[:, 2], atol=0.03)


def test_beams_are_counted_where_they_can_be_told_apart() -> None:
    rng = np.random.default_rng(0)
    azimuth = rng.uniform(-np.pi, np.pi, 20_000)
    beams = np.radians(np.linspace(-15, 15, 16))
    elevation = rng.choice(beams, 20_000) + rng.normal(0, 2e-4, 20_000)
    assert beams_by_elevation(azimuth, elevation) == 16
    # The vehicle drives: beams rise on one side and sink on the other.
    assert beams_by_elevation(azimuth, elevation + 0.01 * np.cos(azimuth)) == 16
    assert beams_by_elevation(azimuth, rng.uniform(-0.3, 0.3, 20_000)) is None
    assert beams_by_elevation(azimuth[:9], elevation[:9]) is None


def test_field_of_view_and_spacing() -> None:
    column, beam = np.meshgrid(np.radians(np.arange(-60, 60, 0.4)), np.radians(np.arange(-8, 8, 1)))
    azimuth, elevation = column.ravel(), beam.ravel()
    assert abs(horizontal_field(azimuth) - 120) <= 1
    rays = 10 * np.stack(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        ],
        axis=1,
    )
    found = spacing(rays.astype(np.float32))
    np.testing.assert_allclose(found, [0.4, 1.0], atol=0.01)


def test_points_on_one_ray() -> None:
    rng = np.random.default_rng(1)
    azimuth, elevation = rng.uniform(-3, 3, 4000), rng.uniform(-0.4, 0.4, 4000)
    ranges = rng.uniform(5, 50, 4000)
    assert shared_rays(azimuth, elevation, ranges)[0] < 0.001
    second = [np.concatenate([a, a[:1000]]) for a in (azimuth, elevation)]
    ray, point = shared_rays(*second, np.concatenate([ranges, ranges[:1000] + 3]))
    np.testing.assert_allclose([ray, point], [0.4, 0.0], atol=0.001)
    ray, point = shared_rays(*second, np.concatenate([ranges, ranges[:1000]]))
    np.testing.assert_allclose([ray, point], [0.4, 0.2], atol=0.001)


def test_shares_of_rows() -> None:
    points = np.random.default_rng(2).normal(0, 20, (1000, 3)).astype(np.float32)
    points[:100], points[100:150], points[150:170] = np.nan, 0, (1, 2, 3)
    points[170:200] *= np.float32(0.3) / np.linalg.norm(points[170:200], axis=1, keepdims=True)
    found = row_shares(points)
    assert found == {"not_finite": 0.1, "at_origin": 0.05, "close": 0.03, "one_place": 0.02}


def test_sweeps_lie_on_each_other_by_their_motion() -> None:
    drive, poses = Recorded(), right_poses()
    first, last, ground = drive.sweep(0).points, drive.sweep(3).points, find_ground([_street()])
    right = inverse(poses[0]) @ poses[3]
    assert share_on(first, last, right, ground) > 2 * share_on(first, last, np.eye(4), ground)
    assert share_on(first, first, np.eye(4)) == 1.0
    assert share_on(first, np.zeros((5, 3), np.float32), np.eye(4)) == 0.0


def test_registration_that_fits_no_better_accuses_no_poses() -> None:
    poses = right_poses()
    wrong = Window(0, poses, inverse(poses))
    assert explain_misfit([wrong]) is not None
    assert explain_misfit([wrong._replace(better=False)]) is None


def test_poses_that_fit_need_no_explanation() -> None:
    poses = right_poses()
    T = turned((10, 20, 30))
    assert explain_misfit([Window(0, T @ poses, poses)]) is None
    still = np.repeat(np.eye(4)[None], len(poses), axis=0)
    assert explain_misfit([Window(0, poses, still)]) is None, "a standing LiDAR tells nothing"
    assert explain_misfit([]) is None


def test_windows_are_where_the_drive_turns_and_within_it() -> None:
    poses = np.repeat(np.eye(4)[None], 40, axis=0)
    poses[:, 0, 3] = np.arange(40)
    for k in range(20, 40):
        poses[k, :3, :3] = turned((0, 0, min(k - 20, 5) * 10))[:3, :3]
    first = windows_of(poses, 40, 6)[0]
    assert first.start in range(18, 22)
    assert windows_of(None, 40, 6) == [range(20, 26), range(10, 16)]
    assert windows_of(None, 3, 6) == [range(0, 3)]
    assert windows_of(poses[:3], 3, 6) == [range(0, 3)]


def test_figures_of_a_path() -> None:
    poses = np.repeat(np.eye(4)[None], 3, axis=0)
    poses[:, 0, 3] = 0, 1, 3
    poses[2, :3, :3] = turned((0, 0, 30))[:3, :3]
    found = pose_figures(poses, np.array([0, 1, 2]) * 10**8)
    assert found == {
        "length_m": 3.0,
        "extent_m": [3.0, 0.0, 0.0],
        "speed_m_s": [15.0, 20.0],
        "largest_turn_deg": 30.0,
    }
