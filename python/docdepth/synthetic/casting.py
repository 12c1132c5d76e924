"""Ray casting in a scene with moving objects.

The static part is one acceleration structure; each part of each actor is another. Rays are
transformed into the frame of an actor with its pose at the time of each ray. So no structure is
rebuilt, and motion within a sweep is exact.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from docdepth.errors import MissingExtraError
from docdepth.synthetic.actors import Actor
from docdepth.synthetic.mesh import SURFACE, Mesh

Floats = NDArray[np.float64]
# Rays per block of neighbours that share one bounding cone.
_BLOCK = 32


class Target:
    """One mesh and its acceleration structure."""

    def __init__(self, mesh: Mesh) -> None:
        try:
            from embreex.mesh_construction import TriangleMesh
            from embreex.rtcore_scene import EmbreeScene
        except ImportError as error:
            raise MissingExtraError(
                'synthetic drives need embreex for ray casting: pip install "docdepth[synth]"'
            ) from error
        self.normals = mesh.normals.astype(np.float32)
        self._scene = EmbreeScene()
        TriangleMesh(self._scene, mesh.vertices.astype(np.float32), mesh.faces)

    def cast(
        self, origins: Floats, directions: Floats, limits: Floats
    ) -> tuple[Floats, NDArray[np.int32]]:
        """Range [m] and face of the first hit nearer than ``limits`` [m]; face -1 = no hit."""
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
    """First hit of each ray."""

    range: Floats  # (N,): metres; inf = no hit
    face: NDArray[np.int32]  # (N,): index into the surface of :class:`World`; -1 = no hit
    # (N,): SemanticKITTI class in the low 16 bits, instance in the high 16 bits
    labels: NDArray[np.uint32]
    speed: NDArray[np.float32]  # (N,): speed of the object at that moment [m/s]
    cosine: NDArray[np.float32]  # (N,): cosine of the angle of incidence
    normals: NDArray[np.float32]  # (N, 3): world frame, facing the origin of the ray


@dataclass(frozen=True)
class Rays:
    """Rays in world coordinates, each at its own time.

    Neighbours in the list should have similar directions: they are bounded in blocks.
    """

    origins: Floats  # (N, 3): origins [m]
    directions: Floats  # (N, 3): unit vectors, so that ``t`` along a ray is metres
    times: Floats  # (m,): times at which rays leave, increasing [s]
    which: NDArray[np.int64]  # (N,): index into ``times`` for each ray

    @cached_property
    def bounds(self) -> tuple[Floats, float]:
        """A sphere around the origins: its centre and radius [m]."""
        low, high = self.origins.min(axis=0), self.origins.max(axis=0)
        return 0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low))

    @cached_property
    def cones(self) -> tuple[Floats, Floats]:
        """Axis and half angle of a cone around each block of rays.

        Most blocks then miss most actors without a ray test.
        """
        first = np.arange(0, len(self.directions), _BLOCK)
        axes = np.add.reduceat(self.directions, first, axis=0)
        axes /= np.maximum(np.linalg.norm(axes, axis=1, keepdims=True), 1e-9)
        cosine = np.einsum(
            "ij,ij->i", self.directions, np.repeat(axes, _BLOCK, axis=0)[: len(self)]
        )
        return axes, np.arccos(np.clip(np.minimum.reduceat(cosine, first), -1.0, 1.0))

    def __len__(self) -> int:
        return len(self.directions)

    def towards(self, centre: Floats, radius: float) -> NDArray[np.int64]:
        """Indices of the rays that may hit a sphere; some of them miss it."""
        offset = centre - self.bounds[0]
        away = float(np.linalg.norm(offset))
        if away < 1.2 * radius:
            return np.arange(len(self))
        half = float(np.arcsin(radius / away))
        axes, openings = self.cones
        off = np.arccos(np.clip(np.einsum("ij,j->i", axes, offset / away), -1.0, 1.0))
        blocks = np.flatnonzero(off <= openings + half + 1e-3)
        rows = (blocks[:, None] * _BLOCK + np.arange(_BLOCK)).ravel()
        return rows[rows < len(self)]


class World:
    """A static mesh and actors, ready for ray casting.

    Parameters
    ----------
    span : tuple of float
        First and last second of the drive. An actor that moves in between has its moving class in
        all sweeps.
    instances : sequence of int, optional
        Of the actors; 1, 2, 3, ... if absent.

    Attributes
    ----------
    surface : ndarray of SURFACE
        One row per face: the static mesh, then each part of each actor; the last one is for rays
        without a hit.
    """

    def __init__(
        self,
        static: Mesh,
        actors: Sequence[Actor],
        span: tuple[float, float],
        instances: Sequence[int] | None = None,
    ) -> None:
        self.static = Target(static)
        self.actors: list[tuple[Actor, list[tuple[int, Target]]]] = []
        surfaces, first = [static.surface], len(static)
        for number, actor in zip(instances or range(1, len(actors) + 1), actors, strict=True):
            targets = []
            moves = actor.moves_between(*span)
            for part in actor.parts:
                targets.append((first, Target(part.mesh)))
                surface = part.mesh.surface.copy()
                surface["label"] = (number << 16) | (actor.moving_label if moves else actor.label)
                surfaces.append(surface)
                first += len(surface)
            self.actors.append((actor, targets))
        self.surface = np.concatenate([*surfaces, np.zeros(1, SURFACE)])

    def cast(self, rays: Rays, limit: float) -> Hits:
        """First hit of each ray within ``limit`` metres."""
        count = len(rays)
        distance, face = self.static.cast(rays.origins, rays.directions, np.full(count, limit))
        normals = self.static.normals[face]
        speed = np.zeros(count, np.float32)
        for actor, targets in self.actors:
            near = self._near(actor, rays, limit, distance)
            if not len(near):
                continue
            moments, which = np.unique(rays.which[near], return_inverse=True)
            times = rays.times[moments]
            speeds = actor.speed(times).astype(np.float32)
            poses = actor.part_poses(times)
            for (first, target), part_poses in zip(targets, poses, strict=True):
                rotation = part_poses[which, :3, :3]
                offset = rays.origins[near] - part_poses[which, :3, 3]
                local = np.einsum("nji,nj->ni", rotation, offset)
                directions = np.einsum("nji,nj->ni", rotation, rays.directions[near])
                found, hit = target.cast(local, directions, distance[near])
                closer = np.flatnonzero(hit >= 0)
                rows = near[closer]
                distance[rows], face[rows] = found[closer], hit[closer] + np.int32(first)
                turned = rotation[closer].astype(np.float32)
                normals[rows] = np.einsum("nij,nj->ni", turned, target.normals[hit[closer]])
                speed[rows] = speeds[which[closer]]
        distance[face < 0] = np.inf
        facing = np.einsum("ij,ij->i", normals, rays.directions.astype(np.float32))
        normals *= np.where(facing > 0, np.float32(-1), np.float32(1))[:, None]
        labels = self.surface["label"][face]
        return Hits(distance, face, labels, speed, np.abs(facing), normals)

    def _near(self, actor: Actor, rays: Rays, limit: float, distance: Floats) -> NDArray[np.int64]:
        """Indices of the rays towards a sphere that bounds the actor at all times of the rays."""
        centres = actor.path.poses(np.linspace(rays.times[0], rays.times[-1], 3))[:, :3, 3]
        centre = 0.5 * (centres.min(axis=0) + centres.max(axis=0))
        middle, spread = rays.bounds
        radius = actor.radius + 0.5 * float(np.linalg.norm(np.ptp(centres, axis=0))) + spread
        away = float(np.linalg.norm(centre - middle))
        if away > limit + radius:
            return np.empty(0, np.int64)
        near = rays.towards(centre, radius)
        return near[distance[near] > away - radius]
