"""LiDAR models: scan pattern, firing times, noise and dropout of each sensor."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets import kitti_lidar
from docdepth.errors import InputError

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Pattern:
    """The rays of one sweep."""

    directions: Floats  # (N, 3): unit vectors in the LiDAR frame
    # (m,): distinct firing times after the stamp, as shares of a sweep, -0.5..0.5
    relative_times: Floats
    which: NDArray[np.int64]  # (N,): index into ``relative_times`` for each ray
    rings: NDArray[np.int64]  # (N,): index of the laser
    # (N, 3): LiDAR frame [m]; None = all rays start at the origin
    ray_origins: Floats | None = None


@dataclass(frozen=True)
class Sensor:
    """A LiDAR."""

    name: str
    pattern: Callable[[int], Pattern]  # gives the rays of sweep ``k``
    # range at which half of the pulses return from a surface of reflectivity 0.1 at normal
    # incidence [m]; determines dropout
    reach: float
    # min_range, max_range: limits of the measured range [m]
    min_range: float
    max_range: float
    noise: float  # standard deviation of range [m]
    bias: float = 0.0  # standard deviation of the constant range error of each laser [m]
    period: float = 0.1  # duration of a sweep [s]
    height: float = 1.73  # height above the ground [m]
    spins: bool = True  # the azimuth of a return tells its time
    beam_width: float = 0.0  # full angle of a beam [rad]; 0 = each beam is a line
    # ghost returns appear around retro-reflectors, up to this angle from them [rad]
    blooming: float = 0.0

    def returned(
        self,
        distance: Floats,
        reflectivity: NDArray[np.float32],
        cosine: NDArray[np.float32],
        rng: np.random.Generator,
    ) -> NDArray[np.bool_]:
        """Which pulses return: weak echoes drop out more often.

        Rough surfaces reflect more at grazing angles than Lambert's law predicts. The square root
        of the cosine keeps the road visible as far as in real sweeps.
        """
        with np.errstate(divide="ignore", invalid="ignore"):
            power = reflectivity / 0.1 * np.sqrt(np.maximum(cosine, 1e-3))
            power = power * (self.reach / distance) ** 2
            chance = power**2 / (1.0 + power**2)
        in_range = (distance >= self.min_range) & (distance <= self.max_range)
        # Half a percent drops out whatever the echo.
        return in_range & (rng.random(len(distance)) < 0.995 * chance)


def _spinning(
    elevations: Floats, columns: int, offsets: Floats | None = None
) -> Callable[[int], Pattern]:
    """A spinning LiDAR: clockwise from above, seam at the back, forward at the stamp.

    ``offsets`` are the azimuth offsets of the lasers [rad].
    """
    rings = len(elevations)
    relative_times = (np.arange(columns) + 0.5) / columns - 0.5
    azimuth = -2.0 * np.pi * relative_times[None] + (0.0 if offsets is None else offsets[:, None])
    azimuth = np.broadcast_to(azimuth, (rings, columns)).ravel()
    directions = _directions(azimuth, np.repeat(elevations, columns))
    which, ring = np.tile(np.arange(columns), rings), np.repeat(np.arange(rings), columns)
    pattern = Pattern(directions, relative_times, which, ring)
    return lambda index: pattern


def _avia(index: int) -> Pattern:
    """A rosette scan that never repeats, drawn by two counter-rotating prisms (Livox).

    The prisms turn at 7294 and -4664 rpm, as measured on Livox's first units.
    """
    moments, lasers = 4000, 6
    relative_times = (np.arange(moments) + 0.5) / moments - 0.5
    seconds = 0.1 * (index + relative_times)
    first = 2 * np.pi * 7294.0 / 60.0 * seconds
    second = -2 * np.pi * 4664.0 / 60.0 * seconds
    x = 0.5 * (np.cos(first) + np.cos(second))
    y = 0.5 * (np.sin(first) + np.sin(second))
    # The lasers stand side by side; each draws the same rosette with a small offset.
    spread = np.radians(1.2) * (np.arange(lasers) - 0.5 * (lasers - 1)) / lasers
    azimuth = (np.radians(35.2) * x[:, None] + spread).ravel()
    elevation = (np.radians(38.6) * y[:, None] + 0.7 * spread).ravel()
    which, ring = np.repeat(np.arange(moments), lasers), np.tile(np.arange(lasers), moments)
    return Pattern(_directions(azimuth, elevation), relative_times, which, ring)


def _directions(azimuth: Floats, elevation: Floats) -> Floats:
    level = np.cos(elevation)
    rays = [level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)]
    return np.stack(rays, axis=1)


def _hdl64() -> Callable[[int], Pattern]:
    """KITTI's HDL-64E: two blocks of lasers, one above the other, of two columns each."""
    # The lasers of a column do not lie in one plane: each has a fixed azimuth offset.
    offsets = np.radians(np.random.default_rng(64).uniform(-0.4, 0.4, 64))
    pattern = _spinning(np.arctan(kitti_lidar.SLOPES), 2083, offsets)(0)
    along = pattern.directions[:, :2] / np.hypot(*pattern.directions.T[:2])[:, None]
    lateral, up = kitti_lidar.LATERAL_OFFSETS[pattern.rings], kitti_lidar.HEIGHTS[pattern.rings]
    ray_origins = np.column_stack([-lateral * along[:, 1], lateral * along[:, 0], up])
    pattern = replace(pattern, ray_origins=ray_origins)
    return lambda index: pattern


def _even(top: float, bottom: float, rings: int, columns: int) -> Callable[[int], Pattern]:
    """A spinning LiDAR whose lasers are evenly spaced between two elevations [deg]."""
    return _spinning(np.radians(np.linspace(top, bottom, rings)), columns)


def _pandar40p() -> Callable[[int], Pattern]:
    """Hesai's Pandar40P: 0.33 degrees from ring to ring ahead, 1 to 6 above and below."""
    middle, below = np.linspace(2.0, -6.0, 25), np.arange(-7.0, -15.0, -1.0)
    elevations = np.concatenate([[15.0, 11.0, 8.0, 5.0, 3.0], middle, below, [-19.0, -25.0]])
    return _spinning(np.radians(elevations), 3600)


def sensors() -> dict[str, Callable[[], Sensor]]:
    """Constructors of all sensors by name."""
    return {
        "HDL-64": lambda: Sensor("HDL-64", _hdl64(), 62.0, 0.9, 120.0, 0.015, bias=0.008),
        "OS1-128": lambda: Sensor(
            "OS1-128", _even(22.5, -22.5, 128, 1024), 60.0, 0.5, 120.0, 0.015
        ),
        "XT-32": lambda: Sensor("XT-32", _even(15.0, -16.0, 32, 2000), 80.0, 0.3, 120.0, 0.008),
        # At 5 Hz, half of the usual rate: traffic goes twice as far from sweep to sweep.
        "Pandar40P": lambda: Sensor("Pandar40P", _pandar40p(), 80.0, 0.3, 200.0, 0.015, period=0.2),
        "VLP-16": lambda: Sensor("VLP-16", _even(15.0, -15.0, 16, 1800), 50.0, 0.5, 100.0, 0.015),
        "Avia": lambda: Sensor("Avia", _avia, 100.0, 1.0, 190.0, 0.02, spins=False),
    }


def sensor(name: str) -> Sensor:
    """A LiDAR model.

    Parameters
    ----------
    name : {"HDL-64", "OS1-128", "XT-32", "Pandar40P", "VLP-16", "Avia"}
    """
    known = sensors()
    if name not in known:
        raise InputError(f"unknown sensor {name!r}; there are {', '.join(known)}")
    return known[name]()
