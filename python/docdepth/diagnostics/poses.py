"""Poses against the motion that the sweeps show: what wrong poses are instead."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from docdepth.errors import Finding
from docdepth.geometry.ground_plane import GroundPlane
from docdepth.geometry.se3 import (
    inverse,
    matrix_to_quaternion,
    quaternion_to_matrix,
    rigid,
    rotation_exp,
    rotation_log,
    transform_points,
)

Poses = NDArray[np.float64]

_LEVER = 10.0  # metres from the LiDAR at which a turn counts as a shift
_FIT = (0.3, 0.05)  # metres, and share of the motion, by which right poses may differ
_CLEARLY = 0.35  # of the misfit of the poses as they are
_BETTER = 0.7  # of the misfit of an explanation before it in the list, which is commoner
_LEAST_MOTION = 1.0  # metres in a window; less tells nothing
_SCALES = (0.8, 1.25)
_UNITS = {1000.0: "millimetres", 100.0: "centimetres", 0.001: "kilometres", 0.3048: "feet"}
# Axes of a camera (x right, y down, z ahead) as seen by a LiDAR (x ahead, y left, z up).
_OPTICAL = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
_SAME_TURN = 1e-6  # entries of rotations that differ less are the same
_CURVE_DEG = 20.0  # by which a path turns that needs turning poses

# How well two sweeps lie on each other.
_REACH = (3.0, 40.0)  # metres from the LiDAR
_ABOVE_GROUND = 0.4  # metres; the ground lies on itself by any poses of a vehicle
_VOXEL = 0.3  # metres, in which one point is kept
_ON = 0.3  # metres between points that lie on each other


class Window(NamedTuple):
    """Poses of a few sweeps that follow each other, and those that registration finds."""

    first: int  # frame of the first
    # given, measured: (n, 4, 4): ``T_world_lidar``; the two worlds may differ
    given: Poses
    measured: Poses
    better: bool = True  # the sweeps lie on each other better by ``measured`` than by ``given``

    @property
    def step(self) -> float:
        """Metres from sweep to sweep on average, by registration."""
        return float(np.linalg.norm(self.measured[-1, :3, 3]) / (len(self.measured) - 1))


def pose_figures(poses: Poses, times: NDArray[np.int64]) -> dict[str, object]:
    """Length, speeds, turns of a trajectory, ready for JSON."""
    steps = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    speed = steps / (np.diff(times) * 1e-9) if len(poses) > 1 else np.zeros(1)
    turns = [
        np.degrees(np.linalg.norm(rotation_log(a[:3, :3].T @ b[:3, :3])))
        for a, b in pairwise(poses)
    ]
    return {
        "length_m": round(float(steps.sum()), 2),
        "extent_m": np.ptp(poses[:, :3, 3], axis=0).round(2).tolist(),
        "speed_m_s": np.quantile(speed, [0.5, 1]).round(2).tolist(),
        "largest_turn_deg": round(float(max(turns, default=0.0)), 2),
    }


def windows_of(poses: Poses | None, count: int, length: int) -> list[range]:
    """Frames to register: where the drive turns most, and where it is fastest.

    Without poses, those in the middle and at a quarter.
    """
    length = min(length, count)
    starts = [count // 2, count // 4]
    if poses is not None and count > length:
        motions = inverse(poses[: -length + 1]) @ poses[length - 1 :]
        moved = np.linalg.norm(motions[:, :3, 3], axis=1)
        turned = np.array([np.linalg.norm(rotation_log(T[:3, :3])) for T in motions])
        starts = [int(np.argmax(np.minimum(turned, 0.5) * (moved > _LEAST_MOTION)))]
        starts.append(int(np.argsort(moved)[3 * len(moved) // 4]))
    starts = [max(0, min(start, count - length)) for start in starts]
    return [range(start, start + length) for start in dict.fromkeys(starts)]


def misfit(given: Poses, measured: Poses) -> float:
    """Distance by which the motion from the first to the last pose differs, metres.

    The distance is that of a point ten metres away, so that it has the turn in it.
    """
    apart = inverse(_motion(measured)) @ _motion(given)
    return _length(apart)


def explain_misfit(
    windows: Sequence[Window], cameras: dict[str, Poses] | None = None
) -> Finding | None:
    """What the poses are instead, where they do not fit the sweeps and something else does.

    Parameters
    ----------
    cameras : dict of ndarray of float64, shape (4, 4), optional
        ``T_camera_lidar`` of each camera.

    Returns
    -------
    Finding or None
        None where the poses fit, and where nothing explains them.
    """
    moving = [w for w in windows if w.better and _size(w.measured) > _LEAST_MOTION]
    if not moving or all(_fits(w.given, w.measured) for w in moving):
        return None
    before = sum(misfit(w.given, w.measured) for w in moving)
    best, explained = before, None
    for candidate, change in _changes(cameras or {}, moving).items():
        changed = [change(w.given) for w in moving]
        after = sum(misfit(p, w.measured) for p, w in zip(changed, moving, strict=True))
        fits = all(_fits(p, w.measured) for p, w in zip(changed, moving, strict=True))
        if fits and after < (_CLEARLY * before if explained is None else _BETTER * best):
            best, explained = after, candidate
    if explained is None:
        return None
    text = (
        f"{explained.text} (so read, they differ from the motion of {len(moving[0].given)} sweeps "
        f"by {best / len(moving):.2f} m, now by {before / len(moving):.2f} m)"
    )
    return replace(explained, text=text)


def rotations_are_missing(poses: Poses) -> bool:
    """Whether all rotations are the same along a path that turns."""
    if len(poses) < 3 or np.ptp(poses[:, :3, :3], axis=0).max() > _SAME_TURN:
        return False
    steps = np.diff(poses[:, :3, 3], axis=0)
    steps = steps[np.linalg.norm(steps, axis=1) > 0.05]
    if len(steps) < 2:
        return False
    ahead = steps / np.linalg.norm(steps, axis=1, keepdims=True)
    return bool((ahead @ ahead[0]).min() < np.cos(np.radians(_CURVE_DEG)))


def _motion(poses: Poses) -> Poses:
    return inverse(poses[0]) @ poses[-1]


def _length(motion: Poses) -> float:
    """Of a motion with its turn, metres."""
    turn = float(np.linalg.norm(rotation_log(motion[:3, :3])))
    return float(np.linalg.norm(motion[:3, 3])) + _LEVER * turn


def _size(poses: Poses) -> float:
    return float(np.linalg.norm(_motion(poses)[:3, 3]))


def _fits(given: Poses, measured: Poses) -> bool:
    return misfit(given, measured) < _FIT[0] + _FIT[1] * _length(_motion(measured))


def _changes(
    cameras: dict[str, Poses], windows: Sequence[Window]
) -> dict[Finding, Callable[[Poses], Poses]]:
    """What poses may be instead, and what makes right ones of them."""
    changes: dict[Finding, Callable[[Poses], Poses]] = {
        Finding("inverse-poses", "", "the poses are T_lidar_world", "give their inverses"): inverse,
        Finding(
            "quaternion-order", "", "the poses have quaternions in the order w x y z",
            "write x y z w",
        ): _reordered,
    }  # fmt: skip
    for name, T in cameras.items():
        text = f"the poses are of the camera {name}, not of the LiDAR"
        remedy = f"say `poses={name + ':FILE'!r}`, or let docdepth estimate them"
        changes[Finding("poses-of-camera", "", text, remedy)] = partial(_turned, T=T)
    text = "the poses are of a camera's frame (x right, y down, z ahead)"
    remedy = "calibrate the camera and say `poses='CAMERA:FILE'`"
    changes[Finding("poses-of-camera", "", text, remedy)] = partial(_turned, T=_OPTICAL)
    for axis, name in enumerate("xyz"):
        S = np.eye(4)
        S[axis, axis] = -1
        text = "poses and points are mirror images of each other (wrong handedness)"
        remedy = f"change the sign of {name} of the points or of the poses"
        changes[Finding("handedness", "", text, remedy)] = partial(_mirrored, mirror=S)
    for angle in (90, -180, -90):
        T = rigid(rotation_exp(np.radians([0.0, 0, angle])))
        text = (
            f"the poses are of a frame that is turned by {-angle} degrees about z against that of "
            "the points"
        )
        remedy = "multiply them from the right by T_frame_lidar"
        changes[Finding("turned-frame", "", text, remedy)] = partial(_turned, T=T)
    scale = _scale(windows)
    if scale is not None:
        unit = next((u for s, u in _UNITS.items() if 0.8 < scale / s < 1.25), "another unit")
        text = f"positions of the poses are in {unit}, 1 m of the sweeps is {scale:.3g}"
        changes[Finding("unit-of-poses", "", text, "give metres")] = partial(
            _scaled, factor=1 / scale
        )
    return changes


def _turned(poses: Poses, T: Poses) -> Poses:
    """Poses of another frame of the vehicle."""
    result: Poses = poses @ T
    return result


def _mirrored(poses: Poses, mirror: Poses) -> Poses:
    result: Poses = mirror @ poses @ mirror
    return result


def _reordered(poses: Poses) -> Poses:
    """Poses whose quaternions were read as x y z w, and are w x y z."""
    result = poses.copy()
    for pose in result:
        x, y, z, w = matrix_to_quaternion(pose[:3, :3])
        pose[:3, :3] = quaternion_to_matrix([y, z, w, x])
    return result


def _scale(windows: Sequence[Window]) -> float | None:
    """How much longer the paths of the poses are than those of the sweeps."""
    scale = sum(_size(w.given) for w in windows) / sum(_size(w.measured) for w in windows)
    return None if _SCALES[0] < scale < _SCALES[1] or scale == 0 else float(scale)


def _scaled(poses: Poses, factor: float) -> Poses:
    result = poses.copy()
    result[:, :3, 3] *= factor
    return result


def share_on(
    first: NDArray[np.float32],
    second: NDArray[np.float32],
    motion: NDArray[np.float64],
    ground: GroundPlane | None = None,
) -> float:
    """Share of the points of a sweep that lie on those of an earlier one.

    Parameters
    ----------
    first, second : ndarray of float32, shape (N, 3)
        As measured, metres.
    motion : ndarray of float64, shape (4, 4)
        Takes points of the second to the frame of the first.
    ground : GroundPlane, optional
        Its points are left out.
    """
    import small_gicp

    target, source = (_sampled(points, ground) for points in (first, second))
    if not len(target) or not len(source):
        return 0.0
    moved = transform_points(motion, source)
    _, squared = small_gicp.KdTree(target).batch_nearest_neighbor_search(moved)
    return float(np.mean(np.asarray(squared) < _ON**2))


def _sampled(points: NDArray[np.float32], ground: GroundPlane | None) -> NDArray[np.float64]:
    import small_gicp

    with np.errstate(invalid="ignore", over="ignore"):
        distance = np.linalg.norm(points, axis=1)
        kept = (distance > _REACH[0]) & (distance < _REACH[1])
        if ground is not None:
            kept &= points @ ground.up + ground.height > _ABOVE_GROUND
    if not kept.any():
        return np.zeros((0, 3))
    cloud = small_gicp.voxelgrid_sampling(points[kept].astype(np.float64), _VOXEL, num_threads=1)
    return np.asarray(cloud.points()[:, :3], np.float64)
