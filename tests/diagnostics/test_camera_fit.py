"""Whether a camera is changed: only where all parts of a drive ask for the same."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from test_calibration_check import CAMERA, boards, drawn

from docdepth.datasets import CameraStream
from docdepth.diagnostics.calibration import RunEdges
from docdepth.diagnostics.depth_edges import edges_of_map
from docdepth.geometry.se3 import rotation_exp
from docdepth.pipeline.camera_fit import fit_camera

IMAGES = 12


def made(changes: list[np.ndarray], motions: list[np.ndarray], unrelated: int = 0) -> RunEdges:
    """Depth maps of boards, and images where they are turned and moved (6,) [rad, m]."""
    images, edges = [], []
    for seed, change in enumerate(changes):
        depth = np.full((240, 620), 40, np.float32)
        image = np.full((240, 620, 3), 120, np.uint8)
        for board, _ in boards(seed):
            drawn(depth, board, float(board[0, 2]))
        for board, color in boards(seed + unrelated):
            drawn(image, board @ rotation_exp(change[:3]).T + change[3:], color)
        noise = np.random.default_rng(seed).normal(0, 4, image.shape)
        images.append(np.clip(image + noise, 0, 255).astype(np.uint8))
        edges.append(edges_of_map(depth))
    names = [f"{k:06d}" for k in range(len(changes))]
    stream = CameraStream("front", CAMERA, np.eye(4), np.arange(len(names)), names)
    return RunEdges("run", stream, names, images, edges, motions)


def driving(seed: int = 0) -> list[np.ndarray]:
    """Standing points turn and come nearer while the vehicle drives, faster and slower."""
    rng = np.random.default_rng(seed)
    return [np.array([0, rng.normal(0, 0.15), 0, 0, 0, -rng.uniform(3, 14)]) for _ in range(IMAGES)]


def test_a_right_camera_stays() -> None:
    found = fit_camera(made([np.zeros(6)] * IMAGES, driving()))
    assert found is not None
    assert not found.is_sure
    assert found.moved_deg < 0.04


@pytest.mark.parametrize(
    ("turn_deg", "shift", "late_ms"),
    [
        ((0.0, -0.11, 0.0), (0, 0, 0), -6.5),
        ((0.3, 0.4, -0.2), (0, 0, 0), 20),
        ((0.2, -0.4, 0.1), (0.05, 0, 0), -20),
        ((0.0, 0.0, 0.5), (0, -0.05, 0), 0),
    ],
)
def test_a_wrong_one_is_found(turn_deg, shift, late_ms) -> None:
    """Of a turn, a shift and a time that is off, less than a pixel is left."""
    change, motions = np.array([*np.radians(turn_deg), *shift]), driving()
    given = made([change + 1e-3 * late_ms * motion for motion in motions], motions)
    found = fit_camera(given)
    assert found is not None
    assert found.is_sure
    left = np.array([*change, 1e-3 * late_ms]) - found.fit.change
    assert np.degrees(np.abs(left[:3])).max() < 0.07
    assert np.abs(left[3:6]).max() < 0.02
    assert abs(left[6]) < 2e-3
    assert given.seen.moved(left) < 0.5


def test_along_a_short_path_a_pan_is_found_and_nothing_else() -> None:
    """Upper edges may lie at the same beam in all images; left and right edges do not."""
    motions, right, pan = driving(), np.zeros(6), np.radians([0, 0.3, 0, 0, 0, 0])
    found = fit_camera(made([pan] * IMAGES, motions), path=20.0)
    assert found is not None
    assert found.is_sure
    assert found.fit.turn_deg == pytest.approx([0, 0.3, 0], abs=0.03)
    assert not found.fit.change[[0, 2, 3, 4, 5, 6]].any()
    for other in (
        right,
        pan / 8,
        np.radians([0.3, 0, 0, 0, 0, 0]),
        np.radians([0, 0, 0.5, 0, 0, 0]),
    ):
        assert fit_camera(made([other] * IMAGES, motions), path=20.0) is None


def test_halves_that_disagree_change_nothing() -> None:
    turn = np.radians([0, 0.3, 0, 0, 0, 0])
    found = fit_camera(made([turn] * (IMAGES // 2) + [-turn] * (IMAGES // 2), driving()))
    assert found is not None
    assert not found.is_sure


def test_images_of_another_drive_change_nothing() -> None:
    found = fit_camera(made([np.zeros(6)] * IMAGES, driving(), unrelated=100))
    assert found is not None
    assert not found.is_sure


def test_few_images_tell_nothing() -> None:
    assert fit_camera(made([np.zeros(6)] * 8, driving()[:8])) is None


def test_beams_that_are_wide_turn_no_camera() -> None:
    """Things are drawn wider on each side; that is told apart, and measured."""
    given = made([np.zeros(6)] * IMAGES, driving())
    wide = []
    for seed in range(IMAGES):
        depth = np.full((240, 620), 40, np.float32)
        for board, _ in boards(seed):
            drawn(depth, board, float(board[0, 2]))
        near = cv2.erode(depth, np.ones((5, 5), np.uint8))  # the nearest within two pixels
        wide.append(edges_of_map(near))
    found = fit_camera(
        RunEdges("run", given.stream, given.names, given.images, wide, given.motions)
    )
    assert found is not None
    assert not found.is_sure
    assert found.fit.half_beam * CAMERA.K[0, 0] == pytest.approx([2, 2], abs=0.3)
