"""Points followed from image to image, their depth, and where motion of the LiDAR takes them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from docdepth.evaluation.pixels import project
from docdepth.geometry.camera import Camera
from docdepth.geometry.se3 import inverse, rigid, rotation_exp, rotation_log, transform_points
from docdepth.geometry.trajectory import Trajectory

Floats = NDArray[np.float64]

_POINTS = 400  # of an image
_APART = 8  # pixels
_QUALITY = 0.01  # of a corner, of that of the best one
_BACK = 0.3  # pixels that a point misses when it is followed back
_AROUND = 7  # pixels within which depth must be smooth
_EVERY = 2  # pixels of the depth map, in rows and columns, that are taken
_STEP = 0.15  # share of the depth by which it may change there
_DEPTHS = (2.0, 60.0)  # metres
_SMOOTH = 0.12  # seconds; poses of sweeps jitter, a vehicle does not
_NEAREST = 0.3  # metres ahead of the camera


@dataclass(frozen=True)
class Window:
    """Points followed from one image to a later one."""

    # start, end: stamps of both images [ns]
    start: int
    end: int
    # first, last: (n, 2): where the points are in both, pixels
    first: Floats
    last: Floats
    # (h, w): depth map of the first image, seen from where the camera was by its stamp
    depth: NDArray[np.float32]

    def points(self, camera: Camera, motion: Floats) -> tuple[Floats, Floats]:
        """Points with smooth depth, (n, 3), and where they are seen last, (n, 2).

        ``motion`` takes points from the camera of the depth map to that of the first image.
        """
        h, w = self.depth.shape
        v, u = _EVERY * np.array(np.nonzero(np.isfinite(self.depth[::_EVERY, ::_EVERY])))
        rays = np.column_stack([u, v, np.ones(len(u))]) @ np.linalg.inv(camera.K).T
        cloud = (rays * self.depth[v, u, None]).astype(np.float32)
        depth, _ = project(camera, motion, cloud)
        kernel, known = np.ones((_AROUND, _AROUND), np.uint8), np.isfinite(depth)
        far = cv2.dilate(np.where(known, depth, -np.inf).astype(np.float32), kernel)
        near = cv2.erode(np.where(known, depth, np.inf).astype(np.float32), kernel)
        u, v = np.clip(np.rint(self.first).astype(int), 0, (w - 1, h - 1)).T
        far, near = far[v, u].astype(np.float64), near[v, u].astype(np.float64)
        good = (near > _DEPTHS[0]) & (near < _DEPTHS[1]) & (far - near < _STEP * near)
        middle = (near[good] + far[good]) / 2
        rays = np.column_stack([self.first, np.ones(len(self.first))]) @ np.linalg.inv(camera.K).T
        return rays[good] * middle[:, None], self.last[good]


def follow(images: Sequence[NDArray[np.uint8]], wanted: NDArray[np.bool_]) -> tuple[Floats, Floats]:
    """Follow corners from the first grey image to the last, and from image to image back.

    Returns
    -------
    first, last : ndarray of float64, shape (n, 2)
        Pixels in the first and in the last image.
    """
    mask = wanted.astype(np.uint8) * 255
    found = cv2.goodFeaturesToTrack(images[0], _POINTS, _QUALITY, _APART, mask=mask)
    if found is None:
        return np.zeros((0, 2)), np.zeros((0, 2))
    places, kept = found, np.ones(len(found), np.bool_)
    for one, next_one in pairwise(images):
        moved, there, _ = cv2.calcOpticalFlowPyrLK(one, next_one, places, None)
        back, again, _ = cv2.calcOpticalFlowPyrLK(next_one, one, moved, None)
        kept &= (there[:, 0] == 1) & (again[:, 0] == 1)
        kept &= np.linalg.norm(back - places, axis=2)[:, 0] < _BACK
        places = moved
    return found[kept, 0].astype(np.float64), places[kept, 0].astype(np.float64)


def predicted(points: Floats, motion: Floats, camera: Camera) -> Floats:
    """Pixels (n, 2) of points after a motion of the camera."""
    moved = transform_points(motion, points)
    depth = np.maximum(moved[:, 2:], _NEAREST)
    result: Floats = (moved @ camera.K.T)[:, :2] / depth
    return result


def smooth_pose(trajectory: Trajectory, time: int) -> Floats:
    """``T_world_lidar`` (4, 4) at a time [ns], of a smooth curve through the poses around it.

    Between two poses that jitter, an interpolated one jitters less than either, so that offsets of
    half a sweep would seem to fit best.
    """
    seconds = (trajectory.times - np.int64(time)) * 1e-9
    near = np.flatnonzero(np.abs(seconds) < 3 * _SMOOTH)
    nearest = trajectory.poses[int(np.argmin(np.abs(seconds)))]
    if len(near) < 3:
        result: Floats = trajectory.interpolate(time)[0]
        return result
    local = inverse(nearest) @ trajectory.poses[near]
    motion = np.column_stack([[rotation_log(R) for R in local[:, :3, :3]], local[:, :3, 3]])
    s = seconds[near]
    weight = np.exp(-0.5 * (s / _SMOOTH) ** 2)[:, None]
    basis = np.column_stack([np.ones(len(s)), s, s * s])
    at = np.linalg.lstsq(basis * weight, motion * weight, rcond=None)[0][0]
    pose = rigid(rotation_exp(at[:3]), at[3:])
    return nearest @ pose
