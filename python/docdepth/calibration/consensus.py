"""Which patches are the board: those for which one extrinsic, from planes alone, holds."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from docdepth.calibration.board import Board
from docdepth.calibration.search import Patch
from docdepth.geometry.se3 import inverse, nearest_rotation

Floats = NDArray[np.float64]

AGREE_PLACE = 0.3
"""Metres between a patch and where it is expected."""

AGREE_ANGLE_DEG = 15.0
"""Degrees between a patch and how it is expected to stand."""

_VARIED = 0.1  # condition of the normals; of less varied boards the rotation cannot be told


def turned(T_lidar_board: Floats, board: Board) -> list[Floats]:
    """The poses of a board that look the same: after half a turn, of a square one a quarter."""
    quarters = (0, 1, 2, 3) if board.is_square else (0, 2)
    poses = []
    for quarter in quarters:
        cos, sin = ((1, 0), (0, 1), (-1, 0), (0, -1))[quarter]
        turn = np.eye(4)
        turn[:2, :2] = ((cos, -sin), (sin, cos))
        poses.append(T_lidar_board @ turn)
    return poses


def agrees(T_lidar_board: Floats, expected: Floats) -> bool:
    """Whether a board stands about where it is expected, and as it is expected to stand."""
    away = np.linalg.norm(T_lidar_board[:3, 3] - expected[:3, 3])
    trace = np.trace(T_lidar_board[:3, :3].T @ expected[:3, :3])
    limit = 1.0 + 2.0 * np.cos(np.radians(AGREE_ANGLE_DEG))
    return bool(away < AGREE_PLACE and trace > limit)


def nearest_turn(T_lidar_board: Floats, expected: Floats, board: Board) -> Floats:
    """The pose that looks the same and is turned least from the expected one."""
    return max(
        turned(T_lidar_board, board), key=lambda T: float(np.trace(T[:3, :3].T @ expected[:3, :3]))
    )


def find_extrinsic(
    T_camera_board: Sequence[Floats],
    patches: Sequence[Sequence[Patch]],
    board: Board,
    lever_arm: float,
) -> tuple[Floats | None, int]:
    """``T_lidar_camera`` (4, 4) for which most sweeps hold the board where it is expected.

    Each patch of each sweep proposes an extrinsic; the others vote.

    Parameters
    ----------
    T_camera_board : sequence of ndarray, shape (4, 4)
        Boards in the images.
    patches : sequence of sequence of Patch
        Of the sweep of each image.
    lever_arm : float
        Most distance of camera and LiDAR [m].

    Returns
    -------
    T_lidar_camera : ndarray of float64, shape (4, 4), or None
        None without any patch.
    votes : int
        Number of sweeps that agree.
    """
    best: tuple[float, Floats | None, list[tuple[Floats, Floats]]] = (0.0, None, [])
    for own, candidates in zip(T_camera_board, patches, strict=True):
        for patch in candidates:
            for pose in turned(patch.T_lidar_board, board):
                T = pose @ inverse(own)
                if np.linalg.norm(T[:3, 3]) > lever_arm:
                    continue
                pairs, worth = _votes(T, T_camera_board, patches, board)
                if worth > best[0]:
                    best = (worth, T, pairs)
    # Together they tell it better than one patch does, unless one of them is no board.
    while len(best[2]) >= 3:
        seen, swept = (np.stack(poses) for poses in zip(*best[2], strict=True))
        if normals_condition(seen[:, :3, 2]) <= _VARIED:
            break
        T = solve_linear(seen, swept)
        pairs, worth = _votes(T, T_camera_board, patches, board)
        if worth <= best[0]:
            break
        best = (worth, T, pairs)
    return best[1], len(best[2])


def _votes(
    T_lidar_camera: Floats,
    T_camera_board: Sequence[Floats],
    patches: Sequence[Sequence[Patch]],
    board: Board,
) -> tuple[list[tuple[Floats, Floats]], float]:
    """Boards that agree with an extrinsic, and how well, counted."""
    pairs, worth = [], 0.0
    for own, candidates in zip(T_camera_board, patches, strict=True):
        expected = T_lidar_camera @ own
        found = []
        for patch in candidates:
            pose = nearest_turn(patch.T_lidar_board, expected, board)
            if agrees(pose, expected):
                away = float(np.linalg.norm(pose[:3, 3] - expected[:3, 3]))
                found.append((patch.score * (1.0 - 0.5 * away / AGREE_PLACE), pose))
        if found:
            value, pose = max(found, key=lambda entry: entry[0])
            pairs.append((own, pose))
            worth += 1.0 + value
    return pairs, worth


_LEAST_NOISE = 0.005  # metres of a board's plane; few boards fit any scale


def solve_linear(T_camera_board: Floats, T_lidar_board: Floats) -> Floats:
    """``T_lidar_camera`` (4, 4) from the planes of boards, seen by both.

    The rotation R brings the normals n_c of the camera onto those of the LiDAR n_l (Eq. 1, by SVD).
    The translation u solves n_l . (R p_c + u) = d_l for the boards' middles p_c (Eq. 2).
    """
    n_c, n_l = T_camera_board[:, :3, 2], T_lidar_board[:, :3, 2]
    T = np.eye(4)
    T[:3, :3] = nearest_rotation(n_l.T @ n_c)
    d_l = np.einsum("ij,ij->i", n_l, T_lidar_board[:, :3, 3])
    p_c = T_camera_board[:, :3, 3] @ T[:3, :3].T
    T[:3, 3] = np.linalg.lstsq(n_l, d_l - np.einsum("ij,ij->i", n_l, p_c), rcond=None)[0]
    return T


def solve_scale(
    T_camera_board: Floats, T_lidar_board: Floats, T_lidar_camera: Floats
) -> tuple[float, float]:
    """How much larger boards are than told, 1 where the size is right, and its standard deviation.

    Equation 2 with one more unknown, n_l . (k R p_c + u) = d_l.
    """
    n_l = T_lidar_board[:, :3, 2]
    d_l = np.einsum("ij,ij->i", n_l, T_lidar_board[:, :3, 3])
    p_c = T_camera_board[:, :3, 3] @ T_lidar_camera[:3, :3].T
    A = np.column_stack([n_l, np.einsum("ij,ij->i", n_l, p_c)])
    solution = np.linalg.lstsq(A, d_l, rcond=None)[0]
    variance = float(np.mean((A @ solution - d_l) ** 2)) * len(A) / max(len(A) - 4, 1)
    noise = max(float(np.sqrt(variance)), _LEAST_NOISE)
    return float(solution[3]), noise * float(np.sqrt(np.linalg.pinv(A.T @ A)[3, 3]))


def normals_condition(normals: Floats) -> float:
    """How varied normals (n, 3) are: smallest by largest singular value, 0 for parallel boards."""
    singular = np.linalg.svd(normals, compute_uv=False)
    return float(singular[2] / singular[0]) if len(singular) == 3 else 0.0
