"""Voting against an independent numpy implementation, exact scenes and real sweeps."""

import os
from pathlib import Path

import numpy as np
import pytest

from docdepth import _core
from docdepth.config import DynamicsParameters, SurfaceParameters, parameters
from docdepth.dynamics import classify, classify_drive, confidence
from docdepth.errors import InputError
from docdepth.surface import Surface
from docdepth.trajectory import Trajectory
from docdepth.voting import KeyFrame, Votes, key_frames, vote
from dynamics_reference import reference_moving, reference_vote

KITTI = os.environ.get("DOCDEPTH_KITTI_RAW")
PAPER, DEFAULT = parameters("paper").dynamics, parameters("default").dynamics


# Scenes whose truth is known --------------------------------------------------------------------


def pose(x=0.0, y=0.0, yaw=0.0):
    T = np.eye(4)
    T[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    T[:2, 3] = x, y
    return T


def scan(T_world_lidar, box_x):
    """A spinning sensor in a walled yard with a box (2 m cube at y = 5) on flat ground.

    Returns points in the sensor's frame and what each one hit: 0 ground, 1 wall, 2 box.
    """
    elevation, azimuth = np.meshgrid(
        np.radians(np.arange(-15, 3, 0.4)), np.radians(np.arange(-180, 180, 0.25)), indexing="ij"
    )
    lidar = np.stack(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        ],
        -1,
    ).reshape(-1, 3)
    u = lidar @ T_world_lidar[:3, :3].T
    origin = T_world_lidar[:3, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        wall = np.minimum.reduce(
            [np.where(s * u[:, k] > 0, (s * 25 - origin[k]) / u[:, k], np.inf)
             for k in (0, 1) for s in (-1, 1)]
        )  # fmt: skip
        floor = np.where(u[:, 2] < 0, (-1.7 - origin[2]) / u[:, 2], np.inf)
        low, high = (
            (np.array([box_x, 5, -1.7]) + side * np.array([1, 1, 1]) + [0, 0, 1] - origin) / u
            for side in (-1, 1)
        )
        enter = np.nanmax(np.minimum(low, high), axis=1)
        leave = np.nanmin(np.maximum(low, high), axis=1)
        box = np.where((enter < leave) & (enter > 0), enter, np.inf)
    hits = np.stack([floor, wall, box])
    what = hits.argmin(0)
    return (lidar * hits.min(0)[:, None]).astype(np.float32), what


def straight(n, step, dt=100_000_000):
    return Trajectory(np.arange(n) * dt, np.stack([pose(x=step * i) for i in range(n)]))


@pytest.fixture(scope="module")
def yard():
    trajectory = straight(12, 0.5)
    scans = [scan(T, box_x=-8 + 1.5 * i) for i, T in enumerate(trajectory.poses)]
    return trajectory, [points for points, _ in scans], [what for _, what in scans]


# Key frames -------------------------------------------------------------------------------------


def test_key_frames_are_near_along_the_path_and_never_the_sweep_itself():
    chosen = key_frames(straight(101, 1.0), PAPER)
    expected = set(range(30, 71, 2)) | {0, 10, 20, 80, 90, 100}
    assert set(chosen[50]) == expected - {50}
    assert set(chosen[51]) == {i for i in range(32, 71, 2)} | {10, 20, 30, 80, 90, 100}
    assert all(i not in frames and (np.diff(frames) > 0).all() for i, frames in enumerate(chosen))


def test_a_crawling_ego_has_a_key_frame_a_second_and_the_ends_more():
    p = DynamicsParameters(time_spacing=1, time_radius=4, end_spacing=0.2, end_radius=0.5)
    chosen = key_frames(straight(101, 0.01), p)
    assert list(chosen[50]) == [0, 10, 20, 30, 40, 60, 70, 80, 90, 100]
    assert list(chosen[55]) == [0, 20, 30, 40, 50, 60, 70, 80, 90, 100]
    assert {96, 98, 100} < set(chosen[95])
    assert 97 not in chosen[95]
    assert set(chosen[4]) == {0, 2, 10, 20, 30, 40, 100}


def test_standing_adds_one_key_frame_to_the_letter():
    rng = np.random.default_rng(0)
    poses = np.stack([pose(*rng.normal(0, 0.005, 2)) for _ in range(50)])
    chosen = key_frames(Trajectory(np.arange(50) * 100_000_000, poses), PAPER)
    assert len(chosen[0]) == 0
    assert all(list(frames) == [0] for frames in chosen[1:])


# Votes ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("window", [1, 3, 5, 7, 11])
@pytest.mark.parametrize("resolution_deg", [0.2, 0.35, 1.0])
@pytest.mark.parametrize("against", ["pixels", "surface"])
def test_votes_equal_the_reference_in_the_yard(yard, against, window, resolution_deg):
    trajectory, sweeps, what = yard
    p = DynamicsParameters(against=against, window=window, resolution_deg=resolution_deg)
    ground = [w == 0 for w in what]
    keys = [0, 3, 7, 11]
    frames = [KeyFrame(sweeps[k], ground[k], p) for k in keys]
    votes = vote(sweeps[5], ground[5], trajectory.poses[5], frames, trajectory.poses[keys], p)
    expected = reference_vote(
        sweeps[5], ground[5], trajectory.poses[5], [sweeps[k] for k in keys],
        [ground[k] for k in keys], trajectory.poses[keys], p,
    )  # fmt: skip
    np.testing.assert_array_equal(votes.static, expected[0])
    np.testing.assert_array_equal(votes.dynamic, expected[1])
    assert votes.static.any()
    assert votes.dynamic.any()


@pytest.mark.parametrize("against", ["pixels", "surface"])
def test_votes_equal_the_reference_on_noise(against):
    """Returns in all directions at ranges near the tolerance: every branch of the algorithm."""
    rng = np.random.default_rng(1)
    T_query, T_key = pose(0.3, -0.2, 0.1), pose(-0.1, 0.4, -2.0)
    for n in (300, 60_000):
        sweep, query = rng.normal(size=(2, n, 3)).astype(np.float32)
        for cloud in (sweep, query):
            cloud *= rng.uniform(2, 3.2, (n, 1)) / np.linalg.norm(cloud, axis=1, keepdims=True)
        ground, query_ground = rng.random((2, n)) < 0.3
        p = DynamicsParameters(against=against, resolution_deg=1.0)
        votes = vote(
            query, query_ground, T_query, [KeyFrame(sweep, ground, p)], T_key[None], p, threads=2
        )
        expected = reference_vote(query, query_ground, T_query, [sweep], [ground], T_key[None], p)
        np.testing.assert_array_equal(votes.static, expected[0])
        np.testing.assert_array_equal(votes.dynamic, expected[1])


def test_moving_box_is_dynamic_and_the_yard_static_without_ground(yard):
    trajectory, sweeps, what = yard
    for ground in ([np.zeros(len(w), bool) for w in what], [w != 1 for w in what]):
        labels = classify_drive(sweeps, trajectory, DEFAULT, ground=ground)
        for label, w, g in zip(labels, what, ground, strict=True):
            # What stands within 8 cm of the ground is taken for it; with three key frames the rim
            # of the box has ties.
            assert (label.classid[w == 2] == 100).mean() > 0.92
            assert (label.classid[w != 2] < 100).mean() > 0.999
            assert (
                label.classid[label.classid != 100] == np.where(g, 0, 50)[label.classid != 100]
            ).all()


def test_feet_called_ground_move_with_what_stands_on_them(yard):
    trajectory, sweeps, what = yard
    above = [sweep[:, 2] + 1.7 for sweep in sweeps]
    ground = [(w == 0) | ((w == 2) & (z < 0.1)) for z, w in zip(above, what, strict=True)]
    for margin in (0.03, 0.08):
        p = DEFAULT.model_copy(update={"ground_across": margin})
        labels = classify_drive(sweeps, trajectory, p, ground=ground)
        for label, z, w in zip(labels, above, what, strict=True):
            feet = (w == 2) & (z < 0.1)
            assert ((label.classid == 100) == (z > margin))[feet].all()
            assert (label.classid[w == 0] == 0).all()


def test_feet_above_what_is_called_ground_move_with_what_stands_on_them(yard):
    """They are not called ground, but what key frames saw below them was."""
    trajectory, sweeps, what = yard
    feet = [(w == 2) & (sweep[:, 2] + 1.7 < 0.08) for sweep, w in zip(sweeps, what, strict=True)]
    assert sum(f.sum() for f in feet) > 400
    for known in (True, False):
        ground = [known & (w == 0) for w in what]
        labels = classify_drive(sweeps, trajectory, DEFAULT, ground=ground)
        for label, f, w in zip(labels, feet, what, strict=True):
            assert ((label.classid[f] == 100) == known).all()
            assert (label.classid[w == 0] != 100).all()


def test_moving_box_is_dynamic_and_the_yard_static_to_the_letter(yard):
    trajectory, sweeps, what = yard
    labels = classify_drive(sweeps, trajectory, PAPER, ground=[w == 0 for w in what])
    for label, sweep, w in zip(labels, sweeps, what, strict=True):
        assert (label.classid[w == 0] == 0).all()
        # The foot of a wall suffers from tau = 0 around ground pixels, to the letter.
        above = sweep[:, 2] > -1.2
        assert (label.classid[(w == 1) & above] == 50).all()
        assert (label.classid[w == 1] == 50).mean() > 0.99
        assert (label.classid[w == 2] == 100).mean() > 0.95


@pytest.mark.parametrize("p", [PAPER, DEFAULT], ids=["paper", "default"])
def test_one_and_two_threads_agree(yard, p):
    trajectory, sweeps, what = yard
    ground = [w == 0 for w in what]
    one, two = (classify_drive(sweeps, trajectory, p, t, ground) for t in (1, 2))
    for a, b in zip(one, two, strict=True):
        np.testing.assert_array_equal(a.votes.static, b.votes.static)
        np.testing.assert_array_equal(a.votes.dynamic, b.votes.dynamic)
        np.testing.assert_array_equal(a.classid, b.classid)


@pytest.mark.parametrize("p", [PAPER, DEFAULT], ids=["paper", "default"])
def test_rows_that_are_no_returns_get_no_vote(yard, p):
    trajectory, sweeps, what = yard
    bad = sweeps[0].copy()
    bad[::7], bad[1::7], bad[2::7] = np.nan, 0, np.inf
    bad[3::7] = 3e19  # whose range overflows
    key = KeyFrame(bad, what[0] == 0, p)
    assert vote(bad, what[0] == 0, np.eye(4), [key], np.eye(4)[None], p).static[::7].max() == 0
    keep = np.isin(np.arange(len(bad)) % 7, [4, 5, 6])
    clean = KeyFrame(bad[keep], (what[0] == 0)[keep], p)
    votes, expected = (
        vote(sweeps[1], what[1] == 0, trajectory.poses[1], [k], trajectory.poses[:1], p)
        for k in (key, clean)
    )
    np.testing.assert_array_equal(votes.static, expected.static)
    np.testing.assert_array_equal(votes.dynamic, expected.dynamic)


def test_nothing_to_ask_and_nobody_to_ask():
    nothing, none = np.zeros((0, 3), np.float32), np.zeros(0, bool)
    point, flag = np.ones((1, 3), np.float32), np.zeros(1, bool)
    assert vote(nothing, none, np.eye(4), [KeyFrame(point, flag)], np.eye(4)[None]).static.size == 0
    assert vote(point, flag, np.eye(4), [KeyFrame(nothing, none)], np.eye(4)[None]).static == [0]
    assert vote(point, flag, np.eye(4), [], np.zeros((0, 4, 4))).dynamic == [0]


def random_votes(points, seed, patches=40):
    """Votes that agree in patches and are wrong here and there, with every share and ratio."""
    rng = np.random.default_rng(seed)
    centres = points[rng.integers(0, len(points), patches)]
    patch = np.linalg.norm(points[:, None] - centres, axis=2).argmin(axis=1)
    static = rng.poisson(rng.choice([0, 0.3, 2, 8], patches)[patch])
    dynamic = rng.poisson(rng.choice([0, 0.3, 2, 8], patches)[patch])
    return Votes(static.astype(np.uint16), dynamic.astype(np.uint16))


@pytest.mark.parametrize("seed", range(4))
def test_shared_evidence_equals_the_reference(yard, seed):
    _, sweeps, what = yard
    rng = np.random.default_rng(seed)
    rows = np.sort(rng.permutation(len(sweeps[seed]))[:15_000])
    points, ground = sweeps[seed][rows], what[seed][rows] == 0
    votes = random_votes(points, seed)
    p = DynamicsParameters(link=0.4, company=0.4)
    expected = reference_moving(points, ground, votes.static, votes.dynamic, p)
    assert 0.05 < expected.mean() < 0.95
    np.testing.assert_array_equal(classify(ground, votes, p, points) == 100, expected)


def test_an_object_moves_as_a_whole_and_single_points_alone_do_not(yard):
    _, sweeps, what = yard
    points, ground = sweeps[6], what[6] == 0
    box = np.flatnonzero(what[6] == 2)
    wall = np.flatnonzero(what[6] == 1)
    votes = Votes(*np.zeros((2, len(points)), np.uint16))
    votes.static[:] = 9
    votes.static[box[::4]] = 20
    votes.dynamic[box] = 12
    votes.dynamic[wall[::100]] = 11
    classid = classify(ground, votes, DEFAULT, points)
    assert (classid[box] == 100).all()
    assert (classid[wall] == 50).all()
    # It stands for most of the drive, and two thirds of its place were seen free by two key frames.
    votes.static[box], votes.dynamic[box] = 7, 2
    votes.dynamic[box[::3]] = 0
    assert (classify(ground, votes, DEFAULT, points)[box] == 100).all()
    off = DEFAULT.model_copy(update={"objects": False})
    assert (classify(ground, votes, off, points)[box] == 50).all()


def test_points_without_votes_do_not_speak_against_their_object(yard):
    _, sweeps, what = yard
    points, ground = sweeps[6], what[6] == 0
    box = np.flatnonzero(what[6] == 2)
    votes = Votes(*np.zeros((2, len(points)), np.uint16))
    seen = box[np.argsort(points[box, 2])[-(len(box) // 3) :]]  # the rest stands before the sky
    votes.dynamic[seen] = 3
    assert (classify(ground, votes, DEFAULT, points)[box] == 100).all()
    off = DEFAULT.model_copy(update={"object_least": 0.5})
    assert (classify(ground, votes, off, points)[box] == 100).mean() < 0.9
    # But where most of those who looked saw it stand, or hardly anybody looked, it does not move.
    votes.static[np.setdiff1d(box, seen)] = 3
    assert (classify(ground, votes, DEFAULT, points)[box] == 100).mean() < 0.9
    votes.static[:], votes.dynamic[:] = 0, 0
    votes.dynamic[seen[-len(box) // 8 :]] = 3
    more = DEFAULT.model_copy(update={"object_least": 0.2})
    assert (classify(ground, votes, more, points)[box] == 100).mean() < 0.9
    assert (classify(ground, votes, DEFAULT, points)[box] == 100).all()
    votes.dynamic[:] = 0
    votes.dynamic[seen[-len(box) // 16 :]] = 3
    assert (classify(ground, votes, DEFAULT, points)[box] == 100).mean() < 0.9


def test_what_always_stood_beside_a_mover_and_is_connected_to_it_stays(yard):
    _, sweeps, what = yard
    points, ground = sweeps[6], what[6] == 0
    box = np.flatnonzero(what[6] == 2)
    mover, beside = box[len(box) // 3 :], box[: len(box) // 3]
    votes = Votes(*np.zeros((2, len(points)), np.uint16))
    votes.dynamic[mover], votes.static[beside] = 9, 8
    classid = classify(ground, votes, DEFAULT, points)
    assert (classid[mover] == 100).all()
    assert (classid[beside] == 50).all()
    votes.static[beside] = 7  # not enough looked
    assert (classify(ground, votes, DEFAULT, points)[box] == 100).all()
    votes.static[beside], votes.dynamic[beside] = 15, 2  # its place was free at times
    assert (classify(ground, votes, DEFAULT, points)[box] == 100).all()


def test_what_lies_flat_and_was_seen_free_at_times_does_not_move():
    """Boughs and signs that key frames look past; as wide as a car, two rows of returns high."""
    for height, classid in ((0.1, 50), (0.5, 100)):
        y, z = np.meshgrid(np.arange(-1, 1, 0.05), np.arange(1, 1 + height, 0.05))
        points = np.stack([np.full(y.shape, 10), y, z], -1).reshape(-1, 3).astype(np.float32)
        votes = Votes(*np.full((2, len(points)), 3, np.uint16))
        votes.static[:] = 9
        assert set(classify(np.zeros(len(points), bool), votes, DEFAULT, points)) == {classid}


def test_ties_and_unseen_points_are_static():
    votes = Votes(np.array([0, 1, 1, 0, 0], np.uint16), np.array([0, 1, 2, 1, 9], np.uint16))
    ground = np.array([False, False, False, False, True])
    assert list(classify(ground, votes, PAPER)) == [50, 50, 100, 100, 0]


def test_wheels_called_ground_are_dynamic_where_the_surface_votes():
    votes = Votes(np.array([0, 3], np.uint16), np.array([9, 1], np.uint16))
    assert list(classify(np.ones(2, bool), votes, DEFAULT)) == [100, 0]


def test_wrong_arrays_are_refused():
    points, ground = np.ones((3, 3), np.float32), np.zeros(3, bool)
    with pytest.raises(InputError, match="float32"):
        KeyFrame(points.astype(np.float64), ground)
    with pytest.raises(InputError, match="one flag a point"):
        KeyFrame(points, ground[:2])
    key = KeyFrame(points, ground)
    with pytest.raises(InputError, match="1 key"):
        vote(points, ground, np.eye(4), [key], np.zeros((2, 4, 4)))
    with pytest.raises(InputError, match="not a rotation"):
        vote(points, ground, 2 * np.eye(4), [key], np.eye(4)[None])
    with pytest.raises(InputError, match="same drive"):
        classify_drive([points], straight(2, 1.0), ground=[ground])
    with pytest.raises(ValueError, match="odd"):
        _core.RangeImage(points, ground, 0.01, 4, 0.2)


# Real sweeps ------------------------------------------------------------------------------------


@pytest.mark.skipif(KITTI is None, reason="DOCDEPTH_KITTI_RAW is not set")
@pytest.mark.parametrize("p", [PAPER, DEFAULT], ids=["paper", "default"])
def test_votes_equal_the_reference_on_real_sweeps(p):
    sweeps, poses = zip(*(real_sweep(k) for k in (30, 20, 34, 60)), strict=True)
    ground = [sweep[:, 2] < -1.5 for sweep in sweeps]
    frames = [KeyFrame(s, g, p) for s, g in zip(sweeps[1:], ground[1:], strict=True)]
    votes = vote(sweeps[0], ground[0], poses[0], frames, np.stack(poses[1:]), p)
    expected = reference_vote(sweeps[0], ground[0], poses[0], sweeps[1:], ground[1:], poses[1:], p)
    np.testing.assert_array_equal(votes.static, expected[0])
    np.testing.assert_array_equal(votes.dynamic, expected[1])


def real_sweep(k, drive="2011_09_26_drive_0005_sync"):
    from docdepth.trajectory import quaternion_to_matrix

    folder = Path(str(KITTI)) / "2011_09_26" / drive
    points = np.fromfile(folder / f"velodyne_points/data/{k:010d}.bin", np.float32).reshape(-1, 4)
    row = np.loadtxt(folder / "lidar_poses_tum.txt")[k]
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = quaternion_to_matrix(row[4:]), row[1:4]
    return np.ascontiguousarray(points[:, :3]), T


def test_the_surface_of_a_run_is_the_one_that_votes() -> None:
    """A surface of tiny triangles only has no plane to look through."""
    sweep = np.array([[10, y, z] for y in np.arange(-2, 2, 0.2) for z in np.arange(-1, 1, 0.2)])
    wall = np.ascontiguousarray(sweep, np.float32)
    query = np.ascontiguousarray(0.5 * (wall + [0, 0.1, 0.1]), np.float32)
    none = np.zeros(len(wall), bool)
    votes = [
        vote(query, none, np.eye(4), [KeyFrame(wall, none, None, surface)], np.eye(4)[None])
        for surface in (None, Surface(wall, SurfaceParameters(max_gap_deg=0.1)))
    ]
    assert votes[0].dynamic.mean() > 0.5
    assert votes[1].dynamic.sum() == 0


def test_confidence_of_points_grows_with_agreement():
    static = np.array([0, 5, 1, 0, 0, 30, 60000], np.uint16)
    dynamic = np.array([0, 5, 0, 1, 2, 1, 0], np.uint16)
    expected = [0, 0, 1 / 3, 1 / 3, 1 / 2, 29 / 33, 60000 / 60002]
    found = confidence(Votes(static, dynamic))
    np.testing.assert_allclose(found, expected, rtol=1e-6)
    assert found.dtype == np.float32
    with pytest.raises(InputError, match="differ in shape"):
        confidence(Votes(static, dynamic[:-1]))


def test_sure_points_are_wrong_less_often():
    """A crossing seen by few beams: the surer the votes of points are, the fewer are misjudged."""
    pytest.importorskip("embreex")
    from docdepth.synthetic import Drive, scene, sensor

    drive = Drive(scene("crossing", 3), sensor("VLP-16"), 14, 3)
    truth = [drive.sweep(k) for k in range(len(drive))]
    trajectory = Trajectory(drive.times, drive.poses)
    ends = {"end_spacing": 0.2, "end_radius": 1.0, "time_spacing": 1.0}  # few sweeps, many votes
    often = DEFAULT.model_copy(update=ends)
    labels = classify_drive([s.points for s in truth], trajectory, often)
    sure = np.concatenate([confidence(one.votes) for one in labels])
    moving = np.concatenate([s.speed > 0.5 for s in truth])
    says = np.concatenate([one.votes.dynamic > one.votes.static for one in labels])
    wrong = [
        (says != moving)[(low <= sure) & (sure < high)].mean()
        for low, high in ((0.01, 0.3), (0.3, 0.6), (0.6, 0.8), (0.8, 1.01))
    ]
    assert wrong == sorted(wrong, reverse=True), wrong
    assert wrong[-1] < 0.01
