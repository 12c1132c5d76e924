"""Plants, fences and cottages beside roads, standing on z = 0."""

from __future__ import annotations

import numpy as np

from docdepth.synthetic.mesh import Mesh, Paint, ball, box, leaves, loft, merged, quads, scattered
from docdepth.synthetic.roadside import walls

Rng = np.random.Generator
_TILES = Paint(50, (0.45, 0.22, 0.17), 0.3)
_GABLE = Paint(50, (0.75, 0.72, 0.66), 0.4)


def cottage(rng: Rng, length: float, depth: float, height: float) -> Mesh:
    """A house with a gable roof, ``length`` along x and ``depth`` along y."""
    parts, _ = walls(rng, length, depth, height)
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
    return merged([*parts, quads(slopes, _TILES), quads(ends, _GABLE)])


def bush(rng: Rng, radius: float = 0.8) -> Mesh:
    """A shrub: leaves around a dense core."""
    paint = Paint(70, (0.19, 0.32, 0.12), 0.5)
    radii = radius * np.array((1.0, 1.0, 0.8))
    centre = (0, 0, 0.6 * radius)
    core = ball(centre, 0.6 * radii, paint, 7)
    cloud = leaves(scattered(int(160 * radius), centre, radii, rng), 0.22, paint, rng)
    return merged([core, cloud])


def hedge(rng: Rng, length: float, height: float = 1.5, width: float = 0.7) -> Mesh:
    """A trimmed hedge along x: a solid core covered with leaves."""
    paint = Paint(70, (0.17, 0.30, 0.12), 0.5)
    core = box((length, 0.6 * width, height - 0.2), (0, 0, 0.5 * height - 0.1), paint)
    count = int(length * (2 * height + width) * 26)
    points = rng.uniform(-0.5, 0.5, (count, 3)) * (length, width, height) + (0, 0, 0.5 * height)
    # Leaves lie on the surface: on one of the two sides, or on top.
    side = rng.random(count) < 2 * height / (2 * height + width)
    depth = rng.exponential(0.06, count)
    points[side, 1] = (np.sign(points[:, 1]) * (0.5 * width - depth))[side]
    points[~side, 2] = (height - depth)[~side]
    return merged([core, leaves(points, 0.17, paint, rng)])


def fence(length: float, height: float = 1.1) -> Mesh:
    """A picket fence along x; rays pass between its slats."""
    paint = Paint(51, (0.55, 0.45, 0.33), 0.4)
    parts = [box((length, 0.04, 0.07), (0, 0, z), paint) for z in (0.25, height - 0.25)]
    for x in np.arange(-0.5 * length + 0.05, 0.5 * length, 0.16):
        parts.append(box((0.09, 0.02, height), (x, 0.03, 0.5 * height), paint))
    return merged(parts)


def guard_rail(length: float) -> Mesh:
    """A steel rail on posts along x."""
    paint = Paint(51, (0.58, 0.60, 0.62), 0.5)
    outline = np.array([(0, 0.46), (0.06, 0.53), (0, 0.60), (0.06, 0.67), (0, 0.76), (-0.05, 0.6)])
    ends = np.array([(-0.5 * length, 0, 0), (0.5 * length, 0, 0)])
    section = np.column_stack([np.zeros(6), outline])
    parts = [loft(ends[:, None] + section, paint)]
    for x in np.arange(-0.5 * length + 1, 0.5 * length, 2.0):
        parts.append(box((0.1, 0.06, 1.0), (x, -0.09, 0.25), paint))
    return merged(parts)
