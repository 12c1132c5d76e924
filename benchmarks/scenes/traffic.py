"""Scenes of what moves and stops: arrivals, overtaking and a queue."""

from __future__ import annotations

import numpy as np

from docdepth.synthetic import road_users, roadside
from docdepth.synthetic.actors import Pace, Path
from docdepth.synthetic.street import Scene, Street, generator
from docdepth.synthetic.urban_street import add_furniture, add_houses, away_from, blocks, urban_road
from scenes import things
from scenes.large_vehicles import bus
from scenes.moving import Speeds, arrive, rounded
from scenes.rural import highway_road, highway_roadside

# Centre of a lane, from the centre line [m].
_LANE = 1.75
# From parking place to parking place along a kerb, and across a car park [m].
_PLACE, _STALL = 6.1, 2.75
# The place on the left that a car leaves.
_LEAVES = 9


def arrivals(seed: int) -> Scene:
    """Cars arrive and stand beside and behind parked ones; people brush bins, bushes and cars.

    The ego drives at 4 m/s and passes some of those that stand by then.
    """
    rng = generator("arrivals", seed)
    start, end, kerb, walk = -110.0, 250.0, 5.6, 8.6
    junctions = [(26.0, 4.0)]
    bend = ((0.05, 330.0, rng.uniform(0, 6.3)),)
    hills = ((0.9, 230.0, rng.uniform(0, 6.3)), (0.15, 70.0, rng.uniform(0, 6.3)))
    road = urban_road(start, end, bend, hills, kerb, walk, junctions, parking=3.5)
    street = Street(road, rng)
    # No houses between: a car park on the left, plants on the right.
    add_houses(street, blocks(start, end, [(36.0, 24.0)]), walk, 11.0)
    # Nothing stands in the entrance of the car park.
    add_furniture(street, start, 8.0, kerb, [], 0.5)
    add_furniture(street, 26.0, end, kerb, [(26.0, 6.0)], 0.5)
    first = {side: 2.9 - 0.7 * side + float(rng.uniform(-1, 1)) for side in (-1.0, 1.0)}
    _arrivals_along_the_kerb(street, start, end, junctions, first)
    _arrivals_in_the_car_park(street)
    _people_among_things(street, first[1.0])
    street.send("car", [(95.0, _LANE), (35.0, _LANE)], Pace(8.5))
    # It passes the ego on its left.
    street.send("cyclist", [(-30.0, 0.2), (30.0, 0.2)], Pace(6.0))
    ego = Path(road, np.array([(0.0, -_LANE), (100.0, -_LANE)]), Pace(4.0, wave=0.15))
    return street.scene("arrivals", ego, 22.0)


def _arrivals_along_the_kerb(
    street: Street,
    start: float,
    end: float,
    junctions: list[tuple[float, float]],
    first: dict[float, float],
) -> None:
    """Parked cars on both sides, and cars that come to stand between and beside them.

    ``first`` is a parking place of each side [m].
    """
    rng = street.rng
    # Places that are free until somebody comes, counted from ``first``, and when he stands.
    taken = {-1.0: {2: 2.8, 7: 5.0, 12: 6.5}, 1.0: {2: 3.4, 6: 4.5}}
    for side in (-1.0, 1.0):
        places = np.arange(first[side] - 18 * _PLACE, end - 5, _PLACE)
        # Cars drive in and out forwards, over the place behind or before theirs.
        over = [number + int(side) for number in taken[side]]
        left = [_LEAVES, _LEAVES - 1] if side > 0 else []
        free = [first[side] + _PLACE * number for number in (*taken[side], *over, *left)]
        places = away_from(places[places > start + 5], [*junctions, *((s, 3.0) for s in free)], 0.0)
        near = (places > -15.0) & (places < 90.0)
        yaw = 0.0 if side < 0 else np.pi
        street.parked_row(places[near], side * 4.55, 0.95, yaw)
        street.parked_row(places[~near], side * 4.55, 0.65, yaw)
        for number, stop in taken[side].items():
            s = first[side] + _PLACE * number
            lane = [(s + side * 90.0, side * _LANE), (s + side * 9.0, side * _LANE)]
            points = rounded([*lane, (s + side * 3.5, side * 4.5), (s, side * 4.5)], 3.0)
            kind = "van" if (side, number) == (-1.0, 7) else "car"
            stop += float(rng.uniform(-0.4, 0.4))
            arrive(street, kind, points, float(rng.uniform(6.5, 8.0)), stop)
    s = first[1.0] + _LEAVES * _PLACE
    street.send(
        "car",
        rounded([(s + 3.0, 4.5), (s - 3.0, 4.5), (s - 10.0, _LANE), (s - 200.0, _LANE)], 3.0),
        Pace(8.0, departure=6.0),
        start=3.0,
        name="leaves its parking place",
    )
    s = 76.0 + float(rng.uniform(-3, 3))
    for kind, at, stop in (("van", s, 5.5), ("car", s + 8.0, 7.5)):
        line = [(at + 90.0, _LANE), (at, _LANE + 0.5)]
        arrive(street, kind, line, 8.0, stop, name="stands beside parked cars")


def _arrivals_in_the_car_park(street: Street) -> None:
    """Two rows of cars, side by side; one comes beside them, one stands behind them."""
    rng = street.rng
    stalls = 33.0 + _STALL * np.arange(8)
    beside, behind = (int(n) for n in rng.permutation(np.arange(2, 6))[:2])
    for row, d, free in ((1, 17.0, beside), (2, 26.5, behind)):
        for k, s in enumerate(stalls):
            if k != free and rng.random() < 0.9:
                street.park(road_users.car(rng), s, d + float(rng.normal(0, 0.2)), 0.5 * np.pi)
        aisle = d - 5.2
        corners = [(90.0, _LANE), (27.0, _LANE), (27.0, aisle), (stalls[free], aisle)]
        points = rounded([*corners, (stalls[free], d)], 3.5)
        name = f"arrives in row {row} of the car park"
        stop = (4.4, 11.4)[row - 1] + float(rng.uniform(-0.4, 0.4))
        arrive(street, "car", points, 5.0, stop, 1.5, name)


def _people_among_things(street: Street, place: float) -> None:
    """People who walk so close to bins, bushes and parked cars that they touch them."""
    rng = street.rng
    half = 0.33  # of a person, shoulder and arm [m]
    line, road_side = -9.6, 4.55 - 1.0 - half
    for k, s in enumerate(np.arange(12.0, 48.0, 3.0)):
        if k % 2:
            street.put(roadside.refuse_bin(rng), s, line)
        else:
            street.put(things.bush(rng, float(rng.uniform(0.6, 0.9))), s, line - 0.4)
        street.put(things.bush(rng, float(rng.uniform(0.5, 0.8))), s + 1.5, line - 2.3)
    brushing = line + 0.3 + half + 0.02  # beside the bins, which are 0.6 m wide
    for name, s, d, speed in (
        ("brushes bins", 14.0, brushing, 1.2),
        ("walks among bushes", 44.0, line - 1.45, -1.0),
        ("brushes parked cars", 52.0, road_side, -1.2),
        ("walks apart", 30.0, 7.9, 1.3),
    ):
        step = 40.0 if speed > 0 else -40.0
        pace = Pace(abs(speed) + float(rng.uniform(-0.1, 0.1)), wave=0.05, period=5.0)
        street.send("pedestrian", [(s, d), (s + step, d)], pace, name=name)
    s = place + 7.5 * _PLACE  # between two parked cars
    points = [(s, 12.0), (s, road_side), (s - 3.5, road_side)]
    arrive(street, "pedestrian", points, 1.2, 9.0, 1.0, name="stops beside a parked car")


def overtaking(seed: int) -> Scene:
    """Lorries and a bus higher than the beams pass the ego at 22 m/s, or are passed, 3.6 m away."""
    rng = generator("overtaking", seed)
    start, end = -160.0, 560.0
    road = highway_road(start, end, rng)
    street = Street(road, rng)
    highway_roadside(street, start, end)
    slow, mine, fast = -10.6, -6.9, -3.4
    for kind, s, d, speed in (
        ("truck", 24.0, slow, 17.5),
        ("truck", 58.0, slow, 16.5),
        ("car", 88.0, slow, 17.0),
        ("van", -16.0, slow, 18.0),
        ("truck", 10.0, fast, 24.5),
        ("bus", -20.0, fast, 25.5),
        ("car", -48.0, fast, 26.5),
        ("truck", -85.0, fast, 26.5),
        ("car", 34.0, mine, 23.0),
        ("van", 75.0, mine, 22.5),
        ("car", -22.0, mine, 21.5),
    ):
        speed += float(rng.uniform(-0.3, 0.3))
        s += float(rng.uniform(-2.0, 2.0))
        street.send(kind, [(s, d), (s + 100.0, d)], Pace(speed))
        if kind == "truck" and s > 20.0:
            _tow(street, "lorry trailer", [(s, d), (s + 100.0, d)], Pace(speed), 9.8)
    for kind, s, d, speed in (
        ("truck", 70.0, 6.9, 20.0),
        ("car", 110.0, 3.4, 28.0),
        ("bus", 190.0, 6.9, 24.0),
        ("car", 280.0, 3.4, 27.0),
        ("truck", 330.0, 10.6, 21.0),
        ("car", 400.0, 6.9, 26.0),
    ):
        street.send(kind, [(s, d), (s - 100.0, d)], Pace(speed + float(rng.uniform(-1, 1))))
    ego = Path(road, np.array([(0.0, mine), (100.0, mine)]), Pace(22.0, wave=0.02))
    return street.scene("overtaking", ego, 15.0, step=1.5)


def _tow(
    street: Street,
    kind: str,
    points: list[tuple[float, float]],
    pace: Pace | Speeds,
    behind: float,
) -> None:
    """Add a trailer, an object of its own, whose centre is ``behind`` that of its vehicle [m]."""
    street.send(kind, points, pace, -behind, name=f"{kind} behind its vehicle")


def queue(seed: int) -> Scene:
    """A queue that creeps; a trailer, a bus that opens its doors, a U-turn, people in between."""
    rng = generator("queue", seed)
    start, end, kerb, walk = -110.0, 190.0, 7.2, 11.5
    junctions = [(38.0, 6.0)]
    hills = ((0.7, 260.0, rng.uniform(0, 6.3)),)
    road = urban_road(
        start, end, ((0.03, 320.0, rng.uniform(0, 6.3)),), hills, kerb, walk, junctions
    )
    street = Street(road, rng)
    add_houses(street, blocks(start, end, junctions), walk, 14.0)
    add_furniture(street, start, end, kerb, junctions, 0.5)
    places = away_from(np.arange(start + 5, end - 5, 6.2), junctions, 8.0)
    street.parked_row(places, 6.2, 0.7, np.pi)
    pace = _stop_and_go(rng)
    _queue_of_cars(street, pace)
    _bus_and_turn(street)
    _people_between(street, pace)
    ego = Path(road, np.array([(0.0, -_LANE), (60.0, -_LANE)]), pace)
    return street.scene("queue", ego, 22.0)


def _stop_and_go(rng: np.random.Generator) -> Speeds:
    """The ego's speed: between 0.3 and 1.5 m/s, with two stops."""
    fast, slow = float(rng.uniform(1.2, 1.5)), float(rng.uniform(0.3, 0.5))
    times = (2.0, 3.2, 6.0, 7.2, 9.0, 10.2, 11.5, 12.5)
    return Speeds(times, (0.9, 0.0, 0.0, fast, fast, 0.0, 0.0, slow))


# Positions of the queue's vehicles, relative to the ego [m]: the gap is a junction.
_QUEUE = (
    ("car", -8.0),
    ("car", 12.3),
    ("van", 19.5),
    ("car", 27.0),
    ("car", 53.0),
    ("car", 60.0),
    ("truck", 69.0),
)
_WAVE = 16.0  # speed at which stops run back through the queue [m/s]


def _queue_of_cars(street: Street, pace: Speeds) -> None:
    """The ego's lane, where each does what those ahead did before; and oncoming traffic."""
    for kind, s in _QUEUE:
        line = [(s, -_LANE), (s + 100.0, -_LANE)]
        street.send(kind, line, pace.later(-s / _WAVE), name=f"{kind} in the queue")
    ahead = _QUEUE[1][1]
    line = [(ahead, -_LANE), (ahead + 100.0, -_LANE)]
    _tow(street, "trailer", line, pace.later(-ahead / _WAVE), 4.6)
    for kind, s, speed in (("car", 14.0, 7.5), ("van", 130.0, 8.0), ("cyclist", 20.0, 4.5)):
        d = 3.2 if kind == "cyclist" else _LANE
        street.send(kind, [(s, d), (s - 60.0, d)], Pace(speed + float(street.rng.uniform(-1, 1))))


def _bus_and_turn(street: Street) -> None:
    """A bus stops beside the queue and opens its doors; a car turns back through the gap."""
    rng = street.rng
    stop, place = 4.6 + float(rng.uniform(-0.3, 0.3)), 12.0
    leaves = stop + 7.0
    times = (stop - 4.0, stop, leaves, leaves + 4.0)
    pace = Speeds(times, (6.0, 0.0, 0.0, 5.0))
    parts = bus(rng, opens=stop + 0.8, closes=leaves - 2.5)
    lane = [(place - 50.0, -5.2), (place + 100.0, -5.2)]
    start = 50.0 - float(pace.distance(stop))
    street.send("bus", lane, pace, start, name="bus at its stop", parts=parts)
    # About 3.5 m of radius, through the junction that the queue leaves free.
    s = 41.0
    turn = rounded([(110.0, _LANE), (s - 3.5, _LANE), (s - 3.5, -5.2), (160.0, -5.2)], 3.6)
    when = 5.5 + float(rng.uniform(-0.4, 0.4))
    pace = Speeds((when - 3.5, when - 1.5, when + 2.5, when + 6.0), (7.5, 3.0, 3.0, 7.0))
    into = 110.0 - s + 3.5  # along the path, where the turn is half done at ``when``
    street.send("car", turn, pace, into - float(pace.distance(when)), name="turns back")


def _people_between(street: Street, pace: Speeds) -> None:
    """People who cross between the standing cars, and who wait for the bus."""
    rng = street.rng
    for first, second, when, side in ((2, 3, 3.2, 1.0), (3, 3, 3.0, -1.0), (0, 0, 11.2, -1.0)):
        # Between two cars, or before one, where they stand at that time.
        places = [_QUEUE[k][1] for k in (first, second)]
        covered = [float(pace.later(-s / _WAVE).distance(when)) for s in places]
        s = 0.5 * (places[0] + covered[0] + places[1] + covered[1]) + 3.2 * (first == second)
        speed = 1.2 + float(rng.uniform(-0.15, 0.15))
        points = [(s, side * 8.5), (s, -side * 9.0)]
        start = 8.5 + side * _LANE - speed * when
        street.send("pedestrian", points, Pace(speed), start, name="crosses in the queue")
    for s, d, stop in ((16.6, -7.3, 5.8), (11.9, -7.4, 6.6)):
        points = [(s + 7.0, d - 1.5), (s + 1.5, d - 0.4), (s, d)]
        arrive(street, "pedestrian", points, 1.2, stop, 1.0, name="comes to the bus")
    for s, d, speed in ((6.0, -9.2, 1.25), (14.0, 9.4, -1.1), (30.0, -10.2, -1.2)):
        street.walk(s, d + float(rng.normal(0, 0.1)), speed)
    stands = Pace(1.0, departure=99.0)
    street.send("pedestrian", [(18.0, -8.3), (30.0, -8.3)], stands, name="waits for another bus")
