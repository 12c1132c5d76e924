"""A road as a coordinate system: s runs along it, d across it to the left."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from docdepth.synthetic.mesh import SURFACE, Mesh, Paint, pose_of

Floats = NDArray[np.float64]
_STEP = 0.1


@dataclass(frozen=True)
class Road:
    """A centre line with elevation and cross profile; (s, d) = (0, 0) is the world origin.

    Attributes
    ----------
    start, end : float
        Range of ``s`` along the centre line [m].
    heading : callable
        Heading of the centre line at ``s`` [rad]; smooth.
    elevation : callable
        Height of the centre line at ``s`` [m]; smooth.
    profile : callable
        Height above the centre line at ``(s, d)`` [m].
    paint : callable
        Index into ``paints`` of each ground cell, from ``(s, d)`` of its centre.
    s_cuts, d_cuts : sequence of float
        Positions of edges (kerbs, markings) at which the mesh has vertices [m].
    """

    start: float
    end: float
    heading: Callable[[Floats], Floats]
    elevation: Callable[[Floats], Floats]
    profile: Callable[[Floats, Floats], Floats]
    paint: Callable[[Floats, Floats], NDArray[np.int64]]
    paints: Sequence[Paint]
    d_cuts: Sequence[float]
    s_cuts: Sequence[float] = ()

    @cached_property
    def line(self) -> Floats:
        """The centre line: rows of s, x and y."""
        s = np.arange(self.start, self.end + _STEP, _STEP)
        heading = self.heading(s + 0.5 * _STEP)
        steps = _STEP * np.stack([np.cos(heading), np.sin(heading)], axis=1)
        points = np.concatenate([np.zeros((1, 2)), np.cumsum(steps[:-1], axis=0)])
        points -= [np.interp(0.0, s, points[:, k]) for k in range(2)]
        return np.column_stack([s, points])

    def height(self, s: ArrayLike, d: ArrayLike) -> Floats:
        """Height of the ground at (s, d)."""
        s, d = np.asarray(s, np.float64), np.asarray(d, np.float64)
        return self.elevation(s) + self.profile(s, d)

    def point(self, s: ArrayLike, d: ArrayLike, above: float = 0.0) -> Floats:
        """World points (..., 3) at (s, d), ``above`` metres over the ground."""
        s, d = np.broadcast_arrays(np.asarray(s, np.float64), np.asarray(d, np.float64))
        heading = self.heading(s)
        x = np.interp(s, self.line[:, 0], self.line[:, 1]) - d * np.sin(heading)
        y = np.interp(s, self.line[:, 0], self.line[:, 2]) + d * np.cos(heading)
        return np.stack([x, y, self.height(s, d) + above], axis=-1)

    def upright(self, s: float, d: float, yaw: float = 0.0, above: float = 0.0) -> Floats:
        """Pose of an upright object at (s, d), rotated by ``yaw`` from the heading of the road."""
        x, y, z = self.point(s, d, above)
        return pose_of(x, y, z, float(self.heading(np.asarray(s))) + yaw)

    def resting(self, s: float, d: float, yaw: float, length: float, width: float) -> Floats:
        """Pose of a vehicle whose wheels, ``length`` by ``width`` apart, stand on the ground."""
        along = 0.5 * length * np.array((np.cos(yaw), np.sin(yaw)))
        across = 0.5 * width * np.array((-np.sin(yaw), np.cos(yaw)))
        ends = np.array([along, -along, across, -across]) + np.array((s, d))
        return resting_poses(*self.point(ends[:, 0], ends[:, 1])[:, None])[0]

    def cuts_between(self, start: float, end: float) -> Sequence[float]:
        """Positions of edges on a part of the road [m]."""
        return self.s_cuts

    def ground(self, step: float = 1.0, span: tuple[float, float] | None = None) -> Mesh:
        """The ground as a mesh, or a part of it; its cells follow kerbs and markings."""
        start, end = span or (self.start, self.end)
        s, cuts = np.arange(start, end + step, step), np.array(self.cuts_between(start, end))
        if len(cuts):
            apart = np.abs(s[:, None] - cuts).min(axis=1)
            s = np.concatenate([s[apart > 0.05], cuts])
        s = np.unique(np.round(s, 4))
        d: Floats = np.unique(np.round(np.asarray(self.d_cuts, np.float64), 4))
        grid_s, grid_d = np.meshgrid(s, d, indexing="ij")
        vertices = self.point(grid_s, grid_d).reshape(-1, 3)
        index = np.arange(grid_s.size).reshape(grid_s.shape)
        a, b, c, e = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
        faces = np.stack([a, b, c, a, c, e], axis=-1).reshape(-1, 3)
        centre_s, centre_d = np.meshgrid(*(0.5 * (v[1:] + v[:-1]) for v in (s, d)), indexing="ij")
        kind = np.repeat(self.paint(centre_s.ravel(), centre_d.ravel()), 2)
        surfaces = np.array([tuple(paint) for paint in self.paints], SURFACE)
        return Mesh(vertices, faces.astype(np.int32), surfaces[kind])


def resting_poses(front: Floats, rear: Floats, left: Floats, right: Floats) -> Floats:
    """Poses (n, 4, 4) of objects that rest on four points each, (n, 3)."""
    x = front - rear
    x = x / np.linalg.norm(x, axis=-1, keepdims=True)
    y = left - right
    y = y - x * (x * y).sum(axis=-1, keepdims=True)
    y = y / np.linalg.norm(y, axis=-1, keepdims=True)
    poses = np.zeros((len(x), 4, 4))
    poses[:, :3, 0], poses[:, :3, 1], poses[:, :3, 2] = x, y, np.cross(x, y)
    poses[:, :3, 3] = 0.5 * (front + rear)
    poses[:, 3, 3] = 1.0
    return poses
