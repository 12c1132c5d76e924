"""A rig of five synthetic LiDARs: one in the bumper, four of 120 degrees on the roof."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from docdepth.synthetic import Sensor, sensor
from docdepth.synthetic.sensors import Pattern

ORIGIN = np.array([1.2, 0.0, 1.73])
"""Of the synthetic LiDAR frame in the frame of the vehicle [m]."""

Place = tuple[float, float, float]

ROOF = {0: (0.8, 0.0, 0.2), 75: (0.4, 0.6, 0.2), -75: (0.4, -0.6, 0.2), 180: (-0.6, 0.0, 0.2)}
BUMPER = (2.3, 0.0, -1.1)


def rig(columns: int) -> list[tuple[Place, Sensor]]:
    """The LiDARs in the order of the merged cloud, with their places."""
    around = np.linspace(-180, 180, 3 * columns // 4, endpoint=False)
    lidars = [
        (BUMPER, _lidar(BUMPER, *np.meshgrid(around, np.linspace(12, -22, 12), indexing="ij")))
    ]
    for yaw, place in ROOF.items():
        ahead = yaw + np.linspace(-60, 60, columns // 3)
        elevation, azimuth = np.meshgrid(np.linspace(10, -15, 40), ahead, indexing="ij")
        lidars.append((place, _lidar(place, azimuth, elevation)))
    return lidars


def _lidar(place: Place, azimuth: np.ndarray, elevation: np.ndarray) -> Sensor:
    """A LiDAR whose rays begin at ``place`` and whose points are in the synthetic LiDAR frame."""
    a, e = np.radians(azimuth.ravel()), np.radians(elevation.ravel())
    directions = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], axis=1)
    none = np.zeros(len(a), np.int64)
    origins = np.broadcast_to(np.array(place), directions.shape)
    pattern = Pattern(directions, np.zeros(1), none, none, origins)
    return replace(sensor("XT-32"), pattern=lambda index: pattern, spins=False)
