"""Labels do not depend on where the world's origin is, nor on when the drive began."""

from __future__ import annotations

import numpy as np
import pytest

from docdepth import Trajectory, classify_drive
from docdepth.geometry.se3 import se3_exp
from walled_yard import pose, scan

COUNT = 8


@pytest.fixture(scope="module")
def drive() -> tuple[list[np.ndarray], np.ndarray]:
    poses = np.array([pose(0.5 * k) for k in range(COUNT)])
    return [scan(T, -8 + 1.5 * k, 7)[0].astype(np.float32) for k, T in enumerate(poses)], poses


def labels(sweeps: list[np.ndarray], poses: np.ndarray, begin: int = 0) -> np.ndarray:
    found = classify_drive(sweeps, Trajectory(begin + 10**8 * np.arange(COUNT), poses))
    return np.concatenate([of.classid for of in found])


@pytest.fixture(scope="module")
def known(drive: tuple[list[np.ndarray], np.ndarray]) -> np.ndarray:
    found = labels(*drive)
    assert len(np.unique(found)) == 3
    return found


@pytest.mark.parametrize("away", [1e3, 1e5, 5e6])
@pytest.mark.parametrize("turn", [0.0, 0.7])
def test_the_origin_of_the_world(drive, known, away: float, turn: float) -> None:
    world = se3_exp(np.array([0, 0, turn]), np.zeros(3))
    world[:3, 3] = away, -0.7 * away, 50.0
    differing = np.mean(labels(drive[0], world @ drive[1]) != known)
    # Voxels of ground have the axes of the world, and take up other points where it is turned.
    assert differing <= (5e-4 if turn else 0)


def test_the_time_and_the_type_of_poses(drive, known) -> None:
    np.testing.assert_array_equal(labels(*drive, begin=1_700_000_000 * 10**9), known)
    single = drive[1].astype(np.float32)
    np.testing.assert_array_equal(labels(drive[0], single), known)
