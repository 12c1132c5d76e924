"""Paths and boxes of tracks against exact ones."""

import numpy as np
import pytest
from things import (
    CAR,
    PERSON,
    RAYS,
    Thing,
    detections_of,
    drive_of,
    measured,
    one_object,
    parked_at,
    ranges_of,
    tracking_of,
    tracks_of,
    waits,
)

from docdepth.geometry.trajectory import Trajectory
from lidar_rays import scan_rays
from motion import straight


def test_a_pedestrian_whose_legs_vanish_behind_a_hedge_stays_upright():
    """What is seen of him rises by 0.6 m; he does not, and does not lean as a car uphill does."""

    def above(i, points):
        return points[:, 2] > -0.8 + min(0.03 * i, 0.6)

    walker = Thing(PERSON, lambda i: (6 + 0.15 * i, 3), range(40), seen=above)
    (track,) = tracks_of([walker], 40)
    np.testing.assert_array_equal(track.poses[:, :3, 2], [[0, 0, 1]] * len(track))


def track_on_ground(size, place, count, slope=0.0, hidden=lambda i: 0.0):
    """The track of a box that stands on a slope 1.73 m below a standing LiDAR.

    Of its lowest ``hidden(i)`` metres sweep ``i`` sees nothing. Also the heights where it stands.
    """
    rng, detections, heights = np.random.default_rng(0), [], []
    with np.errstate(divide="ignore"):
        down = 1.73 / (slope * RAYS[:, 0] - RAYS[:, 2])
    down[(down < 0) | (down > 60)] = np.inf
    for i in range(count):
        x, y = place(i)
        heights.append(slope * x - 1.73)
        ranges = ranges_of(size, (x, y, heights[-1] + size[2] / 2))
        low = RAYS[:, 2] * np.where(np.isfinite(ranges), ranges, 0) < heights[-1] + hidden(i)
        box, ground = np.isfinite(ranges) & ~low, np.isfinite(down) & (down < ranges)
        cloud = np.vstack([measured(ranges, box, rng), measured(down, ground, rng)])
        of_ground = np.arange(len(cloud)) >= np.count_nonzero(box)
        detections.append(one_object(cloud, i, ground=of_ground))
    (track,) = tracking_of(detections, straight(count, 0)).tracks
    return track, np.array(heights)[track.times // 100_000_000]


def test_a_pedestrian_whose_legs_are_hidden_stands_on_the_ground():
    """What is seen of him rises by 0.6 m and comes down again."""
    track, heights = track_on_ground(
        PERSON, lambda i: (6 + 0.15 * i, 3), 40, hidden=lambda i: 0.6 * np.sin(i / 40 * np.pi)
    )
    np.testing.assert_allclose(track.poses[:, 2, 3], heights, atol=0.1)
    np.testing.assert_allclose(track.size[2], PERSON[2], atol=0.15)


def test_the_box_of_a_head_above_a_wall_does_not_reach_down_to_the_ground():
    """Of it alone nobody knows whether a person stands below."""
    track, heights = track_on_ground(PERSON, lambda i: (6 + 0.15 * i, 3), 40, hidden=lambda i: 1.2)
    assert (track.poses[:, 2, 3] > heights + 1).all()
    assert track.size[2] < 0.6


def test_a_lorry_uphill_stays_on_the_road():
    """A hedge hides its lower half later on, and its vertical side tells nothing of its height."""
    track, heights = track_on_ground(
        (9.0, 2.5, 3.6), lambda i: (-14 + 1.2 * i, 6), 30, 0.06, lambda i: min(0.08 * i, 1.8)
    )
    np.testing.assert_allclose(track.poses[:, 2, 3], heights, atol=0.2)
    climbs = 12 * 0.06
    np.testing.assert_allclose(track.velocities[3:-3, 2], climbs, atol=0.3)


@pytest.mark.parametrize(("speed", "slope"), [(18, -0.2), (18, -0.3)])
def test_a_car_on_a_steep_road_is_tracked(speed, slope):
    """It rises by a third to a half of a metre a sweep: more than samples that match may differ."""
    track, heights = track_on_ground(CAR, lambda i: (45 - 0.1 * speed * i, 4), 20, slope)
    assert len(track) >= 18
    assert np.ptp(track.poses[:, 2, 3] - heights) < 0.2  # its box leans, this one does not
    np.testing.assert_allclose(track.velocities[3:-3, 0], -speed, rtol=0.05)
    np.testing.assert_allclose(track.velocities[3:-3, 2], -speed * slope, atol=0.5)


def path_of(place, count, lost=()):
    """The track of a car that a standing LiDAR sees, but for some sweeps, and all it says."""
    rng, detections = np.random.default_rng(0), []
    for i in range(count):
        x, y, turn = place(i)
        ranges = ranges_of(CAR, (x, y, CAR[2] / 2 - 1.7), turn)
        cloud = measured(ranges, np.isfinite(ranges) & (i not in lost), rng)
        detections.append(one_object(cloud, i))
    found = tracking_of(detections, straight(count, 0))
    (track,) = found.tracks
    assert track.kind == "vehicle"
    return track, found.sweeps


def test_a_car_that_is_lost_is_where_its_motion_predicts_it():
    lost = {0, 1, 7, 8, 9, 27}

    def place(i):
        return -10 + 0.8 * i, 8.0, 0.0

    _, sweeps = path_of(place, 28, lost)
    for i in lost:
        (box,) = sweeps[i].boxes
        assert box["is_moving"]
        T = np.vstack([box["T_box_world"], [0, 0, 0, 1]])
        np.testing.assert_allclose(np.linalg.inv(T)[0, 3], place(i)[0], atol=0.3)


def test_the_box_of_a_standing_object_does_not_move():
    car = Thing(CAR, waits((15, 3), 20), range(50))
    found = tracking_of(detections_of([car], 50)[0], drive_of(50)).sweeps
    assert not any(sweep.boxes["is_moving"].any() for sweep in found[:18])
    assert all(sweep.boxes["is_moving"].all() for sweep in found[28:])
    assert all(len(sweep.boxes) for sweep in found)


@pytest.mark.parametrize(
    ("place", "count"),
    [(lambda i: (60 - 0.8 * i, 3.5), 60), (lambda i: waits((40, 3), 20)(79 - i), 80)],
    ids=["oncoming", "comes to stand"],
)
def test_a_path_is_as_exact_as_it_states(place, count):
    """Sweeps in a row err alike; counted as independent they claim a third of their deviation."""
    (track,) = tracks_of([Thing(CAR, place, range(30))], count)
    sweeps = track.times // 100_000_000
    off = track.poses[:, :2, 3] - [place(i) for i in sweeps.tolist()]
    weight = track.deviations[:, None] ** -2
    off -= (off * weight).sum(0) / weight.sum()  # where the middle of the object is
    error = np.sqrt(((off / track.deviations[:, None]) ** 2).sum(1).mean())
    assert 0.4 < error < 2.5


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
    for i, T in enumerate(drive_of(count).poses):
        middle = truth[i] - T[:3, 3] + (speed - 8) * moved
        ranges = np.min([ranges_of(np.array(size), middle + off) for size, off in parts], 0)
        hit = np.isfinite(ranges)
        cloud = (measured(ranges, hit, rng) + 8 * moved[hit]).astype(np.float32)
        detections.append(one_object(cloud, i, T, times=late[hit].astype(np.float32)))
    (track,) = tracking_of(detections, drive_of(count)).tracks
    assert len(track) == count
    off = track.poses[:, 0, 3] - truth[:, 0]
    assert np.abs(off - np.median(off)).max() < 0.08  # 0.2 m as if all were measured at once
    np.testing.assert_allclose(track.size[0], 10, atol=0.3)


def test_what_stands_beside_a_van_makes_it_no_larger():
    """For 2.5 s it is one object with a bush, and both together are wider than any vehicle."""
    count, poses = 60, np.repeat(np.eye(4)[None], 60, 0)
    poses[:, 2, 3] = 1.7
    stands = Trajectory(np.arange(count) * 100_000_000, poses)
    van = Thing((2.2, 5.0, 2.0), lambda i: (14.0, 0.3 * i - 9), range(count))
    bush = Thing((1.2, 3.0, 3.0), parked_at(17.2, 0))
    beside = [i for i in range(count) if abs(van.at(i)[1]) < 3.8]
    (track,) = tracks_of([van, bush], count, drive=stands, joined={(0, 1): beside})
    np.testing.assert_allclose(track.size[:2], (5, 2.2), atol=0.2)  # else 7.4 and 3.8
    truth = [van.at(i) for i in (track.times // 100_000_000).tolist()]
    np.testing.assert_allclose(track.poses[:, :2, 3], truth, atol=0.2)


def tracks_by_petals(at, count, share, seed, size=CAR):
    """Tracks of a thing that each of five petals of a sweep meets in this share of its rays."""
    there = Trajectory(drive_of(count).times, np.repeat(drive_of(1).poses, count, 0))
    rng, detections = np.random.default_rng(seed), []
    for i in range(count):
        petals, times = [], np.arange(0, 0.1, 0.02)
        for t in times:
            middle = np.array((*at(i + 10 * t), size[2] / 2 + 0.05))
            middle -= there.poses[i, :3, 3]
            ranges = ranges_of(size, middle)
            met = np.isfinite(ranges) & (rng.random(len(ranges)) < share)
            petals.append(measured(ranges, met, rng))
        offsets = np.repeat(times, [len(petal) for petal in petals]).astype(np.float32)
        detections.append(one_object(np.vstack(petals), i, there.poses[i], times=offsets))
    return tracking_of(detections, there).tracks


@pytest.mark.parametrize("seed", range(2))
def test_a_fast_car_is_tracked_though_each_petal_of_a_rosette_sees_it_elsewhere(monkeypatch, seed):
    """It comes at 30 m/s: between the first and the last petal it goes on by half its length."""
    rays = scan_rays(np.radians(np.arange(-15, 3, 0.4)), np.radians(np.arange(-35, 35, 0.2)))
    monkeypatch.setattr("things.RAYS", rays.reshape(-1, 3))
    (track,) = tracks_by_petals(lambda i: (55 - 3 * i, 5), 14, 0.08, seed)
    assert len(track) >= 13
    np.testing.assert_allclose(track.velocities[:, 0], -30, atol=0.5)
    np.testing.assert_allclose(track.size, CAR, atol=0.5)


def test_the_side_of_a_fast_lorry_is_known_though_its_samples_are_far_apart():
    """It is 9 m long, so that its hundred samples are 0.6 m apart: too far for planes of 0.5 m."""
    lorry = (9.0, 2.5, 2.7)
    (track,) = tracks_by_petals(lambda i: (28 - 1.6 * i, 5), 30, 0.5, 0, lorry)
    assert len(track) >= 28
    assert np.ptp(track.poses[:, 1, 3]) < 0.05
    assert track.surface_deviations.max() < 0.06


def test_where_a_sweep_shows_little_the_sweeps_around_tell_where_the_surface_is():
    """Ten returns tell little; in a tenth of a second a car can go astray by 1.5 cm."""

    def every_twentieth_once(i, points):
        return (i != 20) | (np.arange(len(points)) % 20 == 0)

    car = Thing(CAR, lambda i: (8 + 1.2 * i, 4), range(40), seen=every_twentieth_once)
    (track,) = tracks_of([car], 40)
    row = int(np.flatnonzero(track.times == 2_000_000_000)[0])
    assert track.points[row] < 12
    around = min(track.surface_deviations[[row - 1, row + 1]])
    assert track.surface_deviations[row] == pytest.approx(around + 0.5 * 3 * 0.1**2)
