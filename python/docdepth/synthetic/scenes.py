"""Scenes by name: a city street and a crossing."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from docdepth.errors import InputError
from docdepth.synthetic.actors import Pace, Path
from docdepth.synthetic.street import Scene, Street, generator
from docdepth.synthetic.urban_street import add_furniture, add_houses, away_from, blocks, urban_road

# Centre of a lane, from the centre line [m].
_LANE = 1.75


def city(seed: int) -> Scene:
    """A busy street at 9 m/s: houses, parked cars, two junctions and many pedestrians."""
    rng = generator("city", seed)
    start, end, kerb, walk = -130.0, 370.0, 5.6, 9.6
    junctions = [(72.0, 5.0), (205.0, 5.0)]
    bend = ((0.09, 420.0, rng.uniform(0, 6.3)), (0.03, 160.0, rng.uniform(0, 6.3)))
    hills = ((1.6, 260.0, rng.uniform(0, 6.3)), (0.25, 70.0, rng.uniform(0, 6.3)))
    road = urban_road(start, end, bend, hills, kerb, walk, junctions, parking=3.5)
    street = Street(road, rng)
    add_houses(street, blocks(start, end, junctions), walk, 13.0)
    add_furniture(street, start, end, kerb, junctions, 0.75)
    waiting = {1.0: (46.0, 150.0), -1.0: (112.0, 180.0)}
    for side in (-1.0, 1.0):
        spots = away_from(np.arange(start + 3, end - 3, 6.1), junctions, 7.0)
        spots = away_from(spots, [(s, 0.0) for s in waiting[side]], 6.5)
        street.parked_row(spots, side * 4.55, 0.72, 0.0 if side < 0 else np.pi)
    for side, into, far, speed, patience in ((1.0, -9, -200, 8.0, 0.06), (-1.0, 9, 300, 10.0, 0.1)):
        for s in waiting[side]:
            points = [(s, side * 4.5), (s + into, side * _LANE), (s + far, side * _LANE)]
            pace = Pace(speed, departure=2.0 + patience * (s - waiting[side][0]))
            street.send("car", points, pace, name="leaves its parking place")
    _city_traffic(street)
    ego = Path(road, [(0.0, -_LANE), (100.0, -_LANE)], Pace(9.0, wave=0.06))
    return street.scene("city", ego, 24.0)


def _city_traffic(street: Street) -> None:
    """Vehicles, cyclists and pedestrians."""
    rng = street.rng
    street.send("car", [(24.0, -_LANE), (80.0, -_LANE)], Pace(9.4, wave=0.05))
    street.send("cyclist", [(33.0, -3.05), (90.0, -3.05)], Pace(4.6, wave=0.1))
    street.send("cyclist", [(98.0, 3.0), (10.0, 3.0)], Pace(5.2))
    for s, kind in ((16.0, "car"), (92.0, "car"), (128.0, "van"), (196.0, "car"), (250.0, "car")):
        street.send(kind, [(s, _LANE), (s - 60, _LANE)], Pace(float(rng.uniform(8.5, 10.5))))
    street.send("car", [(73.8, 24.0), (73.8, -60.0)], Pace(8.0))
    street.send("car", [(70.2, -9.0), (70.2, 60.0)], Pace(7.0, departure=12.0), name="gives way")
    for s, d, speed in (
        (12.0, -7.4, 1.3), (18.0, -8.3, -1.1), (19.0, -8.9, -1.15), (35.0, 7.6, 1.2),
        (41.0, 8.9, -0.9), (55.0, -7.0, 1.0), (62.0, 6.9, -1.45), (90.0, -8.6, -1.25),
        (97.0, 8.0, 1.35), (118.0, -7.5, 0.9), (125.0, 8.8, -1.0), (160.0, -8.4, -1.3),
        (185.0, 7.3, 1.1),
    ):  # fmt: skip
        street.walk(s, d + float(rng.normal(0, 0.15)), speed)
    street.send("pedestrian", [(64.5, 6.4), (64.5, -9.0)], Pace(1.3, wave=0.05), start=2.2)
    street.send("pedestrian", [(101.0, -8.0), (101.0, 8.0)], Pace(1.1, departure=1.0))
    to_its_car = [(27.0, 7.5), (28.5, 5.0), (29.0, 3.3), (35.0, 3.2)]
    street.send("pedestrian", to_its_car, Pace(0.95), name="to its car")


def crossing(seed: int) -> Scene:
    """A wide junction: the ego stands for three seconds, then approaches it slowly."""
    rng = generator("crossing", seed)
    start, end, kerb, walk, centre, half = -120.0, 190.0, 7.2, 11.5, 30.0, 7.0
    junctions = [(centre, half)]
    hills = ((0.9, 240.0, rng.uniform(0, 6.3)),)
    road = urban_road(start, end, ((0.02, 300.0, 0.5),), hills, kerb, walk, junctions)
    street = Street(road, rng)
    add_houses(street, blocks(start, end, junctions), walk, 15.0)
    add_furniture(street, start, end, kerb, junctions, 0.5)
    for side in (-1.0, 1.0):
        spots = np.arange(centre + half + 22, end - 5, 6.2)
        street.parked_row(spots, side * 6.2, 0.6, 0.0 if side < 0 else np.pi)
        street.parked_row(np.arange(start + 5, -14.0, 6.2), side * 6.2, 0.6, np.pi)
    _crossing_traffic(street, centre + half)
    pace = Pace(1.2, departure=3.0, acceleration=0.5)
    ego = Path(road, [(0.0, -_LANE), (60.0, -_LANE)], pace)
    return street.scene("crossing", ego, 30.0)


def _crossing_traffic(street: Street, far_side: float) -> None:
    """Cross traffic, cars that wait at the light, and pedestrians."""
    for kind, s, begin, end, speed in (
        ("car", 26.6, 34.0, -90.0, 9.0),
        ("car", 26.8, 62.0, -90.0, 8.0),
        ("car", 27.0, 84.0, -90.0, 9.5),
        ("car", 33.2, -18.0, 90.0, 8.5),
        ("car", 33.4, -45.0, 90.0, 9.0),
        ("van", 33.2, -70.0, 90.0, 8.6),
        ("cyclist", 24.6, 14.0, -80.0, 4.2),
    ):
        street.send(kind, [(s, begin), (s, end)], Pace(speed))
    for kind, s, d, end, speed, departure in (
        ("car", far_side + 5, 1.9, -120, 9.0, 3.5),
        ("van", far_side + 11.5, 1.9, -120, 9.0, 3.5 + 1.3),
        ("car", far_side + 18.5, 1.9, -120, 9.0, 3.5 + 2.6),
        ("car", 13.5, -5.2, 140, 8.0, 4.0),
        ("car", 6.5, -5.2, 140, 8.0, 4.0 + 1.3),
    ):
        pace = Pace(speed, departure=departure)
        street.send(kind, [(s, d), (s + end, d)], pace, name="waits at the light")
    for s, d, speed, start_at in (
        (20.5, 9.0, 1.3, 2.5),
        (19.6, 9.2, 1.2, 0.0),
        (20.9, -8.5, -1.4, 1.0),
        (39.5, -8.0, -1.15, 3.0),
        (40.2, 8.5, 1.0, 4.0),
    ):
        points = [(s, d), (s, -d)] if speed > 0 else [(s, d), (s + 0.5, -d)]
        street.send("pedestrian", points, Pace(abs(speed), wave=0.05), start=start_at)
    for s, d, speed in (
        (4.0, -8.9, 1.25), (15.0, 9.4, -1.0), (16.0, -10.6, -1.3), (45.0, 9.9, 0.95),
        (52.0, -9.0, 1.1), (9.0, 8.3, 1.45), (60.0, 10.8, -1.2),
    ):  # fmt: skip
        street.walk(s, d, speed)
    stands = Pace(1.0, departure=99.0)
    street.send("pedestrian", [(17.0, -8.4), (30.0, -8.4)], stands, name="stands")


SCENES: dict[str, Callable[[int], Scene]] = {"city": city, "crossing": crossing}
"""Makers of scenes by name, called with a seed. The benchmarks add more."""


def scene(name: str, seed: int = 0) -> Scene:
    """Build a street with its traffic; equal names and seeds give equal scenes.

    Parameters
    ----------
    seed : int
        Varies bends, slopes, houses, plants and vehicles.
    """
    if name not in SCENES:
        raise InputError(f"unknown scene {name!r}; there are {', '.join(SCENES)}")
    return SCENES[name](seed)
