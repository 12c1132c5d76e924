"""Recordings with gaps, lost sweeps, and clocks that step.

Each part is as if alone, and is laid on the one before if it fits.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from docdepth import register_drive
from docdepth.datasets import Sweep
from docdepth.geometry.se3 import inverse, se3_exp
from docdepth.geometry.trajectory import parts_of, within_parts
from docdepth.odometry import first_motion
from docdepth.odometry.clock import even_stamps
from docdepth.odometry.parts import APART
from exact_drive import Drive

PART = 7  # sweeps


@dataclass
class Cut:
    """Some sweeps of a drive, with other stamps."""

    drive: Drive
    frames: list[int]
    times: np.ndarray

    def __getattr__(self, name: str) -> object:
        return getattr(self.drive, name)

    def __len__(self) -> int:
        return len(self.frames)

    def sweep(self, index: int) -> Sweep:
        return replace(self.drive.sweep(self.frames[index]), time=int(self.times[index]))


@pytest.fixture(scope="module")
def drive() -> Drive:
    return Drive(2 * PART + 45)


@pytest.mark.parametrize(("lost", "given"), [(0, False), (45, False), (45, True)])
def test_motion_is_not_carried_over_a_gap(
    drive: Drive, lost: int, given: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A gap of 1.1 s; on the street it is one sweep, or 50 metres farther on."""
    monkeypatch.setattr(first_motion, "_DIRECTIONS", [0.0])
    frames = [*range(PART), *range(PART + lost, 2 * PART + lost)]
    stamps = np.arange(2 * PART, dtype=np.int64) * 10**8
    stamps[PART:] += 10**9
    exact = drive.exact[frames]
    noise = [
        se3_exp(np.zeros(3), v) for v in np.random.default_rng(2).normal(0, 0.1, (2 * PART, 3))
    ]
    poses = exact @ noise if given else None

    def parts(checkpoint: Path) -> tuple[np.ndarray, set[str]]:
        cut = Cut(drive, frames, stamps)
        found = register_drive(cut, poses=poses, checkpoint=checkpoint)
        return found.trajectory.poses, {finding.code for finding in found.findings}

    both, codes = parts(tmp_path)
    np.testing.assert_array_equal(parts(tmp_path)[0], both)  # from what it noted
    for part in (slice(PART), slice(PART, None)):
        motion, true = inverse(both[part][0]) @ both[part], inverse(exact[part][0]) @ exact[part]
        assert np.linalg.norm((motion - true)[:, :3, 3], axis=1).max() < 0.05
    step, true = (inverse(T[PART - 1]) @ T[PART] for T in (both, exact))
    if given or not lost:
        assert np.linalg.norm((step - true)[:3, 3]) < (0.3 if given else 0.05)
        assert "part-apart" not in codes
    else:
        assert np.linalg.norm(step[:3, 3]) == pytest.approx(APART, abs=30)
        assert "part-apart" in codes


def test_a_gap_is_longer_than_a_second() -> None:
    stamps = np.cumsum([0, 1, 1, 9, 1, 11, 1]) * 10**8
    assert parts_of(stamps) == [range(5), range(5, 7)]
    assert parts_of(2 * stamps[:3] * 10) == [range(3)]  # two seconds are usual there
    times = np.array([-1, stamps[4], stamps[4] + 1, stamps[5], stamps[6] + 1])
    assert within_parts(times, stamps).tolist() == [False, True, False, True, False]


@pytest.mark.parametrize(
    ("kind", "given"),
    [
        ("step", False),
        ("step", True),
        ("step back", False),
        ("late", False),
        ("lost", False),
        ("lost uncounted", False),
    ],
)
def test_the_vehicle_drives_on_when_the_clock_steps(
    drive: Drive, kind: str, given: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Poses, and deskewed sweeps, are right by stamps that jump and where sweeps are missing."""
    monkeypatch.setattr(first_motion, "_DIRECTIONS", [0.0])
    lost = {"lost": 5, "lost uncounted": 3}.get(kind, 0)
    frames = [*range(PART), *range(PART + lost, 2 * PART + lost)]
    stamps = drive.times[frames]
    jumps = {"step": 600, "step back": -70, "late": 90, "lost uncounted": -300}
    stamps[PART:] += jumps.get(kind, 0) * 10**6
    if kind == "late":  # one sweep only
        stamps[PART + 1 :] = drive.times[PART + 1 : 2 * PART]
    exact = drive.exact[frames]
    found = register_drive(Cut(drive, frames, stamps), poses=exact if given else None)
    true = inverse(exact[0]) @ exact
    at = inverse(found.trajectory.poses[0]) @ found.trajectory.poses
    assert np.linalg.norm((at - true)[:, :3, 3], axis=1).max() < 0.05
    codes = {finding.code for finding in found.findings}
    assert ("clock-steps" in codes) == (kind != "lost")
    assert "trajectory-jumps" not in codes
    for k in range(PART - 2, PART + 2):
        points = found.sweeps[k].points[np.linalg.norm(found.sweeps[k].points, axis=1) > 1]
        world = points @ exact[k, :3, :3].T + exact[k, :3, 3]
        assert np.quantile(drive.street.distance(world), 0.9) < 0.05


def test_stamps_of_a_standing_vehicle_are_kept() -> None:
    stamps = np.cumsum([0, 1, 1, 7, 1, 1]) * 10**8
    poses = np.repeat(np.eye(4)[None], 6, axis=0)
    np.testing.assert_array_equal(even_stamps(poses, stamps, 1e8), stamps)
    poses[:, 0, 3] = np.arange(6)  # a metre a sweep
    np.testing.assert_array_equal(even_stamps(poses, stamps, 1e8), np.arange(6) * 10**8)
    poses[3:, 0, 3] += 6  # six sweeps were lost
    np.testing.assert_array_equal(even_stamps(poses, stamps, 1e8), stamps)
    poses[:, 0, 3] = 2 * np.arange(6)
    poses[3:, 0, 3] += 4  # two, of which the stamps do not tell
    even = np.array([0, 1, 2, 5, 6, 7]) * 10**8
    np.testing.assert_array_equal(even_stamps(poses, np.arange(6) * 10**8, 1e8), even)


@pytest.mark.parametrize("seconds", [1.1, 1.3])
def test_the_motion_leads_over_a_short_gap_if_the_sweeps_fit_there(
    drive: Drive, seconds: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A second or two are driven as before: the street looks different 12 metres farther on."""
    monkeypatch.setattr(first_motion, "_DIRECTIONS", [0.0])
    lost = round(10 * seconds) - 1
    frames = [*range(PART), *range(PART + lost, 2 * PART + lost)]
    found = register_drive(Cut(drive, frames, drive.times[frames]))
    true = inverse(drive.exact[0]) @ drive.exact[frames]
    at = inverse(found.trajectory.poses[0]) @ found.trajectory.poses
    assert np.linalg.norm((at - true)[:, :3, 3], axis=1).max() < 0.15
    assert "part-apart" not in {finding.code for finding in found.findings}
