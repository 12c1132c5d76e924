"""The first motion of a drive: at any speed, between lorries, with any side of the LiDAR ahead."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scenes  # noqa: F401  adds its scenes
from scipy.spatial.transform import Rotation

from docdepth import open_dataset
from docdepth.config import OdometryParameters
from docdepth.datasets import Sweep
from docdepth.geometry.se3 import inverse, se3_exp
from docdepth.odometry.first_motion import FIRST_SWEEPS, first_motion
from docdepth.odometry.odometry import estimate_poses
from docdepth.odometry.pose_checks import find_other_motion
from docdepth.odometry.sweeps import FINE_SAMPLING, ThinnedSweeps
from docdepth.synthetic import write_drive
from exact_drive import Drive


class Turned:
    """A dataset whose LiDAR is turned about the vertical, from a frame on."""

    def __init__(self, dataset, degrees: float = 0, first: int = 0) -> None:
        self._dataset, self._first = dataset, first
        self.turn = Rotation.from_euler("z", degrees, degrees=True).as_matrix()
        self.times = dataset.times[first:]

    def __len__(self) -> int:
        return len(self.times)

    def sweep(self, index: int) -> Sweep:
        sweep = self._dataset.sweep(self._first + index)
        return replace(sweep, points=(sweep.points @ self.turn.T).astype(np.float32))


def found(dataset) -> np.ndarray | None:
    sweeps = ThinnedSweeps(dataset, OdometryParameters(), FINE_SAMPLING, FIRST_SWEEPS)
    return first_motion(sweeps, range(len(dataset)))


def error(dataset, exact: np.ndarray, degrees: float = 0, first: int = 0) -> float:
    """Error of the first motion in metres a sweep; ``exact`` are the poses of the dataset."""
    turned = Turned(dataset, degrees, first)
    motion = found(turned)
    assert motion is not None
    step = (inverse(exact[first]) @ exact[first + 1])[:3, 3]
    return float(np.linalg.norm(motion[:3, 3] - turned.turn @ step))


@pytest.fixture(scope="module")
def road(tmp_path_factory: pytest.TempPathFactory):
    """A motorway by a sensor, 2.7 m a sweep, with lorries."""
    made: dict[tuple[str, str], object] = {}

    def dataset(scene: str, sensor: str):
        if (scene, sensor) not in made:
            folder = tmp_path_factory.mktemp("drive")
            write_drive(folder, scene, sensor, 24, 31, skew=True, images=False)
            made[scene, sensor] = open_dataset(folder / "sequences" / "00")
        return made[scene, sensor]

    return dataset


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sensor", "degrees"), [("VLP-16", 0), ("VLP-16", -90), ("XT-32", 40), ("XT-32", 180)]
)
def test_any_side_of_the_lidar_may_look_ahead(road, sensor: str, degrees: float) -> None:
    dataset = road("highway", sensor)
    for first in (0, 9):
        assert error(dataset, dataset.poses, degrees, first) < 0.3


@pytest.mark.slow
def test_a_drive_by_a_lidar_that_looks_back(road) -> None:
    """From the first sweep on; it stood at the speed of a motorway."""
    dataset = road("highway", "XT-32")
    turned = Turned(dataset, 180)
    steps = (inverse(poses[:-1]) @ poses[1:] for poses in (estimate_poses(turned), dataset.poses))
    found, exact = (step[:, :3, 3] for step in steps)
    assert np.linalg.norm(found - exact @ turned.turn.T, axis=1).max() < 0.1


@pytest.mark.slow
@pytest.mark.parametrize(("degrees", "first"), [(0, 0), (180, 9), (0, 18)])
def test_a_rosette_between_lorries(road, degrees: float, first: int) -> None:
    """Its points agree only where the tried motion deskews them."""
    dataset = road("overtaking", "Avia")
    assert error(dataset, dataset.poses, degrees, first) < 0.25


@pytest.mark.parametrize(("speed", "turn"), [(0.0, 0.0), (0.8, 0.02), (3.5, 0.06)])
def test_a_known_motion(speed: float, turn: float) -> None:
    drive = Drive(5, motion=se3_exp(np.array([0.0, 0.0, turn]), np.array([speed, 0.0, 0.0])))
    assert error(drive, drive.exact) < 0.05


def test_a_lost_sweep_has_twice_the_time() -> None:
    """The second sweep is missing, and the stamps tell."""
    drive = Drive(6, motion=se3_exp(np.zeros(3), np.array([2.0, 0.0, 0.0])))
    kept = [0, 2, 3, 4, 5]
    sweeps = [drive.sweep(k) for k in kept]
    drive.times, drive.sweep = drive.times[kept], sweeps.__getitem__
    motion = found(drive)
    assert motion is not None
    np.testing.assert_allclose(motion[:3, 3], [2, 0, 0], atol=0.1)


def test_a_field_tells_nothing(tmp_path: Path) -> None:
    drive = Drive(4)
    angles = np.linspace(0, 2 * np.pi, 2000)
    rings = [
        np.stack([r * np.cos(angles), r * np.sin(angles), 0 * angles - 1.7], 1) for r in (8, 9)
    ]
    points = np.concatenate(rings).astype(np.float32)
    drive.sweep = lambda k: Sweep(points, str(k), int(drive.times[k]), motion_compensated=True)
    assert found(drive) is None


@pytest.mark.slow
def test_poses_that_follow_lorries_are_named(road) -> None:
    """As registration finds them that starts from their speed; the right ones are not named."""
    dataset = road("highway", "XT-32")
    exact = np.asarray(dataset.poses)
    follows = np.repeat(np.eye(4)[None], len(exact), axis=0)
    follows[:, 0, 3] = 0.35 * np.arange(len(exact))
    sweeps = ThinnedSweeps(dataset, OdometryParameters(), FINE_SAMPLING, FIRST_SWEEPS)
    assert find_other_motion(sweeps, exact) == []
    (found,) = find_other_motion(sweeps, follows)
    assert found.code == "poses-follow-traffic"
    assert re.search(r"moves by 2\.[678] m a sweep, but its poses by 0\.[34] m", found.text)
