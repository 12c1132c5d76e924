"""How a vehicle drives, and what moves around it: straight on, and as fast all the while."""

import numpy as np

from docdepth.geometry.track import Track
from docdepth.geometry.trajectory import Trajectory


def pose(x=0.0, y=0.0, z=0.0, yaw=0.0):
    """``T_world_lidar``; metres and radians."""
    T = np.eye(4)
    T[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    T[:3, 3] = x, y, z
    return T


def straight(n, spacing=1.0, z=0.0):
    """A drive along x with ten sweeps a second, metres apart."""
    poses = np.stack([pose(spacing * i, z=z) for i in range(n)])
    return Trajectory(np.arange(n) * 100_000_000, poses)


def moving_track(trajectory, position, velocity, size, of=1, kind="vehicle"):
    """A track that moves straight on: ``position`` at the first stamp."""
    seconds = (trajectory.times - trajectory.times[0]) * 1e-9
    velocities = np.tile(np.asarray(velocity, float), (len(seconds), 1))
    poses = np.stack([pose(*place) for place in position + seconds[:, None] * velocities])
    points = np.zeros(len(seconds), np.int64)
    size = np.asarray(size, float)
    exact = 0.0 * points
    return Track(of, kind, trajectory.times, poses, velocities, size, points, exact, exact)
