"""A sensor and a camera driven through a scene: sweeps and images with exact truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from docdepth.errors import InputError
from docdepth.geometry.camera import Camera
from docdepth.geometry.se3 import inverse, rotation_exp
from docdepth.synthetic.casting import Hits, Rays, World
from docdepth.synthetic.photo import View, photograph
from docdepth.synthetic.sensors import Sensor
from docdepth.synthetic.street import Scene

Floats = NDArray[np.float64]
_NS = 1_000_000_000


@dataclass(frozen=True)
class Rig:
    """Where the cameras are: KITTI's four, of which number 2 takes pictures.

    Attributes
    ----------
    camera : Camera
        Of camera 2.
    P : ndarray of float64, shape (4, 3, 4)
        Projections of cameras 0 to 3 from the frame of camera 0.
    Tr : ndarray of float64, shape (4, 4)
        LiDAR points to camera 0.
    T_camera_lidar : ndarray of float64, shape (4, 4)
        LiDAR points to camera 2.
    """

    camera: Camera
    P: Floats
    Tr: Floats
    T_camera_lidar: Floats


def kitti_rig() -> Rig:
    """KITTI's camera: 0.27 m ahead of the LiDAR and 0.08 m below it, a little out of true."""
    K = np.array([(721.5377, 0.0, 609.5593), (0.0, 721.5377, 172.854), (0.0, 0.0, 1.0)])
    P = np.zeros((4, 3, 4))
    P[:, :, :3] = K
    P[:, 0, 3] = (0.0, -387.5744, 44.85728, -339.5242)
    axes = np.array([(0.0, -1.0, 0.0), (0.0, 0.0, -1.0), (1.0, 0.0, 0.0)])
    Tr = np.eye(4)
    Tr[:3, :3] = rotation_exp(np.radians((0.4, -0.5, 0.3))) @ axes
    Tr[:3, 3] = -Tr[:3, :3] @ (0.27, 0.0, -0.08)
    shift = np.eye(4)
    shift[0, 3] = P[2, 0, 3] / K[0, 0]
    return Rig(Camera(K, 1242, 375), P, Tr, shift @ Tr)


@dataclass(frozen=True)
class TrueSweep:
    """A sweep and all that is true of it.

    Attributes
    ----------
    points : ndarray of float32, shape (N, 3)
        LiDAR frame, metres; taken to the stamp by the exact motion of the ego unless skewed.
    intensity : ndarray of float32, shape (N,)
        0..1.
    labels : ndarray of uint32, shape (N,)
        SemanticKITTI class, moving ones for what moves at any time of the drive; instance in the
        high 16 bits.
    speed : ndarray of float32, shape (N,)
        Of the object at that moment, metres a second.
    relative_time : ndarray of float32, shape (N,)
        Time of measurement after the stamp, as a share of the sweep, -0.5..0.5.
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
        return (self.labels & 0xFFFF) >= 252


class Drive:
    """A recorded drive, made when asked for and never kept.

    Parameters
    ----------
    scene : Scene
    sensor : Sensor
    frames : int
        Sweeps.
    seed : int
        Of noise and dropout.
    skew : bool
        Leave sweeps as they were measured while the ego moved.
    shutter : float
        When image ``k`` is taken, as a share of the way from sweep ``k`` to ``k + 1``.

    Attributes
    ----------
    times : ndarray of int64, shape (frames,)
        Nanoseconds of each sweep's middle, where its pose holds.
    poses : ndarray of float64, shape (frames, 4, 4)
        ``T_world_lidar``; the world is the LiDAR frame of the first sweep.
    camera_times : ndarray of int64, shape (frames - 1,)
    T_scene_world : ndarray of float64, shape (4, 4)
        Takes points of the drive's world to the frame in which the scene was built.
    """

    def __init__(
        self,
        scene: Scene,
        sensor: Sensor,
        frames: int,
        seed: int = 0,
        skew: bool = False,
        shutter: float = 0.37,
    ) -> None:
        longest = int(scene.duration / sensor.period)
        if not 2 <= frames <= longest:
            raise InputError(
                f"scene {scene.name!r} is long enough for 2 to {longest} sweeps, not {frames}"
            )
        self.scene, self.sensor, self.seed, self.skew = scene, sensor, seed, skew
        self.rig = kitti_rig()
        period = round(sensor.period * _NS)
        self.times = period * np.arange(frames, dtype=np.int64)
        self.camera_times = self.times[:-1] + round(shutter * period)
        half = 0.5 * sensor.period
        self.world = World(
            scene.motion_corrected, scene.actors, (-half, float(self.times[-1]) / _NS + half)
        )
        self.T_scene_world = self._scene_poses(np.zeros(1))[0]
        self.poses = self.pose_at(self.times)
        self._bias = sensor.bias * np.random.default_rng([seed, 2]).normal(size=256)

    def __len__(self) -> int:
        return len(self.times)

    def _scene_poses(self, seconds: Floats) -> Floats:
        """``T_scene_lidar`` at any times: the road, and a body that sways a little on it."""
        ego = self.scene.ego
        base = ego.poses(seconds)
        sway = ego.pace.at(seconds) / (ego.pace.at(seconds) + 3.0)
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

    def sweep(self, index: int) -> TrueSweep:
        """Sweep ``index``."""
        sensor, rng = self.sensor, np.random.default_rng([self.seed, 1, index])
        pattern = sensor.pattern(index)
        seconds = float(self.times[index]) / _NS + sensor.period * pattern.fractions
        poses = self._scene_poses(seconds)
        rotation, which = poses[pattern.which, :3, :3], pattern.which
        directions = np.einsum("nij,nj->ni", rotation, pattern.directions)
        ray_origins = pattern.ray_origins
        if ray_origins is None:
            ray_origins = np.zeros_like(directions)
        origins = poses[which, :3, 3] + np.einsum("nij,nj->ni", rotation, ray_origins)
        rays = Rays(origins, directions, seconds, which)
        hits = self.world.cast(rays, sensor.max_range)
        reflectivity = self.world.reflectivity[hits.face]
        if sensor.bloom:
            hits, reflectivity = _bloomed(hits, reflectivity, directions, sensor.bloom, rng)
        kept = np.flatnonzero(sensor.returned(hits.range, reflectivity, hits.cosine, rng))
        measured = hits.range[kept] + sensor.noise * rng.normal(size=len(kept))
        measured += self._bias[pattern.rings[kept]]
        if self.skew:
            points = ray_origins[kept] + measured[:, None] * pattern.directions[kept]
        else:
            points = rays.origins[kept] + measured[:, None] * directions[kept]
            stamp = inverse(self._scene_poses(self.times[index : index + 1] / _NS)[0])
            points = np.einsum("ij,kj->ki", stamp[:3, :3], points) + stamp[:3, 3]
        intensity = reflectivity[kept] * np.sqrt(hits.cosine[kept])
        return TrueSweep(
            points.astype(np.float32),
            np.clip(intensity, 0.0, 1.0).astype(np.float32),
            hits.labels[kept],
            hits.speed[kept],
            pattern.fractions[which[kept]].astype(np.float32),
            pattern.rings[kept],
        )

    def image(self, index: int) -> View:
        """What camera 2 sees at ``camera_times[index]``, with exact depth."""
        time = self.camera_times[index : index + 1]
        pose = self.T_scene_world @ self.pose_at(time)[0] @ inverse(self.rig.T_camera_lidar)
        return photograph(self.world, self.rig.camera, pose, float(time[0]) / _NS)

    def depth(self, camera: Camera, T_world_camera: Floats, time: int) -> NDArray[np.float32]:
        """Exact depth (h, w) of any camera at any time [ns]; NaN where there is no surface."""
        pose = self.T_scene_world @ T_world_camera
        return photograph(self.world, camera, pose, time / _NS).depth


def _bloomed(
    hits: Hits,
    reflectivity: NDArray[np.float32],
    directions: Floats,
    bloom: float,
    rng: np.random.Generator,
) -> tuple[Hits, NDArray[np.float32]]:
    """Phantoms: rays that pass a retro-reflector closely come back dimly from its range.

    The nearer they pass, the likelier. They are outliers (class 1) without a speed.
    """
    bright = np.flatnonzero((reflectivity > 1) & np.isfinite(hits.range))
    if not len(bright):
        return hits, reflectivity
    source, cosine = np.empty(len(directions), np.int64), np.empty(len(directions))
    for rows in np.array_split(np.arange(len(directions)), len(directions) // 8192 + 1):
        cosines = directions[rows] @ directions[bright].T
        source[rows], cosine[rows] = bright[cosines.argmax(axis=1)], cosines.max(axis=1)
    phantom = rng.random(len(cosine)) < 1 - np.arccos(np.clip(cosine, -1, 1)) / bloom
    phantom &= (reflectivity <= 1) & (hits.range > hits.range[source] + 0.3)
    values = replace(
        hits,
        range=np.where(phantom, hits.range[source], hits.range),
        cosine=np.where(phantom, 1, hits.cosine),
        labels=np.where(phantom, 1, hits.labels).astype(hits.labels.dtype),
        speed=np.where(phantom, 0, hits.speed).astype(hits.speed.dtype),
    )
    return values, np.where(phantom, 0.3, reflectivity).astype(np.float32)


def sweeps_of(drive: Drive, indices: Sequence[int] | None = None) -> list[TrueSweep]:
    """All sweeps of a short drive at once."""
    return [drive.sweep(k) for k in (range(len(drive)) if indices is None else indices)]
