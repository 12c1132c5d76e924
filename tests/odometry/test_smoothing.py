"""Smoothed positions against least squares over the whole drive."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from docdepth.odometry import smoothing
from docdepth.odometry.smoothing import LAG, State, filtered, first_state, smoothed, stamp_error_of

TIMES = np.array([0, 100, 199, 302, 400, 700, 801, 900, 1000]) * 10**6
"""Two sweeps are lost."""


def least_squares(poses: np.ndarray, covariances: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Most likely positions: of a first state and a jerk for each sweep, all at once.

    How far a jerk may go follows the velocity that the filter knew before it, and how uncertain a
    measurement is follows how far it is from where the filter expected it. Rotations are those of
    the poses.
    """
    n, positions = len(times), poses[:, :3, 3]
    unknowns = 9 + 3 * (n - 1)
    start = np.zeros((9, unknowns))
    start[:, :9] = np.eye(9)
    rows, values = [], []
    prior = np.repeat([1e-6, smoothing._SPEED, smoothing._ACCELERATION], 3)
    first = np.concatenate([positions[0], np.zeros(6)])
    rows.append(np.eye(unknowns)[:9] / prior[:, None])
    values.append(first / prior)
    moved = [start]
    for k in range(1, n):
        dt = 1e-9 * (times[k] - times[k - 1])
        jerk = np.zeros((9, unknowns))
        jerk[:, 9 + 3 * (k - 1) :][:, :3] = np.kron([[dt**3 / 6], [dt**2 / 2], [dt]], np.eye(3))
        turn = Rotation.from_matrix(poses[k, :3, :3] @ poses[k - 1, :3, :3].T).as_rotvec()
        half, Q = (Rotation.from_rotvec(share * turn).as_matrix() for share in (0.5, 1))
        zero = np.zeros((3, 3))
        F = np.block([[np.eye(3), dt * half, dt**2 / 2 * half], [zero, Q, dt * Q], [zero, zero, Q]])
        moved.append(F @ moved[-1] + jerk)
    filter_states = list(states(poses, covariances, times))
    for k, known in enumerate(filter_states[:-1]):
        speed = max(np.linalg.norm(known.velocity), smoothing._STANDING)
        jerk = 20.0**2 * np.eye(3)
        jerk += (2.0**2 - 20.0**2) * np.outer(known.velocity, known.velocity) / speed**2
        weight = np.linalg.cholesky(np.linalg.inv(jerk)).T
        rows.append(weight @ np.eye(unknowns)[9 + 3 * k : 12 + 3 * k])
        values.append(np.zeros(3))
    for k in range(1, n):
        R = 10 * covariances[k] + smoothing._NOISE**2 * np.eye(3)
        off = positions[k] - filter_states[k].predicted[:3]
        expected = filter_states[k].predicted_covariance[:3, :3] + R
        R = R * max(1, off @ np.linalg.inv(expected) @ off)
        weight = np.linalg.cholesky(np.linalg.inv(R)).T
        rows.append(weight @ moved[k][:3])
        values.append(weight @ positions[k])
    solution = np.linalg.lstsq(np.concatenate(rows), np.concatenate(values), rcond=None)[0]
    return np.array([state[:3] @ solution for state in moved])


def states(poses: np.ndarray, covariances: np.ndarray, times: np.ndarray) -> Iterator[State]:
    """Of poses whose rotation is exact; covariances (n, 3, 3) are of their position."""
    return _states(poses, [of_position(covariance) for covariance in covariances], times)


def _states(
    poses: np.ndarray, covariances: Sequence[np.ndarray], times: np.ndarray
) -> Iterator[State]:
    before = None
    for k, (pose, covariance) in enumerate(zip(poses, covariances, strict=True)):
        elapsed = 1e-9 * float(times[k] - times[k - 1]) if k else 0.0
        if before is None:
            before = first_state(pose, None)
        else:
            before = filtered(before, pose, covariance, elapsed)
        yield before


def of_position(covariance: np.ndarray) -> np.ndarray:
    """Of a registration (6, 6) whose rotation is exact."""
    whole = np.zeros((6, 6))
    whole[3:, 3:] = covariance
    return whole


def measured(times: np.ndarray, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Exact positions of a car that brakes in a bend, measured poses, and their covariances."""
    rng, t = np.random.default_rng(seed), 1e-9 * times
    headings = np.arctan2(1.6 * t, 28 - 3 * t)
    exact = np.stack([28 * t - 1.5 * t**2, 0.8 * t**2, 0.02 * t], axis=1)
    covariances = np.empty((len(t), 3, 3))
    for k in range(len(t)):
        covariances[k] = np.diag(rng.uniform([0.02, 0.002, 0.002], [0.2, 0.01, 0.01]) ** 2) / 10
        if k % 2:
            turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
            covariances[k] = turn @ covariances[k] @ turn.T
    covariances[0] = 1e-8 * np.eye(3)
    poses = np.repeat(np.eye(4)[None], len(t), axis=0)
    noise = [rng.multivariate_normal(np.zeros(3), 10 * C) for C in covariances]
    poses[:, :3, 3] = exact + noise
    poses[:, :3, :3] = Rotation.from_euler("z", headings[:, None]).as_matrix()
    return exact, poses, covariances


def test_a_short_drive_is_least_squares() -> None:
    _, poses, covariances = measured(TIMES)
    made = np.array(list(smoothed(states(poses, covariances, TIMES))))
    expected = least_squares(poses, covariances, TIMES)
    np.testing.assert_allclose(made[:, :3, 3], expected, atol=1e-6)
    assert np.abs(expected - poses[:, :3, 3]).max() > 0.01, "nothing was smoothed"
    np.testing.assert_array_equal(made[:, :3, :3], poses[:, :3, :3])


def test_rotations_follow_positions_as_registration_says() -> None:
    """At the position of each pose, the rotation is the most likely one by both errors together."""
    rng = np.random.default_rng(6)
    _, poses, positions = measured(TIMES)
    covariances = np.empty((len(TIMES), 6, 6))
    for k in range(len(TIMES)):
        # A turn of 0.1 degrees goes with a step to the side, as of points far ahead.
        root = np.diag(rng.uniform(1e-4, 2e-3, 6))
        root[3:, 3:] = np.linalg.cholesky(positions[k])
        root[:3, 3:] = rng.normal(scale=4e-4, size=(3, 3))
        covariances[k] = root @ root.T
    known = list(_states(poses, covariances, TIMES))
    turned = 0.0
    for made, pose, C in zip(smoothed(known), poses, covariances, strict=True):
        # Least squares of rotation and position (6,) that registration is off by; what is left of
        # the position is the error that registration does not know of.
        step = made[:3, 3] - pose[:3, 3]
        unknown = np.hypot(0.002, 0.005)
        rows = [np.linalg.inv(np.linalg.cholesky(10 * C)), np.eye(6)[3:] / unknown]
        values = np.concatenate([np.zeros(6), step / unknown])
        expected = np.linalg.lstsq(np.concatenate(rows), values, rcond=None)[0][:3]
        found = Rotation.from_matrix(made[:3, :3] @ pose[:3, :3].T).as_rotvec()
        # First the filter moves the pose, then the smoother: two small turns, one after the other.
        np.testing.assert_allclose(found, expected, atol=2e-6)
        turned = max(turned, float(np.linalg.norm(expected)))
    assert turned > 1e-3, "nothing turned"


def test_a_second_of_later_sweeps_is_enough() -> None:
    times = np.arange(60, dtype=np.int64) * 10**8
    exact, poses, covariances = measured(times, 1)
    made = np.array(list(smoothed(states(poses, covariances, times))))
    whole = least_squares(poses, covariances, times)
    np.testing.assert_allclose(made[:, :3, 3], whole, atol=0.004)

    def error(positions: np.ndarray) -> float:
        return float(np.sqrt((np.diff(positions - exact, axis=0) ** 2).mean()))

    assert error(made[:, :3, 3]) < 0.15 * error(poses[:, :3, 3])


def test_poses_come_a_few_sweeps_later_and_all_of_them() -> None:
    times = np.arange(LAG + 4, dtype=np.int64) * 10**8
    asked: list[int] = []

    def registered():
        state = first_state(np.eye(4), None)
        for k in range(len(times)):
            asked.append(k)
            if k:
                state = filtered(state, np.eye(4), of_position(1e-4 * np.eye(3)), 0.1)
            yield state

    poses = smoothed(registered())
    for k in range(len(times)):
        next(poses)
        assert asked[-1] == min(k + LAG, len(times) - 1)
    with pytest.raises(StopIteration):
        next(poses)


def test_traffic_does_not_pull_a_vehicle_along() -> None:
    """Registration jumps by a metre, as it does between lorries: the motion goes on."""
    times = np.arange(40, dtype=np.int64) * 10**8
    exact, poses, covariances = measured(times, 3)
    poses[:, :3, 3] = exact
    covariances[:] = 0.03**2 * np.eye(3)
    poses[20:24, 0, 3] -= [0.5, 1.0, 1.0, 0.5]
    made = list(smoothed(states(poses, covariances, times)))
    assert np.abs(np.array(made)[:, :3, 3] - exact).max() < 0.15


@pytest.mark.parametrize("lost", [0.3, 2.8])
def test_a_sweep_that_is_lost_without_a_trace_in_the_stamps(lost: float) -> None:
    times = np.arange(40, dtype=np.int64) * 10**8
    exact, poses, covariances = measured(times, 4)
    exact[20:, 0] += lost
    rng = np.random.default_rng(5)
    poses[:, :3, 3] = exact + rng.normal(scale=0.003, size=exact.shape)
    covariances[:] = 0.003**2 * np.eye(3) / 10
    made = np.array(list(smoothed(states(poses, covariances, times))))
    assert np.abs(made[:, :3, 3] - exact).max() < 0.02


def test_registration_that_stays_behind_follows_traffic() -> None:
    """Between lorries it may say, surely, that the vehicle stands. No lost sweep explains that."""
    ahead = np.array([2.2, 0.0, 0.0])
    state = first_state(np.eye(4), 10 * ahead)
    pose, surely = np.eye(4), of_position(1e-8 * np.eye(3))
    for k in range(1, 20):
        pose[:3, 3] = k * ahead
        state = filtered(state, pose, surely, 0.1)
    pose[:3, 3] -= 0.1 * ahead  # as if it had gone back a little, against 25 deviations
    state = filtered(state, pose, surely, 0.1)
    off = np.linalg.norm(pose[:3, 3] - state.predicted[:3])
    spread = state.predicted_covariance[:3, :3] + np.diag([4e-6 + 1e-7] * 3)
    assert off / np.sqrt(spread[0, 0]) > 25
    assert np.linalg.norm(state.mean[:3] - 20 * ahead) < 0.1


def test_the_error_of_stamps_is_told_by_themselves() -> None:
    rng = np.random.default_rng(6)
    even = np.arange(400, dtype=np.int64) * 10**8
    late = even + (rng.normal(scale=8e6, size=400)).astype(np.int64)
    assert stamp_error_of(even) == 0
    assert stamp_error_of(late) == pytest.approx(0.008, rel=0.15)
    gaps = np.concatenate([late[:100], late[110:200], late[230:]])
    assert stamp_error_of(gaps) == pytest.approx(0.008, rel=0.15)
    assert stamp_error_of(even[:2]) == 0
