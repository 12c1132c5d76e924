"""Rays against a street: a still part in one acceleration structure, each mover in its own.

Movers are met in their own frame, with every ray taken there by the mover's pose at the ray's own
time, so that nothing is rebuilt and motion within a sweep is exact.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth.errors import MissingExtraError
from docdepth.synthetic.actors import Actor
from docdepth.synthetic.mesh import Mesh

Floats = NDArray[np.float64]


def _embree() -> tuple[Any, Any]:
    try:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene
    except ImportError as error:
        raise MissingExtraError(
            'synthetic drives need embreex for ray casting: pip install "docdepth[synth]"'
        ) from error
    return EmbreeScene, TriangleMesh


class Target:
    """One mesh made ready for rays."""

    def __init__(self, mesh: Mesh) -> None:
        scene_type, mesh_type = _embree()
        self.mesh = mesh
        self.normals = mesh.normals
        self._scene = scene_type()
        mesh_type(
            self._scene,
            np.ascontiguousarray(mesh.vertices, np.float32),
            np.ascontiguousarray(mesh.faces, np.int32),
        )

    def cast(
        self, origins: Floats, directions: Floats, limits: Floats
    ) -> tuple[Floats, NDArray[np.int32]]:
        """Range and face of the first hit nearer than ``limits``; face -1 where there is none."""
        found = self._scene.run(
            np.ascontiguousarray(origins, np.float32),
            np.ascontiguousarray(directions, np.float32),
            dists=np.ascontiguousarray(limits, np.float32),
            output=True,
        )
        face: NDArray[np.int32] = found["primID"]
        return found["tfar"].astype(np.float64), face


@dataclass(frozen=True)
class Hits:
    """What each ray met.

    Attributes
    ----------
    range : ndarray of float64, shape (N,)
        Metres; inf where nothing was met.
    labels : ndarray of uint32, shape (N,)
        SemanticKITTI label: class in the low, instance in the high 16 bits.
    speed : ndarray of float32, shape (N,)
        Of the object at that moment, metres a second.
    reflectivity : ndarray of float32, shape (N,)
    cosine : ndarray of float32, shape (N,)
        Of the angle of incidence.
    normals : ndarray of float32, shape (N, 3)
        World frame, towards the ray's origin.
    colours : ndarray of float32, shape (N, 3)
    """

    range: Floats
    labels: NDArray[np.uint32]
    speed: NDArray[np.float32]
    reflectivity: NDArray[np.float32]
    cosine: NDArray[np.float32]
    normals: NDArray[np.float32]
    colours: NDArray[np.float32]


@dataclass(frozen=True)
class Rays:
    """Rays in world coordinates, each at its own time.

    Attributes
    ----------
    origins, directions : ndarray of float64, shape (N, 3)
        Directions have unit length, so that ``t`` along a ray is metres.
    times : ndarray of float64, shape (m,)
        Seconds; the times at which rays leave, increasing.
    which : ndarray of int64, shape (N,)
        Index into ``times`` for each ray.
    """

    origins: Floats
    directions: Floats
    times: Floats
    which: NDArray[np.int64]
    middle: Floats = field(init=False)
    spread: float = field(init=False)

    def __post_init__(self) -> None:
        low, high = self.origins.min(axis=0), self.origins.max(axis=0)
        object.__setattr__(self, "middle", 0.5 * (low + high))
        object.__setattr__(self, "spread", 0.5 * float(np.linalg.norm(high - low)))


class World:
    """A still mesh and actors.

    Parameters
    ----------
    still : Mesh
    actors : sequence of Actor
    span : tuple of float
        First and last second of the drive: who moves in between has the moving class throughout.
    """

    def __init__(self, still: Mesh, actors: Sequence[Actor], span: tuple[float, float]) -> None:
        self.still = Target(still)
        self.actors = list(actors)
        self.targets = [[Target(part.mesh) for part in actor.parts] for actor in self.actors]
        self.labels = [
            np.uint32((k + 1) << 16)
            | np.uint32(a.moving_label if a.moves_between(*span) else a.label)
            for k, a in enumerate(self.actors)
        ]

    def cast(self, rays: Rays, limit: float) -> Hits:
        """What each ray meets first within ``limit`` metres."""
        count = len(rays.origins)
        distance, face = self.still.cast(rays.origins, rays.directions, np.full(count, limit))
        owner = np.where(face < 0, -1, 0)
        normals = np.zeros((count, 3), np.float32)
        met = np.flatnonzero(face >= 0)
        normals[met] = self.still.normals[face[met]]
        speed = np.zeros(count, np.float32)
        for number, actor in enumerate(self.actors, 1):
            self._cast_actor(number, actor, rays, limit, distance, face, owner, normals, speed)
        return self._gather(rays, distance, face, owner, normals, speed)

    def _cast_actor(
        self,
        number: int,
        actor: Actor,
        rays: Rays,
        limit: float,
        distance: Floats,
        face: NDArray[np.int32],
        owner: NDArray[np.int64],
        normals: NDArray[np.float32],
        speed: NDArray[np.float32],
    ) -> None:
        near = self._near(actor, rays, limit, distance)
        if not len(near):
            return
        moments, which = np.unique(rays.which[near], return_inverse=True)
        times = rays.times[moments]
        for k, part in enumerate(actor.parts):
            poses = actor.part_poses(part, times)[which]
            rotation = poses[:, :3, :3]
            offset = rays.origins[near] - poses[:, :3, 3]
            origins = np.einsum("nji,nj->ni", rotation, offset)
            directions = np.einsum("nji,nj->ni", rotation, rays.directions[near])
            target = self.targets[number - 1][k]
            found, hit = target.cast(origins, directions, distance[near])
            closer = np.flatnonzero(hit >= 0)
            rows = near[closer]
            distance[rows], face[rows] = found[closer], hit[closer]
            owner[rows] = 1000 * number + k
            normals[rows] = np.einsum("nij,nj->ni", rotation[closer], target.normals[hit[closer]])
            speed[rows] = actor.speed(times)[which[closer]]

    def _near(self, actor: Actor, rays: Rays, limit: float, distance: Floats) -> NDArray[np.int64]:
        """Rays that may meet the actor: those towards a sphere about where it is meanwhile."""
        ends = np.linspace(rays.times[0], rays.times[-1], 3)
        places = actor.path.poses(ends)[:, :3, 3]
        centre = 0.5 * (places.min(axis=0) + places.max(axis=0))
        radius = actor.radius + 0.5 * float(np.linalg.norm(np.ptp(places, axis=0)))
        radius += rays.spread
        towards = centre - rays.middle
        away = float(np.linalg.norm(towards))
        if away > limit + radius:
            return np.empty(0, np.int64)
        if away < 1.5 * radius:
            return np.flatnonzero(distance > 0)
        cosine = rays.directions @ (towards / away)
        inside = cosine > np.sqrt(1.0 - (radius / away) ** 2)
        return np.flatnonzero(inside & (distance > away - radius))

    def _gather(
        self,
        rays: Rays,
        distance: Floats,
        face: NDArray[np.int32],
        owner: NDArray[np.int64],
        normals: NDArray[np.float32],
        speed: NDArray[np.float32],
    ) -> Hits:
        count = len(distance)
        labels = np.zeros(count, np.uint32)
        reflectivity = np.zeros(count, np.float32)
        colours = np.zeros((count, 3), np.float32)
        for code in np.unique(owner[owner >= 0]):
            rows = np.flatnonzero(owner == code)
            number, part = divmod(int(code), 1000)
            mesh = self.still.mesh if not number else self.targets[number - 1][part].mesh
            labels[rows] = self.labels[number - 1] if number else mesh.labels[face[rows]]
            reflectivity[rows] = mesh.reflectivity[face[rows]]
            colours[rows] = mesh.colours[face[rows]]
        facing = np.einsum("ij,ij->i", normals, rays.directions.astype(np.float32))
        normals *= np.where(facing > 0, -1.0, 1.0).astype(np.float32)[:, None]
        result = np.where(owner >= 0, distance, np.inf)
        return Hits(result, labels, speed, reflectivity, np.abs(facing), normals, colours)
