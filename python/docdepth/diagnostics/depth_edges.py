"""Depth edges of depth maps and of sweeps: where one surface ends before another farther away."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.base import CameraStream, Dataset, Sweep
from docdepth.diagnostics.sweeps import sample
from docdepth.geometry.camera import Camera
from docdepth.geometry.points import usable_points
from docdepth.geometry.scan_mesh import ScanMesh
from docdepth.geometry.se3 import inverse
from docdepth.geometry.sensor_rig import SensorRig
from docdepth.geometry.track import Tracks
from docdepth.geometry.trajectory import Trajectory
from docdepth.io.tracks import box_in_image
from docdepth.odometry.deskewing import centred_motion, deskew

Floats = NDArray[np.float64]

_JUMP = (0.5, 0.15)  # metres, and share of the depth, that the farther surface lies behind
_DEPTHS = (3.0, 50.0)  # metres; nearer is the vehicle, farther returns are too sparse

# Of depth maps.
_SMOOTH = 2.0  # pixels over which the direction of an edge is found
_STEEP = 0.7  # part of the direction along rows or columns of the pair of pixels
_BESIDE = 5  # pixels around a moving object
_MOST_EDGES = 2000  # of an image or a sweep that are used

# Of sweeps.
_SWEEPS = 8  # that are compared with an image
_MOST_JUMPS = 0.3  # share of the triangles of a sweep; seen from a wrong place more have one
_WIDEST_GAP_DEG = 1.0  # between two returns; the edge lies somewhere between
_MARGIN = 1.5  # sizes of the image within which edges are looked for
_NEAREST = 0.5  # metres ahead of the camera


@dataclass(frozen=True)
class Edges:
    """Depth edges in an image.

    Attributes
    ----------
    pixels : ndarray of float64, shape (n, 2)
        u and v; integers are pixel centres.
    across : ndarray of float64, shape (n, 2)
        Unit vector in the image from the near side to the far one.
    depth : ndarray of float64, shape (n,)
        Of the near side, metres along the optical axis.
    """

    pixels: Floats
    across: Floats
    depth: Floats

    def __len__(self) -> int:
        return len(self.depth)

    def rows(self, chosen: NDArray[np.bool_] | NDArray[np.int64]) -> Edges:
        return Edges(self.pixels[chosen], self.across[chosen], self.depth[chosen])


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


@dataclass(frozen=True)
class SweepEdges:
    """Depth edges of a sweep, where they were when an image was taken.

    Attributes
    ----------
    image : int
        Index of the image.
    ends : ndarray of float64, shape (2, n, 3)
        LiDAR frame at the time of the image, metres: the near return of each edge, and the
        direction of the far one at its range.
    travel : ndarray of float64, shape (3,)
        Path of the LiDAR from the sweep to the image, in its frame, metres; 0 if it is not known.
    """

    image: int
    ends: Floats
    travel: Floats

    def seen_by(self, T_camera_lidar: Floats, camera: Camera, every: int = 1) -> Edges:
        """Those that fall into the image of a camera; ``every`` so many of them."""
        ends = self.ends[:, ::every]
        x, y, z = np.moveaxis(ends @ T_camera_lidar[:3, :3].T + T_camera_lidar[:3, 3], -1, 0)
        ahead = (z > _NEAREST).all(axis=0)
        rays = np.stack([x, y, z], axis=-1)[:, ahead] / z[:, ahead, None]
        near, far = (rays @ camera.K.T)[..., :2]
        pixels, across = (near + far) / 2, far - near
        across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9)
        size = np.array([camera.width, camera.height])
        inside = ((pixels >= 0) & (pixels <= size - 1)).all(axis=1)
        return Edges(pixels, across, z[0, ahead]).rows(inside)


def edges_of_sweeps(
    recording: Dataset, stream: CameraStream, sweeps: Mapping[int, Sweep]
) -> list[SweepEdges]:
    """Depth edges of sweeps nearest to images that are spread over the drive.

    Parameters
    ----------
    recording : Dataset
    stream : CameraStream
    sweeps : mapping of int to Sweep
        Those that were read already, by index; they are taken where they are enough.
    """
    times = recording.times
    inside = np.flatnonzero((stream.times >= times[0]) & (stream.times <= times[-1]))
    chosen = inside[sample(len(inside), _SWEEPS)]
    nearest = np.searchsorted(times[:-1] + np.diff(times) // 2, stream.times[inside])
    at_image, first = np.unique(nearest, return_index=True)
    known = inside[first[np.isin(at_image, list(sweeps))]]
    if len(known) >= len(chosen):
        chosen = known[sample(len(known), _SWEEPS)]
    trajectory = None
    if recording.poses is not None and len(times) > 1:
        trajectory = Trajectory(times, recording.poses)
    found = []
    for image in chosen.tolist():
        index = int(np.abs(times - stream.times[image]).argmin())
        sweep = sweeps[index] if index in sweeps else recording.sweep(index)
        ends, late = _ends(sweep, stream)
        travel = np.zeros(3)
        if trajectory is not None:
            if late is not None:
                (own,) = centred_motion(trajectory.poses, times, [index])
                ends = np.stack([deskew(end, late, own) for end in ends.astype(np.float32)])
            T_world_image = trajectory.interpolate(stream.times[image : image + 1])[0]
            motion = inverse(T_world_image) @ trajectory.poses[index]
            ends, travel = ends @ motion[:3, :3].T + motion[:3, 3], -motion[:3, 3]
        found.append(SweepEdges(image, ends, travel))
    return found


def _ends(sweep: Sweep, stream: CameraStream) -> tuple[Floats, NDArray[np.float32] | None]:
    """Ends of the depth edges around the image, and when each was measured, as a share of a sweep.

    The times are None where the sweep has none or is motion compensated.
    """
    kept = usable_points(sweep.points)
    kept[kept] = _around_image(sweep.points[kept], stream)
    points = np.ascontiguousarray(sweep.points[kept])
    rig = None if sweep.sensor_rig is None else sweep.sensor_rig.select(kept)
    mesh = ScanMesh(points, rig)
    if not len(mesh.triangles) or mesh.discontinuity.mean() > _MOST_JUMPS:
        return np.zeros((2, 0, 3)), None
    corners = mesh.triangles[mesh.discontinuity].astype(np.int64)
    sides = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    origins = _origins(rig, len(points))
    seen = points - origins
    ranges = np.linalg.norm(seen, axis=1)
    rays = seen / ranges[:, None]
    near_first = ranges[sides[:, :1]] < ranges[sides[:, 1:]]
    near, far = np.unique(np.where(near_first, sides, sides[:, ::-1]), axis=0).T
    distance, gap = ranges[near], np.linalg.norm(rays[near] - rays[far], axis=1)
    edge = ranges[far] - distance > np.maximum(_JUMP[0], _JUMP[1] * distance)
    edge &= (gap < np.radians(_WIDEST_GAP_DEG)) & (distance > _DEPTHS[0])
    rows = np.flatnonzero(edge & (distance < _DEPTHS[1]))
    rows = rows[:: max(1, -(-len(rows) // _MOST_EDGES))]
    near, far = near[rows], far[rows]
    ends = np.stack([rays[near], rays[far]]) * ranges[near, None] + origins[near]
    late = None
    if sweep.relative_time is not None and not sweep.motion_compensated:
        late = sweep.relative_time[kept][near]
    return ends, late


def _origins(rig: SensorRig | None, count: int) -> Floats:
    """Place of the LiDAR that measured each point, (N, 3)."""
    if rig is None:
        return np.zeros((count, 3))
    places = rig.T_lidar_sensor[:, :3, 3]
    of_lidar = np.array([places[rig.lidar_id == lidar].mean(axis=0) for lidar in rig.lidar_id])
    return of_lidar[rig.index]


def _around_image(points: NDArray[np.float32], stream: CameraStream) -> NDArray[np.bool_]:
    """Points in the image, or near it: also those that a camera would see that is turned a bit."""
    camera = stream.camera
    seen = points @ stream.T_camera_lidar[:3, :3].T + stream.T_camera_lidar[:3, 3]
    half = np.array([camera.width, camera.height]) / 2
    from_centre = (seen @ camera.K.T)[:, :2] - half * seen[:, 2:]
    inside = (np.abs(from_centre) < _MARGIN * half * seen[:, 2:]).all(axis=1)
    result: NDArray[np.bool_] = inside & (seen[:, 2] > _NEAREST)
    return result
