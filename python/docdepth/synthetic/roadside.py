"""Meshes of trees, street furniture and houses, standing on z = 0."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from docdepth.synthetic.mesh import (
    Colour,
    Mesh,
    Paint,
    box,
    leaves,
    merged,
    pose_of,
    quads,
    scattered,
    tube,
)

Floats = NDArray[np.float64]
Rng = np.random.Generator
# Walls reach below the lowest ground around them [m].
_BASE = -1.5
WALLS: tuple[Colour, ...] = (
    (0.72, 0.66, 0.55),
    (0.60, 0.42, 0.34),
    (0.78, 0.76, 0.71),
    (0.55, 0.55, 0.54),
    (0.70, 0.56, 0.44),
)
_GLASS = Paint(50, (0.20, 0.25, 0.30), 0.03)
_ROOF = Paint(50, (0.35, 0.34, 0.33), 0.2)
_SLAB = Paint(50, (0.6, 0.6, 0.58), 0.4)


def tree(rng: Rng, height: float = 8.0) -> Mesh:
    """A tree: trunk, branches and a crown of single leaves."""
    bark = Paint(71, (0.30, 0.24, 0.18), 0.25)
    green = (0.20, 0.34, 0.12) if rng.random() < 0.8 else (0.33, 0.36, 0.12)
    paint = Paint(70, green, 0.5)
    base = height * rng.uniform(0.28, 0.36)
    lean = rng.normal(0, 0.15, 2)
    girth = 0.018 * height
    top = np.array((lean[0], lean[1], 0.75 * height))
    trunk = np.array([(0, 0, -0.3), (0.3 * lean[0], 0.3 * lean[1], base), top])
    parts = [tube(trunk, (girth, 0.8 * girth, 0.3 * girth), bark, 8)]
    radius = height * rng.uniform(0.22, 0.3)
    centre = np.array((lean[0], lean[1], 0.5 * (base + height)))
    spread = np.array((radius, radius, 0.5 * (height - base)))
    clumps = centre + 0.62 * (scattered(14, 0, 1, rng)) * spread
    for clump in clumps[:6]:
        start = trunk[1] + rng.uniform(0, 0.5) * (top - trunk[1])
        parts.append(tube([start, clump], (0.4 * girth, 0.15 * girth), bark, 5))
    points = [scattered(120, clump, 0.42 * spread * rng.uniform(0.8, 1.2), rng) for clump in clumps]
    parts.append(leaves(np.concatenate(points), 0.22, paint, rng))
    return merged(parts)


def pole(height: float = 7.0, arm: float = 1.5, radius: float = 0.07) -> Mesh:
    """A street lamp with an arm along y."""
    paint = Paint(80, (0.42, 0.44, 0.44), 0.35)
    parts = [tube([(0, 0, -0.3), (0, 0, height)], (radius, 0.6 * radius), paint, 8)]
    if arm > 0:
        parts.append(tube([(0, 0, height - 0.1), (0, arm, height + 0.1)], 0.035, paint, 6))
        parts.append(box((0.25, 0.6, 0.1), (0, arm, height + 0.08), paint))
    return merged(parts)


def sign(rng: Rng, height: float = 2.4, size: float = 0.65) -> Mesh:
    """A retro-reflecting traffic sign on a post, facing -x."""
    post = Paint(80, (0.50, 0.52, 0.52), 0.35)
    colours: tuple[Colour, ...] = ((0.75, 0.1, 0.1), (0.1, 0.25, 0.65), (0.85, 0.8, 0.75))
    plate = Paint(81, colours[rng.integers(3)], 6.0)
    shaft = tube([(0, 0, -0.2), (0, 0, height + 0.3)], 0.03, post, 6)
    face = tube(
        [(-0.05, 0, height), (-0.035, 0, height)], 0.5 * size, plate, (4, 8, 12)[rng.integers(3)]
    )
    return merged([shaft, face])


def traffic_light() -> Mesh:
    """A traffic light on a post, facing -x."""
    post = tube([(0, 0, -0.2), (0, 0, 3.4)], 0.06, Paint(80, (0.3, 0.32, 0.32), 0.3), 8)
    head = box((0.2, 0.3, 0.9), (-0.12, 0, 3.0), Paint(81, (0.08, 0.1, 0.08), 0.2))
    return merged([post, head])


def bollard() -> Mesh:
    """A short post."""
    return tube([(0, 0, -0.1), (0, 0, 0.95)], 0.06, Paint(80, (0.35, 0.35, 0.36), 0.3), 8)


def refuse_bin(rng: Rng) -> Mesh:
    """A refuse bin on the pavement."""
    paint = Paint(99, ((0.15, 0.3, 0.18), (0.2, 0.2, 0.22))[rng.integers(2)], 0.25)
    return box((0.6, 0.6, 1.05), (0, 0, 0.53), paint)


def building(rng: Rng, length: float, depth: float, height: float, shop: bool = False) -> Mesh:
    """A house with a flat roof, ``length`` along x and ``depth`` along y, its foot at z = 0.

    Ledges and balconies stand out of the walls.
    """
    parts, storey = walls(rng, length, depth, height, shop)
    x, y = 0.5 * length, 0.5 * depth
    top = [(-x, -y, height), (x, -y, height), (x, y, height), (-x, y, height)]
    parts.append(quads([top], _ROOF))
    if rng.random() >= 0.5:
        for floor in range(1, int(height / storey)):
            for at in np.arange(-x + 3, x - 2, 6.0):
                for side in (-1, 1):
                    out, z = side * (y + 0.55), floor * storey
                    parts.append(box((2.2, 1.1, 0.15), (at, out, z), _SLAB))
                    parts.append(box((2.2, 0.05, 0.9), (at, out + side * 0.52, z + 0.5), _SLAB))
    return merged(parts)


def walls(
    rng: Rng, length: float, depth: float, height: float, shop: bool = False
) -> tuple[list[Mesh], float]:
    """The four walls of a house and its ledges, and the height of a storey [m]."""
    colour = WALLS[rng.integers(len(WALLS))]
    paint = Paint(50, colour, float(rng.uniform(0.25, 0.6)))
    storey, pitch = float(rng.uniform(2.8, 3.2)), float(rng.uniform(2.3, 3.2))
    recess = float(rng.uniform(0.08, 0.25))
    parts = []
    for quarter in range(4):
        width, out = (depth, length) if quarter % 2 else (length, depth)
        face = _wall(width, height, paint, _openings(width, height, storey, shop, pitch), recess)
        pose = pose_of(0, 0, 0, 0.5 * np.pi * quarter) @ pose_of(0, -0.5 * out, 0)
        parts.append(face.moved(pose))
    parts.append(box((length + 0.3, depth + 0.3, 0.25), (0, 0, height - 0.1), paint))
    if shop:
        parts.append(box((length + 0.2, depth + 0.2, 0.12), (0, 0, storey - 0.15), paint))
    return parts, storey


def _openings(width: float, height: float, storey: float, shop: bool, pitch: float) -> Floats:
    """Rectangles (u0, u1, v0, v1) of windows and doors in a wall, shape (n, 4)."""
    columns = max(int((width - 0.8) / pitch), 0)
    u = (np.arange(columns) + 0.5) * width / max(columns, 1)
    found = []
    for floor in range(int(height / storey)):
        v, half, low, high = floor * storey, 0.55, 0.95, 2.35
        if floor == 0 and shop:
            half, low, high = 0.42 * pitch, 0.35, 2.6
        for k, centre in enumerate(u):
            door = floor == 0 and k % 3 == 1
            span = (centre - 0.5, centre + 0.5) if door else (centre - half, centre + half)
            found.append((*span, v + (0.02 if door else low), v + (2.15 if door else high)))
    return np.array(found).reshape(-1, 4)


def _wall(width: float, height: float, paint: Paint, openings: Floats, recess: float) -> Mesh:
    """A wall in the x-z plane that faces -y, with windows ``recess`` metres deep."""
    u = np.unique(np.round([0, width, *openings[:, :2].ravel()], 6))
    v = np.unique(np.round([_BASE, 0, height, *openings[:, 2:].ravel()], 6))
    um, vm = 0.5 * (u[1:] + u[:-1]), 0.5 * (v[1:] + v[:-1])
    inside = np.zeros((len(um), len(vm)), bool)
    for u0, u1, v0, v1 in openings:
        inside |= ((um > u0) & (um < u1))[:, None] & ((vm > v0) & (vm < v1))
    i, j = np.nonzero(~inside)
    solid = np.stack([u[i], u[i + 1], v[j], v[j + 1]], axis=1)
    parts = [quads(_upright(solid, 0.0, width), paint)]
    if len(openings):
        front, back = _upright(openings, 0.0, width), _upright(openings, recess, width)
        turned = [1, 2, 3, 0]
        reveals = np.stack([front, front[:, turned], back[:, turned], back], axis=2)
        parts += [quads(back, _GLASS), quads(np.moveaxis(reveals, 1, 0), paint)]
    return merged(parts)


def _upright(rectangles: Floats, y: float, width: float) -> Floats:
    """Corners (n, 4, 3) of rectangles of a wall, ``y`` behind its face."""
    u, v = rectangles[:, [0, 1, 1, 0]], rectangles[:, [2, 2, 3, 3]]
    return np.stack([u - 0.5 * width, np.full(u.shape, y), v], axis=2)
