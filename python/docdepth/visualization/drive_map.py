"""A drive from above: what stands around the path, as a picture (ours)."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from docdepth.geometry.points import DYNAMIC, STATIC, usable_points
from docdepth.geometry.trajectory import Trajectory
from docdepth.io.run_folder import RunFolder
from docdepth.visualization.pictures import Picture

TALL = 3.5
"""Heights above ground up to which static points are drawn [m]; crowns of trees hide streets."""

UNSEEN_TONE, GROUND_TONE = 255, 228
LOW_TONE, TALL_TONE = 190, 60
"""Grey of what stands just above the ground, and of what is :data:`TALL` or taller."""

_REACH = 40.0  # metres around the path that are shown
_STRAY, _MARGIN = 0.01, 2.0  # cells outside the picture, as a share; metres around the others
_CELL = 0.15  # metres; smaller cells stay empty between the beams
_PIXELS = 1400  # of the longer side
_SWEEPS = 150  # at most that many are read, spaced evenly along the path
_SPACING = 1.0  # metres; nearer sweeps show the same
_GROUND_CELL = 2.0  # metres; the ground is flat in such a cell


@dataclass(frozen=True)
class DriveMap:
    """A picture of a drive from above, turned so that the drive goes to the right.

    Attributes
    ----------
    picture : ndarray of uint8, shape (h, w, 3)
        Grey: white where no beam came, light ground, darker the higher something stands.
    heading : float
        Angle from the world's x towards y that points to the right in the picture [rad].
    corner : ndarray of float64, shape (2,)
        Upper left corner of the picture, in the turned world [m].
    cell : float
        Metres a pixel.
    """

    picture: Picture
    heading: float
    corner: NDArray[np.float64]
    cell: float

    def pixels(self, places: NDArray[np.floating]) -> NDArray[np.float64]:
        """Column and row (n, 2) of places in the world (n, 2 or more) [m]."""
        turned = _turned(places, self.heading)
        return (turned - self.corner) * (1, -1) / self.cell


def drive_map(run: RunFolder) -> DriveMap:
    """Draw the static points of a run from above.

    Sweeps are read one at a time, and no more than 150 however long the drive is.

    Parameters
    ----------
    run : RunFolder
        With classified frames.

    Raises
    ------
    RunError
        A frame is missing, damaged or not classified.
    """
    trajectory = run.trajectory()
    heading = _main_direction(trajectory.poses)
    path = _turned(trajectory.poses[:, :2, 3], heading)
    low, high = path.min(axis=0) - _REACH, path.max(axis=0) + _REACH
    cell = max(_CELL, float((high - low).max()) / _PIXELS)
    columns, rows = np.ceil((high - low) / cell).astype(int)
    empty = DriveMap(
        np.zeros((rows, columns, 3), np.uint8), heading, np.array((low[0], high[1])), cell
    )
    heights = np.full(rows * columns, -1, np.float32)
    for k in _spaced(trajectory):
        record, classid = run.classified_frame(k)
        kept = (classid < DYNAMIC) & usable_points(record.points, 0)
        points = record.points.compress(kept, axis=0)
        above = heights_above_ground(points, classid[kept] < STATIC)
        pose = trajectory.poses[k]
        place = np.floor(empty.pixels(points @ pose[:3, :3].T + pose[:3, 3])).astype(np.int64)
        inside = ((place >= 0) & (place < (columns, rows))).all(axis=1) & (above <= TALL)
        np.maximum.at(heights, place[inside] @ (1, columns), above[inside])
    heights = heights.reshape(rows, columns)
    top, bottom, left, right = _filled(heights >= 0, empty.pixels(trajectory.poses[:, :3, 3]), cell)
    corner = empty.corner + cell * np.array((left, -top))
    return DriveMap(_toned(heights[top:bottom, left:right]), heading, corner, cell)


def _filled(
    is_seen: NDArray[np.bool_], path: NDArray[np.float64], cell: float
) -> tuple[int, int, int, int]:
    """First and last row, first and last column of what has nearly all seen cells and the path."""
    edges: list[int] = []
    for axis, along in ((1, path[:, 1]), (0, path[:, 0])):
        share = np.cumsum(is_seen.sum(axis=axis)) / max(int(is_seen.sum()), 1)
        low, high = np.searchsorted(share, (_STRAY, 1 - _STRAY))
        margin = round(_MARGIN / cell)
        low, high = min(int(low), int(along.min())), max(int(high), int(along.max()))
        edges += [max(low - margin, 0), min(high + margin, len(share))]
    return edges[0], edges[1], edges[2], edges[3]


def heights_above_ground(
    points: NDArray[np.float32], is_ground: NDArray[np.bool_]
) -> NDArray[np.float32]:
    """Height of each point of a sweep above the ground below it, or nearest to it [m].

    Parameters
    ----------
    points : ndarray of float32, shape (N, 3)
        LiDAR frame [m].
    is_ground : ndarray of bool, shape (N,)

    Returns
    -------
    ndarray of float32, shape (N,)
        0 for ground; all 0 where a sweep has none.
    """
    if not is_ground.any():
        return np.zeros(len(points), np.float32)
    place = np.floor((points[:, :2] - points[:, :2].min(axis=0)) / _GROUND_CELL).astype(np.int64)
    shape = place.max(axis=0) + 1
    flat = place @ (shape[1], 1)
    count = np.bincount(flat[is_ground], minlength=shape.prod())
    total = np.bincount(flat[is_ground], points[is_ground, 2], minlength=shape.prod())
    is_empty = (count == 0).astype(np.uint8).reshape(shape)
    # The label of a cell is that of the nearest cell with ground.
    _, nearest = cv2.distanceTransformWithLabels(
        is_empty, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    level = np.zeros(int(nearest.max()) + 1)
    known = count > 0
    level[nearest.ravel()[known]] = total[known] / count[known]
    above = points[:, 2] - level[nearest.ravel()[flat]]
    return np.where(is_ground, 0, np.maximum(above, 0)).astype(np.float32)


def _spaced(trajectory: Trajectory) -> list[int]:
    """Sweeps to draw, evenly along the path."""
    if len(trajectory) == 1:
        return [0]
    spacing = max(_SPACING, float(trajectory.arc_length[-1]) / (_SWEEPS - 1))
    return [int(k) for k in trajectory.subsample(spacing)][:_SWEEPS]


def _main_direction(poses: NDArray[np.float64]) -> float:
    """Angle of the line along which the path extends most, with the way that was driven [rad]."""
    path = poses[:, :2, 3] - poses[:, :2, 3].mean(axis=0)
    axis = np.linalg.eigh(path.T @ path)[1][:, -1]
    way = path[-1] - path[0]
    if np.ptp(path @ axis) < _SPACING:
        axis = way = poses[0, :2, 0]
    axis = axis if axis @ way >= 0 else -axis
    return float(np.arctan2(axis[1], axis[0]))


def _turned(places: NDArray[np.floating], heading: float) -> NDArray[np.float64]:
    cos, sin = np.cos(heading), np.sin(heading)
    return np.asarray(places[:, :2] @ np.array([(cos, -sin), (sin, cos)]), np.float64)


def _toned(heights: NDArray[np.float32]) -> Picture:
    share = np.clip(heights / TALL, 0, 1)
    tone = np.rint(LOW_TONE + (TALL_TONE - LOW_TONE) * share)
    tone[heights <= 0] = GROUND_TONE
    tone[heights < 0] = UNSEEN_TONE
    return np.repeat(tone.astype(np.uint8)[..., None], 3, axis=2)
