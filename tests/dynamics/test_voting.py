"""Key frames and their votes against an independent numpy implementation, and real sweeps."""

import os
from itertools import groupby, pairwise
from pathlib import Path

import numpy as np
import pytest
from dynamics_reference import reference_vote

import docdepth._core as _core
from docdepth.config import DynamicsParameters, parameters
from docdepth.dynamics import voting
from docdepth.dynamics.classifier import classify_drive
from docdepth.dynamics.voting import KeyFrame, KeyFrames, OccupancyIntervals, Votes, vote
from docdepth.errors import InputError
from docdepth.geometry.lidar_frame import SensorRig
from docdepth.geometry.scan_mesh import ScanMesh
from docdepth.geometry.se3 import rotation_exp
from docdepth.geometry.trajectory import Trajectory
from motion import pose, straight
from walled_yard import scan

KITTI = os.environ.get("DOCDEPTH_KITTI_RAW")
PAPER, DEFAULT = parameters("paper").dynamics, parameters("default").dynamics


def chosen_of(trajectory, p):
    chosen = KeyFrames(trajectory, p)
    return [chosen[i] for i in range(len(trajectory))]


@pytest.mark.parametrize(("static", "free"), [(0, True), (7, True), (8, False), (15, False)])
def test_a_place_that_nearly_all_key_frames_found_occupied_was_not_free(static, free):
    """Through the leaves of a tree a ray passes now and then."""
    one, end = np.ones(1, bool), np.zeros(1, np.uint16)
    votes = Votes(np.uint16([static]), np.uint16([1]), OccupancyIntervals(one, ~one, end, end))
    assert votes.occupancy_by_sweep(np.array([0]), 1).occupied_once == free


def test_key_frames_are_near_along_the_path_and_never_the_sweep_itself():
    chosen = chosen_of(straight(101, 1.0), PAPER)
    expected = set(range(30, 71, 2)) | {0, 10, 20, 80, 90, 100}
    assert set(chosen[50]) == expected - {50}
    assert set(chosen[51]) == {i for i in range(32, 71, 2)} | {10, 20, 30, 80, 90, 100}
    assert all(i not in frames and (np.diff(frames) > 0).all() for i, frames in enumerate(chosen))


def test_a_crawling_ego_has_a_key_frame_a_second_and_the_ends_more(monkeypatch):
    monkeypatch.setattr(voting, "TIME_RADIUS", 4)
    monkeypatch.setattr(voting, "END_SPACING", 0.2)
    monkeypatch.setattr(voting, "END_RADIUS", 0.5)
    chosen = chosen_of(straight(101, 0.01), DynamicsParameters(time_spacing=1))
    assert list(chosen[50]) == [0, 10, 20, 30, 40, 60, 70, 80, 90, 100]
    assert list(chosen[55]) == [0, 20, 30, 40, 50, 60, 70, 80, 90, 100]
    assert {96, 98, 100} < set(chosen[95])
    assert 97 not in chosen[95]
    assert set(chosen[4]) == {0, 2, 10, 20, 30, 40, 100}


@pytest.mark.parametrize("p", [PAPER, DEFAULT])
def test_no_key_frame_votes_over_a_gap(p):
    """Each part has those that it has alone, though both pass through the same place."""
    rng = np.random.default_rng(4)
    poses = np.repeat(np.eye(4)[None], 160, axis=0)
    poses[:, 0, 3] = np.cumsum(rng.uniform(0, 1, 160))
    poses[90:, 0, 3] -= 40
    times = np.arange(160) * 10**8 + rng.integers(0, 10**7, 160)
    times[90:] += 2 * 10**9
    one, other = (Trajectory(times[s], poses[s]) for s in (slice(90), slice(90, None)))
    alone = [*chosen_of(one, p), *(frames + 90 for frames in chosen_of(other, p))]
    for found, expected in zip(chosen_of(Trajectory(times, poses), p), alone, strict=True):
        np.testing.assert_array_equal(found, expected)


def plain_key_frames(trajectory, p):
    """Every sweep against every key frame."""
    arc, time = trajectory.arc_length, (trajectory.times - trajectory.times[0]) * 1e-9
    kinds = [
        (trajectory.subsample(p.fine_spacing), p.fine_radius, np.inf),
        (trajectory.subsample(p.coarse_spacing), p.coarse_radius, np.inf),
    ]
    if p.time_spacing:
        often = trajectory.subsample(p.fine_spacing, p.time_spacing)
        kinds.append((often, p.fine_radius, 10.0))
    last = len(trajectory) - 1
    ends = np.append(trajectory.subsample(np.inf, 0.4), last)
    chosen = []
    for i in range(len(trajectory)):
        near = [
            frames[(np.abs(arc[frames] - arc[i]) <= radius) & (np.abs(time[frames] - time[i]) <= t)]
            for frames, radius, t in kinds
        ]
        if p.time_spacing and time[last] - time[i] <= 3.0:
            near.append(ends[ends > i])
        if p.time_spacing and time[i] <= 3.0:
            near.append(ends[ends < i])
        chosen.append(sorted(set(np.concatenate(near).tolist()) - {i}))
    return chosen


@pytest.mark.parametrize("p", [PAPER, DEFAULT], ids=["paper", "default"])
@pytest.mark.parametrize("seed", range(3))
def test_key_frames_of_a_long_drive_are_those_of_the_plain_comparison(seed, p):
    """It stands at times, steps are round numbers at times (radii are met exactly), and jitters."""
    rng = np.random.default_rng(seed)
    speed = np.repeat(rng.choice([0.0, 0.0, 0.01, 0.1, 0.5, 1.0, rng.uniform(0, 3)], 60), 50)
    poses = np.tile(np.eye(4), (3000, 1, 1))
    poses[:, 0, 3] = np.cumsum(speed)
    poses[:, 1, 3] = rng.normal(0, 0.01, 3000) * (seed > 0)
    step = 100_000_000 + (rng.integers(-3_000_000, 3_000_000, 3000) if seed > 1 else 0)
    trajectory = Trajectory(np.cumsum(np.full(3000, step)), poses)
    found, expected = chosen_of(trajectory, p), plain_key_frames(trajectory, p)
    for one, plain in zip(found, expected, strict=True):
        assert one.dtype == np.int64
        np.testing.assert_array_equal(one, plain)


def test_a_standing_vehicle_adds_one_key_frame_with_the_paper_preset():
    rng = np.random.default_rng(0)
    poses = np.stack([pose(*rng.normal(0, 0.005, 2)) for _ in range(50)])
    chosen = chosen_of(Trajectory(np.arange(50) * 100_000_000, poses), PAPER)
    assert len(chosen[0]) == 0
    assert all(list(frames) == [0] for frames in chosen[1:])


@pytest.mark.parametrize(
    ("window", "resolution_deg"), [(1, 1.0), (3, 0.35), (5, 0.2), (7, 1.0), (11, 0.35)]
)
@pytest.mark.parametrize("vote_model", ["range_image", "surface"])
def test_votes_equal_the_reference_in_the_yard(yard, vote_model, window, resolution_deg):
    trajectory, sweeps, what = yard
    p = DynamicsParameters(vote_model=vote_model, window=window, resolution_deg=resolution_deg)
    ground = [w == 0 for w in what]
    keys = [0, 3, 7, 11]
    frames = [KeyFrame(sweeps[k], ground[k], p) for k in keys]
    votes = vote(sweeps[5], ground[5], trajectory.poses[5], frames, trajectory.poses[keys])
    expected = reference_vote(
        sweeps[5], ground[5], trajectory.poses[5], [sweeps[k] for k in keys],
        [ground[k] for k in keys], trajectory.poses[keys], p,
    )  # fmt: skip
    np.testing.assert_array_equal(votes.static, expected[0])
    np.testing.assert_array_equal(votes.dynamic, expected[1])
    assert votes.static.any()
    assert votes.dynamic.any()


def test_the_order_of_votes_equals_that_of_single_key_frames(yard):
    """When a place was occupied, and whether it was left for less than a second in between."""
    trajectory, sweeps, what = yard
    ground, sweep = [w == 0 for w in what], 5
    keys = np.array([5, 0, 5, 11, 4, 11])  # the box comes and goes
    frames = [KeyFrame(sweeps[k], ground[k]) for k in keys]
    seconds = np.array([-4.0, -2.5, -1.6, 0.2, 0.9, 2.1])
    asked = sweeps[sweep], ground[sweep], trajectory.poses[sweep]
    together = vote(*asked, frames, trajectory.poses[keys], seconds=seconds)
    single = [
        vote(*asked, [frame], trajectory.poses[[k]]) for frame, k in zip(frames, keys, strict=True)
    ]
    found = np.array([v.static - v.dynamic.astype(int) for v in single])
    found = np.insert(found, 3, 1, axis=0)  # the sweep itself
    times = np.insert(seconds, 3, 0)
    once, porous = np.zeros((2, len(sweeps[sweep])), bool)
    for i, of in enumerate(found.T):
        looks = [(t, v > 0) for t, v in zip(times, of, strict=True) if v]
        stays = [list(stay) for occupied, stay in groupby(looks, lambda look: look[1]) if occupied]
        gaps = [after[0][0] - before[-1][0] for before, after in pairwise(stays)]
        once[i] = len(stays) == 1 and (of < 0).any()
        porous[i] = min(gaps, default=np.inf) <= 1
    np.testing.assert_array_equal(together.occupancy.occupied_once, once)
    np.testing.assert_array_equal(together.occupancy.porous, porous)
    assert once.any()
    assert 0 < porous.sum() < np.count_nonzero(~once & (found < 0).any(0))
    assert not vote(*asked, frames, trajectory.poses[keys]).occupancy.porous.any()


@pytest.mark.parametrize("vote_model", ["range_image", "surface"])
def test_votes_equal_the_reference_on_noise(vote_model):
    """Returns in all directions at ranges near the tolerance: every branch of the algorithm."""
    rng = np.random.default_rng(1)
    T_query, T_key = pose(0.3, -0.2, yaw=0.1), pose(-0.1, 0.4, yaw=-2.0)
    for n in (300, 60_000):
        sweep, query = rng.normal(size=(2, n, 3)).astype(np.float32)
        for cloud in (sweep, query):
            cloud *= rng.uniform(2, 3.2, (n, 1)) / np.linalg.norm(cloud, axis=1, keepdims=True)
        ground, query_ground = rng.random((2, n)) < 0.3
        p = DynamicsParameters(vote_model=vote_model, resolution_deg=1.0)
        votes = vote(
            query, query_ground, T_query, [KeyFrame(sweep, ground, p)], T_key[None], threads=2
        )
        expected = reference_vote(query, query_ground, T_query, [sweep], [ground], T_key[None], p)
        np.testing.assert_array_equal(votes.static, expected[0])
        np.testing.assert_array_equal(votes.dynamic, expected[1])


@pytest.mark.parametrize("p", [PAPER, DEFAULT], ids=["paper", "default"])
def test_rows_that_are_not_returns_get_no_votes(yard, p):
    trajectory, sweeps, what = yard
    bad = sweeps[0].copy()
    bad[::7], bad[1::7], bad[2::7] = np.nan, 0, np.inf
    bad[3::7] = 3e19  # whose range overflows
    key = KeyFrame(bad, what[0] == 0, p)
    assert vote(bad, what[0] == 0, np.eye(4), [key], np.eye(4)[None]).static[::7].max() == 0
    keep = np.isin(np.arange(len(bad)) % 7, [4, 5, 6])
    clean = KeyFrame(bad[keep], (what[0] == 0)[keep], p)
    votes, expected = (
        vote(sweeps[1], what[1] == 0, trajectory.poses[1], [k], trajectory.poses[:1])
        for k in (key, clean)
    )
    np.testing.assert_array_equal(votes.static, expected.static)
    np.testing.assert_array_equal(votes.dynamic, expected.dynamic)


def test_no_points_and_no_key_frames():
    nothing, none = np.zeros((0, 3), np.float32), np.zeros(0, bool)
    point, flag = np.ones((1, 3), np.float32), np.zeros(1, bool)
    assert vote(nothing, none, np.eye(4), [KeyFrame(point, flag)], np.eye(4)[None]).static.size == 0
    assert vote(point, flag, np.eye(4), [KeyFrame(nothing, none)], np.eye(4)[None]).static == [0]
    assert vote(point, flag, np.eye(4), [], np.zeros((0, 4, 4))).dynamic == [0]


def test_a_key_frame_votes_with_the_mesh_that_it_is_given() -> None:
    """A mesh of tiny triangles only has no plane to look through."""
    sweep = np.array([[10, y, z] for y in np.arange(-2, 2, 0.2) for z in np.arange(-1, 1, 0.2)])
    wall = np.ascontiguousarray(sweep, np.float32)
    query = np.ascontiguousarray(0.5 * (wall + [0, 0.1, 0.1]), np.float32)
    none = np.zeros(len(wall), bool)
    tiny = _core.MeshParameters()
    tiny.max_gap = float(np.radians(0.1))
    votes = [
        vote(query, none, np.eye(4), [KeyFrame(wall, none, None, mesh)], np.eye(4)[None])
        for mesh in (None, ScanMesh(wall, parameters=tiny))
    ]
    assert votes[0].dynamic.mean() > 0.5
    assert votes[1].dynamic.sum() == 0


@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0)])
def test_planes_are_level_in_the_world_and_not_in_the_frame_of_the_lidar(axis) -> None:
    """What is 12 cm above the road is free of it, however the LiDAR leans."""
    ground, what = scan(pose(), -8.0)
    road = np.ascontiguousarray(ground[what == 0])
    none = np.zeros(len(road), bool)
    feet = np.ascontiguousarray(road * np.float32((1.7 - 0.12) / 1.7))
    leaning = np.eye(4)
    leaning[:3, :3] = rotation_exp(np.radians(40) * np.array(axis))
    rig = SensorRig(np.zeros(len(road), np.uint8), leaning[None])
    shares = [
        vote(feet, none, np.eye(4), [KeyFrame(road, none, None, None, of)], np.eye(4)[None])
        .dynamic.astype(bool)
        .mean()
        for of in (None, rig)
    ]
    assert shares[0] > 0.5
    assert abs(shares[1] - shares[0]) < 0.05


def test_wrong_arrays_are_refused():
    points, ground = np.ones((3, 3), np.float32), np.zeros(3, bool)
    for wrong in ([points[:, :2]], [ground]), ([points], [ground[:2]]):
        with pytest.raises(InputError):
            classify_drive(wrong[0], straight(1, 1.0), ground=wrong[1])
    with pytest.raises(InputError, match="as many poses"):
        classify_drive([points], straight(2, 1.0), ground=[ground])
    with pytest.raises(ValueError, match="odd"):
        _core.RangeImage(points, ground, 0.01, 4, 0.2)


@pytest.mark.skipif(KITTI is None, reason="DOCDEPTH_KITTI_RAW is not set")
@pytest.mark.parametrize("p", [PAPER, DEFAULT], ids=["paper", "default"])
def test_votes_equal_the_reference_on_real_sweeps(p):
    sweeps, poses = zip(*(real_sweep(k) for k in (30, 20, 34, 60)), strict=True)
    ground = [sweep[:, 2] < -1.5 for sweep in sweeps]
    frames = [KeyFrame(s, g, p) for s, g in zip(sweeps[1:], ground[1:], strict=True)]
    votes = vote(sweeps[0], ground[0], poses[0], frames, np.stack(poses[1:]))
    expected = reference_vote(sweeps[0], ground[0], poses[0], sweeps[1:], ground[1:], poses[1:], p)
    np.testing.assert_array_equal(votes.static, expected[0])
    np.testing.assert_array_equal(votes.dynamic, expected[1])


def real_sweep(k, drive="2011_09_26_drive_0005_sync"):
    from docdepth.geometry.se3 import quaternion_to_matrix

    folder = Path(str(KITTI)) / "2011_09_26" / drive
    points = np.fromfile(folder / f"velodyne_points/data/{k:010d}.bin", np.float32).reshape(-1, 4)
    row = np.loadtxt(folder / "lidar_poses_tum.txt")[k]
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = quaternion_to_matrix(row[4:]), row[1:4]
    return np.ascontiguousarray(points[:, :3]), T
