"""Which tracks a drive has: one for each thing that moves, whatever pieces it is seen in."""

import pytest
from test_tracking import CAR, Thing, detections_of, drive_of, passes, tracked, tracking_of

LORRY, WHEEL, COUNT = (9.0, 2.4, 2.6), (0.9, 2.5, 0.8), 30


def tracks_of(things, count=COUNT):
    """The tracks of a drive, and for each thing the tracks of its objects."""
    detections, rows = detections_of(things, count)
    found = tracking_of(detections, drive_of(count))
    owners = [set() for _ in things]
    for sweep, firsts in zip(found.sweeps, rows, strict=True):
        track_of = {int(first): int(track) for first, track, _ in sweep.members.tolist()}
        for thing, first in firsts.items():
            if first in track_of:
                owners[thing].add(track_of[first])
    return found.tracks, owners


def ahead(at, x, z=1.0):
    """A place that goes along with another one, ``x`` metres before it."""
    return lambda i: (at(i)[0] + x, at(i)[1], z)


@pytest.mark.parametrize("offset", [-3.0, 0.5, 3.0])
def test_a_wheel_of_a_lorry_is_the_lorry(offset):
    """The sweeps see it as an object of its own."""
    at = passes(5, speed=9.0, start=16.0)
    lorry = Thing(LORRY, ahead(at, 0.0, 1.7), range(COUNT))
    tracks, owners = tracks_of([lorry, Thing(WHEEL, ahead(at, offset, 0.5), range(COUNT))])
    assert [track.id for track in tracks] == [1]
    assert owners == [{1}, {1}]
    # With the same wheel alone nothing is joined.
    assert len(tracks_of([Thing(WHEEL, ahead(at, offset, 0.5), range(COUNT))])[0]) == 1


def test_a_piece_that_stays_in_a_lorry_is_the_lorry_however_fast_it_seems():
    """What is seen of its tailboard slides along it by 4 m/s."""
    at = passes(5, speed=12.0, start=10.0)
    lorry = Thing(LORRY, ahead(at, 0.0, 1.7), range(COUNT))
    slides = Thing(WHEEL, lambda i: (at(i)[0] - 3 + 0.4 * (i % 12), at(i)[1], 0.5), range(COUNT))
    tracks, owners = tracks_of([lorry, slides])
    assert len(tracks) == 1
    assert owners[0] == {1}


def test_pieces_of_a_van_of_which_only_the_rear_is_seen_are_one_track():
    at = passes(0.5, speed=9.5, start=12.0)
    doors = Thing((0.2, 2.0, 1.4), ahead(at, 0.0, 1.6), range(COUNT))
    bumper = Thing((0.2, 1.7, 0.5), ahead(at, 0.0, 0.5), range(COUNT))
    tracks, owners = tracks_of([doors, bumper])
    assert len(tracks) == 1
    assert owners == [{1}, {1}]


def test_the_other_half_of_a_car_is_the_car_but_a_trailer_is_none():
    half = (CAR[0], CAR[1] / 2 - 0.1, CAR[2])
    at = passes(4, speed=9.0, start=12.0)
    left = Thing(half, lambda i: (at(i)[0], at(i)[1] + CAR[1] / 4, 0.8), range(COUNT))
    right = Thing(half, lambda i: (at(i)[0], at(i)[1] - CAR[1] / 4, 0.8), range(COUNT))
    assert len(tracks_of([left, right])[0]) == 1
    trailer = Thing((2.0, 1.7, 1.2), ahead(at, -CAR[0] / 2 - 1.2, 0.7), range(COUNT))
    car = Thing(CAR, ahead(at, 0.0, 0.8), range(COUNT))
    assert len(tracks_of([car, trailer])[0]) == 2


def test_cars_of_a_queue_stay_apart():
    """They go as fast, with a metre between them."""
    at = passes(4, speed=6.0, start=4.0)
    cars = [Thing(CAR, ahead(at, x), range(COUNT)) for x in (-CAR[0] - 1, 0.0, CAR[0] + 1)]
    tracks, owners = tracks_of(cars)
    assert len(tracks) == 3
    assert len(set.union(*owners)) == 3


def test_a_car_that_is_passed_closely_is_no_part_of_the_lorry():
    """Their boxes touch for a second, but they do not go as fast."""
    lorry = Thing(LORRY, ahead(passes(4, speed=12.0, start=-6.0), 0.0, 1.7), range(COUNT))
    car = Thing(CAR, passes(6.2, speed=5.0, start=6.0), range(COUNT))
    _, (of_lorry, of_car) = tracks_of([lorry, car])
    assert of_lorry == {1}
    assert of_car
    assert not of_lorry & of_car


def test_where_a_car_stands_is_told_by_the_sweeps_that_saw_it_creep_there():
    """Few beams saw its place free, and only in front of where it stands at last."""
    car = Thing(CAR, lambda i: (-6 + 0.2 * min(i, 8), 4))
    ends_of = car.stay
    car.stay = lambda i, count: (i < 6, *ends_of(i, count)[1:])
    assert tracked([car], 20) == [list(range(20))]
