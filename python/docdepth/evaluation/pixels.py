"""Operations on depth maps: projection, hole filling, depth edges, points, neighbours."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

import docdepth._core as _core
from docdepth.geometry.camera import Camera, pixels_in_image
from docdepth.geometry.se3 import transform_points

Depth = NDArray[np.float32]
Mask = NDArray[np.bool_]
Points = NDArray[np.float64]

# Inverse depth is linear on every plane: a pixel is an edge if the second difference exceeds this
# share of its inverse depth.
_EDGE_BEND = 0.05
# Interior pixels are farther than this from an edge [pixels].
EDGE_MARGIN = 3.0


def project(
    camera: Camera, T_camera_lidar: NDArray[np.float64], points: NDArray[np.float32]
) -> tuple[Depth, NDArray[np.int64]]:
    """Project points into a camera; the nearest point wins each pixel.

    Parameters
    ----------
    T_camera_lidar : ndarray of float64, shape (4, 4)
    points : ndarray of float32, shape (N, 3)
        LiDAR frame [m]; rows that are not finite are ignored.

    Returns
    -------
    depth : ndarray of float32, shape (h, w)
        Depth along the optical axis [m]; NaN = no point.
    row : ndarray of int64, shape (h, w)
        Index of the point; -1 = none.
    """
    moved = transform_points(T_camera_lidar, points.astype(np.float64))
    rows, u, v = pixels_in_image(moved, camera)
    order = np.argsort(-moved[rows, 2], kind="stable")  # the nearest is written last
    row = np.full((camera.height, camera.width), -1)
    row[v[order], u[order]] = rows[order]
    return np.where(row < 0, np.nan, moved[row, 2]).astype(np.float32), row


def fill_background(depth: Depth) -> Depth:
    """Fill empty pixels as KITTI's development kit does (``interpolateBackground``).

    A gap in a row takes the smaller depth of its two ends. Then the outermost depths of each row,
    and of each column, are extended to the border of the image. An empty row between others stays
    empty.

    Parameters
    ----------
    depth : ndarray of float32, shape (h, w)
        Metres; NaN = none.
    """
    rows = np.fmin(_carried(depth), _carried(depth[:, ::-1])[:, ::-1])
    before, after = _carried(rows.T), _carried(rows.T[:, ::-1])[:, ::-1]
    outside = np.isnan(before) | np.isnan(after)
    return np.ascontiguousarray(np.where(outside, np.fmin(before, after), rows.T).T)


def _carried(lines: Depth) -> Depth:
    """Lines with the last value before each empty pixel; NaN where there is none."""
    last = np.where(np.isnan(lines), 0, np.arange(lines.shape[1]))
    return np.take_along_axis(lines, np.maximum.accumulate(last, axis=1), axis=1)


def depth_edges(depth: Depth) -> Mask:
    """Depth edges of an exact, dense depth map.

    Inverse depth is a linear function of the pixel on every plane. A pixel is an edge if the second
    difference of inverse depth, along its row or its column, exceeds 5 % of its inverse depth.
    Pixels without depth count as infinitely far.

    Parameters
    ----------
    depth : ndarray of float32, shape (h, w)
        Metres; NaN = no surface.

    Returns
    -------
    ndarray of bool, shape (h, w)
    """
    inverse = np.where(np.isnan(depth), np.float32(0), 1 / depth)
    bend = np.zeros_like(inverse)
    bend[:, 1:-1] = np.abs(inverse[:, :-2] - 2 * inverse[:, 1:-1] + inverse[:, 2:])
    vertical = np.abs(inverse[:-2] - 2 * inverse[1:-1] + inverse[2:])
    bend[1:-1] = np.maximum(bend[1:-1], vertical)
    return np.asarray(bend > _EDGE_BEND * inverse)


def edge_distance(depth: Depth) -> NDArray[np.float32]:
    """Distance of each pixel to the next depth edge, along rows or columns or both alike (h, w).

    Chebyshev's [pixels]: 0 on an edge, infinite without one.
    """
    edges = depth_edges(depth)
    if not edges.any():
        return np.full(depth.shape, np.inf, np.float32)
    return np.asarray(cv2.distanceTransform((~edges).astype(np.uint8), cv2.DIST_C, 3), np.float32)


_QUERIES = 50_000
"""Points of a cloud that look for their neighbour in the other, evenly chosen: thousands tell the
mean, and a dense image has half a million."""


def nearest_neighbors(
    points: NDArray[np.floating[Any]], queries: NDArray[np.floating[Any]], threads: int = 0
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """The nearest point of each query, found with a k-d tree in single precision.

    Parameters
    ----------
    points, queries : ndarray of float, shape (N, 3) and (M, 3)
        In the same frame [m], finite.

    Returns
    -------
    index : ndarray of int64, shape (M,)
        Row of ``points``.
    distance : ndarray of float64, shape (M,)
        Metres, in double precision; infinite without points.
    """
    if not len(points) or not len(queries):
        return np.zeros(len(queries), np.int64), np.full(len(queries), np.inf)
    # Single precision suffices near the origin; float32 points are searched as they are.
    origin = points.mean(axis=0) if points.dtype == np.float64 else np.zeros(3, points.dtype)
    found, _ = _core.nearest_neighbors(
        np.ascontiguousarray(points - origin, np.float32),
        np.ascontiguousarray(queries - origin, np.float32),
        threads,
    )
    index = found.astype(np.int64)
    offset = points[index].astype(np.float64) - queries
    return index, np.sqrt(np.einsum("ij,ij->i", offset, offset))


def cloud_distance(cloud: NDArray[np.float64], other: NDArray[np.float64]) -> tuple[float, int]:
    """Distance between two clouds: from each point to the nearest of the other, both ways.

    Parameters
    ----------
    cloud, other : ndarray of float64, shape (N, 3)
        The same frame [m].

    Returns
    -------
    (float, int)
        Sum of the distances [m], and how many there are.
    """
    total, count = 0.0, 0
    if not len(cloud) or not len(other):
        return total, count
    for points, queries in ((cloud, other), (other, cloud)):
        _, distance = nearest_neighbors(points, queries[:: -(-len(queries) // _QUERIES)])
        total, count = total + float(distance.sum()), count + len(distance)
    return total, count
