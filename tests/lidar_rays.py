"""Rays of a spinning LiDAR, and their directions as the core counts them."""

import numpy as np

TURN = 65536


def scan_rays(elevations, azimuths):
    """Unit directions, ring by ring: (elevations, azimuths, 3). Angles in radians."""
    a, e = np.meshgrid(azimuths, elevations)
    return np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], -1)


def directions(points):
    """Azimuth and elevation in 65536ths of a turn."""
    x, y, z = points.T
    azimuth, elevation = (
        np.floor(angle * (np.float32(1) / np.float32(2 * np.pi / TURN)) + np.float32(0.5))
        for angle in (atan2_fixed(y, x), atan2_fixed(z, np.sqrt(x * x + y * y)))
    )
    azimuth = azimuth.astype(np.int64)
    return np.where(azimuth >= TURN // 2, azimuth - TURN, azimuth), elevation.astype(np.int64)


def atan2_fixed(y, x):
    """Abramowitz and Stegun 4.4.49 in float32, one rounded operation at a time."""
    f = np.float32
    ax, ay = np.abs(x), np.abs(y)
    low, high = np.minimum(ax, ay), np.maximum(ax, ay)
    t = np.where(high > 0, low / np.where(high > 0, high, f(1)), f(0))
    s = t * t
    series = f(0.0028662257)
    for coefficient in (-0.0161657367, 0.0429096138, -0.0752896400, 0.1065626393, -0.1420889944,
                        0.1999355085, -0.3333314528):  # fmt: skip
        series = series * s + f(coefficient)
    angle = t + (series * s) * t
    angle = np.where(ay > ax, f(1.57079632679) - angle, angle)
    angle = np.where(x < 0, f(3.14159265359) - angle, angle)
    return np.where(y < 0, -angle, angle)
