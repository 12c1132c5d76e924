"""Camera to LiDAR from planes alone: the paper's Equations 1 and 2, the start of the bundle."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from docdepth.geometry.se3 import nearest_rotation

Floats = NDArray[np.float64]

_LEAST_NOISE = 0.005  # metres of a board's plane; few boards fit any scale


def solve_linear(T_camera_board: Floats, T_lidar_board: Floats) -> Floats:
    """``T_lidar_camera`` (4, 4) from the planes of boards, seen by both.

    The rotation R brings the normals n_c of the camera onto those of the LiDAR n_l (Eq. 1, by SVD).
    The translation u solves n_l . (R p_c + u) = d_l for the boards' middles p_c (Eq. 2).

    Parameters
    ----------
    T_camera_board, T_lidar_board : ndarray of float64, shape (n, 4, 4)
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
