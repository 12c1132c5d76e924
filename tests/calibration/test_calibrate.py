"""The whole calibration of boards without noise, and of real ones."""

from dataclasses import replace

import numpy as np
import pytest
import yaml
from boards import BOARD, LENS, T_CAMERA_LIDAR, all_poses, corners_of, pair

from docdepth.calibration.board import Board
from docdepth.calibration.bundle import Solution, covariance, pose_by_sweep, solve_bundle
from docdepth.calibration.calibrate import calibrate, find
from docdepth.calibration.consensus import normals_condition, solve_linear, solve_scale
from docdepth.calibration.outline import crossings, rays_near
from docdepth.calibration.pairs import board_pairs
from docdepth.calibration.quality import difference, leave_one_out, uncertainty
from docdepth.calibration.result import quality_of
from docdepth.calibration.sweeps import board_sweep
from docdepth.datasets import image_streams, open_dataset
from docdepth.geometry.lidar_frame import SensorRig
from docdepth.geometry.se3 import inverse

SIZE = (LENS.width, LENS.height)


def test_planes_alone_give_the_extrinsic_and_the_scale():
    """Equations 1 and 2 of the paper, and one unknown more."""
    swept = np.stack(all_poses())
    seen = T_CAMERA_LIDAR @ swept
    T = solve_linear(seen, swept)
    np.testing.assert_allclose(T, inverse(T_CAMERA_LIDAR), atol=1e-12)
    seen[:, :3, 3] /= 1.1
    scale, spread = solve_scale(seen, swept, T)
    assert scale == pytest.approx(1.1)
    assert 0.001 < spread < 0.02, "5 mm of noise of each plane"
    normals = np.array([(0, 0, 1), (0, 1e-3, 1), (1e-3, 0, 1)])
    assert normals_condition(normals / np.linalg.norm(normals, axis=1)[:, None]) < 1e-2


def test_exact_boards_give_the_exact_extrinsic(calibrated):
    degrees, centimetres = difference(calibrated.T_camera_lidar, T_CAMERA_LIDAR)
    assert degrees < 0.03
    assert centimetres < 0.1
    assert calibrated.not_used == {}
    assert np.median([one.pixels for one in calibrated.boards]) < 0.4
    assert max(corners for corners, _ in calibrated.residuals) < 0.05
    assert max(plane for _, plane in calibrated.residuals) < 5e-4
    assert calibrated.turn_deg.max() < 0.1
    assert np.median(calibrated.halves.degrees) < 0.1
    assert np.median(calibrated.halves.centimetres) < 0.3


def test_the_difference_is_of_the_cameras_places():
    other = T_CAMERA_LIDAR.copy()
    other[:3, 3] += other[:3, :3] @ (0.0, 0.03, 0.04)
    assert difference(other, T_CAMERA_LIDAR) == (pytest.approx(0, abs=1e-5), pytest.approx(5))


def test_k_is_estimated_with_the_extrinsic(exact_pairs):
    found, start, _ = find(BOARD, exact_pairs[:6], SIZE)
    solution = solve_bundle(BOARD, found, start, True)
    np.testing.assert_allclose(solution.lens.K[:2], LENS.K[:2], atol=0.3)
    assert difference(solution.T_camera_lidar, T_CAMERA_LIDAR)[0] < 0.06


@pytest.mark.slow
def test_the_uncertainty_has_what_an_estimated_k_costs(calibrated):
    """Against how much the calibrations of boards with other noise differ."""
    rng, turns, told, bounds = np.random.default_rng(2), [], [], []
    for draw in range(6):
        noisy = [
            replace(o, corners=o.corners + rng.normal(0, 0.3, o.corners.shape))
            for o in calibrated.observations
        ]
        found = solve_bundle(BOARD, noisy, calibrated.solution, True)
        turns.append(difference(found.T_camera_lidar, T_CAMERA_LIDAR)[0])
        bounds.append(np.trace(covariance(BOARD, noisy, found, True)[:3, :3]))
        if draw < 2:
            left_out = leave_one_out(BOARD, noisy, found, True)
            told.append(np.linalg.norm(uncertainty(left_out)[0]))
    error, bound = np.sqrt(np.mean(np.square(turns))), np.degrees(np.sqrt(np.mean(bounds)))
    assert error > 0.1, "several times that of a known K"
    assert 0.6 < error / bound < 1.5
    assert 0.5 < error / np.mean(told) < 1.8


def test_a_board_that_moved_by_seven_centimetres_is_left_out(exact_pairs, calibrated):
    T = all_poses()[2]
    swept = T.copy()
    swept[:3, 3] += (0.0, 0.07, 0.0)
    others = [*exact_pairs[:2], pair("pose2", T, swept), *exact_pairs[3:5], exact_pairs[7]]
    found = calibrate(BOARD, others, SIZE, LENS)
    assert list(found.not_used) == ["pose2"]
    assert "disagree by" in found.not_used["pose2"]
    assert difference(found.T_camera_lidar, T_CAMERA_LIDAR)[0] < 0.05
    assert found.halves is None, "halves of five boards are too few"


def test_where_the_sweep_has_a_board_that_moved(calibrated):
    T = all_poses()[4]
    swept = T.copy()
    swept[:3, 3] += (0.02, 0.05, -0.03)
    swept_pair = pair("moved", T, swept)
    observation = replace(calibrated.observations[4], sweep=swept_pair.sweep, corners=corners_of(T))
    at = Solution(
        T_CAMERA_LIDAR, np.zeros((0, 4, 4)), LENS, blur=0.003, corner_noise=0.1, range_noise=0.003
    )
    found = pose_by_sweep(BOARD, observation, at, T_CAMERA_LIDAR @ T)
    np.testing.assert_allclose((T_CAMERA_LIDAR @ swept)[:3, 3], found[:3, 3], atol=0.004)


def test_rays_out_of_the_box_went_past():
    T = np.eye(4)
    T[:3, 3] = (0.0, 0.0, 3.0)
    places = np.array([(0, 0, 3), (0.4, 0, 3), (0.4, 0, 3.1), (0, 0, 3.1), (0.4, 0, 5)])
    points = places.astype(np.float32)
    near = rays_near(board_sweep(points), BOARD, inverse(T), 0.2)
    assert near.on.tolist() == [True, True, False], "what is 10 cm behind tells nothing"
    box = np.array([(-0.35, 0.35), (-0.5, 0.5), (2.9, 3.05)])
    near = rays_near(board_sweep(points, None, box), BOARD, inverse(T), 0.2)
    assert near.on.tolist() == [True, False, False, False, False]


def test_rays_begin_at_their_lasers():
    points = np.array([(4, 0, 0), (0, 4, 0), (np.nan, 0, 0), (0, 0, 0)], np.float32)
    up = np.eye(4)
    up[:3, 3] = (0.0, 0.0, 0.5)
    rig = SensorRig(np.array([0, 1, 1, 0], np.uint8), np.stack([np.eye(4), up]))
    sweep = board_sweep(points, rig)
    np.testing.assert_array_equal(sweep.points, points[:2])
    np.testing.assert_allclose(sweep.origins, [(0, 0, 0), (0, 0, 0.5)], atol=1e-6)
    # A plane at x = 2 is met half way.
    T = np.eye(4)
    T[:3, :3] = np.array([(0, 0, 1), (0, 1, 0), (-1, 0, 0)]).T @ np.eye(3)
    T[:3, 3] = (2.0, 0.0, 0.0)
    (place,), _ = crossings(points[:1].astype(float), np.array([(0, 0, 0.5)]), inverse(T))
    height = T[:3, :3] @ (*place, 0.0) + T[:3, 3]
    np.testing.assert_allclose(height, (2, 0, 0.25), atol=1e-9)


@pytest.mark.nightly
def test_real_boards(recordings, tmp_path):
    """20 boards by a VLP-16. The files beside them, of 105 mm squares and K, are of another rig."""
    real = recordings / "acfr"
    (tmp_path / "sweeps").mkdir()
    for file in (real / "pcd").glob("*_full.pcd"):
        (tmp_path / "sweeps" / file.name).symlink_to(file)
    (tmp_path / "images").symlink_to(real / "images")
    cameras = {"front": {"images": "images", "times": "sweeps"}}
    text = yaml.safe_dump({"sweeps": "sweeps", "rate": 1, "cameras": cameras})
    (tmp_path / "docdepth.yaml").write_text(text)
    recording = open_dataset(tmp_path)
    board = Board(5, 7, 0.095, 0.61, 0.85)
    given, size = board_pairs(recording, image_streams(recording)["front"], board)
    found = calibrate(board, given, size, model="fisheye")
    quality = quality_of(found)
    assert len(quality["boards"]) == 20, "on every processor, so that the halves are the same"
    assert quality["halves_deg"]["median"] < 0.45
    assert quality["halves_cm"]["median"] < 1.6
    assert quality["left_out_px"] < 6
    assert max(one["corners_px"] for one in quality["boards"].values()) < 0.5
    np.testing.assert_allclose(np.diag(found.lens.K)[:2], 1193, atol=12)
