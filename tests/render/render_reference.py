"""A plain numpy rasteriser of splats, and scenes to compare renderers on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from docdepth.config import RenderParameters
from docdepth.geometry.camera import Camera, View
from docdepth.geometry.lidar_frame import LidarFrame
from docdepth.geometry.track import Tracks
from docdepth.geometry.trajectory import Trajectory
from docdepth.render import depth_map, layers
from docdepth.render.depth_map import render_list
from docdepth.render.dynamic_objects import dynamic_objects
from docdepth.render.render_sweep import RenderSweep
from docdepth.render.selection import static_sweeps
from motion import straight

# Camera axes in the LiDAR frame: x right = -y, y down = -z, z forward = x.
AXES = np.array([[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]], dtype=np.float64)
PAPER = RenderParameters(primitive="splats", behind=0.5, ahead=100.0, step=0.2)
TRIANGLES = RenderParameters()


def small_camera(width=160, height=60, focal=90.0):
    K = np.array([[focal, 0, width / 2 - 0.7], [0, focal * 1.1, height / 2 + 1.3], [0, 0, 1]])
    return Camera(K, width, height)


def frame_of(points, classid, time_offset=None, sensor_rig=None, instance=None):
    """A sweep with classes."""
    rows = np.arange(len(points), dtype=np.uint32)
    return LidarFrame(points, rows, "", len(rows), time_offset, sensor_rig, classid, instance)


def render_sweep(points, classid, parameters=None, velocity=None, objects=None, **more):
    """A sweep with classes, ready to be drawn."""
    return RenderSweep(frame_of(points, classid, **more), parameters, velocity, objects)


def followed(points, classid, index, trajectory, track, parameters=None, time_offset=None):
    """The frame of a sweep whose dynamic points are all of one track."""
    instance = np.where(classid >= 100, track.id, 0).astype(np.uint16)
    pose, time = trajectory.poses[index], int(trajectory.times[index])
    frame = frame_of(points, classid, time_offset, instance=instance)
    return RenderSweep(frame, parameters, None, dynamic_objects(frame, time, pose, Tracks([track])))


def part_of(track, rows):
    """A track in some of its sweeps."""
    stamps = ("times", "poses", "velocities", "points", "deviations", "surface_deviations")
    return replace(track, **{name: getattr(track, name)[rows] for name in stamps})


def splats_of(camera, points, pose, sizes):
    """Rows of the splats within an image, their pixels u and v, depths and sizes in pixels."""
    f, T, (size_max, size_min) = np.float32, pose.astype(np.float32), sizes
    fx, fy, cx, cy = (f(v) for v in camera.K[[0, 1, 0, 1], [0, 1, 2, 2]])
    p, q, r = points.T
    with np.errstate(all="ignore"):
        x, y, z = (((T[i, 0] * p + T[i, 1] * q) + T[i, 2] * r) + T[i, 3] for i in range(3))
        u = np.floor((fx * x) / z + cx + f(0.5))
        v = np.floor((fy * y) / z + cy + f(0.5))
        squared = ((x * x + y * y) + z * z).astype(np.float64)
        sigma = np.where(
            squared < 1.65**2, size_max, np.maximum(size_max / np.log(squared), size_min)
        )
        inside = (z > f(0.1)) & (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
    rows = np.flatnonzero(inside)
    size = np.floor(sigma[rows] + 0.5).astype(int)
    return rows, u[rows].astype(int), v[rows].astype(int), z[rows], size


def reference(camera, clouds):
    """Every splat pixel by pixel. clouds: (points, 4x4 pose, (size_max, size_min))."""
    depth = np.full((camera.height, camera.width), np.inf, np.float32)
    for cloud in clouds:
        _, u, v, z, size = splats_of(camera, *cloud)
        for h in np.unique(size):
            reach = np.arange(-h, h + 1)
            du, dv = np.meshgrid(reach, reach)
            covered = 9 * du**2 + 4 * dv**2 <= h * h
            for a, b in zip(du[covered], dv[covered], strict=True):
                column, row = u[size == h] + a, v[size == h] + b
                ok = (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
                np.minimum.at(depth, (row[ok], column[ok]), z[size == h][ok])
    depth[np.isinf(depth)] = np.nan
    return depth


def scattered(rng, n):
    """Points all around a sensor, most of them near, some unusable."""
    direction = rng.normal(size=(n, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    points = (direction * rng.gamma(1.5, 12.0, size=(n, 1))).astype(np.float32)
    points[:3] = [[0, 0, 0], [np.nan, 1, 2], [np.inf, 0, 0]]
    points[3] = [0.5, 0.1, 0.1]
    return points


def drawing(
    frames, trajectory=None, time=0, parameters=TRIANGLES, camera=None, T_camera_lidar=AXES
):
    """The first arguments of render_list(). ``frames``: a list, a function, or one sweep."""
    if trajectory is None:
        trajectory = straight(1)
    view = View.at(camera or small_camera(), T_camera_lidar, trajectory, time)
    if isinstance(frames, RenderSweep):
        return view, trajectory, lambda _: frames, parameters
    return view, trajectory, getattr(frames, "__getitem__", frames), parameters


def compose_depth(view, trajectory, sweeps, parameters, threads=0, renderer=None, tracks=None):
    drawn = render_list(view, trajectory, sweeps, parameters, tracks)
    return depth_map.compose_depth(drawn, threads, renderer)


def compose_layers(names, depth, view, trajectory, sweeps, parameters, threads=0, tracks=None):
    drawn = render_list(view, trajectory, sweeps, parameters, tracks)
    return layers.compose_layers(names, depth, drawn, threads)


def pixel_rays(camera):
    """Directions with unit depth in the frame of the LiDAR, for AXES: (height, width, 3)."""
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    K = camera.K
    return np.stack([np.ones(u.shape), -(u - K[0, 2]) / K[0, 0], -(v - K[1, 2]) / K[1, 1]], -1)


def drive(rng, camera_time, parameters, n=6):
    """Sweeps along a curve; returns what compose_depth() needs and what reference() needs."""
    trajectory = straight(n)
    angle = 0.05 * np.arange(n)
    poses = trajectory.poses.copy()
    poses[:, 0, 0] = poses[:, 1, 1] = np.cos(angle)
    poses[:, 1, 0], poses[:, 0, 1] = np.sin(angle), -np.sin(angle)
    trajectory = Trajectory(trajectory.times, poses)
    sweeps = [scattered(rng, 4000) for _ in range(n)]
    classes = [rng.choice([0, 50, 99, 100, 251], size=4000).astype(np.uint16) for _ in range(n)]
    frames = [render_sweep(s, c, parameters) for s, c in zip(sweeps, classes, strict=True)]

    T_camera_world = AXES @ np.linalg.inv(trajectory.interpolate(camera_time)[0])
    clouds = []
    for dynamic in (False, True):
        indices = static_sweeps(trajectory, camera_time, parameters)
        for i in [trajectory.nearest(camera_time)] if dynamic else indices:
            with np.errstate(invalid="ignore", over="ignore"):
                distance = np.linalg.norm(sweeps[i].astype(np.float64), axis=1)
            kept = np.isfinite(distance) if dynamic else distance < parameters.crop
            keep = kept & ((classes[i] >= 100) == dynamic)
            pose = T_camera_world @ trajectory.poses[i]
            size = parameters.dynamic_size if dynamic else parameters.static_size
            clouds.append((sweeps[i][keep], pose, size))
    return trajectory, frames, clouds
