"""Scenes with kerbs and pavements: city and crossing."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

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
    _city_parking(street, start, end, junctions)
    _city_traffic(street)
    ego = Path(road, np.array([(0.0, -_LANE), (100.0, -_LANE)]), Pace(9.0, wave=0.06))
    return street.scene("city", seed, ego, 24.0)


def _city_parking(
    street: Street, start: float, end: float, junctions: Sequence[tuple[float, float]]
) -> None:
    """Parked cars on both sides, and cars that leave their parking places."""
    waiting = {1.0: (46.0, 150.0), -1.0: (112.0, 180.0)}
    for side in (-1.0, 1.0):
        spots = away_from(np.arange(start + 3, end - 3, 6.1), junctions, 7.0)
        for s in waiting[side]:
            spots = spots[np.abs(spots - s) > 6.5]
        street.parked_row(spots, side * 4.55, 0.72, 0.0 if side < 0 else np.pi)
    for s in waiting[1.0]:
        street.send(
            "car",
            [(s, 4.5), (s - 9, _LANE), (s - 200, _LANE)],
            Pace(8.0, departure=2.0 + 0.06 * (s - 46)),
            name="leaves its parking place",
        )
    for s in waiting[-1.0]:
        street.send(
            "car",
            [(s, -4.5), (s + 9, -_LANE), (s + 300, -_LANE)],
            Pace(10.0, departure=2.0 + 0.1 * (s - 112)),
            name="leaves its parking place",
        )


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
        (12.0, -7.4, 1.3),
        (18.0, -8.3, -1.1),
        (19.0, -8.9, -1.15),
        (35.0, 7.6, 1.2),
        (41.0, 8.9, -0.9),
        (55.0, -7.0, 1.0),
        (62.0, 6.9, -1.45),
        (90.0, -8.6, -1.25),
        (97.0, 8.0, 1.35),
        (118.0, -7.5, 0.9),
        (125.0, 8.8, -1.0),
        (160.0, -8.4, -1.3),
        (185.0, 7.3, 1.1),
    ):
        street.walk(s, d + float(rng.normal(0, 0.15)), speed)
    street.send("pedestrian", [(64.5, 6.4), (64.5, -9.0)], Pace(1.3, wave=0.05), start=2.2)
    street.send("pedestrian", [(101.0, -8.0), (101.0, 8.0)], Pace(1.1, departure=1.0))
    street.send(
        "pedestrian",
        [(27.0, 7.5), (28.5, 5.0), (29.0, 3.3), (35.0, 3.2)],
        Pace(0.95),
        name="to its car",
    )


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
    ego = Path(
        road, np.array([(0.0, -_LANE), (60.0, -_LANE)]), Pace(1.2, departure=3.0, acceleration=0.5)
    )
    return street.scene("crossing", seed, ego, 30.0)


def _crossing_traffic(street: Street, far_side: float) -> None:
    """Cross traffic, cars that wait at the light, and pedestrians."""
    for s, speed, at in ((26.6, 9.0, 34.0), (26.8, 8.0, 62.0), (27.0, 9.5, 84.0)):
        street.send("car", [(s, at), (s, -90.0)], Pace(speed))
    for s, speed, at in ((33.2, 8.5, -18.0), (33.4, 9.0, -45.0)):
        street.send("car", [(s, at), (s, 90.0)], Pace(speed))
    street.send("van", [(33.2, -70.0), (33.2, 90.0)], Pace(8.6))
    street.send("cyclist", [(24.6, 14.0), (24.6, -80.0)], Pace(4.2))
    for k, at in enumerate((far_side + 5, far_side + 11.5, far_side + 18.5)):
        kind = "van" if k == 1 else "car"
        street.send(
            kind,
            [(at, 1.9), (at - 120, 1.9)],
            Pace(9.0, departure=3.5 + 1.3 * k),
            name="waits at the light",
        )
    for k, at in enumerate((13.5, 6.5)):
        street.send(
            "car",
            [(at, -5.2), (at + 140, -5.2)],
            Pace(8.0, departure=4.0 + 1.3 * k),
            name="waits at the light",
        )
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
        (4.0, -8.9, 1.25),
        (15.0, 9.4, -1.0),
        (16.0, -10.6, -1.3),
        (45.0, 9.9, 0.95),
        (52.0, -9.0, 1.1),
        (9.0, 8.3, 1.45),
        (60.0, 10.8, -1.2),
    ):
        street.walk(s, d, speed)
    street.send(
        "pedestrian", [(17.0, -8.4), (30.0, -8.4)], Pace(1.0, departure=99.0), name="stands"
    )
