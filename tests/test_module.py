"""Arrays that do not fit each other end in an exception: the core would read beyond their end."""

from __future__ import annotations

import numpy as np
import pytest

import docdepth._core as _core

POINTS = np.random.default_rng(0).uniform(-9, 9, (50, 3)).astype(np.float32)
GROUND = np.zeros(50, bool)
CLASSES = np.full(50, 50, np.uint16)
POSE = np.eye(4)
K = np.array([[9.0, 0, 4], [0, 9, 3], [0, 0, 1]])


def mesh() -> _core.ScanMesh:
    return _core.ScanMesh(POINTS, _core.MeshParameters())


def mesh_frame(corner: int = 2, owner: int = 0) -> _core.MeshFrame:
    triangles, nothing = np.array([[0, 1, corner]], np.uint32), np.zeros(0, np.uint32)
    owners, motion = np.full(50, owner, np.uint16), np.zeros((0, 4), np.float32)
    jumps = np.zeros(1, np.uint8)
    return _core.MeshFrame(POINTS, CLASSES, triangles, jumps, nothing, 0.01, owners, motion)


def splats(width: int, height: int, frame: object, pose: np.ndarray = POSE) -> np.ndarray:
    return _core.render_splats(K, width, height, [(frame, pose)], [], (50, 3), (80, 35))


FRAME = _core.Frame(POINTS, CLASSES, 99.0)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: _core.nearest_neighbors(POINTS[:, :2].copy(), POINTS), "points must be a float32"),
        (lambda: _core.nearest_neighbors(POINTS, POINTS[0]), "queries must be a float32"),
        (lambda: _core.RangeImage(POINTS, GROUND[1:], 0.01, 5, 0.2), r"ground must have shape"),
        (lambda: _core.RangeImage(POINTS, GROUND, 1e-9, 5, 0.2), "resolution = 1e-09 must lie"),
        (
            lambda: _core.cluster_objects(POINTS[1:], GROUND[1:], mesh()),
            "mesh was made of another number of points",
        ),
        (
            lambda: _core.vote(POINTS, GROUND, POSE, [None], POSE[None], [0.0]),
            "a key frame is None",
        ),
        (lambda: mesh_frame(corner=50), "triangles name a point that is not there"),
        (lambda: mesh_frame(owner=1), "an object_index = 1 must lie between 0 and 0"),
        (lambda: splats(50_000, 50_000, FRAME), "width times height = 2500000000 must lie"),
        (lambda: splats(9, 9, None), "a frame is None"),
        (lambda: splats(9, 9, FRAME, np.full((4, 4), np.nan)), "a pose is not a rotation"),
        (lambda: splats(9, 9, FRAME, POSE[:3]), "a pose must be a float64 array of shape"),
    ],
)
def test_what_does_not_fit_is_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_a_wrong_type_of_numbers_is_refused():
    with pytest.raises(TypeError):
        _core.nearest_neighbors(POINTS.astype(np.float64), POINTS)
