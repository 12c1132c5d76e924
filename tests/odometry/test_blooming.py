"""Ghost returns around retro-reflectors in exact scenes, where the source of each is known."""

from dataclasses import replace

import numpy as np
import pytest
import scenes  # noqa: F401  adds its scenes

from docdepth.config import parameters
from docdepth.datasets import open_dataset
from docdepth.errors import ConfigError
from docdepth.io.run_folder import RunFolder
from docdepth.odometry.blooming import blooming_points
from docdepth.pipeline import run_classify, run_odometry
from docdepth.synthetic import write_drive

BLOOMING_DEG = 0.8


def sweep_of(things):
    """Rays 0.1 degrees apart; each meets the first thing (name, range, inside(y, z)) it passes."""
    azimuth, elevation = np.meshgrid(
        np.radians(np.arange(-8, 8, 0.1)), np.radians(np.arange(-4, 4, 0.1))
    )
    azimuth, elevation = azimuth.ravel(), elevation.ravel()
    x = np.full(azimuth.shape, 60.0)
    names = np.full(azimuth.shape, "background")
    for name, distance, inside in reversed(things):
        y, z = distance * np.tan(azimuth), distance * np.tan(elevation) / np.cos(azimuth)
        met = inside(y, z)
        x[met], names[met] = distance, name
    points = np.stack([x, x * np.tan(azimuth), x * np.tan(elevation) / np.cos(azimuth)], axis=1)
    intensity = np.where(names == "reflector", 1.0, 0.3)
    return points.astype(np.float32), intensity.astype(np.float32), names


def disc(y, z, radius):
    return lambda a, b: (a - y) ** 2 + (b - z) ** 2 < radius**2


def box(y, z, width, height):
    return lambda a, b: (np.abs(a - y) < width / 2) & (np.abs(b - z) < height / 2)


def test_a_halo_is_ghosts_but_neither_post_nor_wall_nor_car():
    bloom = 20 * np.radians(BLOOMING_DEG)
    points, intensity, names = sweep_of(
        [
            ("reflector", 20.0, disc(0, 0.3, 0.35)),
            ("post", 20.0, box(0, -1, 0.2, 2)),
            ("halo", 20.0, disc(0, 0.3, 0.35 + bloom)),
            ("reflector", 25.0, disc(-2.5, 0, 0.35)),
            ("wall", 25.0, box(-2.5, 0, 2.0, 8)),
            ("reflector", 18.0, box(1.6, -0.2, 0.4, 0.2)),
            ("car", 18.0, box(1.6, -0.2, 1.7, 1.4)),
        ]
    )
    ghost = blooming_points(points, intensity, BLOOMING_DEG)
    share = {name: ghost[names == name].mean() for name in set(names)}
    assert share["halo"] > 0.8
    assert not any(share[name] for name in ("background", "reflector", "wall", "car"))
    assert share["post"] < 0.35  # but for what hides between two halves of the halo


@pytest.mark.parametrize("scale", [1, 255, 65535])
def test_scales_of_intensity(scale):
    bloom = 20 * np.radians(BLOOMING_DEG)
    points, intensity, names = sweep_of(
        [("reflector", 20.0, disc(0, 0, 0.35)), ("halo", 20.0, disc(0, 0, 0.35 + bloom))]
    )
    points[:3] = [[np.nan, 0, 0], [0, 0, 0], [0, np.inf, 0]]
    intensity[:3] = np.nan
    ghost = blooming_points(points, intensity * scale, BLOOMING_DEG)
    assert ghost[names == "halo"].mean() > 0.9
    assert not ghost[names != "halo"].any()
    assert not blooming_points(points, np.minimum(intensity, 0.5) * scale, BLOOMING_DEG).any()


def test_ghost_returns_take_no_part_in_a_run(tmp_path):
    folder = write_drive(tmp_path, frames=3, seed=3, blooming_deg=BLOOMING_DEG, images=False)
    settings = {"odometry.blooming_deg": BLOOMING_DEG, "dynamics.time_spacing": 0}
    dataset = open_dataset(folder)
    run = RunFolder.create(tmp_path / "run", None, parameters("default", settings))
    run_odometry(run, dataset, dataset.poses)
    run_classify(run)
    for k in range(3):
        sweep = dataset.sweep(k)
        ghost = blooming_points(sweep.points, sweep.intensity, BLOOMING_DEG)
        np.testing.assert_array_equal(run.frame(k).index, np.flatnonzero(~ghost))
        labels = np.fromfile(run.path / "labels" / f"{sweep.name}.label", np.uint32)
        np.testing.assert_array_equal(labels == 1, ghost)
    assert ghost.any()

    dataset.sweep = lambda k: replace(sweep, intensity=None)
    other = RunFolder.create(tmp_path / "other", None, parameters("default", settings))
    with pytest.raises(ConfigError, match="no intensity"):
        run_odometry(other, dataset, dataset.poses)
