"""Drives a LiDAR and a camera through a scene: sweeps and images with exact ground truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from docdepth.errors import InputError
from docdepth.geometry.camera import Camera
from docdepth.geometry.se3 import inverse, rigid, rotation_exp
from docdepth.geometry.track import Track
from docdepth.synthetic.beams import cast_beams, with_blooming
from docdepth.synthetic.casting import Rays, World
from docdepth.synthetic.mesh import pose_of
from docdepth.synthetic.photo import View, photograph
from docdepth.synthetic.sensors import Sensor
from docdepth.synthetic.street import Scene

Floats = NDArray[np.float64]
_NS = 1_000_000_000
_SHUTTER = 0.37  # time of image k, as a share of the time from sweep k to sweep k + 1
_FIRST_MOVING_CLASS = 252  # of SemanticKITTI: a moving car


@dataclass(frozen=True)
class Rig:
    """Calibration of KITTI's four cameras; camera 2 takes the images.

    Attributes
    ----------
    camera : Camera
        Camera 2.
    P : ndarray of float64, shape (4, 3, 4)
        Projection matrices of cameras 0 to 3, from the frame of camera 0.
    Tr : ndarray of float64, shape (4, 4)
        ``T_camera0_lidar``.
    T_camera_lidar : ndarray of float64, shape (4, 4)
        Extrinsics of camera 2.
    """

    camera: Camera
    P: Floats
    Tr: Floats
    T_camera_lidar: Floats


def kitti_rig() -> Rig:
    """KITTI's rig: the camera is 0.27 m ahead of the LiDAR, 0.08 m below it, slightly rotated."""
    K = np.array([(721.5377, 0.0, 609.5593), (0.0, 721.5377, 172.854), (0.0, 0.0, 1.0)])
    P = np.zeros((4, 3, 4))
    P[:, :, :3] = K
    P[:, 0, 3] = (0.0, -387.5744, 44.85728, -339.5242)
    axes = np.array([(0.0, -1.0, 0.0), (0.0, 0.0, -1.0), (1.0, 0.0, 0.0)])
    Tr = rigid(rotation_exp(np.radians((0.4, -0.5, 0.3))) @ axes)
    Tr[:3, 3] = -Tr[:3, :3] @ (0.27, 0.0, -0.08)
    shift = np.eye(4)
    shift[0, 3] = P[2, 0, 3] / K[0, 0]
    return Rig(Camera(K, 1242, 375), P, Tr, shift @ Tr)


@dataclass(frozen=True)
class TrueSweep:
    """A sweep with exact ground truth.

    Attributes
    ----------
    points : ndarray of float32, shape (N, 3)
        LiDAR frame at the stamp of the sweep [m], motion compensated unless the drive is skewed.
    intensity : ndarray of float32, shape (N,)
        0..1.
    labels : ndarray of uint32, shape (N,)
        SemanticKITTI class in the low 16 bits, instance in the high 16 bits. Objects that move at
        any time of the drive have a moving class.
    speed : ndarray of float32, shape (N,)
        Speed of the object at that moment [m/s].
    relative_time : ndarray of float32, shape (N,)
        Time of each point after the stamp, as a share of the sweep, -0.5..0.5.
    ring : ndarray of int64, shape (N,)
    """

    points: NDArray[np.float32]
    intensity: NDArray[np.float32]
    labels: NDArray[np.uint32]
    speed: NDArray[np.float32]
    relative_time: NDArray[np.float32]
    ring: NDArray[np.int64]

    @property
    def moving(self) -> NDArray[np.bool_]:
        """Points of objects that move at any time of the drive."""
        return (self.labels & 0xFFFF) >= _FIRST_MOVING_CLASS


class Drive:
    """A synthetic recording; sweeps and images are computed on request and not cached.

    Parameters
    ----------
    frames : int
        Number of sweeps.
    seed : int
        Seed of noise and dropout.
    skew : bool
        Leave the points as measured while the ego moved (raw sweeps).

    Attributes
    ----------
    times : ndarray of int64, shape (frames,)
        Stamp of each sweep, at its middle [ns].
    poses : ndarray of float64, shape (frames, 4, 4)
        ``T_world_lidar`` at the stamps; the world frame is the LiDAR frame of the first sweep.
    camera_times : ndarray of int64, shape (frames - 1,)
    T_scene_world : ndarray of float64, shape (4, 4)
        From the world frame of the drive to the frame of the scene.
    span : tuple of float
        First and last second in which a point is measured.
    """

    def __init__(
        self,
        scene: Scene,
        sensor: Sensor,
        frames: int,
        seed: int = 0,
        skew: bool = False,
    ) -> None:
        longest = np.floor(scene.duration / sensor.period)
        if not 2 <= frames <= longest:
            raise InputError(
                f"scene {scene.name!r} is long enough for 2 to {longest:.0f} sweeps, not {frames}"
            )
        self.scene, self.sensor, self.seed, self.skew = scene, sensor, seed, skew
        self.rig = kitti_rig()
        period = round(sensor.period * _NS)
        self.times = period * np.arange(frames, dtype=np.int64)
        self.camera_times = self.times[:-1] + round(_SHUTTER * period)
        self.T_scene_world = self._scene_poses(np.zeros(1))[0]
        self.poses = self.pose_at(self.times)
        self._bias = sensor.bias * np.random.default_rng([seed, 2]).normal(size=256)
        half = 0.5 * sensor.period
        self.span = (-half, float(self.times[-1]) / _NS + half)
        self.world = World(scene.static, scene.actors, self.span)

    def __len__(self) -> int:
        return len(self.times)

    def _scene_poses(self, seconds: Floats) -> Floats:
        """``T_scene_lidar`` (n, 4, 4) at ``seconds`` [s]: pose on the road plus a slight sway."""
        ego = self.scene.ego
        base = ego.poses(seconds)
        speed = np.abs(ego.pace.at(seconds))  # negative where it reverses
        sway = speed / (speed + 3.0)
        roll = np.radians(0.15) * sway * np.sin(2 * np.pi * 1.1 * seconds)
        pitch = np.radians(0.2) * sway * np.sin(2 * np.pi * 1.4 * seconds + 1.0)
        lift = np.repeat(np.eye(4)[None], len(seconds), axis=0)
        lift[:, :3, :3] = rotation_exp(np.stack([roll, pitch, 0.0 * roll], axis=1))
        lift[:, 2, 3] = self.sensor.height + 0.008 * sway * np.sin(2 * np.pi * 1.6 * seconds)
        return base @ lift

    def pose_at(self, times: NDArray[np.int64]) -> Floats:
        """Exact ``T_world_lidar`` (n, 4, 4) at ``times`` [ns]."""
        seconds = np.atleast_1d(times).astype(np.float64) / _NS
        return inverse(self.T_scene_world) @ self._scene_poses(seconds)

    def world_at(self, second: float) -> World:
        """What the LiDAR or a camera sees at a time [s]."""
        return self.world

    def sweep(self, index: int) -> TrueSweep:
        """The sweep ``index``."""
        sensor, rng = self.sensor, np.random.default_rng([self.seed, 1, index])
        pattern, stamp = sensor.pattern(index), float(self.times[index]) / _NS
        world, seconds = self.world_at(stamp), stamp + sensor.period * pattern.relative_times
        poses, which = self._scene_poses(seconds), pattern.which
        rotation = poses[which, :3, :3]
        directions = np.einsum("nij,nj->ni", rotation, pattern.directions)
        ray_origins = pattern.ray_origins
        if ray_origins is None:
            ray_origins = np.zeros_like(directions)
        origins = poses[which, :3, 3] + np.einsum("nij,nj->ni", rotation, ray_origins)
        rays = Rays(origins, directions, seconds, which)
        if sensor.beam_width:
            hits = cast_beams(world, rays, sensor.beam_width, sensor.max_range)
        else:
            hits = world.cast(rays, sensor.max_range)
        reflectivity = world.surface["reflectivity"][hits.face]
        if sensor.blooming:
            hits, reflectivity = with_blooming(hits, reflectivity, directions, sensor.blooming, rng)
        kept = np.flatnonzero(sensor.returned(hits.range, reflectivity, hits.cosine, rng))
        measured = hits.range[kept] + sensor.noise * rng.normal(size=len(kept))
        measured += self._bias[pattern.rings[kept]]
        if self.skew:
            points = ray_origins[kept] + measured[:, None] * pattern.directions[kept]
        else:
            points = rays.origins[kept] + measured[:, None] * directions[kept]
            back = inverse(self._scene_poses(np.array([stamp]))[0])
            points = np.einsum("ij,kj->ki", back[:3, :3], points) + back[:3, 3]
        intensity = reflectivity[kept] * np.sqrt(hits.cosine[kept])
        return TrueSweep(
            points.astype(np.float32),
            np.clip(intensity, 0.0, 1.0).astype(np.float32),
            hits.labels[kept],
            hits.speed[kept],
            pattern.relative_times[which[kept]].astype(np.float32),
            pattern.rings[kept],
        )

    def tracks(self) -> list[Track]:
        """The exact tracks of all actors that move during the drive, at all stamps.

        Their ids are the instances of the labels. ``points`` is 0: no sweep is cast to count them.
        """
        seconds, step, found = self.times / _NS, 1e-3, []
        for number, actor in enumerate(self.scene.actors, 1):
            if not actor.moves_between(*self.span):
                continue
            low, high = actor.box
            x, y = 0.5 * (low + high)[:2]
            before, poses, after = (
                inverse(self.T_scene_world) @ actor.path.poses(seconds + t) @ pose_of(x, y, low[2])
                for t in (-step, 0.0, step)
            )
            velocities = (after - before)[:, :3, 3] / (2 * step)
            points, exact = np.zeros(len(self), np.int64), np.zeros(len(self))
            about = (number, actor.kind, self.times, poses, velocities, high - low)
            found.append(Track(*about, points, exact, exact))
        return found

    def image(self, index: int) -> View:
        """The image of camera 2 at ``camera_times[index]``, with exact depth."""
        time = self.camera_times[index : index + 1]
        pose = self.T_scene_world @ self.pose_at(time)[0] @ inverse(self.rig.T_camera_lidar)
        second = float(time[0]) / _NS
        return photograph(self.world_at(second), self.rig.camera, pose, second)

    def depth(self, camera: Camera, T_world_camera: Floats, time: int) -> NDArray[np.float32]:
        """Exact depth (h, w) of any camera at any time [ns]; NaN = no surface."""
        pose = self.T_scene_world @ T_world_camera
        return photograph(self.world_at(time / _NS), camera, pose, time / _NS).depth
