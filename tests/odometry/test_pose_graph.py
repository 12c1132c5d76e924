"""The pose graph against closed forms, and against a dense solver that knows no Jacobian."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from docdepth.geometry.se3 import inverse, se3_exp
from docdepth.odometry.pose_graph import (
    CLOSURE_SHIFT,
    CLOSURE_TURN,
    STEP_SHIFT,
    STEP_TURN,
    Edge,
    between_nodes,
    misfits,
    optimized,
)


def chain(steps: list[np.ndarray]) -> np.ndarray:
    poses = [np.eye(4)]
    for step in steps:
        poses.append(poses[-1] @ step)
    return np.array(poses)


def ring(count: int, error: np.ndarray, length: float = 10.0) -> tuple[np.ndarray, np.ndarray]:
    """Nodes once around a ring, exact and with an error in each step."""
    step = se3_exp(np.array([0, 0, 2 * np.pi / count]), np.array([length, 0, 0]))
    return chain([step] * count), chain([step @ error] * count)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_straight_path_that_is_too_long(axis: int) -> None:
    """Along a line that does not turn, variances share the error: the closed form of a chain."""
    shift, count, error = np.zeros(3), 8, 0.3
    shift[axis] = 10.0
    step = se3_exp(np.zeros(3), shift)
    poses = chain([step] * count)
    wanted = poses[-1].copy()
    wanted[axis, 3] -= error
    steps, closure = count * 10 * STEP_SHIFT**2, CLOSURE_SHIFT**2
    moved = optimized(poses, [Edge(0, count, wanted)])
    expected = poses[:, axis, 3] - error * steps / (steps + closure) * np.arange(count + 1) / count
    np.testing.assert_allclose(moved[:, axis, 3], expected, atol=1e-7)
    np.testing.assert_allclose(moved[:, :3, :3], poses[:, :3, :3], atol=1e-9)
    off = error * closure / (steps + closure) / CLOSURE_SHIFT
    np.testing.assert_allclose(misfits(moved, [Edge(0, count, wanted)]), off, rtol=1e-5)


def plain(poses: np.ndarray, closures: list[Edge]) -> np.ndarray:
    """The same least squares over absolute poses, with derivatives by differences."""

    def built(x: np.ndarray) -> np.ndarray:
        values = np.repeat(np.eye(4)[None], len(poses), axis=0)
        values[1:, :3, :3] = Rotation.from_rotvec(x[:, :3]).as_matrix()
        values[1:, :3, 3] = x[:, 3:]
        return values

    def residuals(x: np.ndarray) -> np.ndarray:
        values, rows = built(x.reshape(-1, 6)), []
        steps = [(k, k + 1, np.linalg.inv(p) @ q) for k, (p, q) in enumerate(pairwise(poses))]
        for a, b, measured in [*steps, *closures]:
            off = np.linalg.inv(measured) @ np.linalg.inv(values[a]) @ values[b]
            scale = np.sqrt(np.linalg.norm(measured[:3, 3]))
            turn, shift = STEP_TURN * scale, STEP_SHIFT * scale
            if (a, b) != (a, a + 1):
                turn, shift = CLOSURE_TURN, CLOSURE_SHIFT
            # Shifts by the logarithm of SE(3), which is linear for residuals as small as these.
            vector = Rotation.from_matrix(off[:3, :3]).as_rotvec()
            back = np.cross(vector, off[:3, 3])
            rows += [vector / turn, (off[:3, 3] - back / 2) / shift]
        return np.concatenate(rows)

    vectors = Rotation.from_matrix(poses[1:, :3, :3]).as_rotvec()
    start = np.column_stack([vectors, poses[1:, :3, 3]]).ravel()
    return built(
        least_squares(residuals, start, xtol=1e-14, ftol=1e-14, gtol=1e-12).x.reshape(-1, 6)
    )


@pytest.mark.parametrize("seed", [0, 1])
def test_a_dense_solver_finds_the_same(seed: int) -> None:
    rng = np.random.default_rng(seed)
    error = se3_exp(rng.normal(0, 0.003, 3), rng.normal(0, 0.02, 3))
    exact, poses = ring(7, error, rng.uniform(3, 12))
    noise = [se3_exp(rng.normal(0, 0.002, 3), rng.normal(0, 0.05, 3)) for _ in range(3)]
    pairs = ((0, 7), (1, 6), (2, 6))
    closures = [
        Edge(a, b, inverse(exact[a]) @ exact[b] @ off)
        for (a, b), off in zip(pairs, noise, strict=True)
    ]
    np.testing.assert_allclose(optimized(poses, closures), plain(poses, closures), atol=2e-5)


def test_sweeps_between_nodes() -> None:
    rng = np.random.default_rng(4)
    steps = [se3_exp(rng.normal(0, 0.05, 3), rng.normal([1, 0, 0], 0.1)) for _ in range(12)]
    poses = chain(steps)
    arc = np.concatenate([[0], np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1).cumsum()])
    nodes = np.array([0, 4, 9])
    np.testing.assert_allclose(between_nodes(poses, nodes, poses[nodes], arc), poses, atol=1e-12)
    moved = poses[nodes] @ np.array([se3_exp(*rng.normal(0, 0.02, (2, 3))) for _ in nodes])
    result = between_nodes(poses, nodes, moved, arc)
    np.testing.assert_allclose(result[nodes], moved, atol=1e-12)
    # What a way between nodes changes by is spread over it: no step has more than its share.
    for a, b in ((0, 4), (4, 9)):
        change = inverse(inverse(poses[a]) @ poses[b]) @ inverse(result[a]) @ result[b]
        most = np.abs(change - np.eye(4)).max()
        for k in range(a, b):
            step = inverse(poses[k]) @ poses[k + 1]
            assert (
                np.abs(inverse(step) @ inverse(result[k]) @ result[k + 1] - np.eye(4)).max() < most
            )
    # Behind the last node everything moves as one.
    np.testing.assert_allclose(
        inverse(result[9]) @ result[9:], inverse(poses[9]) @ poses[9:], atol=1e-12
    )
