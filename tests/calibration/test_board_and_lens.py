"""The board as it is described, corners in images, and K from exact corners."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import yaml
from boards import (
    BOARD,
    LENS,
    STRAIGHT,
    T_CAMERA_LIDAR,
    all_poses,
    corners_of,
    held,
    picture,
    printed,
)

from docdepth.calibration.board import PATTERNS, Board, parse_board
from docdepth.calibration.corners import board_pose, counted_corners, find_corners, shows_markers
from docdepth.calibration.lens import Lens, estimate_lens
from docdepth.datasets.formats.bag.ros_images import camera_of
from docdepth.errors import CalibrationError, ConfigError
from docdepth.geometry.camera import Camera
from docdepth.io.calibration import write_calibration

SIZE = (LENS.width, LENS.height)
TRIALS = 4  # of a board of each kind


def test_corners_run_along_the_columns():
    board = Board(4, 3, 0.1, 0.6, 0.5)
    assert board.corners[0].tolist() == pytest.approx([-0.15, -0.1, 0])
    assert board.corners[1].tolist() == pytest.approx([-0.05, -0.1, 0])
    assert board.corners[-1].tolist() == pytest.approx([0.15, 0.1, 0])


def test_distance_from_the_outline_by_hand():
    places = np.array([(0, 0), (0.3, 0), (0.34, 0), (0.44, 0.08), (0.44, 0.56)])
    expected = [-0.34, -0.04, 0, 0.1, np.hypot(0.1, 0.08)]
    np.testing.assert_allclose(BOARD.distance(places), expected, atol=1e-12)


@pytest.mark.parametrize(
    ("corners", "square", "size", "message"),
    [
        ("5", 0.1, "1x1", "must be COLUMNSxROWS"),
        ("5x7", 0.1, "841", "must be WIDTHxHEIGHT in metres"),
        ("5x7", 0.1, "841x1189mm", "must be WIDTHxHEIGHT in metres"),
        ("7x10", 100, "0.841x1.189", "do not fit on a board.*in the same order and in metres"),
        ("10x7", 0.1, "0.841x1.189", "do not fit on a board"),
        ("2x7", 0.1, "1x1", "at least 3x3"),
        ("5x5", 0.1, "0.7x0.9", "looks the same after a quarter turn"),
    ],
)
def test_boards_that_cannot_be(corners, square, size, message):
    with pytest.raises(ConfigError, match=message):
        parse_board(corners, square, size)


def test_a_board_in_words():
    assert parse_board(" 5X7", 0.095, "0.61x.85") == Board(5, 7, 0.095, 0.61, 0.85)


def test_pose_of_exact_corners():
    for T_lidar_board in all_poses():
        pose, error = board_pose(corners_of(T_lidar_board), BOARD, LENS)
        assert error < 1e-3
        np.testing.assert_allclose(pose, T_CAMERA_LIDAR @ T_lidar_board, atol=1e-4)


def test_rays_undo_the_projection():
    fisheye = replace(LENS, model="fisheye", distortion=np.array((-0.02, 0.01, -0.01, 0.002)))
    points = np.random.default_rng(0).uniform((-1.5, -1, 2), (1.5, 1, 4), (50, 3))
    for lens in (LENS, fisheye):
        rays = lens.rays(lens.project(points))
        np.testing.assert_allclose(rays, points[:, :2] / points[:, 2:], atol=1e-4)
    assert np.isnan(LENS.project(-points)).all()


def by_kalibr(text: str, points: np.ndarray) -> np.ndarray:
    """Pixels of points of the LiDAR, by Kalibr's page of its models."""
    camera = yaml.safe_load(text)["cam0"]
    T, (fx, fy, cx, cy) = np.array(camera["T_cam_lidar"]), camera["intrinsics"]
    x, y, z = T[:3, :3] @ points.T + T[:3, 3:]
    x, y, k = x / z, y / z, camera["distortion_coeffs"]
    if camera["distortion_model"] == "equidistant":
        theta = np.arctan(np.hypot(x, y))
        far = theta * (1 + sum(c * theta ** (2 * n) for n, c in enumerate(k, 1))) / np.hypot(x, y)
        x, y = far * x, far * y
    else:
        assert camera["distortion_model"] == "radtan"
        square = x * x + y * y
        far = 1 + k[0] * square + k[1] * square**2
        x, y = (
            far * x + 2 * k[2] * x * y + k[3] * (square + 2 * x * x),
            far * y + k[2] * (square + 2 * y * y) + 2 * k[3] * x * y,
        )
    return np.stack([fx * x + cx, fy * y + cy], axis=1)


@pytest.mark.parametrize("model", ["pinhole", "fisheye"])
def test_kalibr_and_ros_see_points_on_the_same_pixels(model: str, tmp_path: Path) -> None:
    numbers = (-0.1, 0.04, 0.002, -0.001, 0.0)[: 4 if model == "fisheye" else 5]
    lens = replace(LENS, model=model, distortion=np.array(numbers))
    camera = Camera(lens.K, *SIZE)
    write_calibration(tmp_path, camera, T_CAMERA_LIDAR, numbers, model, name="front")
    points = np.random.default_rng(0).uniform((2, -1, -1), (9, 1, 1), (50, 3))
    seen = points @ T_CAMERA_LIDAR[:3, :3].T + T_CAMERA_LIDAR[:3, 3]
    exact = lens.project(seen)
    found = by_kalibr((tmp_path / "camchain.yaml").read_text(), points)
    np.testing.assert_allclose(found, exact, atol=1e-6)
    ros = yaml.safe_load((tmp_path / "camera_info.yaml").read_text())
    info = SimpleNamespace(
        width=ros["image_width"], height=ros["image_height"],
        distortion_model=ros["distortion_model"], d=ros["distortion_coefficients"]["data"],
        **{letter: ros[f"{name}_matrix"]["data"] for letter, name in
           (("k", "camera"), ("r", "rectification"), ("p", "projection"))},
    )  # fmt: skip
    taken, d, kind = camera_of(info, False, None, "ROS")
    assert (kind, taken.width, taken.height) == (model, *SIZE)
    np.testing.assert_allclose(Lens(kind, taken.K, np.array(d), *SIZE).project(seen), exact)
    assert ros["projection_matrix"]["cols"] == 4
    write_calibration(tmp_path / "more", camera, T_CAMERA_LIDAR, [0.1] * 5, name="front")
    assert not (tmp_path / "more" / "camchain.yaml").exists()  # it has no such model


@pytest.mark.parametrize("model", ["pinhole", "fisheye"])
def test_k_of_exact_corners(model):
    true = LENS
    if model == "fisheye":
        numbers = np.array((-0.02, 0.01, -0.01, 0.002))
        true = Lens("fisheye", LENS.K, numbers, *SIZE)
    seen = []
    for pose in all_poses():
        T = T_CAMERA_LIDAR @ pose
        seen.append(true.project(BOARD.corners @ T[:3, :3].T + T[:3, 3]))
    lens, error = estimate_lens(BOARD, seen, SIZE, model)
    assert error < 1e-3
    np.testing.assert_allclose(lens.K, true.K, atol=0.05)
    np.testing.assert_allclose(lens.distortion[:2], true.distortion[:2], atol=5e-3)


def test_k_needs_images_of_this_board():
    corners = [corners_of(pose) for pose in all_poses()]
    with pytest.raises(CalibrationError, match="at least 3 images"):
        estimate_lens(BOARD, corners[:2], SIZE)
    noise = np.random.default_rng(0).normal(0, 20, (8, 24, 2))
    with pytest.raises(CalibrationError, match=r"misses the corners by.*`model`"):
        estimate_lens(BOARD, [c + n for c, n in zip(corners, noise, strict=True)], SIZE)


def test_corners_are_found_to_a_fraction_of_a_pixel():
    T_lidar_board = all_poses()[2]
    T = T_CAMERA_LIDAR @ T_lidar_board
    image = picture(BOARD, LENS, T, np.random.default_rng(1))
    for thorough in (True, False):
        found = find_corners(image, BOARD, thorough)
        exact = corners_of(T_lidar_board)
        exact = exact if np.abs(found - exact).max() < 5 else exact[::-1]
        assert np.sqrt(np.mean((found - exact) ** 2)) < 0.2
    # Of a camera on its side: no corner changes its place on the board.
    found = find_corners(np.rot90(image, -1).copy(), BOARD)
    turned = np.stack([len(image) - 1 - exact[:, 1], exact[:, 0]], axis=1)
    assert min(np.abs(found - turned).max(), np.abs(found - turned[::-1]).max()) < 1
    assert counted_corners(image, replace(BOARD, columns=5, rows=7, square=0.1), False) == (4, 6)
    less = replace(BOARD, columns=3, rows=5)
    assert find_corners(image, less) is not None, "a part of the board"
    assert counted_corners(image, less, True) == (4, 6)
    assert counted_corners(image, BOARD, True) is None
    assert counted_corners(np.full((100, 100, 3), 90, np.uint8), BOARD, False) is None
    # A board that is partly out of the picture is not found, and no smaller one instead.
    away = image[:, : int(exact[:, 0].mean())].copy()
    assert find_corners(away, BOARD) is None


@pytest.mark.parametrize("kind", ["AprilGrid", "ChArUco", "checkerboard"])
def test_markers_are_told_from_checkerboards(kind: str) -> None:
    pixels = np.full((600, 800), 255, np.uint8)
    if kind == "AprilGrid":
        known = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36H11)
        for k in range(12):
            y, x = 40 + 180 * (k // 4), 40 + 180 * (k % 4)
            pixels[y : y + 140, x : x + 140] = cv2.aruco.generateImageMarker(known, k, 140)
    elif kind == "ChArUco":
        known = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_1000)
        pixels = cv2.aruco.CharucoBoard((7, 5), 0.1, 0.07, known).generateImage(
            (800, 600), None, 20
        )
    else:
        pixels[50:550, 50:750] = 255 * (np.indices((500, 700)) // 100).sum(axis=0) % 2
    assert shows_markers(pixels) == (kind != "checkerboard")


@pytest.mark.parametrize("pattern", PATTERNS)
def test_boards_of_each_kind_are_found_to_a_fraction_of_a_pixel(pattern: str) -> None:
    rng, board = np.random.default_rng(4), Board(6, 5, 0.1, 0.9, 0.8, pattern)
    for _ in range(TRIALS):
        T = held(rng, 1.4, 2.2)
        found = find_corners(printed(board, T), board)
        assert found is not None
        exact = STRAIGHT.project(board.corners @ T[:3, :3].T + T[:3, 3])
        error = min(np.abs(found - way).max() for way in (exact, exact[::-1]))
        assert error < (0.5 if pattern == "circles" else 0.3)  # their centres are not projected
        pose, _ = board_pose(found, board, STRAIGHT)
        assert np.linalg.norm(pose[:3, 3] - T[:3, 3]) < 0.004
