"""Pose graph: poses along a path that agree best with loop closures."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from docdepth.errors import MissingExtraError
from docdepth.geometry.se3 import inverse, nearest_rigid, se3_exp, se3_log, skew

# Standard deviations of a step of odometry, for one metre; variances add up along the path.
STEP_TURN, STEP_SHIFT = 2e-4, 0.005  # radians, metres
# Of a closure. What registration of two places is off by changes little from place to place, so
# closures near each other are not independent, and each counts less.
CLOSURE_TURN, CLOSURE_SHIFT = 5e-3, 0.1  # radians, metres
_SHORTEST = 0.1  # metres; a step that is shorter is as unsure as this one
_ITERATIONS = 20
_CONVERGED = 1e-7  # metres and radians that a step of Gauss-Newton moves no pose by


class Edge(NamedTuple):
    """A measured pose of node ``b`` in the frame of node ``a``."""

    a: int
    b: int
    pose: NDArray[np.float64]


def check_solver() -> None:
    """Refuse to begin without scipy, which solves the sparse equations."""
    try:
        import scipy.sparse.linalg  # noqa: F401
    except ImportError:
        raise MissingExtraError(
            "odometry.loop_closure needs scipy: pip install 'docdepth[loops]'"
        ) from None


def optimized(poses: NDArray[np.float64], closures: Sequence[Edge]) -> NDArray[np.float64]:
    """Poses that agree best with the steps between them and with closures.

    Least squares by Gauss-Newton, in which each pose is corrected in its own frame.

    Parameters
    ----------
    poses : ndarray of float64, shape (n, 4, 4)
        Nodes along a path, of odometry. The first stays.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.linalg import splu

    steps = inverse(poses[:-1]) @ poses[1:]
    lengths = np.linalg.norm(steps[:, :3, 3], axis=1).clip(_SHORTEST)
    edges = [Edge(k, k + 1, step) for k, step in enumerate(steps)] + list(closures)
    weights = np.concatenate(
        [
            np.repeat([STEP_TURN, STEP_SHIFT], 3) * np.sqrt(lengths)[:, None],
            np.tile(np.repeat([CLOSURE_TURN, CLOSURE_SHIFT], 3), (len(closures), 1)),
        ]
    )
    weights = 1 / weights
    a, b = np.array([e.a for e in edges]), np.array([e.b for e in edges])
    rows = np.arange(6 * len(edges)).reshape(-1, 6, 1)
    rows = np.broadcast_to(rows, (len(edges), 6, 6))
    at = [np.broadcast_to(6 * k[:, None, None] + np.arange(6), rows.shape) for k in (a, b)]
    values = poses.copy()
    for _ in range(_ITERATIONS):
        residuals, of_a, of_b = linearized(values, edges)
        entries = [weights[:, :, None] * of_a, weights[:, :, None] * of_b]
        shape = (6 * len(edges), 6 * len(poses))
        jacobian = coo_array(
            (np.ravel(entries), (np.ravel([rows, rows]), np.ravel(at))), shape
        ).tocsc()[:, 6:]
        gradient = jacobian.T @ (weights * residuals).ravel()
        change = splu((jacobian.T @ jacobian).tocsc()).solve(-gradient).reshape(-1, 6)
        for k, twist in enumerate(change, 1):
            values[k] = nearest_rigid(values[k] @ se3_exp(twist[:3], twist[3:]))
        if np.abs(change).max() < _CONVERGED:
            break
    return values


def misfits(poses: NDArray[np.float64], closures: Sequence[Edge]) -> NDArray[np.float64]:
    """How many standard deviations closures are from what poses (n, 4, 4) say, shape (m,)."""
    residuals = linearized(poses, closures)[0] if closures else np.zeros((0, 6))
    scaled = residuals / np.repeat([CLOSURE_TURN, CLOSURE_SHIFT], 3)
    return np.asarray(np.linalg.norm(scaled, axis=1))


def linearized(
    poses: NDArray[np.float64], edges: Sequence[Edge]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """What edges are off by, and how that changes with either pose.

    Returns
    -------
    residuals : ndarray of float64, shape (m, 6)
        Rotation vector and shift from the measured pose of b to that of ``poses``.
    of_a, of_b : ndarray of float64, shape (m, 6, 6)
        Derivatives for small corrections (rotation, shift) of each pose in its own frame.
    """
    residuals = np.empty((len(edges), 6))
    of_a, of_b = np.zeros((len(edges), 6, 6)), np.zeros((len(edges), 6, 6))
    for k, (a, b, measured) in enumerate(edges):
        between = inverse(poses[a]) @ poses[b]
        residuals[k] = np.concatenate(se3_log(inverse(measured) @ between))
        # The logarithm's derivative, but for terms of second order: residuals are small.
        turn, shift = skew(residuals[k, :3]), skew(residuals[k, 3:])
        of_b[k, :3, :3] = of_b[k, 3:, 3:] = np.eye(3) + 0.5 * turn
        of_b[k, 3:, :3] = 0.5 * shift
        of_a[k] = -of_b[k] @ _adjoint(inverse(between))
    return residuals, of_a, of_b


def _adjoint(pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """Takes a twist (rotation, shift) to another frame, shape (6, 6)."""
    result, rotation = np.zeros((6, 6)), pose[:3, :3]
    result[:3, :3] = result[3:, 3:] = rotation
    result[3:, :3] = skew(pose[:3, 3]) @ rotation
    return result


def between_nodes(
    poses: NDArray[np.float64],
    nodes: NDArray[np.int64],
    moved: NDArray[np.float64],
    arc_length: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Poses of all sweeps when some of them were moved.

    A sweep between two nodes keeps its place behind the first, but for its share of what the way
    to the second changed by.

    Parameters
    ----------
    poses : ndarray of float64, shape (n, 4, 4)
    nodes : ndarray of int64, shape (m,)
        Sweeps that were moved, ascending, the first of the drive among them.
    moved : ndarray of float64, shape (m, 4, 4)
    arc_length : ndarray of float64, shape (n,)
    """
    result = moved[-1] @ inverse(poses[nodes[-1]]) @ poses  # those behind the last node
    for k, (a, b) in enumerate(pairwise(nodes.tolist())):
        way = inverse(poses[a]) @ poses[a : b + 1]
        omega, shift = se3_log(inverse(way[-1]) @ (inverse(moved[k]) @ moved[k + 1]))
        length = max(float(arc_length[b] - arc_length[a]), 1e-9)
        shares = (arc_length[a : b + 1] - arc_length[a]) / length
        turns = np.array([se3_exp(share * omega, share * shift) for share in shares])
        result[a : b + 1] = moved[k] @ way @ turns
    return nearest_rigid(result)
