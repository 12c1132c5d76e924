"""Edges of depth maps, and what images show across them.

Across each depth edge the image is sampled, from the near side to the far one. Where the
calibration is right, the image changes most in the middle of these samples.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from docdepth.geometry.camera import Camera, View
from docdepth.geometry.points import evenly
from docdepth.geometry.track import Tracks
from docdepth.io.tracks import box_in_image

Floats = NDArray[np.float64]

STEP_DEG = 0.08  # between samples; finer pixels tell no more
REACH = 32  # samples to either side
_NOISE = 0.03  # change of brightness from pixel to pixel; brightness is a square root, 0 to 16

# Where depth maps jump from one surface to another farther away.
_JUMP = (0.5, 0.15)  # metres, and share of the depth, that the farther surface lies behind
_DEPTHS = (3.0, 50.0)  # metres; nearer is the vehicle, farther returns are too sparse
_CREST = 2.0
"""Tangent of the angle at which an upper or lower edge is a crest seen at a grazing angle [-]. Its
last beam lies below it, along a bank of grass in all images alike: once it seemed to be 0.6 degrees
of calibration."""
_SMOOTH = 2.0  # pixels over which the direction of an edge is found
_STEEP = 0.7  # part of the direction along rows or columns of the pair of pixels
_LONG = 15  # pixels that an edge goes on
_BESIDE = 5  # pixels around a moving object
_MOST_EDGES = 2000  # of an image that are used


@dataclass(frozen=True)
class Edges:
    """Depth edges in an image."""

    pixels: Floats  # (n, 2): u and v; integers are pixel centres
    across: Floats  # (n, 2): unit vector in the image from the near side to the far one
    depth: Floats  # (n,): of the near side, metres along the optical axis

    def __len__(self) -> int:
        return len(self.depth)

    def rows(self, chosen: NDArray[np.bool_] | NDArray[np.int64]) -> Edges:
        return Edges(self.pixels[chosen], self.across[chosen], self.depth[chosen])


def edges_of_map(
    depth: NDArray[np.float32], moving: NDArray[np.bool_] | None = None, focal: float = 700.0
) -> Edges:
    """Depth edges between neighbouring pixels, at most 2000 evenly chosen.

    Both sides are three pixels wide at least, and an edge goes on for fifteen: a mesh fence, or
    leaves, are full of edges that no image shows. Crests seen at a grazing angle do not count.

    Parameters
    ----------
    depth : ndarray of float32, shape (h, w)
        Metres; NaN = none. The edge of what has depth is no depth edge.
    moving : ndarray of bool, shape (h, w), optional
        Pixels that do not count.
    focal : float
        Of the camera [px].
    """
    known = np.isfinite(depth)
    share = cv2.GaussianBlur(known.astype(np.float32), (0, 0), _SMOOTH)
    logarithm = np.where(known, np.log(np.where(known, depth, 1.0)), 0.0).astype(np.float32)
    smooth = cv2.GaussianBlur(logarithm, (0, 0), _SMOOTH) / np.maximum(share, 1e-3)
    slope = np.stack([cv2.Sobel(smooth, cv2.CV_32F, 1 - k, k) for k in (0, 1)], axis=-1)
    slope /= np.maximum(np.linalg.norm(slope, axis=-1, keepdims=True), 1e-6)
    free = known if moving is None else known & ~moving
    places, mask = [], np.zeros(depth.shape, np.uint8)
    for axis in (0, 1):  # pairs along rows, then along columns
        if axis == 0:
            v, u = _first_of_pairs(depth, free, slope[..., 0])
        else:
            u, v = _first_of_pairs(depth.T, free.T, slope[..., 1].T, _CREST / focal)
        places.append(np.stack([u, v, np.full(len(u), axis)], axis=1))
        mask[v, u] = 1
    _, part, boxes, _ = cv2.connectedComponentsWithStats(cv2.dilate(mask, np.ones((3, 3))))
    u, v, axis_of = np.concatenate(places).T
    box = boxes[part[v, u]]
    long = np.maximum(box[:, cv2.CC_STAT_WIDTH], box[:, cv2.CC_STAT_HEIGHT]) >= _LONG + 2
    u, v, axis_of = u[long], v[long], axis_of[long]
    every = evenly(len(u), _MOST_EDGES)
    u, v, axis_of = u[every], v[every], axis_of[every]
    side = np.eye(2, dtype=np.int64)[axis_of]
    near = np.fmin(depth[v, u], depth[v + side[:, 1], u + side[:, 0]])
    return Edges(
        np.stack([u, v], axis=1) + 0.5 * side,
        slope[v, u].astype(np.float64),
        near.astype(np.float64),
    )


def _first_of_pairs(
    depth: NDArray[np.float32],
    free: NDArray[np.bool_],
    slope: NDArray[np.float32],
    most_growth: float = np.inf,
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows and columns of pixels with a depth edge to the next one in their row."""
    three = np.ones((1, 3), np.uint8)
    high = cv2.dilate(np.where(np.isfinite(depth), depth, np.inf), three)
    low = cv2.erode(np.where(np.isfinite(depth), depth, 0), three)
    one, other = depth[:, 1:-2], depth[:, 2:-1]
    near, far = np.fmin(one, other), np.fmax(one, other)
    edge = free[:, 1:-2] & np.isfinite(other) & (near > _DEPTHS[0]) & (near < _DEPTHS[1])
    edge &= far - near > np.maximum(_JUMP[0], _JUMP[1] * near)
    middle, rises = np.sqrt(near * far), other > one
    before, after = np.s_[:, :-3], np.s_[:, 3:]
    edge &= np.where(rises, high[before] < middle, low[before] > middle)
    edge &= np.where(rises, low[after] > middle, high[after] < middle)
    growth = (high - low) / 2
    edge &= np.where(rises, growth[before], growth[after]) < most_growth * near
    edge &= slope[:, 1:-2] * np.where(rises, 1, -1) > _STEEP
    v, u = np.nonzero(edge)
    return v, u + 1


def pixels_of_tracks(tracks: Tracks, view: View) -> NDArray[np.bool_]:
    """Pixels in or beside the boxes of moving objects, (h, w)."""
    camera, T_camera_world, time = view
    mask = np.zeros((camera.height, camera.width), np.bool_)
    for track in tracks.between(time, time):
        box = box_in_image(track, T_camera_world @ track.pose_at(time), camera)
        if box is not None:
            (left, top), (right, bottom) = np.floor(box).astype(int) + [[-_BESIDE], [1 + _BESIDE]]
            mask[max(top, 0) : max(bottom, 0), max(left, 0) : max(right, 0)] = True
    return mask


def profiles(edges: Edges, image: NDArray[np.uint8], camera: Camera) -> NDArray[np.float32]:
    """Change of brightness along lines across depth edges, over that of the whole line.

    Parameters
    ----------
    image : ndarray of uint8, shape (h, w, 3)
        BGR, rectified.

    Returns
    -------
    ndarray of float32, shape (n, 2 * 32 + 1)
        From the near side to the far one.
    """
    if not len(edges):  # OpenCV takes no empty map
        return np.zeros((0, 2 * REACH + 1), np.float32)
    step = pixels_a_sample(camera)
    bright = np.sqrt(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY).astype(np.float32))
    bright = cv2.GaussianBlur(bright, (0, 0), step)
    along = np.arange(-REACH, REACH + 1) * step
    lines = edges.pixels[:, None] + edges.across[:, None] * along[:, None]
    u, v = np.moveaxis(lines.astype(np.float32), -1, 0)
    changes = np.zeros(u.shape, np.float32)
    for axis in (0, 1):
        slope = cv2.Sobel(bright, cv2.CV_32F, 1 - axis, axis) / 8
        found = cv2.remap(slope, u, v, cv2.INTER_LINEAR, borderValue=0)
        changes += found * edges.across[:, axis, None].astype(np.float32)
    changes = np.abs(changes)
    result: NDArray[np.float32] = changes / (changes.mean(axis=1, keepdims=True) + _NOISE)
    return result


def pixels_a_sample(camera: Camera) -> float:
    """Pixels from sample to sample."""
    return max(1.0, float(np.radians(STEP_DEG) * camera.K[0, 0]))
