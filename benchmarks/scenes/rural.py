"""Scenes outside towns: highway and hills."""

from __future__ import annotations

from functools import partial

import numpy as np

from docdepth.synthetic import road_users, roadside
from docdepth.synthetic.actors import Pace, Path
from docdepth.synthetic.mesh import Mesh, Paint, box, merged
from docdepth.synthetic.road import Floats, Road
from docdepth.synthetic.street import PAINTS, Scene, Street, bumps, generator, waves
from scenes import things

Kinds = np.ndarray[tuple[int, ...], np.dtype[np.int64]]


def highway_road(start: float, end: float, rng: np.random.Generator) -> Road:
    """Three lanes and a shoulder per direction, on an embankment and in a cutting."""
    edge = 14.6

    def profile(s: Floats, d: Floats) -> Floats:
        across = np.abs(d)
        road = -0.025 * np.minimum(across, edge)
        beyond = np.clip(across - edge - 0.5, 0, None)
        # An embankment falls on the right, a cutting rises on the left.
        bank = np.where(d > 0, np.minimum(0.35 * beyond, 5.0), -np.minimum(0.3 * beyond, 3.0))
        result: Floats = road + bank + np.clip(beyond, 0, 1) * bumps(s, d)
        return result

    def paint(s: Floats, d: Floats) -> Kinds:
        across = np.abs(d)
        kind = np.where(across < edge, 0, 3)
        kind = np.where(across < 0.9, 3, kind)
        solid = (np.abs(across - 1.55) < 0.08) | (np.abs(across - 12.4) < 0.08)
        dashed = (np.abs(across - 5.15) < 0.08) | (np.abs(across - 8.8) < 0.08)
        kind = np.where(solid | (dashed & (np.mod(s, 18.0) < 6.0)), 1, kind)
        return kind.astype(np.int64)

    lines = [c + e for c in (1.55, 5.15, 8.8, 12.4) for e in (-0.08, 0.08)]
    sides = np.array(
        [
            0.0,
            0.9,
            edge,
            *lines,
            *np.arange(15.0, 26.0, 0.75),
            *np.arange(26.0, 60.0, 3.0),
            70.0,
            80.0,
            95.0,
        ]
    )
    bend = waves((0.05, 900.0, rng.uniform(0, 6.3)))
    hills = waves((3.5, 600.0, rng.uniform(0, 6.3)))
    cuts = np.concatenate([-sides, sides]).tolist()
    return Road(start, end, bend, hills, profile, paint, PAINTS, cuts)


def highway(seed: int) -> Scene:
    """Three lanes per direction at 27 m/s: guard rails, verges, embankments, slower lorries."""
    rng = generator("highway", seed)
    start, end = -140.0, 560.0
    road = highway_road(start, end, rng)
    street = Street(road, rng)
    highway_roadside(street, start, end)
    _highway_traffic(street)
    street.park(road_users.car(rng), 120.0, -13.6)
    ego = Path(road, np.array([(0.0, -6.9), (100.0, -6.9)]), Pace(27.0, wave=0.02))
    return street.scene("highway", ego, 15.0, step=1.5)


def highway_roadside(street: Street, start: float, end: float) -> None:
    """Guard rails, a noise barrier, plants, markers and signs."""
    rng = street.rng
    for s in np.arange(start + 6, end - 6, 12.0):
        street.put(things.guard_rail(12.0), s, 0.35)
        street.put(things.guard_rail(12.0), s, -0.35, np.pi)
        street.put(things.guard_rail(12.0), s, -14.9)
        if s < 90.0 or s > 200.0:
            street.put(things.guard_rail(12.0), s, 14.9, np.pi)
    wall = Paint(50, (0.52, 0.50, 0.44), 0.35)
    for s in np.arange(90.0, 202.0, 4.0):
        street.put(box((4.0, 0.2, 4.2), (0, 0, 1.6), wall), s, 16.4)
        street.put(box((0.25, 0.3, 4.4), (-2.0, 0, 1.7), wall), s, 16.4)
    for side, d in ((1.0, 21.0), (1.0, 30.0), (-1.0, 23.0), (-1.0, 34.0)):
        spots = np.arange(start, end, 11.0)
        street.row(lambda: roadside.tree(rng, float(rng.uniform(5, 10))), spots, side * d, 0.5, 3.0)
        street.row(
            lambda: things.bush(rng, float(rng.uniform(0.6, 1.5))),
            spots + 5,
            side * (d - 3.5),
            0.6,
            3.0,
        )
    for side in (-1.0, 1.0):
        yaw = 0.0 if side < 0 else np.pi
        street.row(_marker, np.arange(start, end, 50.0), side * 15.5, 1, 0.1)
        street.row(
            lambda: roadside.sign(rng, 2.6, 1.2),
            np.arange(start, end, 120.0) + 30,
            side * 16.0,
            1,
            5.0,
            yaw,
        )
    for s in (75.0, 330.0):
        _gantry(street, s)


def _highway_traffic(street: Street) -> None:
    """Vehicles in both directions."""
    for s, d, speed, kind in (
        (38.0, -6.9, 29.0, "car"),
        (62.0, -10.6, 23.0, "truck"),
        (22.0, -3.4, 33.0, "car"),
        (95.0, -10.6, 23.5, "truck"),
        (110.0, -6.9, 27.0, "van"),
        (-18.0, -3.4, 34.0, "car"),
        (-25.0, -6.9, 27.0, "car"),
        (14.0, -10.6, 24.0, "car"),
        (140.0, -3.4, 31.0, "car"),
    ):
        street.send(kind, [(s, d), (s + 100, d)], Pace(speed, wave=0.02))
    for s, d, speed, kind in (
        (60.0, 6.9, 30.0, "car"),
        (130.0, 10.6, 24.0, "truck"),
        (180.0, 3.4, 34.0, "car"),
        (240.0, 6.9, 29.0, "van"),
        (300.0, 10.6, 24.0, "truck"),
        (360.0, 6.9, 31.0, "car"),
        (430.0, 10.6, 25.0, "car"),
        (520.0, 3.4, 35.0, "car"),
    ):
        street.send(kind, [(s, d), (s - 100, d)], Pace(speed))


def _marker() -> Mesh:
    """A white marker post with a reflector."""
    white = Paint(80, (0.9, 0.9, 0.88), 0.6)
    post = box((0.1, 0.12, 1.1), (0, 0, 0.45), white)
    eye = box((0.11, 0.06, 0.15), (0, 0, 0.8), Paint(80, (0.9, 0.6, 0.2), 3.0))
    return merged([post, eye])


def _gantry(street: Street, s: float) -> None:
    steel = Paint(80, (0.5, 0.52, 0.52), 0.4)
    blue = Paint(81, (0.1, 0.2, 0.55), 6.0)
    low, high = street.road.point(s, -15.6), street.road.point(s, 1.0)
    for d in (-15.6, 1.0):
        street.put(box((0.35, 0.35, 7.4), (0, 0, 3.4), steel), s, d)
    rise = 0.5 * float(high[2] - low[2])
    street.put(box((0.5, 17.0, 0.5), (0, 0, 6.9 + rise), steel), s, -7.3)
    for d in (-11.5, -6.5):
        street.put(box((0.1, 3.8, 2.4), (-0.35, 0, 6.9 + rise), blue), s, d)


def _hill_road(start: float, end: float, rng: np.random.Generator) -> Road:
    edge = 3.5
    tilt = waves((0.12, 170.0, rng.uniform(0, 6.3)), (0.06, 90.0, rng.uniform(0, 6.3)))

    def profile(s: Floats, d: Floats) -> Floats:
        across = np.abs(d)
        bank = 0.04 * np.sin(2 * np.pi * s / 140.0) * np.clip(d, -edge, edge)
        beyond = np.clip(across - edge - 0.4, 0, None)
        ditch = -0.35 * np.exp(-(((across - edge - 1.6) / 0.7) ** 2))
        slope = np.sign(d) * tilt(s) * np.minimum(beyond, 25.0)
        rolling = np.clip(beyond / 12, 0, 1) * 0.8 * np.sin(0.09 * s + 0.05 * d)
        result: Floats = bank + ditch + slope + rolling + np.clip(beyond, 0, 1) * 1.5 * bumps(s, d)
        return result

    def paint(s: Floats, d: Floats) -> Kinds:
        across = np.abs(d)
        kind = np.where(across < edge, 0, 3)
        kind = np.where((np.abs(across - 3.25) < 0.06), 1, kind)
        kind = np.where((across < 0.06) & (np.mod(s, 9.0) < 3.0), 1, kind)
        return kind.astype(np.int64)

    sides = np.array(
        [
            0.06,
            3.19,
            3.31,
            edge,
            1.0,
            2.0,
            *np.arange(3.9, 10.0, 0.35),
            *np.arange(10.0, 24.0, 1.0),
            *np.arange(24.0, 60.0, 3.0),
            75.0,
            95.0,
        ]
    )
    bend = waves((0.35, 230.0, rng.uniform(0, 6.3)), (0.08, 90.0, rng.uniform(0, 6.3)))
    hills = waves((3.2, 170.0, rng.uniform(0, 6.3)), (0.5, 60.0, rng.uniform(0, 6.3)))
    cuts = np.concatenate([-sides, sides]).tolist()
    return Road(start, end, bend, hills, profile, paint, PAINTS, cuts)


def hills(seed: int) -> Scene:
    """A winding country road with 10 % slopes, ditches, hedges and trees."""
    rng = generator("hills", seed)
    start, end = -125.0, 380.0
    road = _hill_road(start, end, rng)
    street = Street(road, rng)
    _country_roadside(street, start, end)
    for s, d, yaw in ((40.0, 18.0, 0.2), (130.0, -17.0, 2.9), (215.0, 16.5, 0.0)):
        street.put(things.cottage(rng, 12.0, 8.5, 4.5), s, d, yaw)
    street.park(road_users.car(rng), 66.0, -5.0)
    street.send("car", [(30.0, -1.7), (100.0, -1.7)], Pace(12.5, wave=0.05))
    for s, kind, speed in (
        (55.0, "car", 14.0),
        (120.0, "van", 13.0),
        (190.0, "car", 15.0),
        (290.0, "truck", 11.0),
    ):
        street.send(kind, [(s, 1.7), (s - 90, 1.7)], Pace(speed))
    street.send("cyclist", [(48.0, -3.0), (100.0, -3.0)], Pace(4.0, wave=0.1))
    street.send("cyclist", [(80.0, 2.9), (10.0, 2.9)], Pace(9.0))
    for s, d, speed in ((35.0, 4.0, 1.2), (35.8, 4.5, 1.2), (75.0, -4.1, -1.0), (110.0, 4.2, -1.3)):
        street.walk(s, d, speed)
    street.send(
        "car",
        [(95.0, 5.2), (85.0, 1.8), (-80.0, 1.7)],
        Pace(9.0, departure=2.5),
        name="leaves a lay-by",
    )
    ego = Path(road, np.array([(0.0, -1.7), (100.0, -1.7)]), Pace(12.0, wave=0.05))
    return street.scene("hills", ego, 20.0)


def _country_roadside(street: Street, start: float, end: float) -> None:
    """Trees, bushes, hedges, fences, poles, markers and signs."""
    rng = street.rng
    for side in (-1.0, 1.0):
        spots = np.arange(start, end, 9.0)
        street.row(
            lambda: roadside.tree(rng, float(rng.uniform(6, 12))), spots, side * 8.0, 0.35, 1.5
        )
        street.row(
            lambda: roadside.tree(rng, float(rng.uniform(6, 12))), spots, side * 17.0, 0.35, 3
        )
        street.row(
            lambda: things.bush(rng, float(rng.uniform(0.5, 1.4))),
            spots + 4,
            side * 6.8,
            0.4,
            1.5,
        )
        street.row(_marker, np.arange(start, end, 25.0), side * 4.3, 1, 0.1)
        street.row(
            partial(roadside.pole, 8.0, 0.0, 0.13),
            np.arange(start, end, 45.0),
            side * 10.5,
            1.0 if side < 0 else 0.0,
        )
        street.row(
            lambda: roadside.sign(rng),
            np.arange(start + 15, end, 70.0),
            side * 4.7,
            1,
            4.0,
            0.0 if side < 0 else np.pi,
        )
    for s in np.arange(start + 5, end, 5.0):
        part = int((s - start) // 40) % 4
        if part == 1:
            street.put(things.hedge(rng, 5.0, 1.6, 1.0), s, 7.4)
        if part in (0, 2):
            street.put(things.fence(5.0, 1.2), s, 6.3 if part == 2 else -6.3)
