"""Meshes of plants and street furniture, standing on z = 0."""

from __future__ import annotations

import numpy as np

from docdepth.synthetic.mesh import Colour, Mesh, Paint, box, leaves, merged, scattered, tube

Rng = np.random.Generator


def tree(rng: Rng, height: float = 8.0, label: int = 70) -> Mesh:
    """A tree: trunk, branches and a crown of single leaves."""
    bark = Paint(71, (0.30, 0.24, 0.18), 0.25)
    green = (0.20, 0.34, 0.12) if rng.random() < 0.8 else (0.33, 0.36, 0.12)
    paint = Paint(label, green, 0.5)
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
