"""A street on which people and cyclists go in groups, one close behind the other."""

from __future__ import annotations

import numpy as np

from docdepth.synthetic.actors import Pace, Path
from docdepth.synthetic.street import Scene, Street, generator
from docdepth.synthetic.urban_street import add_furniture, add_houses, blocks, urban_road
from scenes import things


def groups(seed: int) -> Scene:
    """A school class in pairs, friends, couples, joggers and cyclists in single file, by fences."""
    rng = generator("groups", seed)
    start, end, kerb, walk = -110.0, 200.0, 5.0, 8.5
    bend = ((0.05, 220.0, rng.uniform(0, 6.3)),)
    hills = ((0.9, 180.0, rng.uniform(0, 6.3)),)
    road = urban_road(start, end, bend, hills, kerb, walk, [])
    street = Street(road, rng)
    add_houses(street, blocks(start, end, []), walk, 13.0)
    add_furniture(street, start, end, kerb, [], 0.5)
    for side in (-1.0, 1.0):
        for s in np.arange(start + 10, end - 10, 14.0):
            street.put(things.fence(10.0), s, side * (walk - 0.3), 0.0 if side > 0 else np.pi)
        street.parked_row(np.arange(start + 3, end - 3, 6.3), side * 4.1, 0.5, 0.0)

    def file(
        kind: str, s: float, d: float, speed: float, count: int, apart: float, start: float = 0
    ) -> None:
        """``count`` of a kind go from ``start`` [s] on, ``apart`` [m] behind each other."""
        for k in range(count):
            begin = s - np.sign(speed) * apart * k
            offset = d + float(rng.normal(0, 0.08))
            points = [(begin, offset), (begin + np.sign(speed) * 80, offset)]
            street.send(kind, points, Pace(abs(speed), departure=start))

    for d in (-6.3, -7.1):
        file("pedestrian", 22.0, d, 1.1, 5, 1.2)  # a class
    file("pedestrian", 34.0, 6.4, -1.25, 3, 1.0, 2.0)
    for d in (6.2, 6.9):
        file("pedestrian", 12.0, d, 1.0, 2, 1.1)
    file("pedestrian", 52.0, 7.3, -2.8, 4, 2.0)  # joggers
    file("cyclist", 48.0, 2.6, -7.0, 5, 2.6)
    file("cyclist", 26.0, -3.0, 5.5, 3, 2.8)
    street.send("car", [(90.0, 1.6), (-60.0, 1.6)], Pace(8.0))
    ego = Path(road, [(0.0, -1.6), (60.0, -1.6)], Pace(5.0, wave=0.1))
    return street.scene("groups", ego, 20.0)
