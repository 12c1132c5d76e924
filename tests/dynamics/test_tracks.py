"""Tracks and the evidence that they carry: exact scenes, and plain numpy."""

import numpy as np
import pytest
from tracks_reference import dynamic_voxels as reference_voxels
from tracks_reference import track_objects as reference_tracks

from docdepth.dynamics.tracking import (
    TRACK_PARAMETERS,
    Detections,
    TrackingResult,
    apply_tracks,
    track_objects,
)
from docdepth.dynamics.voting import Votes
from docdepth.errors import InputError

CAR, PERSON, POLE, WALL = (4.2, 1.8, 1.5), (0.6, 0.6, 1.7), (0.3, 0.3, 2.0), (12.0, 0.3, 2.5)


class Thing:
    """A box of points, its position in each sweep (None: unseen), and the sweeps that vote dynamic.

    Positions are (x, y) or (x, y, z). ``seen`` chooses the points that a sweep sees, all if None.
    """

    def __init__(self, size, at, dynamic=(), step=0.2, seen=None):
        axes = [np.arange(-s / 2, s / 2 + 1e-6, step) for s in size]
        grid = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
        self.shape = grid[(np.abs(grid) > np.array(size) / 2 - step).any(1)]
        self.at, self.dynamic, self.seen = at, set(dynamic), seen

    def shape_in(self, i):
        return self.shape if self.seen is None else self.shape[self.seen(i, self.shape)]


def detections_of(things, count, seed=0, joined=None):
    """Detections from a vehicle that drives ahead, and in each sweep the first row of each thing.

    ``joined`` maps a pair of things to the sweeps in which both are one object.
    """
    rng = np.random.default_rng(seed)
    detections, rows = [], []
    for i in range(count):
        T = np.eye(4)
        T[:2, 3] = 0.8 * i, 0.1 * i
        points, first, moving, firsts, wholes = [], [], [], {}, {}
        for k, thing in enumerate(things):
            place = thing.at(i)
            if place is None:
                continue
            firsts[k] = len(points)
            middle = (*place[:2], *(place[2:] or (0.8,)))
            shape = thing.shape_in(i)
            shape = shape + middle + rng.normal(0, 0.01, shape.shape)
            whole = next((wholes[a] for (a, b), sweeps in (joined or {}).items()
                          if b == k and a in wholes and i in sweeps), firsts[k])  # fmt: skip
            wholes[k] = whole
            points += list(shape - T[:3, 3])
            first += [whole] * len(shape)
            moving += [i in thing.dynamic] * len(shape)
        cloud = np.array(points, np.float32).reshape(-1, 3)
        none = np.zeros(len(cloud), bool)
        objects, flags = np.array(first, np.uint32), np.array(moving, bool)
        detections.append(Detections(cloud, none, objects, flags, T))
        rows.append(firsts)
    return detections, rows


def tracked(things, count, **more):
    """For each thing the sweeps in which only tracks make it dynamic."""
    detections, rows = detections_of(things, count, **more)
    found = track_objects(detections, np.arange(count) * 100_000_000)
    return [
        [i for i in range(count) if k in rows[i] and rows[i][k] in found[i].objects]
        for k in range(len(things))
    ]


def waits(start, leaves, acceleration=2.0):
    """Position of a thing that stands until a sweep and then drives off along x."""
    return lambda i: (start[0] + 0.5 * acceleration * (0.1 * max(i - leaves, 0)) ** 2, start[1])


def passes(y, speed=8.0, start=-10.0):
    return lambda i: (start + 0.1 * speed * i, y)


def parked_at(x, y):
    return lambda i: (x, y)


def test_a_car_that_waits_and_drives_off_is_dynamic_all_the_time():
    # The votes find it when it has gone half a metre.
    (car,) = tracked([Thing(CAR, waits((15, 3), 20), range(28, 50))], 50)
    assert car == list(range(28))


def test_a_car_that_arrives_and_parks_stays_dynamic_to_the_end():
    stop = waits((15, 3), 20)
    (car,) = tracked([Thing(CAR, lambda i: stop(49 - i), range(22))], 50)
    assert car == list(range(22, 50))


def test_last_sweeps_without_votes():
    (car,) = tracked([Thing(CAR, passes(4), range(17))], 20)
    assert car == [17, 18, 19]


def test_hidden_for_a_while():
    moving = passes(4)
    hidden = Thing(CAR, lambda i: None if 6 <= i < 9 else moving(i), [*range(6), *range(11, 20)])
    assert tracked([hidden], 20) == [[9, 10]]
    stands = waits((15, 3), 50)
    hidden = Thing(CAR, lambda i: None if 10 <= i < 40 else stands(i), range(58, 80))
    assert tracked([hidden], 80) == [[*range(10), *range(40, 58)]]


def test_a_parked_car_that_is_passed_closely_stays_static():
    parked = Thing(CAR, parked_at(8, 6.2))
    # The other one passes 40 cm away, and is not seen again after it is level with this one.
    mover = Thing(CAR, lambda i: passes(4)(i) if i < 23 else None, range(23))
    assert tracked([mover, parked], 40) == [[], []]
    # Some sweeps take both for one object.
    mover = Thing(CAR, passes(4), range(40))
    assert tracked([parked, mover], 40, joined={(0, 1): range(20, 25)})[0] == []


def test_a_parked_car_where_another_one_stopped_stays_static():
    """Its place was occupied while the other one came, so it is not the same car."""
    parked = Thing(CAR, parked_at(8, 4))
    mover = Thing(CAR, lambda i: passes(4)(i) if i < 17 else None, range(17))
    assert tracked([mover, parked], 40) == [[], []]


def test_a_pole_and_a_wall_beside_a_pedestrian_who_disappears_stay_static():
    walker = Thing(PERSON, lambda i: (2 + 0.12 * i, 3) if i < 25 else None, range(25), 0.1)
    pole = Thing(POLE, parked_at(5.1, 3.1), step=0.1)
    wall = Thing(WALL, parked_at(4, 3.5))
    assert tracked([walker, pole, wall], 40) == [[], [], []]


def test_a_pedestrian_beside_a_wall_is_tracked_past_it():
    walker = Thing(PERSON, lambda i: (2 + 0.12 * i, 3), [*range(10), *range(20, 30)], 0.1)
    wall = Thing(WALL, parked_at(4, 3.5))
    assert tracked([walker, wall], 30) == [list(range(10, 20)), []]


def test_a_shaking_bush_has_not_moved():
    rng = np.random.default_rng(1)
    bush = Thing((1.2, 1.2, 1.2), lambda i: (6 + rng.normal(0, 0.1), 3), range(0, 30, 2))
    assert tracked([bush], 30) == [[]]


@pytest.mark.parametrize(("dynamic", "sweeps"), [(6, []), (8, list(range(8, 40)))])
def test_a_track_that_drifts_on_without_votes_has_not_moved(dynamic, sweeps):
    """Votes saw a quarter of a metre of a twig's two metres, or a third."""
    assert tracked([Thing(PERSON, lambda i: (6 + 0.05 * i, 3), range(dynamic), 0.1)], 40) == [
        sweeps
    ]


def test_two_dynamic_sweeps_are_no_track():
    assert tracked([Thing(CAR, passes(4), range(10, 12))], 20) == [[]]


def test_an_object_that_is_lost_is_where_its_motion_predicts_it(monkeypatch):
    """Too few points, or a wall taken for a part of it: no object of those sweeps is the car."""
    at, lost = passes(4), {0, 1, 7, 8, 9, 27}
    car = Thing(CAR, lambda i: None if i in lost else at(i), set(range(28)) - lost)
    found = track_objects(detections_of([car], 28)[0], np.arange(28) * 100_000_000)
    for i in lost:
        for box in found[i].boxes:
            np.testing.assert_allclose(0.5 * (box[:2] + box[3:5]), at(i), atol=0.05)
            np.testing.assert_allclose(box[3:] - box[:3], CAR, atol=0.2)
        assert len(found[i].boxes) == 2  # forward and backward
    monkeypatch.setattr(TRACK_PARAMETERS, "window", 0)
    found = track_objects(detections_of([car], 28)[0], np.arange(28) * 100_000_000)
    assert not any(len(sweep.boxes) for sweep in found)


def test_a_standing_object_has_no_predicted_box():
    car = Thing(CAR, waits((15, 3), 20), range(50))
    found = track_objects(detections_of([car], 50)[0], np.arange(50) * 100_000_000)
    assert not any(len(sweep.boxes) for sweep in found[:18])
    assert all(len(sweep.boxes) for sweep in found[26:])


def test_two_pedestrians_in_one_track_have_no_box_around_both():
    at = passes(3, 1.2, 5)
    first = Thing(PERSON, lambda i: at(i) if i < 3 else None, range(3), 0.1)
    second = Thing(PERSON, lambda i: (at(i)[0], 8) if i > 5 else None, range(6, 20), 0.1)
    found = track_objects(detections_of([first, second], 20)[0], np.arange(20) * 100_000_000)
    boxes = np.concatenate([sweep.boxes for sweep in found])
    assert len(boxes) >= 20
    assert (boxes[:, 3:] - boxes[:, :3] < 1.5 * np.array(PERSON) + 0.5).all()


def test_points_in_a_predicted_box_are_dynamic_unless_votes_or_ground_say_otherwise():
    T = np.eye(4)
    T[:3, 3] = 2, 0, 1
    points = np.array([[5, 0, 0], [5, 1, 0], [5, 2, 0], [5, 0, 0], [9, 0, 0]], np.float32)
    box = np.array([[6, -1, 0, 8, 3, 2]], np.float32)  # in the world: [4, -1, -1, 6, 3, 1] here
    static, dynamic = np.array([[0, 2, 3, 0, 0], [0] * 5], np.uint16)
    classid = np.array([50, 50, 50, 0, 50], np.uint16)
    alone = np.arange(5, dtype=np.uint32)
    found = TrackingResult(np.zeros(0, np.uint32), box)
    classid = apply_tracks(points, alone, Votes(static, dynamic), classid, found, T)
    assert list(classid) == [100, 100, 50, 0, 50]


@pytest.mark.parametrize(("always", "share", "moves"), [(8, 0.9, 0), (8, 0.7, 1), (7, 0.9, 1)])
def test_an_always_occupied_rest_of_a_tracked_object_stays_static(always, share, moves):
    """Beyond that share it was observed free at times, or occupied not often enough."""
    rows = np.arange(100)
    occupied = rows >= 40 + 60 * (1 - share)
    points = np.stack([10 + 0.02 * rows, 0 * rows, 0 * rows], 1).astype(np.float32)
    static, dynamic = np.full(100, always, np.uint16), (~occupied).astype(np.uint16)
    classid = np.where(rows < 40, 100, 50).astype(np.uint16)  # these move by their votes
    found = TrackingResult(np.array([0], np.uint32), np.zeros((0, 6), np.float32))
    whole = np.zeros(100, np.uint32)
    votes = Votes(static, dynamic)
    classes = apply_tracks(points, whole, votes, classid, found, np.eye(4))
    assert (classes[:40] == 100).all()
    assert (classes[40:] == (100 if moves else 50)).all()
    waits = apply_tracks(points, whole, votes, (whole + 50).astype(np.uint16), found, np.eye(4))
    assert (waits == 100).all()  # none of it moves now: it is known from another time


def test_a_waiting_car_whose_parts_are_seen_in_turn_is_dynamic_as_a_whole():
    """Its halves have a track each, and that of the upper one ends where it stands."""
    at = waits((15, 3), 30)
    lower = Thing((4.2, 1.8, 0.8), at, range(33, 60))
    upper = Thing((2.0, 1.6, 0.6), lambda i: (*at(i), 1.5) if i % 3 == 0 else None, range(36, 60))
    post = Thing(POLE, parked_at(12.3, 3), step=0.1)
    found = tracked([lower, upper, post], 60)
    assert found[0] == list(range(33))
    assert found[1] == list(range(0, 36, 3))
    assert found[2] == []


@pytest.mark.parametrize("seed", range(3))
def test_a_car_is_tracked_though_each_sweep_of_a_rosette_sees_other_parts(seed):
    """Four of eight slices, drawn anew in each sweep; two sweeps may share only one."""
    at = waits((15, 3), 30)

    def slices(i, shape):
        drawn = np.random.default_rng([seed, i]).permutation(8)[:4]
        return np.isin(((shape[:, 0] / CAR[0] + 0.5) * 7.99).astype(int), drawn)

    car = Thing(CAR, at, range(35, 60), seen=slices)
    assert tracked([car], 60) == [list(range(35))]


def test_a_bin_that_a_pedestrian_leaves_is_not_part_of_him():
    """They are one object at first; when he is far away, the bin is occluded."""
    walker = Thing(PERSON, lambda i: (8 + 0.08 * i, 3), range(60), 0.1)
    bin_ = Thing((0.6, 0.6, 1.0), lambda i: (7.6, 3, 0.5) if i < 40 else None, step=0.1)
    assert tracked([walker, bin_], 60, joined={(0, 1): range(8)})[1] == []


def test_a_thin_post_that_a_track_includes_stays_static_if_it_was_not_seen_before():
    """While the pedestrian was elsewhere, the post was too far to be an object."""
    at = waits((6, 3), 25)
    walker = Thing((1.0, 0.6, 1.7), at, range(28, 45), 0.1)
    for size, expected in (((0.1, 0.1, 1.6), []), ((0.5, 0.5, 1.6), list(range(28)))):
        beside = Thing(size, lambda i: (at(i)[0] + 0.2, 3.2) if i < 28 else None, step=0.1)
        assert tracked([walker, beside], 45) == [list(range(28)), expected]


def test_a_track_of_few_points_adds_no_object_of_many():
    """A pedestrian is lost where a bin comes into view that was occluded or too far."""

    def every(n):
        return lambda _, shape: np.arange(len(shape)) % n == 0

    def later(i):
        return (10.0, 3) if i >= 20 else None

    walker = Thing(
        PERSON, lambda i: (8 + 0.1 * i, 3) if i < 20 else None, range(20), 0.1, every(30)
    )
    for n, sweeps in ((1, []), (15, list(range(20, 40)))):
        assert tracked([walker, Thing(PERSON, later, step=0.1, seen=every(n))], 40) == [[], sweeps]


def test_a_car_that_moves_less_than_its_length_was_observed_to_leave():
    at = waits((15, 3), 30)
    car = Thing(CAR, at, range(35, 50))
    assert at(49)[0] - at(0)[0] < CAR[0]
    assert tracked([car], 50) == [list(range(35))]


def random_things(rng, count):
    things = []
    for _ in range(12):
        size = [CAR, PERSON, WALL, (2.0, 1.0, 0.2)][rng.integers(4)]
        start, leaves = rng.uniform((-5, -15), (25, 15)), rng.integers(0, count // 2)
        moves = waits(start, leaves, rng.choice([0.0, 1.5, 6.0], p=[0.2, 0.4, 0.4]))
        hidden = set(rng.integers(0, count, 3).tolist())
        first = leaves + rng.integers(0, 9)
        things.append(
            Thing(
                size,
                lambda i, moves=moves, hidden=hidden: None if i in hidden else moves(i),
                range(first, count, rng.integers(1, 3)),
                0.3,
            )
        )
    return things


@pytest.mark.parametrize("seed", range(4))
def test_tracked_objects_equal_the_reference(seed, monkeypatch):
    rng = np.random.default_rng(seed)
    pairs = [pair for pair in np.sort(rng.integers(0, 12, (3, 2)), 1).tolist() if pair[0] < pair[1]]
    joined = {tuple(pair): range(rng.integers(0, 20), 25) for pair in pairs}
    detections, _ = detections_of(random_things(rng, 30), 30, seed, joined)
    monkeypatch.setattr(TRACK_PARAMETERS, "max_gap", 0.3)
    monkeypatch.setattr(TRACK_PARAMETERS, "max_gap_standing", 1.0)
    times = np.arange(30) * 100_000_000
    found = [track_objects(detections, times, threads) for threads in (1, 2)]
    again = [Detections.of(seen.arrays) for seen in detections]
    expected = reference_tracks(
        [seen.arrays for seen in detections], times * 1e-9, max_gap=0.3, max_gap_standing=1.0
    )
    assert sum(len(rows) for rows, _ in expected) > 10
    assert sum(len(boxes) for _, boxes in expected) > 50
    for one, two, three, right in zip(*found, track_objects(again, times), expected, strict=True):
        for result in (one, two, three):
            np.testing.assert_array_equal(result.objects, right[0])
            np.testing.assert_allclose(result.boxes, right[1], atol=1e-4)
        np.testing.assert_array_equal(one.boxes, two.boxes)
    voxels = reference_voxels(
        [seen.arrays for seen in detections], [of for of, _ in expected], times * 1e-9
    )
    assert sum(len(of) for of in voxels) > 100
    for one, two, right in zip(*found, voxels, strict=True):
        np.testing.assert_array_equal(one.voxels, right)
        np.testing.assert_array_equal(two.voxels, right)


def test_a_few_points_in_a_dynamic_voxel_are_dynamic():
    """They are too few for an object; beside a hedge they may be of the hedge."""
    walker = Thing(PERSON, lambda i: (8 + 0.1 * i, 3) if i != 15 else None, range(30), 0.1)
    hedge = Thing((1.6, 0.6, 1.7), parked_at(9.5, 3.4), step=0.1)
    for things, moves in (((walker,), True), ((walker, hedge), False)):
        detections, _ = detections_of(things, 30)
        found = track_objects(detections, np.arange(30) * 100_000_000)[15]
        few = np.float32([(9.5, 3.0, 0.5), (9.5, 3.0, 1.4), (14.0, 3.0, 0.5)])
        place = TrackingResult(np.zeros(0, np.uint32), np.zeros((0, 6), np.float32), found.voxels)
        none, alone = np.zeros(3, np.uint16), np.arange(3, dtype=np.uint32)
        static = np.uint16([0, 3, 0])  # many more say that it stands
        classid = apply_tracks(few, alone, Votes(static, none), none + 50, place, np.eye(4))
        assert list(classid) == [100 if moves else 50, 50, 50]


def test_detections_are_the_objects_of_their_sweep():
    rng = np.random.default_rng(0)
    points = rng.uniform(-5, 5, (400, 3)).astype(np.float32)
    ground = rng.random(400) < 0.3
    objects = rng.integers(0, 6, 400).astype(np.uint32)
    objects = np.array([np.flatnonzero((objects == o) & ~ground)[0] for o in objects], np.uint32)
    objects[ground] = np.flatnonzero(ground)
    moving = rng.random(400) < 0.5
    T = np.eye(4)
    T[:3, 3] = 3, -2, 1
    numbers, boxes, places = Detections(points, ground, objects, moving, T).arrays
    assert list(numbers[:, 0]) == sorted(set(objects[~ground]))
    for (first, count, dynamic, _), box in zip(numbers, boxes, strict=True):
        members = ~ground & (objects == first)
        assert count == members.sum()
        assert dynamic == (members & moving).sum()
        world = points[members] + np.float32([3, -2, 1])
        np.testing.assert_array_equal(box, [*world.min(0), *world.max(0)])
    assert numbers[:, 3].sum() == len(places)
    assert numbers[:, 3].max() <= 100


def test_wrong_objects_are_refused():
    points, ground = np.ones((3, 3), np.float32), np.zeros(3, bool)
    objects, moving = np.array([0, 1, 1], np.uint32), np.zeros(3, bool)
    with pytest.raises(ValueError, match="cluster_objects"):
        Detections(points, ground, objects[::-1].copy(), moving, np.eye(4))
    with pytest.raises(InputError, match="one of each"):
        track_objects([Detections(points, ground, objects, moving, np.eye(4))], np.arange(2))
    assert track_objects([], np.zeros(0, np.int64)) == []
