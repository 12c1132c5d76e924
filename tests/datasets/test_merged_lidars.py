"""Clouds of several LiDARs without numbers, against those told apart."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("embreex")
import lidar_rig as rigs

from docdepth.datasets import Sweep
from docdepth.datasets.merged_lidars import (
    _in_order,
    find_lidars,
    find_stretches,
    lidar_ends,
    rig_in_order,
)
from docdepth.datasets.sensor_pose import LevelledRecording, estimate_sensor_origin
from docdepth.geometry.lidar_frame import SensorRig
from docdepth.geometry.scan_mesh import share_in_triangles
from docdepth.synthetic import Drive, scene


@pytest.fixture(scope="module")
def cloud() -> tuple[np.ndarray, np.ndarray, list[tuple[float, float, float]]]:
    """Points in the frame of the vehicle, where the returns of each LiDAR end, and their places."""
    lidars = rigs.rig(columns=900)
    drives = [Drive(scene("crossing", 91), own, 3, 5 + k) for k, (_, own) in enumerate(lidars)]
    points = [drive.sweep(1).points for drive in drives]
    places = [tuple((np.array(place) + rigs.ORIGIN).tolist()) for place, _ in lidars]
    together = np.concatenate(points) + rigs.ORIGIN.astype(np.float32)
    return together, np.cumsum([len(own) for own in points]), places


@pytest.mark.slow
def test_returns_are_given_to_their_lidars(cloud) -> None:
    """Two that see no common place need not be told apart, but the returns of most are right."""
    points, ends, places = cloud
    found = lidar_ends(points, places)
    assert found[-1] == len(points)
    assert (np.diff(found) > 0).all()
    true = np.searchsorted(ends, np.arange(len(points)), side="right")
    ours = rig_in_order(places, found).index
    assert np.mean(ours == true) > 0.9
    whole = share_in_triangles(points, SensorRig.single(places[1], len(points)))
    own = share_in_triangles(points, rig_in_order(places, ends))
    told = share_in_triangles(points, rig_in_order(places, found))
    assert told > own - 0.003 > whole + 0.01


@pytest.mark.nightly
def test_a_lidar_in_the_bumper_is_told_from_those_on_the_roof(cloud) -> None:
    points, ends, places = cloud
    blocks = np.linspace(0, len(points), 33).astype(int).tolist()
    first, *others = find_stretches(points, places[2], blocks)
    assert others
    assert abs(first.end - ends[0]) < len(points) / 32, "to a block"
    assert first.place[2] < 1 < min(stretch.place[2] for stretch in others)
    found = find_lidars([points, points[1:]], places[2])
    assert found[0] == first.place
    assert len(found) == len(others) + 1


class Recording:
    """Two sweeps of the same cloud, of which the second lacks a point."""

    name, path, poses, cameras, lidars = "made", Path("made"), None, {}, {}
    times = np.arange(2) * 10**8

    def __init__(self, points: np.ndarray) -> None:
        self.points = points

    def __len__(self) -> int:
        return 2

    def sweep(self, index: int) -> Sweep:
        return Sweep(self.points[index:], f"{index}", int(self.times[index]))


@pytest.mark.slow
@pytest.mark.parametrize("lidar", [0, 2])
def test_a_single_lidar_is_one(cloud, lidar) -> None:
    points, ends, places = cloud
    own = points[np.append(0, ends)[lidar] : ends[lidar]]
    found = estimate_sensor_origin(Recording(own))
    assert found is None or len(found.places) == 1
    shifted = own - np.array(places[lidar], np.float32)
    assert estimate_sensor_origin(Recording(shifted)) is None, "seen from where it is"


@pytest.mark.nightly
def test_a_recording_has_the_rig_that_was_found(cloud) -> None:
    points, _, places = cloud
    mounted = LevelledRecording(Recording(points), sensor_origin=places)
    for index in (1, 0, 1):
        rig = mounted.sweep(index).sensor_rig
        np.testing.assert_array_equal(rig.T_lidar_sensor[:, :3, 3], places)
        ends = lidar_ends(points[index:], places)
        np.testing.assert_array_equal(rig.index, rig_in_order(places, ends).index)
    found = estimate_sensor_origin(Recording(points))
    assert found is not None
    assert found.share > 0.9 > found.at_origin
    assert np.abs(np.array(found.places) - np.mean(places, axis=0)).max() < 2.5


def test_the_order_of_blocks_is_the_best_of_all() -> None:
    random = np.random.default_rng(4)
    for _ in range(30):
        counts = random.integers(0, 9, (6, 3)).astype(float)
        rows = np.arange(6)
        orders = itertools.combinations_with_replacement(range(3), 6)
        best = max(counts[rows, list(order)].sum() for order in orders)
        ours = _in_order(counts)
        assert (np.diff(ours) >= 0).all()
        assert counts[rows, ours].sum() == best
