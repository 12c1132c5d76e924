"""Buildings with windows recessed into their walls."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from docdepth.synthetic.mesh import Colour, Mesh, Paint, box, merged, pose_of, quads

Floats = NDArray[np.float64]
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


def wall(
    width: float,
    height: float,
    paint: Paint,
    storey: float = 3.0,
    shop: bool = False,
    pitch: float = 2.8,
    recess: float = 0.16,
) -> Mesh:
    """A wall in the x-z plane that faces -y, with windows ``recess`` metres deep."""
    openings = _openings(width, height, storey, shop, pitch)
    u = np.unique(np.round(np.concatenate([[0, width], openings[:, :2].ravel()]), 6))
    v = np.unique(np.round(np.concatenate([[_BASE, 0, height], openings[:, 2:].ravel()]), 6))
    um, vm = 0.5 * (u[1:] + u[:-1]), 0.5 * (v[1:] + v[:-1])
    inside = np.zeros((len(um), len(vm)), bool)
    for u0, u1, v0, v1 in openings:
        inside |= ((um > u0) & (um < u1))[:, None] & ((vm > v0) & (vm < v1))
    i, j = np.nonzero(~inside)
    parts = [quads(_upright(u[i], u[i + 1], v[j], v[j + 1], 0.0, width), paint)]
    if len(openings):
        u0, u1, v0, v1 = openings.T
        parts.append(quads(_upright(u0, u1, v0, v1, recess, width), _GLASS))
        parts.append(quads(_reveals(u0, u1, v0, v1, recess, width), paint))
    return merged(parts)


def _upright(u0: Floats, u1: Floats, v0: Floats, v1: Floats, y: float, width: float) -> Floats:
    depth = np.full(len(u0), y)
    corners = [(u0, v0), (u1, v0), (u1, v1), (u0, v1)]
    return np.stack([np.stack([a - 0.5 * width, depth, b], axis=1) for a, b in corners], axis=1)


def _reveals(u0: Floats, u1: Floats, v0: Floats, v1: Floats, y: float, width: float) -> Floats:
    front = _upright(u0, u1, v0, v1, 0.0, width)
    back = _upright(u0, u1, v0, v1, y, width)
    sides = [
        np.stack([front[:, k], front[:, (k + 1) % 4], back[:, (k + 1) % 4], back[:, k]], 1)
        for k in range(4)
    ]
    return np.concatenate(sides)


def building(
    rng: np.random.Generator,
    length: float,
    depth: float,
    height: float,
    shop: bool = False,
    gable: bool = False,
) -> Mesh:
    """A house, ``length`` along x and ``depth`` along y, centred, its foot at z = 0.

    Ledges and balconies stand out of the walls.
    """
    colour = WALLS[rng.integers(len(WALLS))]
    paint = Paint(50, colour, float(rng.uniform(0.25, 0.6)))
    storey, pitch = float(rng.uniform(2.8, 3.2)), float(rng.uniform(2.3, 3.2))
    recess = float(rng.uniform(0.08, 0.25))
    parts = []
    for yaw, width, out in (
        (0.0, length, depth),
        (0.5 * np.pi, depth, length),
        (np.pi, length, depth),
        (1.5 * np.pi, depth, length),
    ):
        face = wall(width, height, paint, storey, shop, pitch, recess)
        parts.append(face.moved(pose_of(0, 0, 0, yaw) @ pose_of(0, -0.5 * out, 0)))
    parts += _ledges(length, depth, height, storey, paint, shop)
    parts.append(_gable(length, depth, height) if gable else _flat(length, depth, height))
    if not gable:
        parts += _balconies(rng, length, depth, height, storey)
    return merged(parts)


def _ledges(
    length: float, depth: float, height: float, storey: float, paint: Paint, shop: bool
) -> list[Mesh]:
    parts = [box((length + 0.3, depth + 0.3, 0.25), (0, 0, height - 0.1), paint)]
    if shop:
        parts.append(box((length + 0.2, depth + 0.2, 0.12), (0, 0, storey - 0.15), paint))
    return parts


def _balconies(
    rng: np.random.Generator, length: float, depth: float, height: float, storey: float
) -> list[Mesh]:
    if rng.random() < 0.5:
        return []
    slab = Paint(50, (0.6, 0.6, 0.58), 0.4)
    parts = []
    for floor in range(1, int(height / storey)):
        for x in np.arange(-0.5 * length + 3, 0.5 * length - 2, 6.0):
            for side in (-1, 1):
                y, z = side * (0.5 * depth + 0.55), floor * storey
                parts.append(box((2.2, 1.1, 0.15), (x, y, z), slab))
                parts.append(box((2.2, 0.05, 0.9), (x, y + side * 0.52, z + 0.5), slab))
    return parts


def _flat(length: float, depth: float, height: float) -> Mesh:
    corners = [(-length, -depth), (length, -depth), (length, depth), (-length, depth)]
    top = [(0.5 * x, 0.5 * y, height) for x, y in corners]
    return quads([top], Paint(50, (0.35, 0.34, 0.33), 0.2))


def _gable(length: float, depth: float, height: float) -> Mesh:
    tiles = Paint(50, (0.45, 0.22, 0.17), 0.3)
    x, y, rise = 0.5 * length + 0.3, 0.5 * depth + 0.5, 0.4 * depth
    eaves, ridge = height - 0.25, height + rise
    slopes = [
        [(-x, -y, eaves), (x, -y, eaves), (x, 0, ridge), (-x, 0, ridge)],
        [(x, y, eaves), (-x, y, eaves), (-x, 0, ridge), (x, 0, ridge)],
    ]
    ends = []
    for sign in (-1, 1):
        e, w = sign * 0.5 * length, 0.5 * depth
        ends.append(
            [(e, -w, height - 0.1), (e, w, height - 0.1), (e, 0, ridge - 0.1), (e, 0, ridge - 0.1)]
        )
    return merged([quads(slopes, tiles), quads(ends, Paint(50, (0.75, 0.72, 0.66), 0.4))])
