"""Smoothed positions against least squares over the whole drive."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from docdepth.odometry import smoothing
from docdepth.odometry.smoothing import LAG, State, filtered, smoothed

TIMES = np.array([0, 100, 199, 302, 400, 700, 801, 900, 1000]) * 10**6
"""Two sweeps are lost."""


def least_squares(positions: np.ndarray, covariances: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Most likely positions: of a first state and a jerk for each sweep, all at once.

    How far a jerk may go follows the velocity that the filter knew before it.
    """
    n = len(times)
    unknowns = 9 + 3 * (n - 1)
    start = np.zeros((9, unknowns))
    start[:, :9] = np.eye(9)
    rows, values = [], []
    prior = np.repeat([1.0, smoothing._SPEED, smoothing._ACCELERATION], 3)
    first = np.concatenate([positions[0], np.zeros(6)])
    rows.append(np.eye(unknowns)[:9] / prior[:, None])
    values.append(first / prior)
    moved = [start]
    for k in range(1, n):
        dt = 1e-9 * (times[k] - times[k - 1])
        jerk = np.zeros((9, unknowns))
        jerk[:, 9 + 3 * (k - 1) :][:, :3] = np.kron([[dt**3 / 6], [dt**2 / 2], [dt]], np.eye(3))
        F = np.kron([[1, dt, dt**2 / 2], [0, 1, dt], [0, 0, 1]], np.eye(3))
        moved.append(F @ moved[-1] + jerk)
    poses = np.repeat(np.eye(4)[None], n, axis=0)
    poses[:, :3, 3] = positions
    for k, known in enumerate(list(states(poses, covariances, times))[:-1]):
        speed = max(np.linalg.norm(known.velocity), smoothing._STANDING)
        jerk = 20.0**2 * np.eye(3)
        jerk += (2.0**2 - 20.0**2) * np.outer(known.velocity, known.velocity) / speed**2
        weight = np.linalg.cholesky(np.linalg.inv(jerk)).T
        rows.append(weight @ np.eye(unknowns)[9 + 3 * k : 12 + 3 * k])
        values.append(np.zeros(3))
    for k in range(n):
        R = covariances[k] + (smoothing._NOISE**2 if k else 0) * np.eye(3)
        weight = np.linalg.cholesky(np.linalg.inv(R)).T
        rows.append(weight @ moved[k][:3])
        values.append(weight @ positions[k])
    solution = np.linalg.lstsq(np.concatenate(rows), np.concatenate(values), rcond=None)[0]
    return np.array([state[:3] @ solution for state in moved])


def states(poses: np.ndarray, covariances: np.ndarray, times: np.ndarray) -> Iterator[State]:
    before = None
    for k, (pose, covariance) in enumerate(zip(poses, covariances, strict=True)):
        elapsed = 1e-9 * float(times[k] - times[k - 1]) if k else 0.0
        before = filtered(before, pose, covariance, elapsed)
        yield before


def measured(times: np.ndarray, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Exact positions of a car that brakes in a bend, measured poses, and their covariances."""
    rng, t = np.random.default_rng(seed), 1e-9 * times
    exact = np.stack([28 * t - 1.5 * t**2, 0.8 * t**2, 0.02 * t], axis=1)
    covariances = np.empty((len(t), 3, 3))
    for k in range(len(t)):
        covariances[k] = np.diag(rng.uniform([0.02, 0.002, 0.002], [0.2, 0.01, 0.01]) ** 2)
        if k % 2:
            turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
            covariances[k] = turn @ covariances[k] @ turn.T
    covariances[0] = 1e-8 * np.eye(3)
    poses = np.repeat(np.eye(4)[None], len(t), axis=0)
    noise = [rng.multivariate_normal(np.zeros(3), C) for C in covariances]
    poses[:, :3, 3] = exact + noise
    return exact, poses, covariances


def test_a_short_drive_is_least_squares() -> None:
    _, poses, covariances = measured(TIMES)
    made = np.array(list(smoothed(states(poses, covariances, TIMES))))
    expected = least_squares(poses[:, :3, 3], covariances, TIMES)
    np.testing.assert_allclose(made[:, :3, 3], expected, atol=1e-6)
    assert np.abs(expected - poses[:, :3, 3]).max() > 0.01, "nothing was smoothed"
    np.testing.assert_array_equal(made[:, :3, :3], poses[:, :3, :3])


def test_a_second_of_later_sweeps_is_enough() -> None:
    times = np.arange(60, dtype=np.int64) * 10**8
    exact, poses, covariances = measured(times, 1)
    made = np.array(list(smoothed(states(poses, covariances, times))))
    whole = least_squares(poses[:, :3, 3], covariances, times)
    np.testing.assert_allclose(made[:, :3, 3], whole, atol=0.004)

    def error(positions: np.ndarray) -> float:
        return float(np.sqrt((np.diff(positions - exact, axis=0) ** 2).mean()))

    assert error(made[:, :3, 3]) < 0.15 * error(poses[:, :3, 3])


def test_poses_come_a_few_sweeps_later_and_all_of_them() -> None:
    times = np.arange(LAG + 4, dtype=np.int64) * 10**8
    asked: list[int] = []

    def registered():
        state = None
        for k in range(len(times)):
            asked.append(k)
            state = filtered(state, np.eye(4), 1e-4 * np.eye(3), 0.1)
            yield state

    poses = smoothed(registered())
    for k in range(len(times)):
        next(poses)
        assert asked[-1] == min(k + LAG, len(times) - 1)
    with pytest.raises(StopIteration):
        next(poses)


def test_the_filter_tells_how_fast_it_is() -> None:
    times = np.arange(40, dtype=np.int64) * 10**8
    exact, poses, covariances = measured(times, 2)
    last = list(states(poses, covariances, times))[-1]
    speed = np.gradient(exact, 0.1, axis=0)[-1]
    np.testing.assert_allclose(last.velocity, speed, atol=0.6)
    np.testing.assert_allclose(last.pose[:3, 3], exact[-1], atol=0.15)


def test_the_first_pose_stays() -> None:
    _, poses, covariances = measured(TIMES)
    covariances[0] = 0
    made = list(smoothed(states(poses, covariances, TIMES)))
    np.testing.assert_allclose(made[0], poses[0], atol=1e-12)
