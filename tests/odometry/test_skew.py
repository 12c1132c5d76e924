"""Whether sweeps without times are as measured or motion compensated, told by exact drives."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from docdepth.datasets import Sweep
from docdepth.datasets.views import TurningLidar
from docdepth.geometry.turn import Turn
from docdepth.odometry.odometry import estimate_poses
from docdepth.odometry.skew import find_skew
from docdepth.synthetic import Drive, scene, sensor


class Without:
    """A synthetic drive without times of points; rows are in another order."""

    name, path = "folder", Path("without")

    def __init__(self, skew: bool, order: str, count: int = 12, every: int = 1) -> None:
        self.drive = Drive(scene("city"), sensor("VLP-16"), every * count, seed=7, skew=skew)
        self.times, self._every = self.drive.times[::every], every
        self._order, self.lidars, self.cameras = order, {}, {}
        self.poses, self._read = None, dict[int, Sweep]()

    def __len__(self) -> int:
        return len(self.times)

    def sweep(self, index: int) -> Sweep:
        if index not in self._read:
            true = self.drive.sweep(self._every * index)
            time, ring = true.relative_time, true.ring
            keys = (ring, time) if self._order == "columns" else (-time, ring)
            rows = np.lexsort(keys)
            self._read[index] = Sweep(true.points[rows], str(index), int(self.times[index]))
        return self._read[index]


@pytest.mark.parametrize(
    ("skew", "order", "count"),
    [
        (True, "columns", 12),
        (False, "columns", 12),
        pytest.param(True, "rings backwards", 26, marks=pytest.mark.slow),
        pytest.param(False, "rings backwards", 26, marks=pytest.mark.nightly),
    ],
)
def test_what_is_right_makes_the_world_sharper(skew: bool, order: str, count: int) -> None:
    drive = Without(skew, order, count)
    found = find_skew(drive)
    assert found is not None
    assert found.state == ("measured" if skew else "compensated")
    assert (found.measured.blur < found.compensated.blur) == skew
    if skew:
        assert found.turn == Turn(True, None if order == "columns" else 180.0)
        poses = estimate_poses(TurningLidar(drive, found.turn), threads=1)
        steps = [
            np.linalg.norm(np.diff(p[:, :3, 3], axis=0), axis=1).sum()
            for p in (poses, drive.drive.poses)
        ]
        assert steps[0] == pytest.approx(steps[1], rel=0.01)


def test_where_sweeps_were_left_out_the_lidar_turned_several_times() -> None:
    found = find_skew(Without(True, "columns", every=2))
    assert found is not None
    assert found.state == "measured"
    assert found.turn == Turn(True, revolutions=2)


def test_a_lidar_that_stands_tells_nothing() -> None:
    drive = Without(True, "columns")
    first, times = drive.sweep(0), drive.times.tolist()
    drive._read = {k: replace(first, time=time) for k, time in enumerate(times)}
    assert find_skew(drive) is None


def test_a_short_drive_does_not_tell_one_turn_of_many() -> None:
    assert find_skew(Without(True, "rings")) is None
