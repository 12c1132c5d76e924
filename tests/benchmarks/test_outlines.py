"""Where outlines of depth maps lie beside the edges of images, from benchmarks/."""

import cv2
import numpy as np
import pytest
from outlines import Silhouette, change_of, offsets, silhouettes

from docdepth.geometry.lidar_frame import LidarFrame
from docdepth.synthetic import Drive, scene, sensor

NEAR, FAR = 8.0, 20.0


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("fat", [-2.5, 0.0, 1.25])
def test_the_distance_to_the_edge_of_the_image(side: int, fat: float) -> None:
    """Of a leaning outline, which is so many pixels too far out."""
    rows = np.arange(60)
    edge = 50.3 + 0.4 * rows  # of the image, seen sixteen times as fine
    fine = np.arange(16 * 120) / 16 - 0.5 + 1 / 32
    image = np.where(side * (fine[None] - edge[:, None]) < 0, 60.0, 160.0)
    image = image.reshape(60, 120, 16).mean(axis=2) + np.random.default_rng(0).normal(
        0, 2, (60, 120)
    )
    outline = edge + side * fat
    depth = np.where(side * (np.arange(120)[None] - outline[:, None]) < 0, NEAR, FAR)
    pixels = np.stack([outline + 2.0, rows], axis=1)[5:55:7]
    points = np.full((len(pixels), 3), NEAR / np.sqrt(3))
    one = Silhouette(points, np.zeros(len(pixels), np.int64), side)
    change = change_of(np.repeat(image.clip(0, 255).astype(np.uint8)[..., None], 3, axis=2))
    found = offsets(pixels, one, depth.astype(np.float32), change)
    assert np.isfinite(found).mean() > 0.9
    assert np.nanmedian(found) == pytest.approx(fat, abs=0.1)


def test_two_edges_tell_nothing() -> None:
    image = np.full((60, 120, 3), 60, np.uint8)
    image[:, 50:54] = 160  # a post: both sides are equally strong
    depth = np.where(np.arange(120) < 50, NEAR, FAR)[None].repeat(60, axis=0).astype(np.float32)
    pixels = np.stack([np.full(8, 49.0), np.arange(5.0, 60, 7)], axis=1)
    points = np.full((8, 3), NEAR / np.sqrt(3))
    one = Silhouette(points, np.zeros(8, np.int64), 1)
    found = offsets(pixels, one, depth, change_of(cv2.GaussianBlur(image, (0, 0), 0.5)))
    assert np.isnan(found).all()


def test_silhouettes_are_sides_of_objects() -> None:
    """Along each, the range jumps from ring to ring at the same place."""
    drive = Drive(scene("city", 3), sensor("HDL-64"), 2, 3, skew=True)
    sweep = drive.sweep(0)
    count = len(sweep.points)
    frame = LidarFrame(sweep.points, np.arange(count, dtype=np.uint32), "0", count)
    found = silhouettes(frame)
    assert len(found) > 20
    for one in found:
        azimuth = np.arctan2(one.points[:, 1], one.points[:, 0])
        assert len(one.points) >= 4
        assert np.abs(np.diff(azimuth)).max() < 0.01
        assert np.all(np.diff(sweep.ring[one.rows]) == 1)
