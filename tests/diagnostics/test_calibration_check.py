"""Depth edges against image edges: how far a calibration is off, and in which direction."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from command_line import cli
from docdepth.config import parameters
from docdepth.datasets import CameraStream
from docdepth.diagnostics import calibration
from docdepth.diagnostics.calibration import (
    RunEdges,
    check_camera_calibration,
    compare,
    edges_of_images,
)
from docdepth.diagnostics.depth_edges import edges_of_map, pixels_of_tracks
from docdepth.errors import CalibrationError
from docdepth.geometry.camera import Camera, View
from docdepth.geometry.se3 import rotation_exp
from docdepth.geometry.track import Track, Tracks
from docdepth.geometry.trajectory import Trajectory
from docdepth.io.run_folder import RunFolder

K = np.array([[400.0, 0, 310], [0, 400, 120], [0, 0, 1]])
CAMERA = Camera(K, 620, 240)
IMAGES = 8


def boards(seed: int) -> Iterator[tuple[np.ndarray, list[int]]]:
    """Corners (4, 3) of twelve upright boards in the camera's frame, the farthest first."""
    rng = np.random.default_rng(seed)
    for depth in np.sort(rng.uniform(5, 25, 12))[::-1]:
        middle = np.array([*rng.uniform([20, 20], [600, 220]), 1.0]) @ np.linalg.inv(K).T * depth
        half = rng.uniform(0.3, 1.2, 2)
        corners = [(-1, -1), (1, -1), (1, 1), (-1, 1)]
        board = np.array([[*(half * corner), 0] for corner in corners]) + middle
        yield board, rng.integers(0, 255, 3).tolist()


def drawn(canvas: np.ndarray, points: np.ndarray, value: object) -> None:
    pixels = points @ K.T
    fine = np.rint(16 * pixels[:, :2] / pixels[:, 2:]).astype(np.int32)
    cv2.fillConvexPoly(canvas, fine, value, shift=4)


def made(turn_deg=(0, 0, 0), shift=(0, 0, 0), unrelated: bool = False) -> RunEdges:
    """Depth maps of boards, and images where the boards are turned and moved."""
    R, images, edges = rotation_exp(np.radians(turn_deg)), [], []
    for seed in range(IMAGES):
        depth = np.full((240, 620), 40, np.float32)
        image = np.full((240, 620, 3), 120, np.uint8)
        for board, _ in boards(seed):
            drawn(depth, board, float(board[0, 2]))
        for board, color in boards(seed + 100 * unrelated):
            drawn(image, board @ R.T + shift, color)
        noise = np.random.default_rng(seed).normal(0, 4, image.shape)
        images.append(np.clip(image + noise, 0, 255).astype(np.uint8))
        edges.append(edges_of_map(depth))
    names = [f"{k:06d}" for k in range(IMAGES)]
    stream = CameraStream("front", CAMERA, np.eye(4), np.arange(IMAGES), names)
    return RunEdges(Path("run"), stream, names, images, edges, [np.zeros(6)] * IMAGES)


def test_a_right_calibration_agrees() -> None:
    found = compare(made())
    assert found.agrees
    assert "agrees with the images: it is off by less than 0." in found.verdict
    assert np.abs(found.fit.turn_deg).max() < 0.05
    assert np.abs(found.fit.shift_m).max() < 0.01


@pytest.mark.parametrize(
    ("turn_deg", "shift", "words"),
    [
        ((0.3, 0, 0), (0, 0, 0), "degrees down"),
        ((0, -0.3, 0), (0, 0, 0), "degrees to the right"),
        ((0, 0, 0.5), (0, 0, 0), "degrees counterclockwise"),
        ((0, 1.5, 0), (0, 0, 0), "degrees to the left"),
        ((0, 0, 0), (0.08, 0, 0), "m to the left"),
        ((0.4, 0.3, 0), (0, -0.08, 0), "m down"),
    ],
)
def test_a_wrong_one_is_measured(turn_deg, shift, words) -> None:
    found = compare(made(turn_deg, shift))
    assert not found.agrees
    errors = np.concatenate([np.radians(turn_deg), shift, [0]]) - found.fit.change
    assert np.abs(np.degrees(errors[:3])).max() < 0.07
    assert np.abs(errors[3:6]).max() < 0.015
    # Errors are honest: not many times what is stated, and what is stated is not wide.
    assert (np.abs(errors) < 4 * found.fit.deviations).all()
    assert np.degrees(found.fit.deviations[:3]).max() < 0.1
    assert words in found.verdict


def test_the_direction_in_pixels() -> None:
    right, down = compare(made((0, 0.5, 0))).fit.pixels
    assert right == pytest.approx(400 * np.radians(0.5), abs=0.6)
    assert down == pytest.approx(0, abs=0.6)


def test_images_of_another_drive_tell_nothing() -> None:
    with pytest.raises(CalibrationError, match="by chance only"):
        compare(made(unrelated=True))


def test_an_image_without_edges_changes_nothing() -> None:
    """A map may be empty, or show nothing but what moves."""
    found, empty = made(), made()
    empty.names.append("000099")
    empty.images.append(np.full((240, 620, 3), 120, np.uint8))
    empty.edges.append(edges_of_map(np.full((240, 620), 40, np.float32)))
    empty.motions.append(np.zeros(6))
    assert len(empty.edges[-1]) == 0
    with_it, without = compare(empty).fit, compare(found).fit
    np.testing.assert_array_equal(with_it.change, without.change)
    assert with_it.score == without.score


def test_too_few_edges_tell_nothing() -> None:
    found = made()
    parts = found.names, found.images, found.edges, found.motions
    few = RunEdges(found.path, found.stream, *(part[:3] for part in parts))
    with pytest.raises(CalibrationError, match="has 3 images"):
        compare(few)


def images_along(path: list[float], monkeypatch) -> RunEdges:
    """Images of the boards, as if the vehicle had come so far by each of them [m]."""
    given = made()
    monkeypatch.setattr(CameraStream, "rectified_image", lambda _, k: given.images[k])
    poses = np.tile(np.eye(4), (len(path), 1, 1))
    poses[:, 2, 3] = path
    times = np.arange(len(path)) * 10**8
    names = [f"{k:06d}" for k in range(len(path))]
    stream = CameraStream("front", CAMERA, np.eye(4), times, names)
    depth = np.full((240, 620), 40, np.float32)
    for board, _ in boards(0):
        drawn(depth, board, float(board[0, 2]))
    indices = range(len(path))
    return edges_of_images(
        Path("run"), stream, indices, lambda _: depth, Trajectory(times, poses), Tracks()
    )


def test_images_from_one_place_count_once(monkeypatch) -> None:
    waiting = images_along([0, 0.01, 0, 0.02, 0.01, 0, 0.01, 0], monkeypatch)
    assert waiting.names == ["000000"]
    with pytest.raises(CalibrationError, match="take a drive that moves"):
        compare(waiting)
    assert check_camera_calibration(waiting) == (None, [])
    crawling = images_along([0, 0.2, 0.4, 0.6, 0.8, 1.0, 1.2, 1.4], monkeypatch)
    assert crawling.names == ["000000", "000003", "000006", "000007"]


def test_a_run_finds_a_wrong_calibration() -> None:
    verdict, found = check_camera_calibration(made())
    assert verdict is not None
    assert "agrees with the images" in verdict
    assert found == []
    verdict, (finding,) = check_camera_calibration(made((0, 0.5, 0)))
    assert verdict == finding.text
    assert (finding.code, finding.subject) == ("calibration-off", "front")
    assert "degrees to the left" in finding.text
    verdict, (finding,) = check_camera_calibration(made(unrelated=True))
    assert verdict == finding.text
    assert finding.code == "by-chance"


def test_edges_lie_between_near_and_far_and_point_away_from_the_near() -> None:
    depth = np.full((60, 80), 20, np.float32)
    depth[20:40, 30:50] = 8
    depth[:, 70:] = np.nan  # no depth is no depth edge
    edges = edges_of_map(depth)
    assert set(edges.depth) == {8.0}
    left = edges.pixels[:, 0] == 29.5
    assert 14 <= left.sum() <= 20
    inner = left & (np.abs(edges.pixels[:, 1] - 29.5) < 5)
    np.testing.assert_allclose(edges.across[inner], [[-1, 0]] * inner.sum(), atol=0.05)
    below = (edges.pixels[:, 1] == 39.5) & (np.abs(edges.pixels[:, 0] - 40) < 5)
    np.testing.assert_allclose(edges.across[below], [[0, 1]] * below.sum(), atol=0.05)
    assert not len(edges_of_map(depth, np.ones(depth.shape, bool)))


def test_crests_of_the_ground_are_no_edges() -> None:
    """The last beam on it lies anywhere below the crest; a wall tells whatever its angle."""
    rows = np.arange(60, dtype=np.float64)[:, None]
    bank = np.where(rows < 30, 60, 400 / np.maximum(rows - 5, 1)) * np.ones(80)
    assert not len(edges_of_map(bank.astype(np.float32)))
    assert len(edges_of_map(np.repeat(bank.T[:1], 60, axis=0).astype(np.float32)))


def test_boxes_of_moving_objects_are_left_out() -> None:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = [[0, -1, 0], [0, 0, -1], [1, 0, 0]], (1, 1, 10)
    times = np.array([0, 10])
    track = Track(
        1, "vehicle", times, np.stack([T, T]), np.zeros((2, 3)), np.array([4.0, 2, 1.5]),
        np.array([9, 9]), np.full(2, 0.1), np.full(2, 0.1),
    )  # fmt: skip
    mask = pixels_of_tracks(Tracks([track]), View(CAMERA, np.eye(4), 5))
    v, u = np.nonzero(mask)
    # Its near side is 8 m ahead, 2 m wide about x = 1, its top 1.5 m above y = 1.
    assert abs(u.min() - (310 - 5)) <= 1
    assert abs(u.max() - (310 + 400 * 2 / 8 + 5)) <= 1
    assert abs(v.min() - (120 - 400 * 0.5 / 8 - 5)) <= 1
    assert not pixels_of_tracks(Tracks([track]), View(CAMERA, np.eye(4), 11)).any()


def test_the_verb(finished, tmp_path, monkeypatch) -> None:
    run, _ = finished
    ended = cli("calibrate", run)
    assert ended.exit_code == 2
    assert "has 4 images" in str(ended.exception)
    monkeypatch.setattr(calibration, "_FEWEST_IMAGES", 3)
    monkeypatch.setattr(calibration, "_FEWEST_EDGES", 50)
    ended = cli("calibrate", run, "-o", tmp_path / "check")
    assert ended.exit_code == 0, ended.output
    assert "the calibration" in ended.output
    assert "in 4 images" in ended.output
    (picture,) = (tmp_path / "check").iterdir()
    assert cv2.imread(str(picture)).shape == (40, 96, 3)
    assert "a fit needs ten images" in ended.output
    figures = json.loads(cli("calibrate", run, "--json").stdout)["image_2"]
    assert figures["images"] == 4
    assert len(figures["turn_deg"]) == 3


def test_splats_reach_over_edges(finished, monkeypatch) -> None:
    splats = parameters("paper")
    monkeypatch.setattr(RunFolder, "parameters", property(lambda _: splats))
    ended = cli("calibrate", finished[0])
    assert ended.exit_code == 2
    assert "render.primitive=triangles" in str(ended.exception)


def test_options_of_boards_do_not_go_with_it(finished) -> None:
    ended = cli("calibrate", finished[0], "--corners", "4x6")
    assert ended.exit_code == 2
    assert "leave the others out" in str(ended.exception)
