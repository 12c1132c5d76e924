"""Objects of a sweep; whole drives with and without tracks, in memory and in run folders."""

from dataclasses import replace

import numpy as np
import pytest
from things import with_options

from docdepth.config import parameters
from docdepth.datasets.base import Sweep
from docdepth.dynamics import voting
from docdepth.dynamics.classes import classify, cluster_objects
from docdepth.dynamics.classifier import classify_drive
from docdepth.dynamics.voting import OccupancyIntervals, Votes
from docdepth.geometry.lidar_frame import LidarFrame, SensorRig
from docdepth.ground.growing import grow_ground
from docdepth.io.frames import write_trajectory
from docdepth.io.run_folder import RunFolder
from docdepth.pipeline import run_classify
from lidar_rays import scan_rays
from motion import straight
from walled_yard import scan

DEFAULT = parameters("default").dynamics


@pytest.fixture
def few_votes(monkeypatch):
    """Settings with which votes alone do not find what tracks should find."""
    with_options(monkeypatch, observed_free_share=1.0)
    monkeypatch.setattr(voting, "END_SPACING", 0.2)
    monkeypatch.setattr(voting, "END_RADIUS", 1)
    return {"ground.seed_radius": 3.0, "dynamics.time_spacing": 1}


@pytest.fixture(scope="module")
def street():
    """A box that waits beside a slow ego for 20 sweeps and is gone soon after."""
    trajectory = straight(30, 0.1)
    box = [-3 + 3.0 * max(i - 20, 0) * 0.5 for i in range(30)]
    scans = [scan(T, x) for T, x in zip(trajectory.poses, box, strict=True)]
    return trajectory, [p for p, _ in scans], [w for _, w in scans]


def test_a_box_that_waits_is_dynamic_in_the_whole_drive(street, few_votes):
    trajectory, sweeps, what = street
    ground = [w == 0 for w in what]
    shares = []
    for evidence in ("objects", "tracks"):
        p = parameters("default", {**few_votes, "dynamics.evidence": evidence})
        labels = classify_drive(sweeps, trajectory, p, ground=ground)
        box = [(label.classid[w == 2] == 100).mean() for label, w in zip(labels, what, strict=True)]
        rest = [(label.classid[w != 2] < 100).mean() for label, w in zip(labels, what, strict=True)]
        assert min(rest) > 0.999
        shares.append(np.mean(box[:20]))
    assert shares[0] < 0.2
    assert shares[1] > 0.9


def folder_of(path, trajectory, sweeps, p):
    """A run whose odometry is done."""
    run = RunFolder.create(path, None, p)
    for i, points in enumerate(sweeps):
        record = LidarFrame(points, np.arange(len(points), dtype=np.uint32), f"{i:06d}",
                             len(points))  # fmt: skip
        run.write_frame(i, record, {"odometry": "exact"})
    write_trajectory(run.trajectory_path, trajectory, np.arange(len(sweeps)))
    run.set_stage("odometry", state="done", key="exact")
    return run


def assert_same_labels(run, labels):
    for i, label in enumerate(labels):
        frame = run.frame(i)
        np.testing.assert_array_equal(frame.classid, label.classid)
        np.testing.assert_array_equal(frame.votes_static, label.votes.static)
        np.testing.assert_array_equal(frame.votes_dynamic, label.votes.dynamic)


@pytest.mark.parametrize("preset", ["default", "paper"])
def test_a_run_gives_the_labels_of_the_drive_in_memory(yard, preset, tmp_path):
    """Bit for bit, and with the given parameters, those of the ground included."""
    trajectory, sweeps, what = yard
    p = parameters(preset, {"ground.seed_radius": 3.0, "ground.plane_distance": 0.06})
    run = folder_of(tmp_path / "run", trajectory, sweeps, p)
    run_classify(run)
    drive = sweeps, run.trajectory()
    labels = classify_drive(*drive, p)
    assert_same_labels(run, labels)
    assert sum((label.classid == 0)[w == 0].sum() for label, w in zip(labels, what, strict=True))
    assert not (run.state_dir / "evidence").exists()
    given = classify_drive(*drive, p, ground=grow_ground(*drive, p))
    assert_same_labels(run, given)
    steps = []
    other = parameters(preset, {"ground.seed_radius": 3.0, "ground.plane_distance": 0.01})
    changed = classify_drive(*drive, other, progress=lambda *step: steps.append(step), threads=1)
    assert any((a.classid != b.classid).any() for a, b in zip(labels, changed, strict=True))
    expected = ["ground", "classify"] + ["track"] * (preset == "default")
    assert list(dict.fromkeys(step for step, _, _ in steps)) == expected
    for step in expected:
        done = [done for name, done, total in steps if name == step and total == len(sweeps)]
        assert done == sorted(done)
        assert done[-1] == len(sweeps)


def test_the_rig_of_a_sweep_is_used(yard):
    trajectory, sweeps, what = yard
    shifted = [
        Sweep(points, f"{i}", int(trajectory.times[i]), sensor_rig=SensorRig.single((1, 0, 0), n))
        for i, (points, n) in enumerate((sweep, len(sweep)) for sweep in sweeps)
    ]
    ground = [w == 0 for w in what]
    labels, plain = (classify_drive(s, trajectory, ground=ground) for s in (shifted, sweeps))
    assert any((a.votes.static != b.votes.static).any() for a, b in zip(labels, plain, strict=True))
    # Ego motion within a sweep is the business of rendering.
    moving = [
        replace(s, sensor_rig=s.sensor_rig.with_ego_motion((9, 0, 0), np.full(len(s.points), 0.1)))
        for s in shifted
    ]
    for a, b in zip(labels, classify_drive(moving, trajectory, ground=ground), strict=True):
        np.testing.assert_array_equal(a.votes.static, b.votes.static)
        np.testing.assert_array_equal(a.classid, b.classid)


def test_objects_are_connected_points_above_the_ground(street):
    _, sweeps, what = street
    objects = cluster_objects(sweeps[0], what[0] == 0)
    assert (objects[what[0] == 0] == np.flatnonzero(what[0] == 0)).all()
    box = np.flatnonzero(what[0] == 2)
    assert np.bincount(objects[box]).max() > 0.9 * len(box)


def _before_a_wall(met):
    """A sweep of 16 rings: what is 8 m away where `met` (16 rings, 60 columns), else a wall."""
    rays = scan_rays(np.radians(np.arange(16) - 8), np.radians(np.arange(60) - 30))
    points = rays * np.where(met, 8, 20)[..., None]
    return points.reshape(-1, 3).astype(np.float32), np.zeros(met.size, bool)


def test_a_pole_with_one_return_a_ring_is_one_object_apart_from_the_wall_behind():
    met = np.zeros((16, 60), bool)
    met[3:13, 30] = True
    points, ground = _before_a_wall(met)
    objects = cluster_objects(points, ground)
    assert len(np.unique(objects[met.ravel()])) == 1
    assert not np.isin(objects[~met.ravel()], objects[met.ravel()]).any()
    votes = Votes(*np.zeros((2, met.size), np.uint16))
    votes.dynamic[np.flatnonzero(met)[::2]] = 1
    assert ((classify(ground, votes, DEFAULT, points) == 100) == met.ravel()).all()


@pytest.mark.parametrize(
    ("static", "dynamic", "once", "moves"),
    [(1, 4, True, True), (0, 4, False, False), (0, 1, True, False), (2, 4, True, False)],
)
def test_a_return_alone_moves_where_it_was_clearly_free_and_occupied_once(
    static, dynamic, once, moves
):
    met = np.zeros((16, 60), bool)
    met[8, 30] = True
    points, ground = _before_a_wall(met)
    votes = Votes(*np.zeros((2, met.size), np.uint16))
    votes.static[met.ravel()], votes.dynamic[met.ravel()] = static, dynamic
    ends = np.zeros(met.size, np.uint16)
    stay = np.full(met.size, once)
    votes = replace(votes, occupancy=OccupancyIntervals(stay, ~stay, ends, ends))
    assert ((classify(ground, votes, DEFAULT, points) == 100) == (met.ravel() & moves)).all()


def test_a_fence_was_not_free_though_key_frames_look_through_it():
    board = np.zeros((16, 60), bool)
    board[3:13, 10:40] = True
    fence = np.zeros_like(board)  # one wire, up and down
    fence[3:13, 10:40:4] = True
    for k in range(10, 36, 4):
        fence[3 if k % 8 == 2 else 12, k : k + 4] = True
    for met, moves in ((board, True), (fence, False)):
        points, ground = _before_a_wall(met)
        votes = Votes(*np.zeros((2, met.size), np.uint16))
        votes.static[met.ravel()], votes.dynamic[met.ravel()] = 10, 2
        once, ends = votes.dynamic > 0, np.zeros(met.size, np.uint16)
        votes = replace(votes, occupancy=OccupancyIntervals(once, ~once, ends, ends))
        largest = np.bincount(cluster_objects(points, ground)[met.ravel()]).max()
        assert largest > 100
        assert (classify(ground, votes, DEFAULT, points)[met.ravel()] == 100).all() == moves
        assert (classify(ground, votes, DEFAULT, points)[met.ravel()] == 100).any() == moves
