"""What tracks make dynamic: exact scenes, and plain numpy."""

from dataclasses import fields

import numpy as np
import pytest
from dynamics_reference import dynamic_voxels as reference_voxels
from things import (
    CAR,
    LORRY,
    PERSON,
    POLE,
    WALL,
    Thing,
    Tracking,
    detections_of,
    drive_of,
    parked_at,
    passes,
    rosette,
    tracked,
    tracking_of,
    tracks_of,
    waits,
)

import docdepth._core as _core
from docdepth.dynamics import tracking
from docdepth.dynamics.tracking import (
    TrackedSweep,
    label_by_tracks,
    track_objects,
    withdraw_untracked,
)
from docdepth.dynamics.voting import Votes
from docdepth.geometry.trajectory import Trajectory
from lidar_rays import scan_rays


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
    monkeypatch.setattr("things.MEMORY", 200)
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


@pytest.mark.parametrize("height", [6.0, 3.2])
def test_a_tree_that_sways_does_not_move(monkeypatch, height):
    rays = scan_rays(np.radians(range(-8, 20)), np.radians(np.arange(0, 60, 0.3)))
    monkeypatch.setattr("things.RAYS", rays.reshape(-1, 3))

    def place(i):
        return 20 + 0.8 * np.sin(0.3 * i), 8.0, height / 2

    assert tracked([Thing((2.3, 2.0, height), place, range(17))], 20) == [[]]


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


def test_a_parked_car_that_was_one_object_with_a_car_that_arrives_stays_static(monkeypatch):
    """Far away both are one object, and votes tell of neither that it was there before."""
    monkeypatch.setattr("things.MEMORY", 60)
    stop = waits((15, 3), 20)
    mover = Thing(CAR, lambda i: stop(49 - i), range(22))
    parked = Thing(CAR, parked_at(15.5, 5.6))
    parked.stay = lambda i, count: (False, 22, count - 1)
    arrived, neighbor = tracked([mover, parked], 60, joined={(0, 1): range(22, 40)})
    assert arrived == list(range(22, 60))
    assert [i for i in neighbor if i >= 22] == []


def test_a_parked_car_of_which_a_part_was_known_before_stays_static(monkeypatch):
    """It hides a car that parks beside it, the track of which goes on with it."""
    monkeypatch.setattr("things.MEMORY", 60)
    stop = waits((15, 3), 20)
    mover = Thing(CAR, lambda i: stop(49 - i) if i < 26 else None, range(22))
    shown = [*range(18, 22), *range(26, 60)]
    lower = Thing((4.2, 1.8, 0.5), lambda i: (16.4, 4.6, 0.3) if i in shown else None)
    upper = Thing((4.2, 1.8, 1.0), lambda i: (16.4, 4.6, 1.05) if i in shown else None)
    lower.stay = lambda i, count: (False, 0, count - 1)
    upper.stay = lambda i, count: (False, 26, count - 1)
    together = {(0, 1): range(18, 22), (1, 2): range(60)}
    assert tracked([mover, lower, upper], 60, joined=together)[1] == []


def test_a_car_that_arrives_stays_dynamic_though_a_part_of_its_place_seems_occupied_before():
    """Far away few rays tell that; others tell that a part of it was free."""
    stop = waits((15, 3), 20)
    parts = [
        Thing((4.2, 1.8, height), lambda i, z=z: (*stop(49 - i), z), range(22))
        for height, z in ((0.5, 0.3), (0.5, 0.8), (0.5, 1.3))
    ]
    for part, free, first in zip(parts, (False, False, True), (0, 22, 22), strict=True):
        part.stay = lambda i, count, free=free, first=first: (free, min(first, i), count - 1)
    together = {(0, 1): range(50), (1, 2): range(50)}
    assert tracked(parts, 50, joined=together)[0] == list(range(22, 50))


def test_shrubs_along_which_a_lost_track_goes_on_are_static():
    """In each sweep another one is met; the place of the car is not known any more."""
    off = np.random.default_rng(1).uniform(-0.6, 0.6, (60, 2))
    at = passes(20, speed=4.0, start=12.0)
    car = Thing(CAR, lambda i: at(i) if i < 20 else None, range(20))
    shrub = Thing((2.5, 1.5, 1.5), lambda i: tuple(at(i) + off[i]) if i > 20 else None)
    shrub.stay = lambda i, count: (False, 20, count - 1)
    detections, rows = detections_of([car, shrub], 60)
    found = tracking_of(detections, drive_of(60))
    (track,) = found.tracks
    sweeps = track.times // 100_000_000
    known = sweeps[track.deviations <= 0.5][-1]
    lost = [i for i in sweeps.tolist() if at(i)[0] > at(known)[0] + 3.9]
    assert len(lost) > 1
    assert not any(rows[i][1] in found.sweeps[i].dynamic for i in lost)


def test_a_parked_car_beside_a_place_that_was_free_is_static_before_another_car_stands_there():
    """When that one is first seen, both are one object."""
    arrived = Thing(CAR, lambda i: (60, 5) if i >= 30 else None, range(30, 34))
    arrived.stay = lambda i, count: (True, 30, count - 1)
    parked = Thing(CAR, lambda i: (60.5, 7.2) if i < 10 or i >= 30 else None)
    parked.stay = lambda i, count: (False, 30, count - 1)
    found = tracked([arrived, parked], 80, joined={(0, 1): range(30, 50)})
    assert found == [list(range(30, 80)), []]


def test_a_pole_and_a_wall_beside_a_pedestrian_who_disappears_stay_static():
    walker = Thing(PERSON, lambda i: (2 + 0.12 * i, 3) if i < 25 else None, range(25))
    pole = Thing(POLE, parked_at(5.1, 3.1))
    wall = Thing(WALL, parked_at(4, 3.5))
    assert tracked([walker, pole, wall], 40) == [[], [], []]


def test_a_parked_car_that_a_pedestrian_brushed_stays_static():
    """Both were one object, and the track goes on with the rear of the car."""
    walker = Thing(PERSON, lambda i: (2 + 0.1 * i, 3) if i < 35 else None, range(35))
    car = Thing(CAR, lambda i: (7.6, 4.2) if i >= 27 else None, seen=lambda i, p: p[:, 0] < 0.1)
    car.stay = lambda i, count: (False, 27, count - 1)
    found = tracked([walker, car], 60, joined={(0, 1): range(27, 35)})
    assert found[1] == []


@pytest.mark.parametrize("size", [(0.6, 0.6, 1.2), (0.5, 0.5, 1.5)])
def test_a_bin_that_is_first_seen_where_a_pedestrian_was_last_seen_stays_static(size):
    """A narrow view sees its place only from then on, so votes do not tell that it was there."""
    walker = Thing(PERSON, lambda i: (2 + 0.12 * i, 3) if i < 22 else None, range(22))
    bin = Thing(size, lambda i: (4.7, 3.1, size[2] / 2) if i >= 22 else None)
    bin.stay = lambda i, count: (False, 22, 39)
    assert tracked([walker, bin], 40) == [[], []]


@pytest.mark.parametrize(
    ("place", "hidden"), [((11.0, 3), 0), ((11.3, 3.4), 3), ((11.6, 3), 0), ((11.6, 3), 3)]
)
def test_a_track_does_not_go_on_with_a_bush_that_stood_there_all_along(place, hidden):
    """A walker disappears about a metre before it; it may be hidden for a while, too."""
    walker = Thing(PERSON, lambda i: (8 + 0.12 * i, 3) if i < 20 else None, range(20))
    bush = Thing((0.8, 0.6, 1.5), lambda i: None if 20 <= i < 20 + hidden else place)
    (track,) = tracks_of([walker, bush], 45)
    assert len(track) == 20


def test_a_car_seen_once_does_not_go_on_as_one_that_comes_into_view_later():
    """It could be there after 0.8 s, at 6 m/s."""
    first = Thing(CAR, lambda i: (10, 8) if i == 2 else None, [2])
    later = Thing(CAR, lambda i: (12 + 0.8 * (i - 10), 4) if i >= 10 else None, range(10, 30))
    (track,) = tracks_of([first, later], 30)
    assert track.times[0] == 10 * 100_000_000


def test_a_car_is_tracked_by_two_sweeps_a_second():
    detections, _ = detections_of([Thing(CAR, passes(4), range(30))], 30)
    slow = Trajectory(drive_of(30).times * 5, drive_of(30).poses)
    (track,) = tracking_of(detections, slow).tracks
    assert len(track) == 30
    np.testing.assert_allclose(track.velocities[:, 0], 8.0 / 5, atol=0.1)


def test_a_pedestrian_beside_a_wall_is_tracked_past_it():
    walker = Thing(PERSON, lambda i: (2 + 0.12 * i, 3), [*range(10), *range(20, 30)])
    wall = Thing(WALL, parked_at(4, 3.5))
    assert tracked([walker, wall], 30) == [list(range(10, 20)), []]


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


def test_rails_have_no_number():
    """What is seen of one goes along with us. It is seen longest, and would be number 1."""
    rail = Thing((6.0, 0.24, 0.5), lambda i: (4 + 0.8 * i, 4, 0.25), range(30))
    car = Thing(CAR, lambda i: passes(-6, start=0)(i) if i > 8 else None, range(30))
    detections, _ = detections_of([rail, car], 30)
    found = tracking_of(detections, drive_of(30))
    assert [(track.id, track.kind) for track in found.tracks] == [(1, "vehicle")]
    assert found.tracks[0].size[2] > 1
    for rows in ("members", "boxes"):
        assert {number for of in found.sweeps for number in getattr(of, rows)["track"]} == {1}


def test_tracking_tells_how_much_is_done():
    things = random_things(np.random.default_rng(0), 20)[:4]
    detections, _ = detections_of(things, 20)
    told = []
    track_objects(detections.__getitem__, drive_of(20), lambda sweep: None, 1, told.append)
    assert told == sorted(told)
    assert told[-1] == 20
    assert max(np.diff([0, *told])) < 0.2 * 20


def test_no_track_goes_over_a_gap():
    """Each part has the tracks that it has alone, with numbers of their own."""
    detections, _ = detections_of([Thing(CAR, passes(-6, start=0), range(30))], 30)
    drive = drive_of(30)
    times = drive.times + np.where(np.arange(30) < 12, 0, 2 * 10**9)
    both = tracking_of(detections, Trajectory(times, drive.poses))
    assert [track.id for track in both.tracks] == [1, 2]
    for part, track in zip((range(12), range(12, 30)), both.tracks, strict=True):
        rows = slice(part.start, part.stop)
        alone = tracking_of(detections[rows], Trajectory(times[rows], drive.poses[rows]))
        np.testing.assert_array_equal(track.times, alone.tracks[0].times)
        for k in part:
            members = alone.sweeps[k - part.start].members.copy()
            members["track"] = track.id
            np.testing.assert_array_equal(both.sweeps[k].members, members)


def test_the_track_of_a_point_does_not_depend_on_how_many_are_compared_at_once(monkeypatch):
    rng = np.random.default_rng(0)
    boxes = np.zeros(7, TrackedSweep().boxes.dtype)
    boxes["track"], boxes["T_box_world"] = np.arange(1, 8), np.eye(4)[:3]
    boxes["T_box_world"][:, :, 3], boxes["half_size"] = rng.uniform(-5, 5, (7, 3)), 1.2
    points, alone = rng.uniform(-5, 5, (500, 3)).astype(np.float32), np.arange(500, dtype=np.uint32)
    of_all = points, alone, alone >= 0, TrackedSweep(boxes=boxes), np.eye(4)
    right = tracking._instances(*of_all)
    assert len(np.unique(right)) == 8
    monkeypatch.setattr(tracking, "_PAIRS", 20)
    assert np.array_equal(tracking._instances(*of_all), right)


def test_points_in_a_predicted_box_are_dynamic_unless_votes_or_ground_say_otherwise():
    T = np.eye(4)
    T[:3, 3] = 2, 0, 1
    points = np.array([[5, 0, 0], [5, 1, 0], [5, 2, 0], [5, 0, 0], [9, 0, 0]], np.float32)
    T_box_world = np.eye(4)[:3]
    T_box_world[:, 3] = -7, -1, -1  # in the world: from (6, -1, 0) to (8, 3, 2)
    box = np.array([(4, 1, T_box_world, (1, 2, 1))], TrackedSweep().boxes.dtype)
    static, dynamic = np.array([[0, 2, 3, 0, 0], [0] * 5], np.uint16)
    classid = np.array([50, 50, 50, 0, 50], np.uint16)
    alone = np.arange(5, dtype=np.uint32)
    found = TrackedSweep(boxes=box)
    classes, instance = label_by_tracks(
        points, alone, Votes(static, dynamic), classid, found, T, 20
    )
    assert list(classes) == [100, 100, 50, 0, 50]
    assert list(instance) == [4, 4, 0, 0, 0]
    box["is_moving"] = 0
    stands = TrackedSweep(boxes=box)
    classes, _ = label_by_tracks(points, alone, Votes(static, dynamic), classid, stands, T, 20)
    assert list(classes) == list(classid)


@pytest.mark.parametrize(
    ("always", "key_frames", "share", "moves"),
    [(8, 20, 0.9, 0), (8, 20, 0.7, 1), (7, 20, 0.9, 1), (5, 10, 0.9, 0), (4, 10, 0.9, 1)],
)
def test_an_always_occupied_rest_of_a_tracked_object_stays_static(always, key_frames, share, moves):
    """Beyond that share it was observed free at times, or occupied not often enough."""
    rows = np.arange(100)
    occupied = rows >= 40 + 60 * (1 - share)
    points = np.stack([10 + 0.02 * rows, 0 * rows, 0 * rows], 1).astype(np.float32)
    static, dynamic = np.full(100, always, np.uint16), (~occupied).astype(np.uint16)
    classid = np.where(rows < 40, 100, 50).astype(np.uint16)  # these move by their votes
    found = TrackedSweep(np.array([(0, 3, 1)], TrackedSweep().members.dtype))
    whole = np.zeros(100, np.uint32)
    votes = Votes(static, dynamic)
    classes, instance = label_by_tracks(points, whole, votes, classid, found, np.eye(4), key_frames)
    np.testing.assert_array_equal(instance, np.where(classes == 100, 3, 0))
    assert (classes[:40] == 100).all()
    assert (classes[40:] == (100 if moves else 50)).all()
    standing = (whole + 50).astype(np.uint16)
    waits, _ = label_by_tracks(points, whole, votes, standing, found, np.eye(4), key_frames)
    assert (waits == 100).all()  # none of it moves now: it is known from another time


def test_what_no_track_follows_stands_among_things_that_stand():
    """Of the places around that were found free half stand, or a fifth was hit and passed in turn.

    The fifth is of those that no track follows.

    So does ground that no more than twice as many key frames found free as occupied. Forty points
    in half a metre move whose places more than three times as many key frames found free, but
    those of a plank do not.
    """
    rng = np.random.default_rng(0)
    points = rng.uniform(-30, 30, (6000, 3)).astype(np.float32)
    points[:, 2] = rng.uniform(-1, 1, 6000)
    crowds = [(15, 0, 0), (15, 9, 0), (0, -20, 0), (15, -9, 0), (0, 0, 0), (0, 9, 0)]
    points[:600] = (np.repeat(crowds, 100, axis=0) + rng.uniform(0, 0.5, (600, 3))).astype("f4")
    points[100:200, 2] *= 0.4  # a plank, 20 cm high
    ground, free = rng.random((2, 6000)) < [[0.3], [0.5]]
    statics, dynamics = rng.integers(0, 9, (2, 6000)).astype(np.uint16)
    statics[:300] //= 3
    votes = Votes(statics, 3 * dynamics * free)
    passed = rng.random(6000) < np.where(points[:, 0] > 10, 0.5, 0.1)
    porous = (votes.dynamic > 0) & passed
    untracked = rng.random(6000) < 0.1
    untracked[:600] = rng.random(600) < 0.9
    classid = np.where(ground, 0, 50).astype(np.uint16)
    classid[untracked | (rng.random(6000) < np.where(points[:, 1] > -15, 0.95, 0.2))] = 100
    found = withdraw_untracked(classid, untracked, ground, points, votes, porous)
    expected, dense, planks = classid.copy(), 0, 0
    for i in np.flatnonzero(untracked):
        near = np.abs(np.floor(points / 2) - np.floor(points[i] / 2)).max(1) <= 1
        near &= ~ground & (votes.dynamic > 0)
        doubtful = ground[i] and int(votes.dynamic[i]) <= 2 * int(votes.static[i])
        stand = np.count_nonzero(near & (classid < 100))
        loose = near & ((classid < 100) | untracked)
        is_porous = 5 * np.count_nonzero(loose & porous) > np.count_nonzero(loose)
        beside = untracked & (np.floor(points / 0.5) == np.floor(points[i] / 0.5)).all(1)
        clear = votes.dynamic[beside].sum(dtype=int) > 3 * votes.static[beside].sum(dtype=int)
        is_high = np.ptp(points[beside, 2]) >= 0.25
        is_dense = np.count_nonzero(beside) >= 40 and clear and is_high
        stands = is_porous or 2 * stand > np.count_nonzero(near)
        dense += stands and is_dense and not doubtful
        planks += stands and clear and not is_high and not doubtful
        if doubtful or (stands and not is_dense):
            expected[i] = 0 if ground[i] else 50
    np.testing.assert_array_equal(found, expected)
    assert 0.2 < (found[untracked] == 100).mean() < 0.8
    assert dense > 20
    assert planks > 20
    none = np.zeros(6000, bool)
    dynamic = np.full_like(classid, 100)
    alone = withdraw_untracked(dynamic, untracked, none, points, votes, none)
    np.testing.assert_array_equal(alone, dynamic)


def test_a_fence_that_seems_to_go_along_is_no_track():
    """Each sweep hits other slats, so that most of their places are hit and passed in turn."""
    for porous, was_free in ((0.3, False), (0.4, False), (0.4, True)):
        thing = Thing((2.0, 0.1, 1.2), passes(5), range(40), remembered=was_free, porous=porous)
        found = tracking_of(detections_of([thing], 40)[0], drive_of(40)).tracks
        assert bool(found) == (porous < 1 / 3)


class _InSingleFile(Thing):
    """Somebody whose place was free before or after only where the votes call him dynamic."""

    def stay(self, i, count):
        return i in self.dynamic, None, None


@pytest.mark.parametrize(("porous", "claimed"), [(0.0, False), (0.3, False), (0.8, True)])
def test_who_walks_in_single_file_moves_where_his_place_was_free_and_occupied_in_turn(
    porous, claimed
):
    """What was never found free there is something else."""
    walks = set(range(40)) - set(range(15, 25))
    walker = _InSingleFile(PERSON, lambda i: (0.5 * i, 4), walks, porous=porous)
    (found,) = tracked([walker], 40)
    assert set(range(16, 25)) <= set(found) if claimed else not found


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


@pytest.mark.parametrize("seed", range(2))
def test_a_car_is_tracked_though_each_sweep_of_a_rosette_sees_other_parts(seed):
    car = Thing(CAR, waits((15, 3), 30), range(35, 60), seen=rosette(seed, CAR, 0.5))
    assert tracked([car], 60) == [list(range(35))]


@pytest.mark.parametrize("seed", range(2))
def test_of_a_lorry_a_rosette_is_enough_to_know_its_side(seed):
    """Its samples are as dense as those of a car, or those of two sweeps would miss each other."""
    level = drive_of(40)
    poses = level.poses.copy()
    poses[:, 2, 3] = 3  # so high that its beams meet all of the lorry
    drive = Trajectory(level.times, poses)
    lorry = Thing(LORRY, lambda i: (1.6 * i - 25, 10, 1.9), range(40), rosette(seed, LORRY, 0.5))
    (track,) = tracks_of([lorry], 40, drive=drive, seed=seed)
    assert len(track) >= 39
    assert np.ptp(track.poses[:, 1, 3]) < 0.03
    # It leaves; how far it is along its side is known worse and worse, but not where its side is.
    assert track.deviations[-1] > 0.1
    assert track.surface_deviations.max() < 0.04


def test_a_lorry_is_tracked_though_every_other_sweep_sees_its_lower_part_only():
    """That is as high as a van, and cars of this height have few samples."""
    level = drive_of(40)
    poses = level.poses.copy()
    poses[:, 2, 3] = 3
    drive = Trajectory(level.times, poses)
    lorry = Thing(
        LORRY,
        lambda i: (1.6 * i - 10, 10, 1.9),
        range(20, 40),
        seen=lambda i, points: points[:, 2] < (1.7 if i % 2 else 0.9),
    )
    (track,) = tracks_of([lorry], 40, drive=drive)
    assert len(track) == 40


def test_what_the_lidar_sees_of_its_own_vehicle_is_not_tracked():
    """It moves with the vehicle, as a cyclist does who rides beside it for half of the drive."""
    rack = Thing((0.4, 0.4, 0.4), lambda i: (0.8 * i - 1, 1.2, 1.1), range(40))
    ahead = [0.8 * i + 1 + 0.02 * max(0, i - 20) ** 2 for i in range(40)]
    cyclist = Thing((1.7, 0.6, 1.7), lambda i: (ahead[i], 2.2), range(40))
    for things, count in (((rack, cyclist), 1), ((cyclist,), 1), ((rack,), 0)):
        assert len(tracks_of(things, 40)) == count


def test_a_thing_beside_a_lidar_that_stands_is_tracked():
    """It waits for most of the drive, at the same place of both frames, and goes."""
    there = Trajectory(drive_of(40).times, np.repeat(drive_of(1).poses, 40, 0))
    things = [Thing(PERSON, lambda i: (1 + max(0, i - 35) * 0.5, 2.0), range(36, 40))]
    assert len(tracks_of(things, 40, drive=there)) == 1


def test_a_bin_that_a_pedestrian_leaves_is_not_part_of_him():
    """They are one object at first; when he is far away, the bin is occluded."""
    walker = Thing(PERSON, lambda i: (8 + 0.08 * i, 3), range(60))
    bin_ = Thing((0.6, 0.6, 1.0), lambda i: (7.6, 3, 0.5) if i < 40 else None)
    assert tracked([walker, bin_], 60, joined={(0, 1): range(8)})[1] == []


@pytest.mark.parametrize(
    ("width", "free", "claimed"),
    [(0.1, False, []), (0.5, False, []), (0.5, True, list(range(20)))],
    ids=["a thin post", "a bin", "his trolley, whose place was free before"],
)
def test_what_is_beside_a_pedestrian_who_waits(width, free, claimed):
    """While he was elsewhere it was too far to be an object."""
    at = waits((6, 3), 25)
    walker = Thing((1.0, 0.6, 1.7), at, range(28, 45))
    size = (width, width, 1.6)
    beside = Thing(size, lambda i: (at(i)[0] + 0.3, 2.6) if i < 28 else None)
    beside.stay = lambda i, count: (free, *Thing.stay(beside, i, count)[1:])
    found = tracked([walker, beside], 45)[1]
    assert [i for i in found if i < 20] == claimed  # then he goes


def test_a_car_that_moves_less_than_its_length_was_observed_to_leave():
    at = waits((15, 3), 30)
    car = Thing(CAR, at, range(35, 50))
    assert at(49)[0] - at(0)[0] < CAR[0]
    stays = car.stays

    def ends_were_free(i, count, places):
        rows = stays(i, count, places)
        rows[:, 0] = places[:, 0] > at(0)[0] + 0.5 * CAR[0]
        return rows

    car.stays = ends_were_free
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
        for field in fields(left):
            name = field.name
            np.testing.assert_array_equal(getattr(left, name), getattr(right, name))


@pytest.mark.parametrize("seed", range(2))
def test_tracks_do_not_depend_on_threads_or_files(seed):
    rng = np.random.default_rng(seed)
    detections, _ = detections_of(random_things(rng, 30), 30, seed)
    again = [_core.Detections.of(*seen.arrays) for seen in detections]
    one, two = (tracking_of(detections, drive_of(30), threads) for threads in (1, 2))
    assert len(one.tracks) >= 3
    same_tracking(one, two)
    same_tracking(one, tracking_of(again, drive_of(30)))
    claimed = [set(sweep.dynamic.tolist()) for sweep in one.sweeps]
    times = drive_of(30).times * 1e-9
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
    right = tracking_of(detections, drive_of(count))
    assert len(right.tracks) > 3
    for held, reads_a_sweep in ((1, 7), (20, 5), (count, 3)):
        monkeypatch.setattr(tracking, "_HELD_SWEEPS", held)
        reads, sweeps = [], []

        def read(sweep, reads=reads):
            reads.append(sweep)
            return _core.Detections.of(*saved[sweep])

        tracks = track_objects(read, drive_of(count), sweeps.append)
        same_tracking(Tracking(sweeps, tracks), right)
        assert len(reads) <= reads_a_sweep * count


def test_a_few_points_in_a_dynamic_voxel_are_dynamic():
    """They are too few for an object; beside a hedge they may be of the hedge."""
    walker = Thing(PERSON, lambda i: (8 + 0.1 * i, 3) if i != 15 else None, range(30))
    hedge = Thing((1.6, 0.6, 1.7), parked_at(9.5, 3.4))
    for things, moves in (((walker,), True), ((walker, hedge), False)):
        detections, _ = detections_of(things, 30)
        found = tracking_of(detections, drive_of(30)).sweeps[15]
        few = np.float32([(9.5, 3.0, 0.5), (9.5, 3.0, 1.4), (14.0, 3.0, 0.5)])
        place = TrackedSweep(voxels=found.voxels)
        none, alone = np.zeros(3, np.uint16), np.arange(3, dtype=np.uint32)
        static = np.uint16([0, 3, 0])  # many more say that it stands
        classid, _ = label_by_tracks(
            few, alone, Votes(static, none), none + 50, place, np.eye(4), 20
        )
        assert list(classid) == [100 if moves else 50, 50, 50]
