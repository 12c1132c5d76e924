"""A street of fences: what rays pass, and nothing that moves but a few road users."""

from __future__ import annotations

from functools import partial

import numpy as np

from docdepth.synthetic import roadside
from docdepth.synthetic.actors import Pace, Path
from docdepth.synthetic.mesh import Mesh, Paint, box, merged, quads, tube
from docdepth.synthetic.street import Ground, Scene, Street, generator
from docdepth.synthetic.urban_street import urban_road
from scenes import things

_STEEL = Paint(51, (0.55, 0.57, 0.58), 0.4)
_SECTION = 24.0  # of a roadside with one kind of fence [m]


def fences(seed: int) -> Scene:
    """Mesh, pickets, railings, guard rails, hedges and scaffolds; two cars, a cyclist, a walker."""
    street, ego = _street("fences", seed)
    street.send("car", [(24.0, -1.6), (130.0, -1.6)], Pace(9.0, wave=0.1))
    street.send("car", [(150.0, 1.6), (0.0, 1.6)], Pace(10.0))
    street.send("cyclist", [(70.0, 2.9), (0.0, 2.9)], Pace(4.5))
    street.walk(30.0, -4.7, 1.2)
    return street.scene("fences", ego, 20.0)


def still_fences(seed: int) -> Scene:
    """The street of ``fences`` where nothing moves but the ego vehicle."""
    street, ego = _street("still_fences", seed)
    return street.scene("still_fences", ego, 20.0)


def _street(name: str, seed: int) -> tuple[Street, Path]:
    rng = generator(name, seed)
    start, end, kerb, walk = -100.0, 260.0, 4.2, 6.2
    bend = ((0.12, 220.0, rng.uniform(0, 6.3)), (0.04, 90.0, rng.uniform(0, 6.3)))
    hills = ((1.2, 170.0, rng.uniform(0, 6.3)),)
    road = urban_road(start, end, bend, hills, kerb, walk, [], yard=Ground.GRASS)
    street = Street(road, rng)
    hedge = partial(things.hedge, rng)
    kinds = (_mesh_fence, _pickets, _railing, things.guard_rail, hedge, _scaffold)
    for side in (-1.0, 1.0):
        for number, s in enumerate(np.arange(start + 6, end - 6, _SECTION)):
            if number % len(kinds) == 0:
                order = rng.permutation(len(kinds))
            kind = kinds[order[number % len(kinds)]]
            for at in np.arange(s, s + _SECTION - 2, 4.0):
                street.put(kind(4.0), at, side * (walk + 0.3), 0.0 if side < 0 else np.pi)
        for s in np.arange(start + 10, end - 10, 30.0):
            house = things.cottage(rng, 12.0, 8.0, float(rng.uniform(3.5, 6.0)))
            street.put(house, s + rng.uniform(-4, 4), side * (walk + 10.0), above=-0.1)
            street.put(roadside.tree(rng, 7.0), s + 13.0, side * (walk + 3.0))
    # Tram rails stand a few centimetres out of a worn road.
    for d in (-2.35, -0.9, 0.9, 2.35):
        for s in np.arange(start + 3, end - 3, 3.0):
            street.put(box((3.0, 0.07, 0.10), (0, 0, 0.0), _STEEL), s, d)
    ego = Path(road, [(0.0, -1.6), (100.0, -1.6)], Pace(8.0, wave=0.1))
    return street, ego


def _wires(places: list[tuple[float, float, float, float]], width: float) -> Mesh:
    """Flat wires in the plane y = 0, each from (x, z) to (x, z) [m]."""
    corners = []
    for x0, z0, x1, z1 in places:
        along = np.array((x1 - x0, z1 - z0)) / np.hypot(x1 - x0, z1 - z0)
        dx, dz = 0.5 * width * -along[1], 0.5 * width * along[0]
        corners.append(
            [
                (x0 + dx, 0, z0 + dz),
                (x0 - dx, 0, z0 - dz),
                (x1 - dx, 0, z1 - dz),
                (x1 + dx, 0, z1 + dz),
            ]
        )
    return quads(corners, _STEEL)


def _mesh_fence(length: float) -> Mesh:
    """A fence of wires 4 mm thick every 5 cm across and every 20 cm up, between posts."""
    x, top = 0.5 * length, 1.8
    upright = [(v, 0.05, v, top) for v in np.arange(-x, x, 0.05)]
    level = [(-x, z, x, z) for z in np.arange(0.1, top, 0.2)]
    posts = [box((0.06, 0.04, 1.9), (-x, 0, 0.95), _STEEL)]
    return merged([_wires(upright + level, 0.004), *posts])


def _pickets(length: float) -> Mesh:
    """Slats of 2.5 cm every 13 cm on two bars."""
    paint, x = Paint(51, (0.45, 0.36, 0.28), 0.4), 0.5 * length
    parts = [box((length, 0.04, 0.06), (0, 0.03, z), paint) for z in (0.25, 1.0)]
    parts += [box((0.025, 0.02, 1.2), (v, 0, 0.6), paint) for v in np.arange(-x, x, 0.13)]
    return merged(parts)


def _railing(length: float) -> Mesh:
    """Tubes of 5 cm along x, bars of 1.4 cm every 12 cm between them."""
    x = 0.5 * length
    parts = [tube([(-x, 0, z), (x, 0, z)], [0.025, 0.025], _STEEL, 6) for z in (0.15, 1.05)]
    parts += [box((0.014, 0.014, 0.9), (v, 0, 0.6), _STEEL) for v in np.arange(-x, x, 0.12)]
    return merged(parts)


def _scaffold(length: float) -> Mesh:
    """Tubes of 5 cm in two rows, two storeys high, with planks."""
    x, parts = 0.5 * length, []
    for y in (0.0, -0.9):
        for v in (-x, 0.0):
            parts.append(tube([(v, y, 0), (v, y, 4.2)], [0.024, 0.024], _STEEL, 6))
        for z in (1.0, 2.0, 3.0, 4.0):
            parts.append(tube([(-x, y, z), (x, y, z)], [0.024, 0.024], _STEEL, 6))
    wood = Paint(50, (0.6, 0.5, 0.35), 0.4)
    parts += [box((length, 0.7, 0.04), (0, -0.45, z), wood) for z in (2.0, 4.0)]
    return merged(parts)
