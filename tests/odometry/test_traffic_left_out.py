"""What drives along is left out of registration; what stands is not."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from docdepth.geometry.se3 import inverse, rotation_exp
from docdepth.odometry.passes import LoggedRegistration
from docdepth.odometry.registration import SEEN, Found, Traffic
from docdepth.odometry.registration_log import RegistrationLog

STEP = 2.5  # metres a sweep


def pose_of(k: int, step: float = STEP, turned: float = 0.0) -> np.ndarray:
    """A drive along x with the LiDAR turned about z."""
    pose = np.eye(4)
    pose[:3, :3] = rotation_exp(np.array([0.0, 0.0, turned]))
    pose[0, 3] = step * k
    return pose


def sweep_of(k: int, car: float, turned: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Points in the LiDAR's frame, and which are of the rear of a car that gains ``car`` a sweep.

    A pole stands every 9 m on both sides of the road, and the car drives 12 m ahead.
    """
    rng = np.random.default_rng(k)
    z = np.linspace(-1, 2, 13)
    x = np.arange(-54, 400, 9.0)
    poles = np.array([[a, side, h] for a in x for side in (-6.0, 6.0) for h in z])
    poles = poles[np.abs(poles[:, 0] - STEP * k) < 50]
    y, h = np.meshgrid(np.linspace(-0.8, 0.8, 9), np.linspace(-1, 0, 6))
    rear = np.column_stack([np.full(y.size, 12 + (STEP + car) * k), y.ravel(), h.ravel()])
    points = np.concatenate([poles, rear]) + rng.normal(scale=0.01, size=(len(poles) + y.size, 3))
    T = inverse(pose_of(k, turned=turned))
    return points @ T[:3, :3].T + T[:3, 3], np.arange(len(points)) >= len(poles)


def told(car: float, turned: float = 0.0) -> list[tuple[float, float]]:
    """Shares of the car and of the poles that are left out, sweep by sweep."""
    traffic, shares = Traffic(), []
    for k in range(14):
        points, of_car = sweep_of(k, car, turned)
        along = traffic.left_out(points, pose_of(k, turned=turned))
        shares.append((float(along[of_car].mean()), float(along[~of_car].mean())))
    return shares


def test_a_car_at_the_speed_of_the_vehicle_is_left_out() -> None:
    for car, turned in ((0.0, 0.0), (0.4, 0.0), (-0.4, 0.7), (0.8, 2.5)):
        shares = told(car, turned)
        assert shares[0] == (0, 0), "nothing is known yet"
        assert min(of_car for of_car, _ in shares[4:]) > 0.95, (car, turned)
        assert max(of_poles for _, of_poles in shares) < 0.02, (car, turned)


def test_sweeps_of_no_open_road_are_none_to_compare_with() -> None:
    traffic, none = Traffic(), np.zeros((0, 3))
    for k in range(6):
        assert traffic.left_out(none, pose_of(k)).shape == (0,)
    assert not traffic.left_out(sweep_of(6, 0)[0], pose_of(6)).any()
    for k in range(7, 12):
        along = traffic.left_out(sweep_of(k, 0)[0], pose_of(k))
    assert along.any()


def test_against_distances_between_all_points() -> None:
    rng, traffic = np.random.default_rng(1), Traffic()
    seen: list[tuple[np.ndarray, np.ndarray]] = []
    flagged = 0
    for k in range(24):
        pose = pose_of(k, rng.uniform(0.9, 1.3), 0.05 * k)
        pose[:3, 3] += rng.normal(scale=0.2, size=3)
        points = rng.uniform([-15, -4, -1], [15, 4, 1], (300, 3))
        along = traffic.left_out(points, pose)
        np.testing.assert_array_equal(along, plainly(points, pose, seen))
        seen.append((pose, points))
        flagged += int(along.sum())
    assert flagged > 100


def plainly(
    points: np.ndarray, pose: np.ndarray, seen: list[tuple[np.ndarray, np.ndarray]]
) -> np.ndarray:
    along = np.zeros(len(points), bool)
    if not seen:
        return along
    before, last = seen[-1]
    moved = (inverse(before) @ pose)[:3, 3]
    behind = [(p, q) for p, q in seen[-SEEN:] if 6 <= np.linalg.norm((p - pose)[:3, 3]) <= 15]
    if np.linalg.norm(moved) <= 1 or not behind:
        return along
    way = moved / np.linalg.norm(moved)
    world = points @ pose[:3, :3].T + pose[:3, 3]
    for k, point in enumerate(points):
        offsets = last - point
        ahead = offsets @ way
        aside = np.linalg.norm(offsets - ahead[:, None] * way, axis=1)
        if np.hypot(ahead, aside / 0.3).min() >= 1:
            continue
        along[k] = all(
            np.linalg.norm(q @ p[:3, :3].T + p[:3, 3] - world[k], axis=1).min() > 0.5
            for p, q in behind
        )
    return along


def test_an_interrupted_drive_reads_the_sweeps_that_tell_traffic(tmp_path: Path) -> None:
    """They are looked back at, so the first sweep that the map shows needs those before it."""
    file = tmp_path / "pass_1.log"
    log = RegistrationLog(file, "key")
    for k in range(300):
        log.add(Found(pose_of(k), np.eye(6), True))
    log.close()
    taken, inserted = list[int](), list[int]()

    class Recorded:
        def take(self, points: np.ndarray, guess: np.ndarray) -> None:
            taken.append(round(guess[0, 3] / STEP))

        def align(self, guess: np.ndarray) -> Found:
            return Found(guess, np.eye(6), True)

        def insert(self, pose: np.ndarray) -> None:
            inserted.append(round(pose[0, 3] / STEP))

    kept = RegistrationLog(file, "key")
    logged = LoggedRegistration(Recorded(), kept, 310, 80.0)  # type: ignore[arg-type]
    points = np.zeros((60, 3), np.float32)
    for k in range(310):
        logged.align(k, lambda: points, [pose_of(k)])
        logged.insert(k, pose_of(k))
    kept.close()
    assert inserted == list(range(logged.first, 310))
    assert taken == list(range(logged.first - SEEN, 310))
    assert logged.first > SEEN
