"""Meshes of vehicles and people: x forward, z up, origin on the ground below the centre."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from docdepth.synthetic.actors import Part, swinging
from docdepth.synthetic.mesh import Colour, Mesh, Paint, ball, box, loft, merged, tube

Rng = np.random.Generator
CAR_COLOURS: tuple[tuple[Colour, float], ...] = (
    ((0.75, 0.76, 0.78), 0.5),
    ((0.90, 0.90, 0.88), 0.7),
    ((0.10, 0.10, 0.11), 0.05),
    ((0.30, 0.32, 0.35), 0.15),
    ((0.45, 0.07, 0.07), 0.3),
    ((0.12, 0.20, 0.42), 0.2),
    ((0.20, 0.32, 0.24), 0.2),
)
CLOTHES: tuple[Colour, ...] = (
    (0.15, 0.18, 0.30),
    (0.50, 0.15, 0.15),
    (0.20, 0.35, 0.25),
    (0.60, 0.58, 0.50),
    (0.25, 0.25, 0.27),
    (0.75, 0.65, 0.20),
)


def _hull(stations: Sequence[tuple[float, ...]], paint: Paint) -> Mesh:
    """A body from stations (x, z_low, z_high, width_low, width_high), with bevelled edges."""
    x, low, high, below, above = np.array(stations, np.float64).T
    bevel = 0.18 * (high - low)
    y = np.stack([0.46 * below, 0.5 * below, 0.5 * above, 0.42 * above], axis=1)
    z = np.stack([low, low + bevel, high - bevel, high], axis=1)
    y = np.concatenate([-y, y[:, ::-1]], axis=1)
    z = np.concatenate([z, z[:, ::-1]], axis=1)
    return loft(np.stack([np.repeat(x[:, None], 8, axis=1), y, z], axis=2), paint)


def wheels(label: int, xs: tuple[float, ...], track: float, radius: float) -> Mesh:
    tyre = Paint(label, (0.06, 0.06, 0.06), 0.08)
    rim = Paint(label, (0.55, 0.55, 0.57), 0.4)
    parts = []
    for x in xs:
        for side in (-1.0, 1.0):
            hub = np.array([(x, side * (0.5 * track - 0.2), radius), (x, side * track / 2, radius)])
            parts.append(tube(hub, radius, tyre, 14))
            parts.append(tube(hub + np.array((0, side * 0.015, 0)), 0.6 * radius, rim, 10))
    return merged(parts)


def plates_and_lamps(label: int, length: float, width: float, height: float) -> Mesh:
    plate = Paint(label, (0.9, 0.9, 0.85), 2.0)
    lamp = Paint(label, (0.6, 0.1, 0.08), 1.5)
    head = Paint(label, (0.85, 0.85, 0.8), 0.6)
    parts = [box((0.02, 0.5, 0.11), (sign * 0.5 * length, 0, 0.45), plate) for sign in (-1, 1)]
    for side in (-1, 1):
        y = side * 0.36 * width
        parts.append(box((0.04, 0.25, 0.12), (-0.5 * length, y, height), lamp))
        parts.append(box((0.06, 0.3, 0.12), (0.5 * length - 0.02, y, height - 0.1), head))
    return merged(parts)


def car(rng: Rng) -> Mesh:
    """A saloon, hatchback or estate car, 4.0 to 4.8 m long."""
    colour, reflectivity = CAR_COLOURS[rng.integers(len(CAR_COLOURS))]
    paint = Paint(10, colour, reflectivity)
    glass = Paint(10, (0.13, 0.16, 0.18), 0.03)
    half, width = 0.5 * rng.uniform(4.0, 4.8), rng.uniform(1.72, 1.86)
    height = rng.uniform(1.42, 1.56)
    belt, floor = rng.uniform(0.86, 0.94), rng.uniform(0.17, 0.22)
    tail = (0.9, 1.25, 1.55)[rng.integers(3)]  # saloon, hatchback, estate
    body = [
        (-half, floor + 0.18, belt - 0.12, 0.90 * width, 0.86 * width),
        (-half + 0.12, floor + 0.05, belt, 0.98 * width, 0.94 * width),
        (-0.3 * half, floor, belt + 0.02, width, width),
        (0.45 * half, floor, belt, width, width),
        (half - 0.35, floor + 0.02, 0.80 * belt, 0.97 * width, 0.92 * width),
        (half, floor + 0.12, 0.66 * belt, 0.84 * width, 0.78 * width),
    ]
    rear = -half + {0.9: 0.75, 1.25: 0.35, 1.55: 0.12}[tail]
    cabin = [
        (rear, belt - 0.1, belt + 0.02, 0.9 * width, 0.86 * width),
        (rear + (0.25 if tail > 1.3 else 0.55), belt - 0.1, height - 0.06, 0.9 * width, 1.25),
        (-0.05 * half, belt - 0.1, height, 0.93 * width, 1.3),
        (0.16 * half, belt - 0.1, height - 0.04, 0.93 * width, 1.28),
        (0.60 * half, belt - 0.12, belt + 0.02, 0.88 * width, 0.86 * width),
    ]
    roof = [
        (rear + 0.5, height - 0.09, height - 0.03, 1.28, 1.22),
        (-0.05 * half, height - 0.05, height + 0.015, 1.32, 1.26),
        (0.16 * half, height - 0.08, height - 0.02, 1.3, 1.24),
    ]
    mirrors = [
        box((0.12, 0.18, 0.14), (0.38 * half, side * (0.5 * width + 0.09), belt + 0.05), paint)
        for side in (-1, 1)
    ]
    return merged(
        [
            _hull(body, paint),
            _hull(cabin, glass),
            _hull(roof, paint),
            *mirrors,
            wheels(10, (-0.58 * half, 0.62 * half), width - 0.04, 0.31),
            plates_and_lamps(10, 2 * half, width, 0.72),
        ]
    )


def van(rng: Rng) -> Mesh:
    """A delivery van, 5 to 5.6 m long, 2.1 to 2.5 m high."""
    colour, reflectivity = CAR_COLOURS[rng.integers(2)]
    paint = Paint(20, colour, reflectivity)
    glass = Paint(20, (0.13, 0.16, 0.18), 0.03)
    half, height, width = 0.5 * rng.uniform(5.0, 5.6), rng.uniform(2.1, 2.5), 1.98
    body = [
        (-half, 0.38, height - 0.06, width, 0.90 * width),
        (-half + 0.1, 0.28, height, width, 0.93 * width),
        (half - 1.75, 0.26, height, width, 0.93 * width),
        (half - 1.35, 0.26, height - 0.12, width, 0.92 * width),
        (half - 0.65, 0.27, 1.28, width, 0.95 * width),
        (half - 0.06, 0.30, 1.0, 0.95 * width, 0.9 * width),
        (half, 0.36, 0.9, 0.88 * width, 0.84 * width),
    ]
    pane = [(half - 1.3, 1.3, height - 0.2, 1.75, 1.6), (half - 0.6, 1.26, 1.4, 1.8, 1.75)]
    tyres = wheels(20, (-0.55 * half, 0.62 * half), width - 0.04, 0.34)
    trim = plates_and_lamps(20, 2 * half, width, 0.95)
    return merged([_hull(body, paint), _hull(pane, glass), tyres, trim])


def pedestrian(rng: Rng) -> list[Part]:
    """A person, 1.55 to 1.9 m tall, with swinging legs and arms."""
    tall = rng.uniform(1.55, 1.9) / 1.75
    shirt = Paint(30, CLOTHES[rng.integers(len(CLOTHES))], float(rng.uniform(0.15, 0.6)))
    trousers = Paint(30, CLOTHES[rng.integers(len(CLOTHES))], float(rng.uniform(0.1, 0.4)))
    skin = Paint(30, (0.75, 0.58, 0.47), 0.4)
    torso = np.array([(0, 0, 0.84), (0.02, 0, 1.05), (0.01, 0, 1.32), (0, 0, 1.5)]) * tall
    body = tube(torso, np.array((0.15, 0.15, 0.18, 0.09)) * tall, shirt, 8)
    body.vertices[:, 1] *= 1.35
    head = ball(np.array((0.02, 0, 1.64)) * tall, np.array((0.1, 0.085, 0.125)) * tall, skin, 8)
    phase = float(rng.uniform(0, 2 * np.pi))
    parts = [Part(merged([body, head]))]
    for side in (-1.0, 1.0):
        hip = np.array((0.0, side * 0.09, 0.88)) * tall
        leg = np.array([(0, side * 0.09, 0.88), (0.03, side * 0.09, 0.47), (0, side * 0.09, 0.06)])
        foot = box((0.26, 0.1, 0.08), (0.06, side * 0.09 * tall, 0.05), trousers)
        shape = merged([tube(leg * tall, np.array((0.1, 0.075, 0.055)) * tall, trousers, 6), foot])
        parts.append(Part(shape, swinging(hip, 0.42, 1.4 * tall, phase + (side > 0) * np.pi)))
        shoulder = np.array((0.0, side * 0.23, 1.42)) * tall
        arm = np.array(
            [(0, side * 0.23, 1.42), (-0.02, side * 0.26, 1.1), (0.1, side * 0.25, 0.85)]
        )
        limb = tube(arm * tall, np.array((0.055, 0.045, 0.035)) * tall, shirt, 6)
        parts.append(Part(limb, swinging(shoulder, 0.3, 1.4 * tall, phase + (side < 0) * np.pi)))
    return parts


@lru_cache(maxsize=2)
def bicycle(label: int = 11) -> Mesh:
    """A bicycle without its rider."""
    frame = Paint(label, (0.15, 0.15, 0.17), 0.2)
    parts = []
    for x in (-0.52, 0.52):
        angle = 2 * np.pi * np.arange(17) / 16
        rim = np.stack([x + 0.33 * np.cos(angle), 0 * angle, 0.34 + 0.33 * np.sin(angle)], axis=1)
        parts += [tube(rim[k : k + 2], 0.02, frame, 4) for k in range(16)]
        parts += [tube(rim[[k, k + 8]], 0.004, frame, 3) for k in range(0, 8, 2)]
    bars = [
        ((-0.52, 0, 0.34), (-0.2, 0, 0.9)),
        ((-0.2, 0, 0.9), (-0.08, 0, 0.3)),
        ((-0.08, 0, 0.3), (0.4, 0, 0.85)),
        ((-0.17, 0, 0.82), (0.4, 0, 0.85)),
        ((0.52, 0, 0.34), (0.38, 0, 1.02)),
        ((-0.52, 0, 0.34), (-0.08, 0, 0.3)),
        ((0.36, -0.28, 1.03), (0.36, 0.28, 1.03)),
    ]
    parts += [tube(np.array(ends), 0.02, frame, 5) for ends in bars]
    parts.append(box((0.24, 0.14, 0.06), (-0.22, 0, 0.95), frame))
    return merged(parts)


def cyclist(rng: Rng) -> list[Part]:
    """A rider on a bicycle, with moving legs."""
    shirt = Paint(31, CLOTHES[rng.integers(len(CLOTHES))], float(rng.uniform(0.2, 0.7)))
    trousers = Paint(31, (0.12, 0.13, 0.18), 0.15)
    skin = Paint(31, (0.75, 0.58, 0.47), 0.4)
    torso = tube([(-0.22, 0, 0.95), (-0.1, 0, 1.2), (0.06, 0, 1.45)], (0.15, 0.17, 0.14), shirt)
    torso.vertices[:, 1] *= 1.2
    parts = [bicycle(31), torso, ball((0.14, 0, 1.63), (0.11, 0.09, 0.13), skin)]
    for side in (-1.0, 1.0):
        arm = [(0.04, side * 0.2, 1.42), (0.18, side * 0.26, 1.2), (0.36, side * 0.26, 1.05)]
        parts.append(tube(arm, (0.05, 0.045, 0.035), shirt, 6))
    result = [Part(merged(parts))]
    for side in (-1.0, 1.0):
        leg = [(-0.2, side * 0.1, 0.93), (0.15, side * 0.12, 0.68), (-0.02, side * 0.12, 0.28)]
        pivot = (-0.2, side * 0.1, 0.93)
        limb = tube(leg, (0.09, 0.07, 0.05), trousers, 6)
        result.append(Part(limb, swinging(pivot, 0.25, 4.5, (side > 0) * np.pi)))
    return result
