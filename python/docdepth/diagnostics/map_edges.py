"""Where depth maps jump from one surface to another farther away."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from docdepth.diagnostics.edge_fit import Edges
from docdepth.geometry.camera import Camera
from docdepth.geometry.track import Tracks
from docdepth.io.tracks import box_in_image

_JUMP = (0.5, 0.15)  # metres, and share of the depth, that the farther surface lies behind
_DEPTHS = (3.0, 50.0)  # metres; nearer is the vehicle, farther returns are too sparse
_SMOOTH = 2.0  # pixels over which the direction of an edge is found
_STEEP = 0.7  # part of the direction along rows or columns of the pair of pixels
_BESIDE = 5  # pixels around a moving object
_MOST_EDGES = 2000  # of an image that are used


def edges_of_map(depth: NDArray[np.float32], moving: NDArray[np.bool_] | None = None) -> Edges:
    """Depth edges between neighbouring pixels, at most 2000 evenly chosen.

    Parameters
    ----------
    depth : ndarray of float32, shape (h, w)
        Metres; NaN = none. The edge of what has depth is no depth edge.
    moving : ndarray of bool, shape (h, w), optional
        Pixels that do not count.
    """
    known = np.isfinite(depth)
    share = cv2.GaussianBlur(known.astype(np.float32), (0, 0), _SMOOTH)
    logarithm = np.where(known, np.log(np.where(known, depth, 1.0)), 0.0).astype(np.float32)
    smooth = cv2.GaussianBlur(logarithm, (0, 0), _SMOOTH) / np.maximum(share, 1e-3)
    slope = np.stack([cv2.Sobel(smooth, cv2.CV_32F, 1 - k, k) for k in (0, 1)], axis=-1)
    slope /= np.maximum(np.linalg.norm(slope, axis=-1, keepdims=True), 1e-6)
    found = []
    for axis in (0, 1):
        # Pairs along rows, then along columns.
        first = np.s_[:, :-1] if axis == 0 else np.s_[:-1, :]
        second = np.s_[:, 1:] if axis == 0 else np.s_[1:, :]
        one, other, across = depth[first], depth[second], slope[first]
        near, far = np.fmin(one, other), np.fmax(one, other)
        jump = np.isfinite(one + other) & (near > _DEPTHS[0]) & (near < _DEPTHS[1])
        jump &= far - near > np.maximum(_JUMP[0], _JUMP[1] * near)
        if moving is not None:
            jump &= ~moving[first]
        jump &= across[..., axis] * np.where(other > one, 1, -1) > _STEEP
        v, u = np.nonzero(jump)
        place = np.stack([u, v], axis=1) + 0.5 * np.eye(2)[axis]
        found.append((place, across[v, u].astype(np.float64), near[v, u].astype(np.float64)))
    pixels, across, near = (np.concatenate(parts) for parts in zip(*found, strict=True))
    every = np.unique(np.linspace(0, len(near) - 1, min(len(near), _MOST_EDGES)).astype(np.int64))
    return Edges(pixels, across, near).rows(every)


def pixels_of_tracks(
    tracks: Tracks, time: int, T_camera_world: NDArray[np.float64], camera: Camera
) -> NDArray[np.bool_]:
    """Pixels in or beside the boxes of moving objects, (h, w)."""
    mask = np.zeros((camera.height, camera.width), np.bool_)
    for track in tracks.between(time, time):
        box = box_in_image(track.size, T_camera_world @ track.pose_at(time), camera)
        if box is not None:
            (left, top), (right, bottom) = np.floor(box).astype(int) + [[-_BESIDE], [1 + _BESIDE]]
            mask[max(top, 0) : max(bottom, 0), max(left, 0) : max(right, 0)] = True
    return mask
