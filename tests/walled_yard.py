"""A scene whose truth is known: a box that goes through a walled yard, and a LiDAR beside it."""

import numpy as np

from lidar_rays import scan_rays

ELEVATIONS, AZIMUTHS = np.arange(-15, 3, 0.4), np.arange(-180, 180, 0.25)
RAYS = scan_rays(np.radians(ELEVATIONS), np.radians(AZIMUTHS)).reshape(-1, 3)


def scan(T_world_lidar, box_x, every=1):
    """A spinning sensor in a walled yard with a box (2 m cube at y = 5) on flat ground.

    Returns points of each ``every``-th ray in the sensor's frame, and what each one hit: 0 ground,
    1 wall, 2 box.
    """
    lidar = RAYS[::every]
    distance, what = cast(T_world_lidar[:3, 3], lidar @ T_world_lidar[:3, :3].T, box_x)
    return (lidar * distance[:, None]).astype(np.float32), what


def cast(origin, u, box_x):
    """Distance along rays u (n, 3) from a place in the yard, and what each one hits."""
    u = u.T.copy()  # rows of x, y and z: numpy is slow along a short last axis
    with np.errstate(divide="ignore", invalid="ignore"):
        wall = np.minimum.reduce(
            [np.where(s * u[k] > 0, (s * 25 - origin[k]) / u[k], np.inf)
             for k in (0, 1) for s in (-1, 1)]
        )  # fmt: skip
        floor = np.where(u[2] < 0, (-1.7 - origin[2]) / u[2], np.inf)
        middle = np.array([box_x, 5, -0.7]) - origin
        low, high = ((middle + side)[:, None] / u for side in (-1, 1))
        enter = np.fmax.reduce(np.minimum(low, high))
        leave = np.fmin.reduce(np.maximum(low, high))
        box = np.where((enter < leave) & (enter > 0), enter, np.inf)
    hits = np.stack([floor, wall, box])
    return hits.min(0), hits.argmin(0)
