"""Beams that are wider than a line, against a plain implementation and simple geometry."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from plain_scene import plain_scene

from docdepth import synthetic
from docdepth.datasets import open_dataset
from docdepth.synthetic import Drive, Paint, box, write_drive
from docdepth.synthetic.sensors import Pattern

pytest.importorskip("embreex")

WALL, PLATE = Paint(50, (0.5, 0.5, 0.5), 0.5), Paint(80, (0.5, 0.5, 0.5), 0.7)
WIDTH, PULSE = np.radians(0.3), 0.45
HALF, FRONT = np.array((0.5, 0.4)), 20.0  # of the plate, which stands at x = 20 m
HEIGHT = 1.73


def dense(index):
    """Beams 0.02 degrees apart towards the plate."""
    y, z = (axis.ravel() for axis in np.meshgrid(*[np.radians(np.arange(-1.6, 1.6, 0.02))] * 2))
    directions = np.column_stack([np.ones(len(y)), np.tan(y), np.tan(z)])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    nothing = np.zeros(len(y), np.int64)
    return Pattern(directions, np.zeros(1), nothing, nothing)


def sweep_of_plate(gap, **changes):
    """A plate ``gap`` metres before a wall, seen by a sensor that measures exactly."""
    sensor = replace(synthetic.sensor("OS1-128"), pattern=dense, noise=0.0, reach=1e6, **changes)
    thin = box((0.01, 1.0, 0.8), (FRONT + 0.005, 0.0, HEIGHT), PLATE)
    wall = box((1.0, 60.0, 40.0), (FRONT + gap + 0.5, 0.0, 0.0), WALL)
    return Drive(plain_scene([thin, wall]), sensor, 2).sweep(0)


def range_and_paint(direction, gap):
    """Where a ray from the origin meets the plate or the wall, and its reflectivity."""
    on_plate = np.abs(direction[1:] / direction[0] * FRONT) <= HALF
    if on_plate.all():
        return FRONT / direction[0], 0.7, 80
    return (FRONT + gap) / direction[0], 0.5, 50


def strongest_echo(direction, gap):
    """Range and class of a beam: the middle ray and six around it."""
    side = np.cross(direction, (0, 0, 1.0))
    side /= np.linalg.norm(side)
    up = np.cross(side, direction)
    echoes = []
    for k in range(7):
        out = 0.0 if k == 0 else 0.7 * WIDTH / 2
        angle = k * np.pi / 3
        ray = direction + np.tan(out) * (np.cos(angle) * side + np.sin(angle) * up)
        ray /= np.linalg.norm(ray)
        distance, reflectivity, label = range_and_paint(ray, gap)
        power = (1.0 if k == 0 else np.exp(-2 * 0.7**2)) * reflectivity / distance**2
        echoes.append((distance, power * np.sqrt(ray[0]), label))
    echoes.sort()
    groups = [[echoes[0]]]
    for echo in echoes[1:]:
        if echo[0] - groups[-1][-1][0] > PULSE:
            groups.append([])
        groups[-1].append(echo)
    best = max(groups, key=lambda group: sum(power for _, power, _ in group))
    total = sum(power for _, power, _ in best)
    return sum(d * power for d, power, _ in best) / total, max(best, key=lambda e: e[1])[2]


@pytest.mark.parametrize("gap", [0.2, 8.0])
def test_a_beam_returns_the_mean_of_its_strongest_echo(gap):
    sweep = sweep_of_plate(gap, beam_width=WIDTH)
    directions = dense(0).directions
    assert len(sweep.points) > 0.99 * len(directions)  # half a percent never returns
    points, labels = sweep.points[::5].astype(np.float64), sweep.labels[::5]
    distance = np.linalg.norm(points, axis=1)
    found = [strongest_echo(p / d, gap) for p, d in zip(points, distance, strict=True)]
    expected, of_most = np.array(found).T
    # Where the outline meets one of the seven rays, rounding decides.
    same = np.abs(distance - expected) < 1e-3
    assert same.mean() > 0.998
    assert (labels == of_most)[same].mean() > 0.998


def test_outlines_grow_by_less_than_half_a_beam():
    thin, wide = sweep_of_plate(8.0), sweep_of_plate(8.0, beam_width=WIDTH)
    beyond = []
    for sweep in (thin, wide):
        on_plate = sweep.points[sweep.labels == 80].astype(np.float64)
        assert np.abs(on_plate[:, 0] - FRONT).max() < 1e-3  # 8 m apart: nothing in between
        beyond.append((np.abs(on_plate[:, 1:]) - HALF).max())
    assert beyond[0] < 1e-3
    assert 0.01 < beyond[1] < 0.5 * WIDTH * FRONT


def test_a_written_drive_has_the_width_and_is_made_once(tmp_path):
    folder = write_drive(tmp_path, "city", "VLP-16", 2, images=False, beam_width_deg=0.2)
    assert "beam_width_deg: 0.2" in (folder / "docdepth.yaml").read_text()
    thin = write_drive(tmp_path / "thin", "city", "VLP-16", 2, images=False)
    one, other = (np.fromfile(f / "velodyne/000000.bin", "<f4") for f in (folder, thin))
    assert len(one) != len(other) or (one != other).any()
    assert len(open_dataset(folder)) == 2
