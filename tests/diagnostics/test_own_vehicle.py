"""The own vehicle is what stays in its place of the LiDAR's frame, to centimetres, on the way."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from types import SimpleNamespace

import numpy as np
import pytest

from docdepth.datasets import Sweep
from docdepth.diagnostics.own_vehicle import (
    OwnVehicle,
    _staying,
    find_own_vehicle,
    in_boxes,
    sweeps_on_the_way,
    vehicle_of,
)
from docdepth.geometry.ground_plane import GroundPlane
from docdepth.geometry.se3 import se3_exp
from exact_drive import Drive

COUNT = 14
_STREET = Drive(COUNT, se3_exp(np.array([0, 0, 0.004]), np.array([1.1, 0, 0])))
HEIGHT = 1.8
GROUND = GroundPlane(np.array([0.0, 0, 1]), HEIGHT, 0.5, 0.5)
LIDAR, AHEAD = np.zeros((1, 3)), np.array([1.0, 0, 0])

BONNET = [[1.5, 2.2], [-0.8, 0.8], [-0.9, -0.8]]
ROOF = [[-2.0, -0.6], [-0.7, 0.7], [-0.5, -0.4]]
TRAILER = [[-6.5, -4.0], [-1.0, 1.0], [-1.2, 0.6]]


def part(box: list[list[float]], count: int = 60, seed: int = 4) -> np.ndarray:
    """Returns of a part of the vehicle."""
    return np.random.default_rng(seed).uniform(*np.array(box).T, (count, 3))


@dataclass
class Carried:
    """The exact drive with further returns in each sweep, as its LiDAR sees its vehicle."""

    own: np.ndarray
    noise: float = 0.01
    stands: bool = False
    lidars: dict = field(default_factory=dict)
    name: str = "exact"
    times: np.ndarray = field(default_factory=lambda: _STREET.times)

    def __post_init__(self) -> None:
        self.read: list[int] = []

    def __len__(self) -> int:
        return COUNT

    def sweep(self, index: int) -> Sweep:
        self.read.append(index)
        measured = _STREET.sweep(0 if self.stands else index)
        rng = np.random.default_rng(index)
        own = self.own + rng.normal(0, self.noise, self.own.shape)
        points = np.concatenate([measured.points, own]).astype(np.float32)
        return replace(measured, points=points, relative_time=None)


def lidars(*places: list[float]) -> dict:
    poses = [np.eye(4) for _ in places]
    for T, place in zip(poses, places, strict=True):
        T[:3, 3] = place
    return {str(k): SimpleNamespace(T_lidar_sensor=T) for k, T in enumerate(poses)}


def check_found(found: OwnVehicle | None, own: np.ndarray, parts: int) -> None:
    assert found is not None
    assert len(found.boxes) == parts
    assert in_boxes(own, found.boxes).all()
    low, high = np.array(found.boxes).min(axis=(0, 2)), np.array(found.boxes).max(axis=(0, 2))
    assert (np.abs([low - own.min(axis=0), high - own.max(axis=0)]) < 0.2).all()
    assert abs(found.returns - len(own)) <= 1


def test_roof_bonnet_and_trailer() -> None:
    own = np.concatenate([part(box) for box in (BONNET, ROOF, TRAILER)])
    recording = Carried(own)
    found = find_own_vehicle(recording)
    check_found(found, own, parts=3)
    assert not found.mirrored
    np.testing.assert_allclose(found.reach, np.linalg.norm(own, axis=1).max(), atol=0.1)
    assert len(recording.read) <= 20


def test_a_trailer_far_behind_one_lidar_and_near_another() -> None:
    far = part([[-13.0, -12.0], [-1.0, 1.0], [-1.2, 0.6]])
    assert find_own_vehicle(Carried(far)) is None
    check_found(find_own_vehicle(Carried(far, lidars=lidars([0, 0, 0], [-9, 0, 0]))), far, parts=1)


@pytest.mark.parametrize(
    "recording",
    [
        Carried(np.zeros((0, 3))),
        Carried(part(BONNET), stands=True),
        # A car that drives at the same speed, and an own part that swings, keep no place.
        Carried(part(TRAILER, 300), noise=0.15),
        Carried(part(BONNET, 3)),
    ],
    ids=["nothing", "standing", "traffic", "too few returns"],
)
def test_what_is_not_found(recording: Carried) -> None:
    assert find_own_vehicle(recording) is None


def test_mirror_images_below_the_ground() -> None:
    bonnet = part(BONNET)
    both = np.concatenate([bonnet, bonnet * [1, 1, 0] - [0, 0, 3.0]])
    found = find_own_vehicle(Carried(both))
    check_found(found, both, parts=2)
    assert found.mirrored


def clouds_with(*seen: Callable[[int], np.ndarray]) -> list[np.ndarray]:
    """Eight sweeps of scattered posts that go by, and what ``seen(k)`` shows besides."""
    rng = np.random.default_rng(1)
    clouds = []
    for k in range(8):
        posts = rng.uniform([-15, -15, -1.4], [15, 15, 1], (8000, 3))
        clouds.append(np.concatenate([posts, *(show(k) for show in seen)]).astype(np.float32))
    return clouds


def test_a_rail_along_a_straight_way_is_no_vehicle() -> None:
    """It stays to centimetres, but has no end within reach."""
    x = np.arange(-15, 15, 0.1)
    rail = np.stack([x, np.full(len(x), 2.5), np.full(len(x), -1.0)], axis=1)
    own = part(BONNET)
    check_found(
        vehicle_of(clouds_with(lambda k: own, lambda k: rail), GROUND, LIDAR, AHEAD), own, parts=1
    )


def test_few_returns_of_a_follower_stay_by_chance() -> None:
    """Their places are taken again and again; those around them are not."""
    rng = np.random.default_rng(2)

    def follower(k: int) -> np.ndarray:
        moved = rng.uniform([-9, 1, -1.4], [-7, 2.6, 0], (300, 3))
        return np.concatenate([moved, np.tile([-8.0, 1.8, -0.7], (2, 1))])

    own = part(BONNET)
    check_found(
        vehicle_of(clouds_with(lambda k: own, follower), GROUND, LIDAR, AHEAD), own, parts=1
    )


def test_a_world_that_does_not_go_by() -> None:
    cloud = clouds_with(lambda k: part(BONNET))[0]
    assert vehicle_of([cloud] * 8, GROUND, LIDAR, AHEAD) is None


def test_sweeps_count_that_are_apart_on_the_way() -> None:
    times = np.arange(10.0)
    assert sweeps_on_the_way(times, np.full(10, 2.0)) == list(range(10))
    assert sweeps_on_the_way(times, np.full(10, 1.15)) == list(range(10))
    assert sweeps_on_the_way(times, np.full(10, 1.05)) == []  # 9.5 m are too short
    assert sweeps_on_the_way(times, np.zeros(10)) == []
    # One wrong motion of a vehicle that stands is no way; nor is a start.
    assert sweeps_on_the_way(times, np.eye(10)[4] * 30) == []
    assert sweeps_on_the_way(times, np.repeat([0.0, 3.0], 5)) == []
    stop = np.array([3.0, 3, 3, 3, 0, 0, 3, 3, 3, 3])
    assert sweeps_on_the_way(times, stop) == [0, 1, 2, 3, 7, 8, 9]


@pytest.mark.parametrize(("within", "share"), [(0.05, 0.8), (0.3, 0.5)])
def test_staying_is_that_of_plain_numpy(within: float, share: float) -> None:
    rng = np.random.default_rng(3)
    steady = rng.uniform(-1, 1, (40, 3))
    clouds = [
        np.concatenate([steady + rng.normal(0, 0.03, (40, 3)), rng.uniform(-1, 1, (60, 3))])
        .astype(np.float32)[: 100 if k else 0]
        for k in range(7)
    ]  # fmt: skip
    for k, found in enumerate(_staying(clouds, clouds, within, share)):
        others = [cloud.astype(np.float64) for j, cloud in enumerate(clouds) if j != k]
        near = [
            (np.linalg.norm(clouds[k][:, None] - cloud, axis=2) <= within).any(axis=1)
            for cloud in others
        ]
        np.testing.assert_array_equal(found, np.mean(near, axis=0) >= share)
