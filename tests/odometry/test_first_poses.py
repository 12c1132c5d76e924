"""The first poses of a drive, which find a map of few sweeps."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from docdepth.config import OdometryParameters
from docdepth.datasets import Sweep
from docdepth.geometry.se3 import inverse, se3_exp, se3_log
from docdepth.odometry.first_poses import FIRST, with_first_poses
from docdepth.odometry.passes import fine_registration
from docdepth.odometry.registration_log import RegistrationLog
from docdepth.odometry.sweeps import FINE_SAMPLING, SweepPart, ThinnedSweeps
from docdepth.synthetic import Drive, scene, sensor

COUNT = 20


class Recording:
    """A synthetic drive by 16 beams."""

    def __init__(self, few: int | None = None) -> None:
        self.drive = Drive(scene("city"), sensor("VLP-16"), COUNT, seed=7, skew=True)
        self.times, self._few = self.drive.times, few

    def __len__(self) -> int:
        return COUNT

    def sweep(self, index: int) -> Sweep:
        true = self.drive.sweep(index)
        rows = slice(10 if index == self._few else None)
        name, time = str(index), int(self.times[index])
        return Sweep(true.points[rows], name, time, None, true.relative_time[rows])


def registered(recording: Recording, poses: NDArray[np.float64]) -> NDArray[np.float64]:
    sweeps = ThinnedSweeps(recording, OdometryParameters(), FINE_SAMPLING, COUNT)
    part = SweepPart(sweeps, range(COUNT))
    return np.array(
        list(with_first_poses(iter(poses), part, fine_registration(1), RegistrationLog()))
    )


def errors(poses: NDArray[np.float64], true: NDArray[np.float64]) -> tuple[float, float]:
    """Greatest error of the first sweeps' places as seen from a later one: degrees and metres."""
    off = [inverse(inverse(true[-1]) @ t) @ inverse(poses[-1]) @ p
           for p, t in zip(poses[:FIRST], true, strict=False)]  # fmt: skip
    turns = [np.degrees(np.linalg.norm(se3_log(one)[0])) for one in off]
    return max(turns), max(float(np.linalg.norm(one[:3, 3])) for one in off)


def test_first_sweeps_that_lean_are_put_right() -> None:
    recording = Recording()
    true, rng = recording.drive.poses, np.random.default_rng(3)
    wrong = true.copy()
    for k in range(FIRST):
        turn = rng.normal(0, np.radians(0.3), 3) * (1, 1, 0.1)
        wrong[k] = true[k] @ se3_exp(turn, rng.normal(0, 0.02, 3))
    found = registered(recording, wrong)
    np.testing.assert_allclose(found[0], np.eye(4), atol=1e-12)
    turned, moved = errors(found, true)
    assert errors(wrong, true)[0] > 0.4
    assert turned < 0.1
    assert moved < 0.03
    behind = inverse(found[FIRST]) @ found[FIRST:]
    np.testing.assert_allclose(behind, inverse(true[FIRST]) @ true[FIRST:], atol=1e-9)


@pytest.mark.parametrize("few", [2, 12])
def test_a_sweep_of_few_points_leaves_the_poses(few: int) -> None:
    recording = Recording(few)
    true = recording.drive.poses
    found = registered(recording, true)
    np.testing.assert_allclose(found, inverse(true[0]) @ true, atol=1e-12)


def test_a_short_part_keeps_its_poses() -> None:
    recording = Recording()
    true = recording.drive.poses[:10]
    sweeps = ThinnedSweeps(recording, OdometryParameters(), FINE_SAMPLING, COUNT)
    part = SweepPart(sweeps, range(10))
    found = np.array(
        list(with_first_poses(iter(true), part, fine_registration(1), RegistrationLog()))
    )
    np.testing.assert_allclose(found, inverse(true[0]) @ true, atol=1e-12)
