"""Results that cannot be right are found; those that are right are not."""

from __future__ import annotations

import numpy as np
import pytest

from docdepth.diagnostics.sweeps import find_lonely_returns
from docdepth.dynamics.classes import count_classes, find_unlikely_classes
from docdepth.geometry.points import evenly
from docdepth.odometry.sweeps import lidar_frame
from docdepth.pipeline.depth_files import find_empty_maps


def _hall(height: float = 0.0) -> np.ndarray:
    """A sweep of 32 rings inside a hall of 30 x 20 m, seen ``height`` above its origin."""
    azimuth, elevation = np.meshgrid(
        np.radians(np.arange(0, 360, 0.5)), np.radians(np.linspace(-25, 10, 32))
    )
    across = 1 / np.maximum(np.abs(np.cos(azimuth)) / 15, np.abs(np.sin(azimuth)) / 10)
    down = np.where(elevation < 0, 1.9 / np.maximum(-np.tan(elevation), 1e-9), np.inf)
    near = np.minimum(across, down)
    rows = near * np.cos(azimuth), near * np.sin(azimuth), near * np.tan(elevation) + height
    return np.stack(rows, axis=-1).reshape(-1, 3).astype(np.float32)


@pytest.mark.parametrize(("height", "wrong"), [(0.0, False), (1.9, True)])
def test_points_that_were_not_seen_from_their_origin(height, wrong):
    # In the vehicle's frame rings overlap; a wall of its own keeps each ring's place uncertain.
    points = _hall(height)
    points += np.random.default_rng(0).normal(0, 0.02, points.shape).astype(np.float32)
    if wrong:  # and merged with another LiDAR beside it
        points = np.concatenate([points, points[:, [1, 0, 2]] + np.float32([3, 1, -1.2])])
    found = find_lonely_returns(lambda _: lidar_frame(points, np.float32(1)), 9)
    assert [f.code for f in found] == ["lonely-returns"] * wrong


@pytest.mark.parametrize(
    ("count", "codes"),
    [
        ((1000, 400, 30), []),
        ((1000, 3, 30), ["no-ground"]),
        ((1000, 400, 400), ["much-dynamic"]),
        ((0, 0, 0), []),
    ],
)
def test_classes_that_cannot_be(count, codes):
    assert [found.code for found in find_unlikely_classes(np.multiply(count, 20))] == codes


def test_classes_are_counted():
    classid = np.array([0, 0, 50, 100, 100, 100], np.uint16)
    assert count_classes(classid).tolist() == [6, 2, 3]


@pytest.mark.parametrize(("coverage", "warned"), [([0.6, 0.7], 0), ([0.01, 0.0, 0.02], 1), ([], 0)])
def test_maps_that_are_all_but_empty(coverage, warned):
    found = find_empty_maps(coverage, "image_02")
    assert [f.code for f in found] == ["empty-maps"] * warned
    assert all("only 1.0 % of the pixels of image_02" in f.text for f in found)


@pytest.mark.parametrize(("count", "most", "chosen"), [(3, 5, [0, 1, 2]), (100, 3, [0, 49, 99])])
def test_samples_are_spread(count, most, chosen):
    assert evenly(count, most) == chosen
