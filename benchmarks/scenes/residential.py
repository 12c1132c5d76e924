"""A street of houses with gardens."""

from __future__ import annotations

from functools import partial

import numpy as np

from docdepth.synthetic import road_users, roadside
from docdepth.synthetic.actors import Pace, Path
from docdepth.synthetic.road import Floats
from docdepth.synthetic.street import Ground, Scene, Street, generator
from docdepth.synthetic.urban_street import away_from, urban_road
from scenes import things


def residential(seed: int) -> Scene:
    """Houses with gardens: hedges, picket fences, slow traffic, people on the street."""
    rng = generator("residential", seed)
    start, end, kerb, walk = -110.0, 290.0, 4.2, 5.9
    junctions = [(60.0, 3.2)]
    bend = ((0.16, 260.0, rng.uniform(0, 6.3)), (0.05, 110.0, rng.uniform(0, 6.3)))
    hills = ((1.4, 190.0, rng.uniform(0, 6.3)), (0.3, 60.0, rng.uniform(0, 6.3)))
    road = urban_road(start, end, bend, hills, kerb, walk, junctions, yard=Ground.GRASS)
    street = Street(road, rng)
    for side in (-1.0, 1.0):
        _gardens(street, away_from(np.arange(start + 8, end - 8, 19.0), junctions, 9.0), side, walk)
        street.row(
            partial(roadside.pole, 5.5, 0.8, 0.06),
            np.arange(start, end, 33.0) + 9 * side,
            side * (kerb + 0.4),
            1,
            0.2,
            np.pi if side > 0 else 0.0,
        )
        spots = np.arange(start + 12, end, 47.0)
        street.row(lambda: roadside.sign(rng), spots, side * (kerb + 0.3), 0.8, 2.0)
        street.row(lambda: roadside.refuse_bin(rng), spots + 6, side * (kerb + 1.2), 0.9, 2.0)
    spots = away_from(np.arange(start, end, 6.3), junctions, 6.0)
    spots = spots[(np.abs(spots - 34.0) > 6.5)]
    street.parked_row(spots, 3.2, 0.5, np.pi)
    street.send(
        "car",
        [(34.0, 3.2), (26.0, 1.2), (-90.0, 1.2)],
        Pace(6.0, departure=1.8),
        name="leaves its parking place",
    )
    street.send("car", [(20.0, -1.6), (90.0, -1.6)], Pace(6.4, wave=0.1))
    street.send("car", [(75.0, 1.0), (10.0, 1.0)], Pace(6.0))
    street.send("van", [(150.0, 1.0), (10.0, 1.0)], Pace(6.5))
    street.send("cyclist", [(26.0, -3.2), (90.0, -3.2)], Pace(3.6, wave=0.1))
    street.send("cyclist", [(66.0, 1.3), (10.0, 1.3)], Pace(4.5))
    for s, d, speed in (
        (10.0, -4.9, 1.2),
        (16.0, 5.1, -1.0),
        (24.0, -5.2, -0.9),
        (38.0, 5.0, 1.3),
        (45.0, -4.8, 1.1),
        (44.3, -5.3, 1.1),
        (70.0, 5.2, -1.4),
        (88.0, -5.0, -1.2),
    ):
        street.walk(s, d, speed)
    street.send("pedestrian", [(52.0, -5.5), (52.0, 5.5)], Pace(0.9, departure=0.5))
    street.send("pedestrian", [(41.5, 4.9), (43.0, 2.0), (50.0, 1.9)], Pace(1.0))
    ego = Path(road, [(0.0, -1.6), (60.0, -1.6)], Pace(6.0, wave=0.1))
    return street.scene("residential", ego, 28.0)


def _gardens(street: Street, spots: Floats, side: float, walk: float) -> None:
    rng, yaw = street.rng, 0.0 if side > 0 else np.pi
    for s in spots:
        setback = float(rng.uniform(4.5, 7.0))
        length, depth = float(rng.uniform(8.5, 11.5)), float(rng.uniform(7.5, 9.5))
        house = things.cottage(rng, length, depth, float(rng.uniform(3.2, 6.2)))
        street.put(house, s, side * (walk + setback + 0.5 * depth), yaw, above=-0.05)
        border, width = rng.random(), 7.0
        for shift in (-5.6, 5.0):
            if border < 0.45:
                height = float(rng.uniform(0.9, 1.9))
                thing = things.hedge(rng, width, height)
            elif border < 0.8:
                thing = things.fence(width, float(rng.uniform(0.9, 1.3)))
            else:
                continue
            street.put(thing, s + shift, side * (walk + 0.6), yaw)
        for _ in range(rng.integers(1, 4)):
            at = side * (walk + float(rng.uniform(1.8, setback - 0.5)))
            street.put(things.bush(rng, float(rng.uniform(0.4, 1.0))), s + rng.uniform(-6, 6), at)
        if rng.random() < 0.6:
            tall = float(rng.uniform(4.0, 8.0))
            street.put(roadside.tree(rng, tall), s + 9.3, side * (walk + float(rng.uniform(2, 5))))
        if rng.random() < 0.4:
            street.park(
                road_users.car(rng), s - 0.5 * length - 2.6, side * (walk + 4.5), 0.5 * np.pi
            )
