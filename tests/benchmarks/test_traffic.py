"""Scenes of what moves and stops do what they are for; speed profiles against plain integrals."""

from __future__ import annotations

from functools import cache
from itertools import combinations

import numpy as np
import pytest
from scenes.large_vehicles import bus
from scenes.moving import Speeds, rounded

from docdepth import synthetic
from docdepth.synthetic import Drive

pytestmark = pytest.mark.slow

pytest.importorskip("embreex")

FRAMES = {"arrivals": 150, "overtaking": 90, "queue": 140}
SEEDS = (0, 4)


@cache
def drive_of(name, seed):
    return Drive(synthetic.scene(name, seed), synthetic.sensor("VLP-16"), FRAMES[name], seed)


def corners(pose, size, margin=0.0):
    half = 0.5 * np.asarray(size)[:2] - margin
    box = np.array([(1, 1), (1, -1), (-1, -1), (-1, 1)]) * half
    return box @ pose[:2, :2].T + pose[:2, 3]


def overlap(a, b):
    """Whether two rectangles (4, 2) overlap: no edge of either separates them."""
    for p in (a, b):
        for k in (0, 1):
            axis = p[k + 1] - p[k]
            if (a @ axis).max() < (b @ axis).min() or (b @ axis).max() < (a @ axis).min():
                return False
    return True


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("name", list(FRAMES))
def test_nothing_drives_through_anything_that_moves(name, seed):
    drive = drive_of(name, seed)
    tracks = drive.tracks()
    for k in range(0, len(drive), 3):
        # Mirrors and swinging arms may touch: somebody brushes a car.
        boxes = {t.id: corners(t.poses[k], t.size, 0.15) for t in tracks}
        boxes[0] = corners(drive.poses[k], (4.4, 1.85))
        hits = [p for p in combinations(boxes, 2) if overlap(boxes[p[0]], boxes[p[1]])]
        assert hits == [], k


@pytest.mark.parametrize("name", list(FRAMES))
def test_nothing_drives_through_what_stands(name):
    drive = drive_of(name, SEEDS[0])
    mesh, into = drive.scene.static, np.linalg.inv(drive.T_scene_world)
    ground_and_leaves = (40, 44, 48, 49, 60, 70, 72)
    things = ~np.isin(mesh.surface["label"] & 0xFFFF, ground_and_leaves)
    at = np.unique(mesh.faces[things])
    vertices = mesh.vertices[at] @ into[:3, :3].T + into[:3, 3]
    for track in drive.tracks():
        half = 0.5 * track.size - 0.15  # mirrors may touch
        for pose in track.poses[::8]:
            near = np.abs(vertices[:, :2] - pose[:2, 3]).max(axis=1) < 8.0
            own = (vertices[near] - pose[:3, 3]) @ pose[:3, :3]
            inside = (np.abs(own[:, :2]) < half[:2]).all(axis=1)
            inside &= (own[:, 2] > 0.3) & (own[:, 2] < track.size[2] - 0.1)
            assert not inside.any(), drive.scene.actors[track.id - 1].name


@pytest.mark.parametrize("seed", SEEDS)
def test_cars_arrive_and_stand_until_the_end(seed):
    drive = drive_of("arrivals", seed)
    stood = []
    for track in drive.tracks():
        speed = np.linalg.norm(track.velocities, axis=1)
        standing = speed < 0.1
        if track.kind == "vehicle" and standing[-10:].all() and speed[:10].min() > 1.0:
            last = int(np.flatnonzero(~standing)[-1])
            away = np.linalg.norm(track.poses[last, :3, 3] - drive.poses[last, :3, 3])
            stood.append((away, (len(drive) - last) / 10))
    away, seconds = np.array(stood).T
    assert len(stood) >= 8
    assert (away < 12).any()
    assert (away > 45).any()
    assert (away < 70).all()
    assert (seconds > 2.5).all()


@pytest.mark.parametrize("seed", SEEDS)
def test_vehicles_higher_than_the_beams_pass_beside_the_ego(seed):
    drive = drive_of("overtaking", seed)
    passed = 0
    for track in drive.tracks():
        own = np.linalg.inv(drive.poses) @ track.poses
        x, y = own[:, 0, 3], own[:, 1, 3]
        beside = np.abs(x) < 6.0
        if track.size[2] > 3.0 and beside.any() and np.abs(y[beside]).max() < 5.0:
            speed = np.linalg.norm(track.velocities, axis=1)
            assert ((speed > 15) & (speed < 28)).all()
            assert np.abs(y[beside]).min() > 3.0
            passed += 1
    assert passed >= 4


@pytest.mark.parametrize("seed", SEEDS)
def test_the_queue_creeps_and_a_car_turns_back(seed):
    drive = drive_of("queue", seed)
    tracks = drive.tracks()
    ego = drive.scene.ego.pace.at(np.linspace(0, 13, 200))
    assert ego.max() <= 1.5
    assert (ego == 0).mean() > 0.2
    yaw = [np.unwrap(np.arctan2(t.poses[:, 1, 0], t.poses[:, 0, 0])) for t in tracks]
    turned = [abs(float(y[-1] - y[0])) for y in yaw]
    assert sum(t > 3.0 for t in turned) == 1
    names = {drive.scene.actors[t.id - 1].name for t in tracks}
    assert {"trailer behind its vehicle", "bus at its stop"} <= names


@pytest.mark.parametrize("at", [-3.0, 0.0, 0.4, 2.2, 3.0, 9.0])
def test_speeds_between_knots_are_integrated(at):
    pace = Speeds((-1.0, 1.0, 2.0, 4.0), (2.0, 6.0, 0.0, 1.5))
    t = np.linspace(0.0, at, 100_001)
    speed = np.interp(t, pace.times, pace.speeds)
    assert pace.at(at) == np.interp(at, pace.times, pace.speeds)
    assert pace.distance(at) == pytest.approx(float(np.trapezoid(speed, t)), abs=1e-6)
    assert pace.later(2.0).at(at + 2.0) == pace.at(at)


def test_rounded_corners_have_no_kink():
    path = rounded([(0.0, 0.0), (10.0, 0.0), (10.0, 10.0)], 4.0)
    step = np.diff(path, axis=0)
    turn = np.degrees(np.diff(np.unwrap(np.arctan2(step[:, 1], step[:, 0]))))
    assert turn.sum() == pytest.approx(90.0)
    assert turn.max() < 20.0
    np.testing.assert_allclose(path[[0, 1, -2, -1]], [(0, 0), (6, 0), (10, 4), (10, 10)])


def test_doors_of_a_bus_open_and_shut():
    parts = bus(np.random.default_rng(0), opens=2.0, closes=6.0)
    times = np.array([1.0, 4.0, 9.0])
    for part in parts[1:]:
        poses = part.swing(times, np.zeros(3), np.zeros(3))
        assert poses[0] == pytest.approx(np.eye(4))
        assert poses[1, 0, 3] < -1.0  # open: a door's width to the rear
        assert poses[2] == pytest.approx(np.eye(4))
