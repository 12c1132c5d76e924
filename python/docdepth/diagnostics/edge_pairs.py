"""Depth edges of sweeps and edges of the images that were taken meanwhile, and how well they fit.

A depth edge lies where a sweep jumps from one surface to another farther away.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.base import CameraStream, Dataset, Sweep
from docdepth.diagnostics.sweeps import sample
from docdepth.geometry.lidar_frame import SensorRig
from docdepth.geometry.points import usable_points
from docdepth.geometry.scan_mesh import ScanMesh
from docdepth.geometry.se3 import inverse, transform_points
from docdepth.geometry.trajectory import Trajectory
from docdepth.odometry.deskewing import centred_motion, deskew

PAIRS = 8
"""Pairs of a sweep and an image that are compared."""

_FEWEST_EDGES = 30  # depth edges in an image, weighted
_MOST_EDGES = 1500  # of a sweep that are used; more take time and tell no more
_JUMP = (0.5, 0.15)  # metres, and share of the range, that the farther surface lies behind
_MOST_JUMPS = 0.3  # share of the triangles of a sweep; seen from a wrong place more have one
_RANGES = (3.0, 60.0)  # metres; nearer is the vehicle, farther edges are rare
_WIDEST_GAP_DEG = 1.0  # between two returns; the edge lies somewhere between
_SHARPEST_GAP_DEG = 0.4  # from here on an edge weighs less the wider its gap
_MARGIN = 1.5  # sizes of the image within which edges are looked for
_PIXEL_DEG = 0.12  # images are reduced to this
_EDGE_DEG = 0.35  # how far from an image edge a depth edge still counts
_CONTRAST_DEG = 4.0  # around an edge, that its strength is compared with
_DARK = 0.02  # contrast of noise; brightness is a square root, 0 to 16


@dataclass(frozen=True)
class EdgePair:
    """Depth edges of a sweep and edges of the image that was taken then."""

    # (3, n, 3): LiDAR frame at the time of the image, metres: the near return of each edge, the
    # place halfway to the far one, and the far one's direction at the near one's range
    ends: NDArray[np.float64]
    weight: NDArray[np.float64]  # (n,)
    image: int  # index of the image
    strength: NDArray[np.float32]  # (h, w, 3): edges of the image, see :func:`edge_strength`
    # (3,): path of the LiDAR from the sweep to the image, in its frame, metres; 0 if it is not
    # known
    travel: NDArray[np.float64]


def edge_pairs(
    recording: Dataset, stream: CameraStream, sweeps: Mapping[int, Sweep]
) -> list[EdgePair]:
    """Pairs of sweep and image, spread over the drive; ``sweeps`` are read already."""
    times = recording.times
    inside = np.flatnonzero((stream.times >= times[0]) & (stream.times <= times[-1]))
    chosen = inside[sample(len(inside), PAIRS)]
    nearest = np.searchsorted(times[:-1] + np.diff(times) // 2, stream.times[inside])
    at_image, first = np.unique(nearest, return_index=True)
    known = inside[first[np.isin(at_image, list(sweeps))]]
    if len(known) >= len(chosen):  # no sweep needs to be read again
        chosen = known[sample(len(known), PAIRS)]
    trajectory = None
    if recording.poses is not None and len(times) > 1:
        trajectory = Trajectory(times, recording.poses)
    pairs = []
    for image in chosen.tolist():
        index = int(np.abs(times - stream.times[image]).argmin())
        sweep = sweeps[index] if index in sweeps else recording.sweep(index)
        ends, late, weight = _depth_edges(sweep, stream)
        travel = np.zeros(3)
        if trajectory is not None:
            if late is not None:
                (own,) = centred_motion(trajectory.poses, times, [index])
                ends = np.stack([deskew(end, late, own) for end in ends.astype(np.float32)])
            T_world_image = trajectory.interpolate(stream.times[image : image + 1])[0]
            motion = inverse(T_world_image) @ trajectory.poses[index]
            ends, travel = transform_points(motion, ends), -motion[:3, 3]
        if weight.sum() >= _FEWEST_EDGES:
            pairs.append(EdgePair(ends, weight, image, edge_strength(stream, image), travel))
    return pairs


def _depth_edges(
    sweep: Sweep, stream: CameraStream
) -> tuple[NDArray[np.float64], NDArray[np.float32] | None, NDArray[np.float64]]:
    """Depth edges of a sweep around the image, as :class:`EdgePair` has them, at the time of each.

    The second array has the times of the near returns, as a share of the sweep; None where the
    sweep has none or is motion compensated.
    """
    kept = usable_points(sweep.points)
    kept[kept] = _around_image(sweep.points[kept], stream)
    points = np.ascontiguousarray(sweep.points[kept])
    rig = None if sweep.sensor_rig is None else sweep.sensor_rig.select(kept)
    mesh = ScanMesh(points, rig)
    if not len(mesh.triangles) or mesh.discontinuity.mean() > _MOST_JUMPS:
        return np.zeros((3, 0, 3)), None, np.zeros(0)
    corners = mesh.triangles[mesh.discontinuity].astype(np.int64)
    sides = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    origins = _origins(rig, len(points))
    seen = points - origins
    ranges = np.linalg.norm(seen, axis=1)
    first_is_near = ranges[sides[:, 0]] < ranges[sides[:, 1]]
    near = np.where(first_is_near, sides[:, 0], sides[:, 1])
    far = np.where(first_is_near, sides[:, 1], sides[:, 0])
    near, far = np.unique(np.stack([near, far]), axis=1)
    rays = seen / ranges[:, None]
    gap = np.degrees(np.arccos(np.clip((rays[near] * rays[far]).sum(axis=1), -1, 1)))
    distance = ranges[near]
    edge = ranges[far] - distance > np.maximum(_JUMP[0], _JUMP[1] * distance)
    edge &= (gap < _WIDEST_GAP_DEG) & (distance > _RANGES[0]) & (distance < _RANGES[1])
    rows = np.flatnonzero(edge)
    rows = rows[:: max(1, -(-len(rows) // _MOST_EDGES))]
    near, far, distance = near[rows], far[rows], distance[rows, None]
    ends = np.stack([rays[near], (rays[near] + rays[far]) / 2, rays[far]]) * distance
    ends += origins[near]
    late = None
    if sweep.relative_time is not None and not sweep.motion_compensated:
        late = sweep.relative_time[kept][near]
    return ends, late, np.minimum(1.0, _SHARPEST_GAP_DEG / np.maximum(gap[rows], 0.1))


def _origins(rig: SensorRig | None, count: int) -> NDArray[np.float64]:
    """Place of the LiDAR that measured each point, (N, 3)."""
    if rig is None:
        return np.zeros((count, 3))
    places = rig.T_lidar_sensor[:, :3, 3]
    of_lidar = np.array([places[rig.lidar_id == lidar].mean(axis=0) for lidar in rig.lidar_id])
    return of_lidar[rig.index]


def _around_image(points: NDArray[np.float32], stream: CameraStream) -> NDArray[np.bool_]:
    """Points in the image, or near it: also those that a camera would see that is turned a bit."""
    camera = stream.camera
    x, y, z = transform_points(stream.T_camera_lidar, points).T
    half_width, half_height = camera.width / 2, camera.height / 2
    u = camera.K[0, 0] * x + (camera.K[0, 2] - half_width) * z
    v = camera.K[1, 1] * y + (camera.K[1, 2] - half_height) * z
    inside: NDArray[np.bool_] = (z > 0.5) & (np.abs(u) < _MARGIN * half_width * z)
    return inside & (np.abs(v) < _MARGIN * half_height * z)


def edge_strength(stream: CameraStream, image: int) -> NDArray[np.float32]:
    """Structure tensor (xx, xy, yy) of a smaller image, over its contrast around."""
    picture = stream.rectified_image(image)
    assert picture is not None
    grey = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
    scale = _scale(stream)
    grey = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    bright = np.sqrt(grey.astype(np.float32))
    across = cv2.Sobel(bright, cv2.CV_32F, 1, 0) / 8
    down = cv2.Sobel(bright, cv2.CV_32F, 0, 1) / 8
    tensor = np.stack([across * across, across * down, down * down], axis=-1)
    pixel_deg = np.degrees(1 / stream.camera.K[0, 0]) / scale
    smooth = cv2.GaussianBlur(tensor, (0, 0), _EDGE_DEG / pixel_deg)
    window = 2 * round(2 * _CONTRAST_DEG / pixel_deg) + 1
    around = cv2.blur(tensor[..., 0] + tensor[..., 2], (window, window))
    result: NDArray[np.float32] = smooth / (around + _DARK)[..., None]
    return result


def _scale(stream: CameraStream) -> float:
    return min(1.0, float(np.degrees(1 / stream.camera.K[0, 0])) / _PIXEL_DEG)


def scores_of(
    pairs: Sequence[EdgePair], stream: CameraStream, change: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Strength of the image across each depth edge, on average over each pair.

    ``change`` is a transform (4, 4) of points in the frame of the camera.
    """
    T = change @ stream.T_camera_lidar
    return np.array([_score(pair, stream, T[:3, :3], T[:3, 3]) for pair in pairs])


def _score(
    pair: EdgePair,
    stream: CameraStream,
    rotation: NDArray[np.float64],
    offset: NDArray[np.float64],
) -> float:
    K, scale = stream.camera.K, _scale(stream)
    x, y, z = np.moveaxis(pair.ends @ rotation.T + offset, -1, 0)
    seen = (z > 0.5).all(axis=0)
    z = np.where(seen, z, 1.0)
    u, v = K[0, 0] * x / z + K[0, 2], K[1, 1] * y / z + K[1, 2]
    column = np.floor(u[1] * scale + 0.5).astype(np.int64)
    row = np.floor(v[1] * scale + 0.5).astype(np.int64)
    height, width = pair.strength.shape[:2]
    seen &= (column >= 0) & (column < width) & (row >= 0) & (row < height)
    if not seen.any():
        return 0.0
    du, dv = (u[2] - u[0])[seen], (v[2] - v[0])[seen]
    xx, xy, yy = pair.strength[row[seen], column[seen]].T
    across = (du * du * xx + 2 * du * dv * xy + dv * dv * yy) / (du * du + dv * dv + 1e-12)
    weight = pair.weight[seen]
    return float((np.sqrt(np.maximum(across, 0)) * weight).sum() / weight.sum())
