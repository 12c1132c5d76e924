"""What a wrong camera adds to the error of depth maps, against maps that are drawn right."""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np
import pytest

from docdepth.datasets import CameraStream
from docdepth.diagnostics.calibration import RunEdges
from docdepth.diagnostics.depth_edges import edges_of_map
from docdepth.evaluation import camera_error as module
from docdepth.evaluation.camera_error import camera_error, changed, difference
from docdepth.geometry.camera import Camera
from docdepth.geometry.se3 import rotation_exp
from docdepth.io.run_folder import RunFolder

K = np.array([[400.0, 0, 310], [0, 420, 120], [0, 0, 1]])
CAMERA = Camera(K, 620, 240)


def boards(seed: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Corner and edges (2, 3) of upright boards before a wall at 40 m, in the camera's frame."""
    rng = np.random.default_rng(seed)
    found = [(np.array([-60.0, -30, 40]), np.array([[120.0, 0, 0], [0, 60, 0]]))]
    for depth in np.sort(rng.uniform(6, 30, 10))[::-1]:
        corner = np.array([*rng.uniform([20, 20], [600, 200]), 1]) @ np.linalg.inv(K).T * depth
        found.append((corner, np.diag([*rng.uniform(1, 4, 2), 0])[:2]))
    return found


def map_of(seed: int, change: np.ndarray) -> np.ndarray:
    """Depth of the boards, their points turned and moved: where each ray meets each plane."""
    R, t = rotation_exp(change[:3]), change[3:]
    v, u = np.mgrid[:240, :620]
    rays = np.stack([(u - 310) / 400, (v - 120) / 420, np.ones(u.shape)], -1)
    depth = np.full(u.shape, np.inf)
    for corner, edges in boards(seed):
        start, (a, b) = R @ corner + t, edges @ R.T
        normal = np.cross(a, b)
        z = (normal @ start) / (rays @ normal)
        at = rays * z[..., None] - start
        inside = (z > 0) & (np.abs((at @ a) / (a @ a) - 0.5) <= 0.5)
        inside &= np.abs((at @ b) / (b @ b) - 0.5) <= 0.5
        depth = np.where(inside & (z < depth), z, depth)
    return np.where(np.isfinite(depth), depth, np.nan).astype(np.float32)


CHANGES = [
    np.array([*np.radians((0, 0.5, 0)), 0, 0, 0]),
    np.array([*np.radians((0.4, -0.3, 0.5)), 0, 0, 0]),
    np.array([0, 0, 0, 0.1, 0, -0.4]),
    np.array([*np.radians((0.1, 0, -0.2)), 0.05, -0.05, 0.2]),
]


@pytest.mark.parametrize("change", CHANGES)
def test_it_is_the_error_against_maps_drawn_by_a_right_camera(change):
    """What a board hid, and a shift shows, is not counted: the given map does not know it."""
    off, true, pixels = [], [], 0
    given = [map_of(seed, np.zeros(6)) for seed in range(4)]
    for seed, depth in enumerate(given):
        right, known = map_of(seed, change), changed(depth, CAMERA, change)
        both = np.isfinite(known) & np.isfinite(depth)
        pixels += np.isfinite(right).sum()
        off.append(np.abs(depth - right)[both])
        true.append(right[both])
        assert np.percentile(np.abs(known / right - 1)[both], 97) < 0.01
    off, true = np.concatenate(off), np.concatenate(true)
    assert len(off) > 0.93 * pixels
    mae, wrong = difference(given, CAMERA, change)
    assert mae == pytest.approx(off.mean(), rel=0.08)
    assert wrong == pytest.approx(100 * (off > 0.05 * true).mean(), rel=0.08)


def test_no_change_is_no_error():
    depth = map_of(1, np.zeros(6))
    assert (changed(depth, CAMERA, np.zeros(6)) == depth).all()
    assert difference([depth], CAMERA, np.zeros(6)) == (0, 0)


def test_what_is_nearer_shows_and_what_leaves_the_image_goes():
    """A metre nearer along the axis, what lies at 4 m is seen 4 / 3 as far from the middle."""
    depth = np.full((240, 620), np.nan, np.float32)
    depth[120, [310, 350, 600]] = 4
    nearer = changed(depth, CAMERA, np.array([0, 0, 0, 0, 0, -1.0]))
    v, u = np.nonzero(nearer == 3)
    assert v.tolist() == [120, 120]
    assert u.tolist() == [310, 363]  # 310 + 40 * 4 / 3; 600 would lie at 697
    depth[120, 345] = 53 / 18  # moves to 310 + 35 * (53 / 18) / (35 / 18), the same pixel
    nearer = changed(depth, CAMERA, np.array([0, 0, 0, 0, 0, -1.0]))
    assert nearer[120, 363] == pytest.approx(35 / 18)
    nothing = np.full((240, 620), np.nan, np.float32)
    assert np.isnan(difference([nothing], CAMERA, np.zeros(6))).all()


def test_images_that_fit_by_chance_only_are_named(monkeypatch, tmp_path):
    """The worst camera of all must not pass in silence."""
    rng = np.random.default_rng(0)
    names = [f"{k:06d}" for k in range(6)]
    stream = CameraStream("front", CAMERA, np.eye(4), np.arange(6), names)
    edges = [edges_of_map(map_of(seed, np.zeros(6))) for seed in range(6)]
    images = [
        cv2.GaussianBlur(rng.integers(0, 255, (240, 620, 3), np.uint8), (0, 0), 3) for _ in names
    ]
    motions = [np.zeros(6)] * 6
    given = RunEdges(Path("run"), stream, names, images, edges, motions)
    assert given.enough
    monkeypatch.setattr(module, "edges_of_run", lambda *_: given)
    found = camera_error(RunFolder(tmp_path))
    assert math.isnan(found.mae)
    assert "by chance only" in found.line
    assert "not known" in found.line
    few = RunEdges(given.path, stream, names[:3], images[:3], edges[:3], motions[:3])
    monkeypatch.setattr(module, "edges_of_run", lambda *_: few)
    assert camera_error(RunFolder(tmp_path)) is None, "a drive that stands tells nothing"
