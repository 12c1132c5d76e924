"""Protocols for cleaned maps against plain loops, from benchmarks/."""

from __future__ import annotations

import math

import numpy as np
import pytest
from peer_maps import compare_map, nearest_neighbor_protocol, voxel_protocol

from docdepth.evaluation import LabelCounts


def test_nearest_neighbor_protocol_equals_brute_force() -> None:
    random = np.random.default_rng(2)
    points = random.uniform(0, 2, (400, 3)).astype(np.float32)
    dynamic = random.random(400) < 0.4
    cleaned = np.vstack([points[::3] + np.float32(0.02), random.uniform(-90, 90, (50, 3))])
    cleaned = cleaned.astype(np.float32)
    away = np.linalg.norm(points[:, None].astype(float) - cleaned[None].astype(float), axis=2)
    expected = LabelCounts.of(dynamic, away.min(axis=1) > 0.05)
    assert nearest_neighbor_protocol(points, dynamic, cleaned) == expected
    assert 0 < expected.static_lost < expected.static


def test_an_empty_cleaned_map_keeps_nothing() -> None:
    points = np.zeros((4, 3), np.float32)
    counts = nearest_neighbor_protocol(points, np.array([True, True, False, False]), points[:0])
    assert (counts.da, counts.sa) == (100.0, 0.0)


def voxels_by_hand(points: np.ndarray, dynamic: np.ndarray, size: float) -> list:
    members: dict[tuple, list[int]] = {}
    for k, point in enumerate(points.astype(float)):
        members.setdefault(tuple(np.floor(point / size)), []).append(k)
    voxels = []
    for index in members.values():
        inside = points[index].astype(float)
        centre = inside.mean(axis=0)
        nearest = int(np.argmin(((inside - centre) ** 2).sum(axis=1)))
        voxels.append((centre, bool(dynamic[index[nearest]])))
    return voxels


def test_voxel_protocol_equals_brute_force() -> None:
    random = np.random.default_rng(3)
    points = random.uniform(-2, 2, (3000, 3)).astype(np.float32)
    dynamic = points[:, 0] + random.normal(0, 0.3, 3000) > 0.5
    kept = random.random(3000) < np.where(dynamic, 0.2, 0.8)
    truth = voxels_by_hand(points, dynamic, 0.2)
    left = voxels_by_hand(points[kept], dynamic[kept], 0.2)
    centres = np.array([centre for centre, _ in left])
    preserved = remaining = 0
    for centre, is_dynamic in truth:
        away = np.linalg.norm(centres - centre, axis=1)
        same = away.min() < 0.2 * math.sqrt(3) / 2 and left[int(away.argmin())][1] == is_dynamic
        preserved += same and not is_dynamic
        remaining += same and is_dynamic
    result = voxel_protocol(points, dynamic, kept)
    total = sum(is_dynamic for _, is_dynamic in truth)
    assert (result.static, result.dynamic) == (len(truth) - total, total)
    assert result.sa == pytest.approx(100 * preserved / (len(truth) - total))
    assert result.da == pytest.approx(100 * (total - remaining) / total)


def test_a_map_of_several_sweeps() -> None:
    """Untouched it preserves everything; a removed point beside a kept one counts as kept."""
    random = np.random.default_rng(4)
    points = random.uniform(-20, 20, (3, 5000, 3)).astype(np.float32)
    labels = np.where(random.random((3, 5000)) < 0.1, 251, 9).astype(np.uint32)
    pairs = zip(points, labels, strict=True)
    for counts in compare_map((p, truth, np.zeros(5000, bool)) for p, truth in pairs):
        assert (counts.sa, counts.da) == (100.0, 0.0)
    three = np.array([[0, 0, 0], [0.04, 0, 0], [5, 0, 0]], np.float32)
    truth, removed = np.array([9, 251, 251], np.uint32), np.array([False, True, True])
    nearest, _ = compare_map([(three, truth, removed)])
    assert (nearest.dynamic_missed, nearest.dynamic_found) == (1, 1)
