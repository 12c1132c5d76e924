"""Tracks and the evidence that they carry: exact scenes, and plain numpy."""

import numpy as np
import pytest
from tracks_reference import dynamic_voxels as reference_voxels

from docdepth.dynamics import tracking
from docdepth.dynamics.tracking import (
    TRACK_PARAMETERS,
    Detections,
    PointStays,
    TrackedSweep,
    Tracking,
    apply_tracks,
    follow_tracks,
    track_objects,
)
from docdepth.dynamics.voting import Votes
from docdepth.errors import InputError
from docdepth.geometry.scan_mesh import ScanMesh
from docdepth.geometry.trajectory import Trajectory

MEMORY = 30  # sweeps: for so long key frames remember a place
CAR, PERSON, POLE, WALL = (4.2, 1.8, 1.5), (0.6, 0.6, 1.7), (0.3, 0.3, 2.0), (12.0, 0.3, 2.5)


def rays():
    """Directions of a LiDAR with a ring each degree."""
    azimuth, elevation = np.radians(np.arange(-180, 180, 0.3)), np.radians(np.arange(-25, 3, 1.0))
    azimuth, elevation = (a.ravel() for a in np.meshgrid(azimuth, elevation))
    level = np.cos(elevation)
    return np.stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)], 1)


RAYS = rays()


class Thing:
    """A box, its position in each sweep (None: unseen), and the sweeps that vote dynamic.

    Positions are (x, y) or (x, y, z) of its middle. ``seen`` chooses among its returns, in its own
    frame; all if None. ``remembered``: votes tell in order of time that it came or left.
    """

    def __init__(self, size, at, dynamic=(), seen=None, remembered=True):
        self.at, self.dynamic, self.seen = at, set(dynamic), seen
        self.box, self.size, self.remembered = size, float(np.hypot(*size[:2])), remembered

    def stay(self, i, count):
        """Whether its place was free within 3 s, and the sweeps that found it occupied then."""
        here, half = np.array(self.at(i)[:2]), 0.5 * max(self.box[:2])
        near = range(max(i - MEMORY, 0), min(i + MEMORY + 1, count))
        off = {j: np.linalg.norm(self.at(j)[:2] - here) for j in near if self.at(j) is not None}
        there = [j for j, distance in off.items() if distance < half]
        left = self.remembered and max(off.values()) > self.size
        return left, there[0], there[-1]

    def ranges(self, i, lidar):
        """Where each ray of a sweep meets it."""
        place = self.at(i)
        if place is None:
            return np.full(len(RAYS), np.inf)
        middle = np.array((*place[:2], *(place[2:] or (0.8,)))) - lidar
        ranges = ranges_of(self.box, middle)
        if self.seen is not None:
            hit = np.flatnonzero(np.isfinite(ranges))
            unseen = ~self.seen(i, RAYS[hit] * ranges[hit, None] - middle)
            ranges[hit[unseen]] = np.inf
        return ranges


def ranges_of(size, middle, turn=0.0):
    """Where each ray of a LiDAR at the origin meets a box; infinite where it does not."""
    rotation = np.array([[np.cos(turn), np.sin(turn), 0], [-np.sin(turn), np.cos(turn), 0],
                         [0, 0, 1]])  # fmt: skip
    start, along = np.negative(middle) @ rotation.T, RAYS @ rotation.T
    with np.errstate(divide="ignore"):
        ends = np.sort((np.array([-1, 1])[:, None, None] * np.array(size) / 2 - start) / along, 0)
    near, far = ends[0].max(1), ends[1].min(1)
    return np.where((near < far) & (near > 0), near, np.inf)


def measured(ranges, rays, rng):
    """The returns of some rays, with noise."""
    noise = rng.normal(0, 0.01, np.count_nonzero(rays))
    return (RAYS[rays] * (ranges[rays] + noise)[:, None]).astype(np.float32)


def detections_of(things, count, seed=0, joined=None, drive=None):
    """Detections from a vehicle that drives ahead, and in each sweep the first row of each thing.

    ``joined`` maps a pair of things to the sweeps in which both are one object.
    """
    rng = np.random.default_rng(seed)
    detections, rows = [], []
    for i in range(count):
        T = (drive or straight(count)).poses[i]
        points, first, moving, stays, firsts, wholes = [], [], [], [], {}, {}
        ranges = np.array([thing.ranges(i, T[:3, 3]) for thing in things])
        nearest = np.where(np.isfinite(ranges).any(0), ranges.argmin(0), -1)
        for k, thing in enumerate(things):
            own = nearest == k
            if not own.any():
                continue
            firsts[k] = len(points)
            seen = measured(ranges[k], own, rng)
            whole = next((wholes[a] for (a, b), sweeps in (joined or {}).items()
                          if b == k and a in wholes and i in sweeps), firsts[k])  # fmt: skip
            wholes[k] = whole
            points += list(seen)
            first += [whole] * len(seen)
            moving += [i in thing.dynamic] * len(seen)
            stays += [thing.stay(i, count)] * len(seen)
        cloud = np.array(points, np.float32).reshape(-1, 3)
        none = np.zeros(len(cloud), bool)
        objects, flags = np.array(first, np.uint32), np.array(moving, bool)
        once, *ends = np.array(stays, np.int32).reshape(-1, 3).T
        seen = PointStays(once > 0, *(np.ascontiguousarray(end) for end in ends))
        detections.append(Detections(cloud, none, objects, flags, seen, ScanMesh(cloud), T))
        rows.append(firsts)
    return detections, rows


def straight(count):
    """The trajectory of the vehicle."""
    poses = np.repeat(np.eye(4)[None], count, 0)
    poses[:, 0, 3], poses[:, 2, 3] = 0.8 * np.arange(count), 1.7
    return Trajectory(np.arange(count) * 100_000_000, poses)


def tracked(things, count, **more):
    """For each thing the sweeps in which only tracks make it dynamic."""
    detections, rows = detections_of(things, count, **more)
    found = track_objects(detections, straight(count)).sweeps
    return [
        [i for i in range(count) if k in rows[i] and rows[i][k] in found[i].dynamic]
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


def test_a_car_that_stands_when_it_is_last_seen_stays_there(monkeypatch):
    """It is hidden for longer than a track is continued, and then seen for two sweeps."""
    monkeypatch.setitem(globals(), "MEMORY", 200)
    stop = waits((45, 5), 20)
    lost = [*range(40, 96), *range(98, 110)]
    car = Thing(CAR, lambda i: None if i in lost else stop(49 - i), range(22))
    assert tracked([car], 110) == [[*range(22, 40), 96, 97]]
    # What stands there then and was there all the time is another thing.
    other = Thing(CAR, lambda i: stop(0) if i in (96, 97) else None, remembered=False)
    gone = Thing(CAR, lambda i: None if i >= 40 else stop(49 - i), range(22))
    assert tracked([gone, other], 110) == [list(range(22, 40)), []]


def test_last_sweeps_without_votes():
    (car,) = tracked([Thing(CAR, passes(4), range(17))], 20)
    assert car == [17, 18, 19]


@pytest.mark.parametrize(
    ("height", "dynamic", "claimed"),
    [(2.6, range(17), [17, 18, 19]), (0.8, range(17), []), (2.6, range(0, 20, 3), [])],
    ids=["the side of a lorry", "a crash barrier", "a fence that votes rarely call free"],
)
def test_a_long_thin_thing_that_goes_along_itself(height, dynamic, claimed):
    at = passes(4)
    # Where nothing is claimed, the order of votes does not tell that it came or left either.
    told = claimed != []
    side = Thing((9.0, 0.1, height), lambda i: (*at(i), height / 2), dynamic, remembered=told)
    assert tracked([side], 20) == [claimed]


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


def test_a_piece_within_a_lorry_that_passes_is_the_lorry():
    """In one sweep its rear is an object of its own, whose place other vehicles took before."""
    at = passes(4, speed=5.0, start=6.0)
    front = Thing((4.0, 2.4, 2.5), lambda i: (at(i)[0] + 2, 4), range(40))
    rear = Thing((4.0, 2.4, 2.5), lambda i: (at(i)[0] - 2, 4), [i for i in range(40) if i != 20])
    rear.stay = lambda i, count: (False, i, i) if i == 20 else Thing.stay(rear, i, count)
    kerb = Thing((3.0, 0.4, 0.3), lambda _: (at(20)[0], 2.1, 0.15))
    whole = {(0, 1): [i for i in range(40) if i != 20]}
    assert tracked([front, rear, kerb], 40, joined=whole) == [[], [20], []]


def test_a_parked_car_where_another_one_stopped_stays_static():
    """Its place was occupied while the other one came, so it is not the same car."""
    parked = Thing(CAR, parked_at(8, 4))
    mover = Thing(CAR, lambda i: passes(4)(i) if i < 17 else None, range(17))
    assert tracked([mover, parked], 40) == [[], []]


def test_a_pole_and_a_wall_beside_a_pedestrian_who_disappears_stay_static():
    walker = Thing(PERSON, lambda i: (2 + 0.12 * i, 3) if i < 25 else None, range(25))
    pole = Thing(POLE, parked_at(5.1, 3.1))
    wall = Thing(WALL, parked_at(4, 3.5))
    assert tracked([walker, pole, wall], 40) == [[], [], []]


def test_a_pedestrian_beside_a_wall_is_tracked_past_it():
    walker = Thing(PERSON, lambda i: (2 + 0.12 * i, 3), [*range(10), *range(20, 30)])
    wall = Thing(WALL, parked_at(4, 3.5))
    assert tracked([walker, wall], 30) == [list(range(10, 20)), []]


def test_a_pedestrian_whose_legs_vanish_behind_a_hedge_stays_upright():
    """What is seen of him rises by 0.6 m; he does not, and does not lean as a car uphill does."""

    def above(i, points):
        return points[:, 2] > -0.8 + min(0.03 * i, 0.6)

    walker = Thing(PERSON, lambda i: (6 + 0.15 * i, 3), range(40), seen=above)
    detections, _ = detections_of([walker], 40)
    (track,) = track_objects(detections, straight(40)).tracks
    np.testing.assert_array_equal(track.poses[:, :3, 2], [[0, 0, 1]] * len(track))


def test_a_shaking_bush_has_not_moved():
    rng = np.random.default_rng(1)
    bush = Thing((1.2, 1.2, 1.2), lambda i: (6 + rng.normal(0, 0.1), 3), range(0, 30, 2))
    assert tracked([bush], 30) == [[]]


def test_a_track_that_drifts_on_without_votes_has_not_moved():
    """Votes saw a quarter of a metre of a twig's two metres."""
    twig = Thing(PERSON, lambda i: (6 + 0.05 * i, 3), range(6), remembered=False)
    assert tracked([twig], 40) == [[]]


def test_two_dynamic_sweeps_are_no_track():
    assert tracked([Thing(CAR, passes(4), range(10, 12), remembered=False)], 20) == [[]]


def path_of(place, count, lost=()):
    """The track of a car that a standing LiDAR sees, but for some sweeps, and all it says."""
    rng, detections = np.random.default_rng(0), []
    for i in range(count):
        x, y, turn = place(i)
        ranges = ranges_of(CAR, (x, y, CAR[2] / 2 - 1.7), turn)
        cloud = measured(ranges, np.isfinite(ranges) & (i not in lost), rng)
        none, whole = np.zeros(len(cloud), bool), np.zeros(len(cloud), np.uint32)
        ends = np.full(len(cloud), i, np.int32)
        stays, mesh = PointStays(~none, ends, ends), ScanMesh(cloud)
        detections.append(Detections(cloud, none, whole, ~none, stays, mesh, np.eye(4)))
    poses = np.repeat(np.eye(4)[None], count, 0)
    found = track_objects(detections, Trajectory(np.arange(count) * 100_000_000, poses))
    (track,) = found.tracks
    assert track.kind == "vehicle"
    return track, found.sweeps


def test_a_car_that_is_lost_is_where_its_motion_predicts_it(monkeypatch):
    lost = {0, 1, 7, 8, 9, 27}

    def place(i):
        return -10 + 0.8 * i, 8.0, 0.0

    _, sweeps = path_of(place, 28, lost)
    for i in lost:
        ((_, moving),) = sweeps[i].box_tracks
        assert moving
        T = np.vstack([sweeps[i].boxes[0, :12].reshape(3, 4), [0, 0, 0, 1]])
        np.testing.assert_allclose(np.linalg.inv(T)[0, 3], place(i)[0], atol=0.3)
    monkeypatch.setattr(TRACK_PARAMETERS, "window", 0)
    assert not any(len(sweep.boxes) for sweep in path_of(place, 28, lost)[1])


def test_the_box_of_a_standing_object_does_not_move():
    car = Thing(CAR, waits((15, 3), 20), range(50))
    found = track_objects(detections_of([car], 50)[0], straight(50)).sweeps
    assert not any(moves for sweep in found[:18] for _, moves in sweep.box_tracks)
    assert all(moves for sweep in found[28:] for _, moves in sweep.box_tracks)
    assert all(len(sweep.boxes) for sweep in found)


def test_points_in_a_predicted_box_are_dynamic_unless_votes_or_ground_say_otherwise():
    T = np.eye(4)
    T[:3, 3] = 2, 0, 1
    points = np.array([[5, 0, 0], [5, 1, 0], [5, 2, 0], [5, 0, 0], [9, 0, 0]], np.float32)
    T_box_world = np.eye(4)[:3]
    T_box_world[:, 3] = -7, -1, -1  # in the world: from (6, -1, 0) to (8, 3, 2)
    box = np.r_[T_box_world.ravel(), 1, 2, 1].astype(np.float32)[None]
    static, dynamic = np.array([[0, 2, 3, 0, 0], [0] * 5], np.uint16)
    classid = np.array([50, 50, 50, 0, 50], np.uint16)
    alone = np.arange(5, dtype=np.uint32)
    found = TrackedSweep(box_tracks=np.array([[4, 1]], np.uint32), boxes=box)
    classes, instance = apply_tracks(points, alone, Votes(static, dynamic), classid, found, T)
    assert list(classes) == [100, 100, 50, 0, 50]
    assert list(instance) == [4, 4, 0, 0, 0]
    stands = found._replace(box_tracks=np.array([[4, 0]], np.uint32))
    classes, _ = apply_tracks(points, alone, Votes(static, dynamic), classid, stands, T)
    assert list(classes) == list(classid)


@pytest.mark.parametrize(("always", "share", "moves"), [(8, 0.9, 0), (8, 0.7, 1), (7, 0.9, 1)])
def test_an_always_occupied_rest_of_a_tracked_object_stays_static(always, share, moves):
    """Beyond that share it was observed free at times, or occupied not often enough."""
    rows = np.arange(100)
    occupied = rows >= 40 + 60 * (1 - share)
    points = np.stack([10 + 0.02 * rows, 0 * rows, 0 * rows], 1).astype(np.float32)
    static, dynamic = np.full(100, always, np.uint16), (~occupied).astype(np.uint16)
    classid = np.where(rows < 40, 100, 50).astype(np.uint16)  # these move by their votes
    found = TrackedSweep(np.array([[0, 3, 1]], np.uint32))
    whole = np.zeros(100, np.uint32)
    votes = Votes(static, dynamic)
    classes, instance = apply_tracks(points, whole, votes, classid, found, np.eye(4))
    np.testing.assert_array_equal(instance, np.where(classes == 100, 3, 0))
    assert (classes[:40] == 100).all()
    assert (classes[40:] == (100 if moves else 50)).all()
    standing = (whole + 50).astype(np.uint16)
    waits, _ = apply_tracks(points, whole, votes, standing, found, np.eye(4))
    assert (waits == 100).all()  # none of it moves now: it is known from another time


def test_a_waiting_car_whose_parts_are_seen_in_turn_is_dynamic_as_a_whole():
    """Its halves have a track each, and that of the upper one ends where it stands."""
    at = waits((15, 3), 30)
    lower = Thing((4.2, 1.8, 0.8), at, range(33, 60))
    upper = Thing((2.0, 1.6, 0.6), lambda i: (*at(i), 1.5) if i % 3 == 0 else None, range(36, 60))
    post = Thing(POLE, parked_at(12.3, 3))
    found = tracked([lower, upper, post], 60)
    assert found[0] == list(range(33))
    assert found[1] == list(range(0, 36, 3))
    assert found[2] == []


@pytest.mark.parametrize("seed", range(3))
def test_a_car_is_tracked_though_each_sweep_of_a_rosette_sees_other_parts(seed):
    """Half of its cells of 60 cm, drawn anew in each sweep."""
    at = waits((15, 3), 30)

    def cells(i, points):
        drawn = np.random.default_rng([seed, i]).random((8, 4, 4)) < 0.5
        return drawn[tuple(np.floor((points + np.array(CAR) / 2) / 0.6).astype(int).T)]

    car = Thing(CAR, at, range(35, 60), seen=cells)
    assert tracked([car], 60) == [list(range(35))]


def test_what_the_lidar_sees_of_its_own_vehicle_is_not_tracked():
    """It moves with the vehicle, as a cyclist does who rides beside it for half of the drive."""
    rack = Thing((0.4, 0.4, 0.4), lambda i: (0.8 * i - 1, 1.2, 1.1), range(40))
    ahead = [0.8 * i + 1 + 0.02 * max(0, i - 20) ** 2 for i in range(40)]
    cyclist = Thing((1.7, 0.6, 1.7), lambda i: (ahead[i], 2.2), range(40))
    for things, count in (((rack, cyclist), 1), ((cyclist,), 1), ((rack,), 0)):
        detections, _ = detections_of(things, 40)
        assert len(track_objects(detections, straight(40)).tracks) == count


def test_a_thing_beside_a_lidar_that_stands_is_tracked():
    """It waits for most of the drive, at the same place of both frames, and goes."""
    there = Trajectory(straight(40).times, np.repeat(straight(1).poses, 40, 0))
    things = [Thing(PERSON, lambda i: (1 + max(0, i - 35) * 0.5, 2.0), range(36, 40))]
    detections, _ = detections_of(things, 40, drive=there)
    assert len(track_objects(detections, there).tracks) == 1


def test_a_bin_that_a_pedestrian_leaves_is_not_part_of_him():
    """They are one object at first; when he is far away, the bin is occluded."""
    walker = Thing(PERSON, lambda i: (8 + 0.08 * i, 3), range(60))
    bin_ = Thing((0.6, 0.6, 1.0), lambda i: (7.6, 3, 0.5) if i < 40 else None)
    assert tracked([walker, bin_], 60, joined={(0, 1): range(8)})[1] == []


def test_a_thin_post_that_a_track_includes_stays_static_if_it_was_not_seen_before():
    """While the pedestrian was elsewhere, the post was too far to be an object."""
    at = waits((6, 3), 25)
    walker = Thing((1.0, 0.6, 1.7), at, range(28, 45))
    for size, expected in (((0.1, 0.1, 1.6), []), ((0.5, 0.5, 1.6), list(range(28)))):
        beside = Thing(size, lambda i: (at(i)[0] + 0.3, 2.6) if i < 28 else None)
        assert tracked([walker, beside], 45)[1] == expected


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
        first = leaves + rng.integers(0, 9)
        things.append(Thing(size, moves, range(first, count, rng.integers(1, 3))))
    return things


def same_tracking(one, other):
    """Whether all arrays of two results are the same."""
    assert len(one.sweeps) == len(other.sweeps)
    for left, right in zip(one.sweeps, other.sweeps, strict=True):
        for of_left, of_right in zip(left, right, strict=True):
            np.testing.assert_array_equal(of_left, of_right)
    for left, right in zip(one.tracks, other.tracks, strict=True):
        assert (left.id, left.kind) == (right.id, right.kind)
        for name in ("times", "poses", "velocities", "size", "points", "deviations"):
            np.testing.assert_array_equal(getattr(left, name), getattr(right, name))


@pytest.mark.parametrize("seed", range(4))
def test_tracks_do_not_depend_on_threads_or_files(seed):
    rng = np.random.default_rng(seed)
    detections, _ = detections_of(random_things(rng, 30), 30, seed)
    again = [Detections.of(seen.arrays) for seen in detections]
    one, two = (track_objects(detections, straight(30), threads) for threads in (1, 2))
    assert len(one.tracks) >= 3
    same_tracking(one, two)
    same_tracking(one, track_objects(again, straight(30)))
    claimed = [set(sweep.dynamic.tolist()) for sweep in one.sweeps]
    times = straight(30).times * 1e-9
    voxels = reference_voxels([seen.arrays for seen in detections], claimed, times)
    assert sum(len(of) for of in voxels) > 100
    for sweep, right in zip(one.sweeps, voxels, strict=True):
        np.testing.assert_array_equal(sweep.voxels, right)


def test_a_drive_of_which_few_sweeps_are_held(monkeypatch):
    """As if all were held: sweeps are read again when they are needed, and not for nothing."""
    count = 90
    detections, _ = detections_of(random_things(np.random.default_rng(0), 60)[:8], count)
    saved = [seen.arrays for seen in detections]
    monkeypatch.setattr(tracking, "_HELD_SWEEPS", count)
    right = track_objects(detections, straight(count))
    assert len(right.tracks) > 3
    for held, reads_a_sweep in ((1, 7), (3, 7), (20, 5), (count, 3)):
        monkeypatch.setattr(tracking, "_HELD_SWEEPS", held)
        reads, sweeps = [], []

        def read(sweep, reads=reads):
            reads.append(sweep)
            return Detections.of(saved[sweep])

        tracks = follow_tracks(read, straight(count), sweeps.append)
        same_tracking(Tracking(sweeps, tracks), right)
        assert len(reads) <= reads_a_sweep * count


def turning(i):
    """A car that drives at 8 m/s and turns by 0.4 rad/s from the first second on."""
    speed, rate, seconds = 8.0, 0.4, 0.1 * i
    if seconds < 1:
        return -6 + speed * seconds, 5.0, 0.0
    turn = rate * (seconds - 1)
    radius = speed / rate
    return 2 + radius * np.sin(turn), 5.0 + radius * (1 - np.cos(turn)), turn


def test_the_path_of_a_turning_car_is_found():
    """Registered surfaces tell position and heading, whatever side of the car is seen."""
    track, _ = path_of(turning, 40)
    sweeps = track.times // 100_000_000
    truth = np.array([turning(i) for i in sweeps])
    assert len(sweeps) >= 30
    np.testing.assert_allclose(track.poses[:, :2, 3], truth[:, :2], atol=0.25)
    heading = np.arctan2(track.poses[:, 1, 0], track.poses[:, 0, 0])
    assert np.abs(np.degrees(heading - truth[:, 2])).max() < 6
    speed = np.linalg.norm(track.velocities, axis=1)
    assert np.abs(speed - 8)[3:-3].max() < 0.6
    np.testing.assert_allclose(track.size, CAR, atol=0.4)


def test_a_lorry_that_overtakes_is_measured_at_different_times():
    """In a sweep its front and its rear are up to 40 ms apart, in which it goes 0.7 m."""
    speed, count, rng = 18.0, 30, np.random.default_rng(0)
    parts = (((6.5, 2.5, 3.5), (-1.5, 0, 1.75)), ((2, 2.3, 2.8), (4, 0, 1.6)))
    late = np.arctan2(RAYS[:, 1], RAYS[:, 0]) / (-2 * np.pi) * 0.1
    moved = np.outer(late, (1, 0, 0))
    truth = np.stack([1.8 * np.arange(count) - 14, np.full(count, 4.0), np.zeros(count)], 1)
    detections = []
    for i, T in enumerate(straight(count).poses):
        middle = truth[i] - T[:3, 3] + (speed - 8) * moved
        ranges = np.min([ranges_of(np.array(size), middle + off) for size, off in parts], 0)
        hit = np.isfinite(ranges)
        cloud = (measured(ranges, hit, rng) + 8 * moved[hit]).astype(np.float32)
        none, here = np.zeros(len(cloud), bool), np.full(len(cloud), i, np.int32)
        whole, stays = np.zeros(len(cloud), np.uint32), PointStays(~none, here, here)
        times = late[hit].astype(np.float32)
        detections.append(Detections(cloud, none, whole, ~none, stays, ScanMesh(cloud), T, times))
    (track,) = track_objects(detections, straight(count)).tracks
    assert len(track) == count
    off = track.poses[:, 0, 3] - truth[:, 0]
    assert np.abs(off - np.median(off)).max() < 0.08  # 0.2 m as if all were measured at once
    np.testing.assert_allclose(track.size[0], 10, atol=0.3)


def test_a_few_points_in_a_dynamic_voxel_are_dynamic():
    """They are too few for an object; beside a hedge they may be of the hedge."""
    walker = Thing(PERSON, lambda i: (8 + 0.1 * i, 3) if i != 15 else None, range(30))
    hedge = Thing((1.6, 0.6, 1.7), parked_at(9.5, 3.4))
    for things, moves in (((walker,), True), ((walker, hedge), False)):
        detections, _ = detections_of(things, 30)
        found = track_objects(detections, straight(30)).sweeps[15]
        few = np.float32([(9.5, 3.0, 0.5), (9.5, 3.0, 1.4), (14.0, 3.0, 0.5)])
        place = TrackedSweep(voxels=found.voxels)
        none, alone = np.zeros(3, np.uint16), np.arange(3, dtype=np.uint32)
        static = np.uint16([0, 3, 0])  # many more say that it stands
        classid, _ = apply_tracks(few, alone, Votes(static, none), none + 50, place, np.eye(4))
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
    ends = np.arange(400, dtype=np.int32)
    free = rng.random(400) < 0.5
    stays, mesh = PointStays(free, ends, ends), ScanMesh(points)
    made = Detections(points, ground, objects, moving, stays, mesh, T)
    numbers, areas, boxes, places, normals, borders, times = made.arrays
    assert list(numbers[:, 0]) == sorted(set(objects[~ground]))
    for (first, count, dynamic, _, earliest, *_), area, box in zip(
        numbers, areas, boxes, strict=True
    ):
        members = ~ground & (objects == first)
        assert count == members.sum()
        assert dynamic == (members & moving).sum()
        world = points[members] + np.float32([3, -2, 1])
        np.testing.assert_array_equal(box, [*world.min(0), *world.max(0)])
        squares = (points[members] ** 2).sum(1)
        np.testing.assert_allclose(area[0], squares.sum(), rtol=1e-5)
        np.testing.assert_allclose(area[1], squares[moving[members]].sum(), rtol=1e-5)
        isolated = np.isin(np.flatnonzero(members), mesh.core.isolated).sum()
        freed = squares[free[members]].sum() if isolated <= 0.1 * count else 0
        np.testing.assert_allclose(area[2], freed, rtol=1e-5)
        assert earliest == np.sort(np.flatnonzero(members))[count // 2]
    assert numbers[:, 3].sum() == len(places) == len(normals)
    assert numbers[:, 6:].sum() == len(borders)
    assert len(times) == len(places) + len(borders)
    assert ((np.abs(np.linalg.norm(normals, axis=1) - 1) < 1e-5) | ~normals.any(1)).all()
    assert numbers[:, 3].max() <= 100


def test_borders_tell_where_an_object_ends_and_where_it_is_hidden():
    """A car before a wall, with a pole before the car."""
    things = [
        Thing(CAR, parked_at(0, 8)),
        Thing(WALL, parked_at(0, 14)),
        Thing(POLE, parked_at(0.8, 4)),
    ]
    detections, rows = detections_of(things, 1)
    numbers, *_, borders, _ = detections[0].arrays
    (k,) = np.flatnonzero(numbers[:, 0] == rows[0][0])
    ends = np.cumsum(numbers[:, 6:].ravel().astype(int))  # edges and hidden of each in turn
    edges, hidden = (
        borders[ends[2 * k] - numbers[k, 6] : ends[2 * k]],
        borders[ends[2 * k] : ends[2 * k + 1]],
    )
    front = 8 - CAR[1] / 2
    below = edges[:, 2] < 1.3  # the roof ends, too
    assert below.sum() >= 4
    np.testing.assert_allclose(np.abs(edges[below, 0]), CAR[0] / 2, atol=0.1)
    assert len(hidden) >= 4
    shadow = front * np.array([0.65 / 4.15, 0.95 / 3.85])  # of the pole, from the LiDAR
    assert np.quantile(np.abs(hidden[:, :1] - shadow).min(1), 0.8) < 0.15


def test_wrong_objects_are_refused():
    points, ground = np.ones((3, 3), np.float32), np.zeros(3, bool)
    objects, moving = np.array([0, 1, 1], np.uint32), np.zeros(3, bool)
    stays, mesh = PointStays(moving, *np.zeros((2, 3), np.int32)), ScanMesh(points)
    with pytest.raises(ValueError, match="cluster_objects"):
        Detections(points, ground, objects[::-1].copy(), moving, stays, mesh, np.eye(4))
    one = Detections(points, ground, objects, moving, stays, mesh, np.eye(4))
    with pytest.raises(InputError, match="one of each"):
        track_objects([one], straight(2))
    with pytest.raises(InputError, match="order"):
        PointStays.of(Votes(*np.zeros((2, 3), np.uint16)), np.arange(2), 2)
