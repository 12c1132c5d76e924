"""Meshes of lorries, buses and trailers: x forward, z up, origin on the ground below the centre."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from docdepth.synthetic.actors import Part, Swing
from docdepth.synthetic.mesh import Colour, Mesh, Paint, box, merged
from docdepth.synthetic.road import Floats
from docdepth.synthetic.road_users import CAR_COLOURS, plates_and_lamps, wheels

Rng = np.random.Generator
_GLASS: Colour = (0.13, 0.16, 0.18)
# A bus: length, width, height, and where its two doors begin and end, from its centre [m].
_BUS = (12.0, 2.55, 3.1)
_DOORS = ((3.9, 5.2), (-1.1, 0.5))
_FLOOR = 0.32


def bus(rng: Rng, opens: float = np.inf, closes: float = np.inf, label: int = 13) -> list[Part]:
    """A city bus, 12 m long and 3.1 m high, with two doors on its right side.

    Parameters
    ----------
    opens, closes : float
        When the doors slide open and shut [s].
    """
    length, width, height = _BUS
    colour, reflectivity = CAR_COLOURS[rng.integers(4, len(CAR_COLOURS))]
    paint, dark = Paint(label, colour, reflectivity), Paint(label, (0.1, 0.1, 0.1), 0.1)
    glass = Paint(label, _GLASS, 0.03)
    cuts = sorted([-0.5 * length, 0.5 * length, *(x for door in _DOORS for x in door)])
    parts = [box((length, width, 0.3), (0, 0, height - 0.15), paint)]
    for rear, front in pairwise(cuts):
        behind_door = (rear, front) in _DOORS
        # Behind a door the body is a step deep, so that an open door shows the inside.
        deep = 0.6 if behind_door else 0.0
        wall = (front - rear, width - deep, height - 0.3 - _FLOOR)
        middle = (0.5 * (rear + front), 0.5 * deep, _FLOOR + 0.5 * wall[2])
        parts.append(box(wall, middle, dark if behind_door else paint))
        if not behind_door and front - rear > 1.0:
            pane = (front - rear - 0.3, width + 0.02, 1.1)
            parts.append(box(pane, (middle[0], 0, 2.05), glass))
    parts.append(box((0.03, width - 0.3, 1.5), (0.5 * length, 0, 1.9), glass))
    parts.append(wheels(label, (-2.9, 2.9), width - 0.04, 0.48))
    parts.append(plates_and_lamps(label, length, width, 0.8))
    result = [Part(merged(parts))]
    for rear, front in _DOORS:
        size = (front - rear, 0.05, height - 0.45 - _FLOOR)
        middle = (0.5 * (rear + front), -0.5 * width, _FLOOR + 0.5 * size[2])
        frame = box((size[0], 0.03, size[2]), middle, paint)
        window = box((size[0] - 0.3, 0.05, 1.6), (middle[0], middle[1], 1.6), glass)
        # It slides outside the wall, to the rear.
        slide = sliding((rear - front, -0.12, 0.0), opens, closes)
        result.append(Part(merged([frame, window]), slide))
    return result


def sliding(to: ArrayLike, opens: float, closes: float, seconds: float = 1.5) -> Swing:
    """A door that slides by ``to`` (x, y, z) [m] from ``opens`` on, and back from ``closes`` on."""
    shift = np.asarray(to, np.float64)

    def swing(times: Floats, distance: Floats, speed: Floats) -> Floats:
        share = np.clip((times - opens) / seconds, 0.0, 1.0)
        share = share - np.clip((times - closes) / seconds, 0.0, 1.0)
        poses = np.repeat(np.eye(4)[None], len(share), axis=0)
        poses[:, :3, 3] = share[:, None] * shift
        return poses

    return swing


def truck(rng: Rng, label: int = 18) -> Mesh:
    """A lorry with a box body, 3.6 m high, open between its axles."""
    colour, reflectivity = CAR_COLOURS[rng.integers(len(CAR_COLOURS))]
    length = 9.0
    half = 0.5 * length
    cab = Paint(label, colour, reflectivity)
    load = Paint(label, (0.82, 0.80, 0.74), 0.55)
    parts = [
        box((length - 2.3, 2.5, 2.55), (-1.15, 0, 2.35), load),
        box((2.0, 2.4, 2.3), (half - 1.0, 0, 1.75), cab),
        box((0.04, 2.1, 0.8), (half, 0, 2.3), Paint(label, (0.13, 0.16, 0.18), 0.03)),
        box((length - 1.0, 0.9, 0.25), (-0.2, 0, 0.85), Paint(label, (0.1, 0.1, 0.1), 0.1)),
        wheels(label, (-half + 1.2, -half + 2.5, half - 1.3), 2.45, 0.5),
        plates_and_lamps(label, length, 2.4, 0.8),
    ]
    return merged(parts)


def trailer(rng: Rng, label: int = 20) -> Mesh:
    """A car's trailer with a box, 2.6 m long without its drawbar, 1.9 m high."""
    load = Paint(label, (0.55, 0.58, 0.6), float(rng.uniform(0.2, 0.5)))
    steel = Paint(label, (0.4, 0.42, 0.42), 0.35)
    parts = [
        box((2.6, 1.5, 1.4), (-0.3, 0, 1.2), load),
        box((1.3, 0.08, 0.08), (1.6, 0, 0.48), steel),
        wheels(label, (-0.4,), 1.75, 0.3),
    ]
    return merged(parts)


def lorry_trailer(label: int = 18) -> Mesh:
    """A lorry's trailer with a box body, 8 m long without its drawbar, 3.8 m high."""
    load = Paint(label, (0.70, 0.72, 0.76), 0.5)
    steel = Paint(label, (0.1, 0.1, 0.1), 0.1)
    parts = [
        box((8.0, 2.5, 2.75), (0, 0, 2.43), load),
        box((7.6, 0.9, 0.25), (0, 0, 0.93), steel),
        box((1.2, 0.12, 0.12), (4.5, 0, 0.85), steel),
        wheels(label, (-2.9, -1.6, 2.9), 2.45, 0.5),
    ]
    return merged(parts)


LARGE_VEHICLES = {
    "truck": (lambda rng: [Part(truck(rng))], 18, 258, 5.5, 2.1),
    "bus": (bus, 13, 257, 5.8, 2.1),
    "trailer": (lambda rng: [Part(trailer(rng, 20))], 20, 259, 2.0, 1.6),
    "lorry trailer": (lambda rng: [Part(lorry_trailer(18))], 18, 258, 4.6, 2.1),
}
"""Kinds of actors, as in :data:`docdepth.synthetic.street.KINDS`."""
