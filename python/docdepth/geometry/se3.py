"""Rigid transforms, SE(3): checks, inverses, rotations, quaternions, logarithm and exponential."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from docdepth.errors import InputError

_ORTHOGONAL = 1e-3  # of R R^T - I; poses printed with a few digits pass
_SERIES_ANGLE = 1e-6  # radians; below, the Jacobian's closed form loses digits and a series has all
_SMALL_ANGLE = 1e-8  # radians; below, the rotation's linear terms are exact
_NO_SINE = 1e-12  # of half an angle; below, the axis cannot be told and does not matter
_FARTHEST = 1e8
"""Of a pose from the origin [m]: beyond every coordinate of the Earth."""

_SHORTEST_QUATERNION = 1e-6


def check_rigid(poses: NDArray[np.float64]) -> None:
    """Refuse poses that are not rotations and translations, or lie beyond the Earth."""
    finite = np.isfinite(poses).all(axis=(1, 2))
    affine = (poses[:, 3] == (0, 0, 0, 1)).all(axis=1)
    bad = np.flatnonzero(~(finite & affine & are_rotations(poses[:, :3, :3])))
    if len(bad):
        raise InputError(
            f"the pose of frame {bad[0]} is not a rotation and a translation"
            f"{if_mirrored(poses[bad[0]])}; poses are 4x4 matrices T_world_lidar with finite "
            "entries"
        )
    far = np.flatnonzero((np.abs(poses[:, :3, 3]) >= _FARTHEST).any(axis=1))
    if len(far):
        away = 1e-3 * np.abs(poses[far[0], :3, 3]).max()
        raise InputError(
            f"the pose of frame {far[0]} lies {away:,.0f} km from the origin; poses are in metres"
        )


def if_mirrored(matrix: NDArray[np.float64]) -> str:
    """What an error adds of a matrix, shape (3 or 4, 3 or 4), that turns right hands into left."""
    mirrors = np.isfinite(matrix).all() and np.linalg.det(matrix[:3, :3]) < 0
    return ", but mirrors (determinant below 0): a frame is left-handed" if mirrors else ""


def are_rotations(matrices: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which 3x3 matrices, shape (n, 3, 3), are right-handed rotations, to a thousandth."""
    with np.errstate(invalid="ignore"):
        gram = matrices @ matrices.transpose(0, 2, 1)
        orthogonal = np.abs(gram - np.eye(3)).max(axis=(1, 2)) < _ORTHOGONAL
        right_handed = np.linalg.det(np.where(np.isfinite(matrices), matrices, 0)) > 0
    return np.asarray(orthogonal & right_handed)


def transform_points(
    T: NDArray[np.float64], points: NDArray[np.floating[Any]]
) -> NDArray[np.float64]:
    """Points (..., 3) of frame b in frame a, by ``T_a_b`` (4, 4)."""
    moved: NDArray[np.float64] = points @ T[:3, :3].T + T[:3, 3]
    return moved


def inverse(pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """Inverse of rigid poses, shape (..., 4, 4)."""
    result = np.zeros_like(pose)
    rotation = np.swapaxes(pose[..., :3, :3], -1, -2)
    result[..., :3, :3] = rotation
    result[..., :3, 3] = -(rotation @ pose[..., :3, 3, None])[..., 0]
    result[..., 3, 3] = 1.0
    return result


def rotation_log(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotation vector (axis times angle in radians, shape (3,)) of a 3x3 rotation."""
    x, y, z, w = matrix_to_quaternion(rotation)
    vector, sine = np.array([x, y, z]), float(np.sqrt(x * x + y * y + z * z))
    if sine < _NO_SINE:
        return np.asarray(2.0 * vector)
    return np.asarray(vector * (2.0 * np.arctan2(sine, w) / sine))


def rotation_exp(vector: ArrayLike) -> NDArray[np.float64]:
    """3x3 rotations of rotation vectors, shape (..., 3) to (..., 3, 3)."""
    vector = np.asarray(vector, dtype=np.float64)
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    x, y, z = vector[..., 0], vector[..., 1], vector[..., 2]
    zero = np.zeros_like(x)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1)
    cross = cross.reshape((*vector.shape[:-1], 3, 3))
    small = angle < _SMALL_ANGLE
    safe = np.where(small, 1.0, angle)
    first = np.where(small, 1.0, np.sin(safe) / safe)
    second = np.where(small, 0.5, (1.0 - np.cos(safe)) / safe**2)
    return np.asarray(np.eye(3) + first * cross + second * (cross @ cross))


def matrix_to_quaternion(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit quaternion (x, y, z, w), w >= 0, of a 3x3 rotation."""
    m = rotation
    # The symmetric matrix whose largest eigenvector is the quaternion (Bar-Itzhack 2000): no
    # special cases, exact for slightly non-orthogonal input too.
    k = np.array(
        [
            [m[0, 0] - m[1, 1] - m[2, 2], 0, 0, 0],
            [m[0, 1] + m[1, 0], m[1, 1] - m[0, 0] - m[2, 2], 0, 0],
            [m[0, 2] + m[2, 0], m[1, 2] + m[2, 1], m[2, 2] - m[0, 0] - m[1, 1], 0],
            [m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1], np.trace(m)],
        ]
    )
    quaternion: NDArray[np.float64] = np.linalg.eigh(k / 3.0)[1][:, 3]
    return -quaternion if quaternion[3] < 0 else quaternion


def quaternion_to_matrix(quaternion: ArrayLike) -> NDArray[np.float64]:
    """3x3 rotation of a quaternion (x, y, z, w) of any length but zero."""
    q = np.asarray(quaternion, dtype=np.float64)
    norm = float(np.linalg.norm(q))
    if not np.isfinite(norm) or norm < _SHORTEST_QUATERNION:
        raise InputError(f"{q.tolist()} is not a quaternion x y z w; its length is {norm}")
    x, y, z, w = q / norm
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def poses_from(
    rotations: Sequence[NDArray[np.float64]], positions: ArrayLike
) -> NDArray[np.float64]:
    """Stack 3x3 rotations and positions (n, 3) into poses (n, 4, 4)."""
    positions = np.asarray(positions, dtype=np.float64)
    poses = np.repeat(np.eye(4)[None], len(positions), axis=0)
    poses[:, :3, :3] = np.asarray(rotations)
    poses[:, :3, 3] = positions
    return poses


def rigid(rotation: ArrayLike, position: ArrayLike = (0.0, 0.0, 0.0)) -> NDArray[np.float64]:
    """A rotation (3, 3) and a translation (3,) as one transform (4, 4)."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation, position
    return T


def nearest_rotation(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """The rotations nearest to matrices (..., 3, 3), in the Frobenius norm (Kabsch)."""
    u, _, vt = np.linalg.svd(matrix)
    signs = np.ones((*u.shape[:-2], 1, 3))
    signs[..., 0, 2] = np.sign(np.linalg.det(u @ vt))
    return np.asarray((u * signs) @ vt)


def nearest_rigid(pose: ArrayLike) -> NDArray[np.float64]:
    """The same poses (..., 4, 4) with the nearest rotations; rounding errors do not add up so."""
    pose = np.array(pose, dtype=np.float64)
    pose[..., :3, :3] = nearest_rotation(pose[..., :3, :3])
    return pose


def se3_log(motion: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Logarithm of a rigid motion (4, 4).

    Returns
    -------
    omega, velocity : ndarray of float64, shape (3,)
        The twist: rotation vector in radians and velocity in metres that, held for one unit of
        time, make the motion.
    """
    motion = np.asarray(motion, dtype=np.float64)
    omega = rotation_log(motion[:3, :3])
    return omega, np.linalg.solve(_left_jacobian(omega), motion[:3, 3])


def se3_exp(omega: NDArray[np.float64], velocity: NDArray[np.float64]) -> NDArray[np.float64]:
    """Exponential of a twist: the rigid motion (4, 4) that :func:`se3_log` takes apart."""
    result = np.eye(4)
    result[:3, :3] = rotation_exp(omega)
    result[:3, 3] = _left_jacobian(omega) @ velocity
    return result


def power(motion: NDArray[np.float64], share: float) -> NDArray[np.float64]:
    """The motion (4, 4) in a share of its time."""
    omega, velocity = se3_log(motion)
    return se3_exp(share * omega, share * velocity)


def skew(v: NDArray[np.float64]) -> NDArray[np.float64]:
    """The matrix [v]x (3, 3) whose product with a vector is the cross product of v with it."""
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def _left_jacobian(omega: NDArray[np.float64]) -> NDArray[np.float64]:
    """The left Jacobian of SO(3) at a rotation vector."""
    angle = float(np.linalg.norm(omega))
    A = skew(omega)
    if angle < _SERIES_ANGLE:
        return np.asarray(np.eye(3) + 0.5 * A + A @ A / 6.0)
    first = (1.0 - np.cos(angle)) / angle**2
    second = (angle - np.sin(angle)) / angle**3
    return np.asarray(np.eye(3) + first * A + second * (A @ A))
