"""Triangle meshes and the basic shapes of the scenes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from docdepth.geometry.se3 import transform_points

Colour = tuple[float, float, float]
SURFACE = np.dtype([("label", np.uint32), ("colour", np.float32, 3), ("reflectivity", np.float32)])
"""A :class:`Paint` as a row of an array; the high 16 bits of the label hold an instance."""


class Paint(NamedTuple):
    """Material of a face."""

    label: int  # SemanticKITTI class
    colour: Colour  # red, green, blue in 0..1
    # diffuse reflectivity at the wavelength of the LiDAR, 0..1; above 1 for retro-reflectors
    reflectivity: float = 0.3


@dataclass(frozen=True)
class Mesh:
    """Triangles and what they are made of."""

    vertices: NDArray[np.float64]  # (V, 3)
    faces: NDArray[np.int32]  # (F, 3)
    surface: NDArray[Any]  # (F,)

    def __len__(self) -> int:
        return len(self.faces)

    def moved(self, pose: NDArray[np.float64]) -> Mesh:
        """The same triangles after the 4x4 transform ``pose``."""
        return replace(self, vertices=transform_points(pose, self.vertices))

    @property
    def normals(self) -> NDArray[np.float64]:
        """Unit normal of each face, shape (F, 3); zero for a degenerate one."""
        a, b, c = (self.vertices[self.faces[:, k]] for k in range(3))
        normal = np.cross(b - a, c - a)
        length = np.linalg.norm(normal, axis=1, keepdims=True)
        return normal / np.where(length > 0, length, 1.0)


def painted(vertices: ArrayLike, faces: ArrayLike, paint: Paint) -> Mesh:
    """A mesh of one material."""
    faces = np.asarray(faces, dtype=np.int32).reshape(-1, 3)
    return Mesh(
        np.asarray(vertices, dtype=np.float64).reshape(-1, 3),
        faces,
        np.full(len(faces), np.array(tuple(paint), SURFACE)),
    )


def merged(meshes: Sequence[Mesh]) -> Mesh:
    """All triangles in one mesh, in the order given."""
    offsets = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate(
            [mesh.faces + np.int32(o) for mesh, o in zip(meshes, offsets[:-1], strict=True)]
        ),
        np.concatenate([mesh.surface for mesh in meshes]),
    )


def pose_of(x: float, y: float, z: float, yaw: float = 0.0) -> NDArray[np.float64]:
    """A 4x4 pose from a position and a heading."""
    pose = np.eye(4)
    cos, sin = np.cos(yaw), np.sin(yaw)
    pose[:2, :2] = ((cos, -sin), (sin, cos))
    pose[:3, 3] = (x, y, z)
    return pose


def quads(corners: ArrayLike, paint: Paint) -> Mesh:
    """Quadrilaterals, shape (n, 4, 3), each split into two triangles."""
    corners = np.asarray(corners, dtype=np.float64).reshape(-1, 4, 3)
    first = 4 * np.arange(len(corners))[:, None]
    faces = np.concatenate([first + np.array((0, 1, 2)), first + np.array((0, 2, 3))], axis=1)
    return painted(corners, faces, paint)


def box(size: ArrayLike, centre: ArrayLike, paint: Paint) -> Mesh:
    """An axis-aligned box."""
    signs = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    vertices = np.asarray(centre) + 0.5 * np.asarray(size) * signs
    faces = (
        *((0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1)),
        *((2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)),
    )
    return painted(vertices, faces, paint)


def loft(sections: ArrayLike, paint: Paint) -> Mesh:
    """The closed hull of successive outlines of m points each, shape (k, m, 3).

    The first and the last outline are closed by triangle fans.
    """
    sections = np.asarray(sections, dtype=np.float64)
    count, sides = sections.shape[:2]
    ring = np.arange(sides)
    low = (ring + sides * np.arange(count - 1)[:, None]).ravel()
    next_low = (np.roll(ring, -1) + sides * np.arange(count - 1)[:, None]).ravel()
    wall = np.stack([low, next_low, next_low + sides, low, next_low + sides, low + sides], axis=1)
    fan = np.stack([np.zeros(sides - 2, int), ring[1:-1], ring[2:]], axis=1)
    caps = np.concatenate([fan[:, ::-1], fan + sides * (count - 1)])
    return painted(sections, np.concatenate([wall.reshape(-1, 3), caps]), paint)


def tube(path: ArrayLike, radii: ArrayLike, paint: Paint, sides: int = 8) -> Mesh:
    """A round bar along the points ``path`` (k, 3), with a radius at each point."""
    path = np.asarray(path, dtype=np.float64)
    radii = np.broadcast_to(np.asarray(radii, dtype=np.float64), (len(path),))
    axis = path[-1] - path[0]
    axis = axis / np.linalg.norm(axis)
    helper = np.array((0.0, 1.0, 0.0)) if abs(axis[1]) < 0.9 else np.array((1.0, 0.0, 0.0))
    u = np.cross(helper, axis)
    u /= np.linalg.norm(u)
    v = np.cross(axis, u)
    angle = 2 * np.pi * np.arange(sides) / sides
    outline = np.cos(angle)[:, None] * u + np.sin(angle)[:, None] * v
    return loft(path[:, None] + radii[:, None, None] * outline, paint)


def ball(centre: ArrayLike, radii: ArrayLike, paint: Paint, sides: int = 8) -> Mesh:
    """An ellipsoid."""
    polar = np.linspace(0.05, np.pi - 0.05, max(sides // 2 + 1, 4))
    azimuth = 2 * np.pi * np.arange(sides) / sides
    ring = np.stack([np.cos(azimuth), np.sin(azimuth), np.ones(sides)], axis=1)
    scale = np.stack([np.sin(polar), np.sin(polar), -np.cos(polar)], axis=1)
    return loft(np.asarray(centre) + np.asarray(radii) * ring * scale[:, None], paint)


def leaves(
    centres: NDArray[np.float64], size: float, paint: Paint, rng: np.random.Generator
) -> Mesh:
    """Small quadrilaterals at ``centres`` (n, 3), with random rotations and shades."""
    count = len(centres)
    u = rng.normal(size=(count, 3))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    v = np.cross(u, rng.normal(size=(count, 3)))
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    scale = size * rng.uniform(0.6, 1.4, (count, 1))
    u, v = 0.5 * scale * u, 0.35 * scale * v
    mesh = quads(np.stack([centres - u, centres + v, centres + u, centres - v], axis=1), paint)
    mesh.surface["colour"] *= np.repeat(rng.uniform(0.7, 1.25, (count, 1)).astype(np.float32), 2, 0)
    return mesh


def scattered(
    count: int, centre: ArrayLike, radii: ArrayLike, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Random points (count, 3) in an ellipsoid, denser towards its surface."""
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    radius = rng.uniform(0.3, 1.0, (count, 1)) ** 0.5
    return np.asarray(centre) + np.asarray(radii) * direction * radius
