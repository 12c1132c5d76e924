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
_BLOCK = 32


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
        self.normals = mesh.normals.astype(np.float32)
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
    face : ndarray of int32, shape (N,)
        Into the tables of :class:`World`; -1 where nothing was met.
    labels : ndarray of uint32, shape (N,)
        SemanticKITTI label: class in the low, instance in the high 16 bits.
    speed : ndarray of float32, shape (N,)
        Of the object at that moment, metres a second.
    cosine : ndarray of float32, shape (N,)
        Of the angle of incidence.
    normals : ndarray of float32, shape (N, 3)
        World frame, towards the ray's origin.
    """

    range: Floats
    face: NDArray[np.int32]
    labels: NDArray[np.uint32]
    speed: NDArray[np.float32]
    cosine: NDArray[np.float32]
    normals: NDArray[np.float32]


@dataclass(frozen=True)
class Rays:
    """Rays in world coordinates, each at its own time.

    Neighbours in the list should look about the same way: they are handled in blocks.

    Attributes
    ----------
    origins : ndarray of float64, shape (N, 3)
        Where each ray begins.
    directions : ndarray of float64, shape (N, 3)
        Unit vectors, so that ``t`` along a ray is metres.
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
    axes: Floats = field(init=False)
    openings: Floats = field(init=False)

    def __post_init__(self) -> None:
        low, high = self.origins.min(axis=0), self.origins.max(axis=0)
        object.__setattr__(self, "middle", 0.5 * (low + high))
        object.__setattr__(self, "spread", 0.5 * float(np.linalg.norm(high - low)))
        # A cone about each block of rays, so that most rays are never asked about most actors.
        first = np.arange(0, len(self.directions), _BLOCK)
        axes = np.add.reduceat(self.directions, first, axis=0)
        axes /= np.maximum(np.linalg.norm(axes, axis=1, keepdims=True), 1e-9)
        cosine = np.einsum(
            "ij,ij->i", self.directions, np.repeat(axes, _BLOCK, axis=0)[: len(self)]
        )
        opening = np.arccos(np.clip(np.minimum.reduceat(cosine, first), -1.0, 1.0))
        object.__setattr__(self, "axes", axes)
        object.__setattr__(self, "openings", opening)

    def __len__(self) -> int:
        return len(self.directions)

    def towards(self, centre: Floats, radius: float) -> NDArray[np.int64]:
        """Rays that may meet a sphere, and some more."""
        offset = centre - self.middle
        away = float(np.linalg.norm(offset))
        if away < 1.2 * radius:
            return np.arange(len(self))
        half = float(np.arcsin(radius / away))
        off = np.arccos(np.clip(np.einsum("ij,j->i", self.axes, offset / away), -1.0, 1.0))
        blocks = np.flatnonzero(off <= self.openings + half + 1e-3)
        rows = (blocks[:, None] * _BLOCK + np.arange(_BLOCK)).ravel()
        return rows[rows < len(self)]


class World:
    """A still mesh and actors.

    Parameters
    ----------
    motion_corrected : Mesh
    actors : sequence of Actor
    span : tuple of float
        First and last second of the drive: who moves in between has the moving class throughout.

    Attributes
    ----------
    labels, colours, reflectivity : ndarray
        Of every face: those of the still mesh, then those of each part of each actor.
    """

    def __init__(
        self, motion_corrected: Mesh, actors: Sequence[Actor], span: tuple[float, float]
    ) -> None:
        self.motion_corrected = Target(motion_corrected)
        self.actors = list(actors)
        meshes = [motion_corrected, *(part.mesh for actor in self.actors for part in actor.parts)]
        first = np.cumsum([0, *(len(mesh) for mesh in meshes)]).tolist()
        targets = iter(zip(first[1:], map(Target, meshes[1:]), strict=False))
        self.targets = [[next(targets) for _ in actor.parts] for actor in self.actors]
        labels = [motion_corrected.labels]
        for number, actor in enumerate(self.actors, 1):
            moves = actor.moves_between(*span)
            label = (number << 16) | (actor.moving_label if moves else actor.label)
            labels += [np.full(len(part.mesh), label, np.uint32) for part in actor.parts]
        # One row more for rays that meet nothing: index -1.
        self.labels = np.concatenate([*labels, np.zeros(1, np.uint32)])
        self.colours = np.concatenate([m.colours for m in meshes] + [np.zeros((1, 3), np.float32)])
        self.reflectivity = np.concatenate(
            [m.reflectivity for m in meshes] + [np.zeros(1, np.float32)]
        )

    def cast(self, rays: Rays, limit: float) -> Hits:
        """What each ray meets first within ``limit`` metres."""
        count = len(rays)
        distance, face = self.motion_corrected.cast(
            rays.origins, rays.directions, np.full(count, limit)
        )
        normals = self.motion_corrected.normals[face]
        speed = np.zeros(count, np.float32)
        for actor, targets in zip(self.actors, self.targets, strict=True):
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
        return Hits(distance, face, self.labels[face], speed, np.abs(facing), normals)

    def _near(self, actor: Actor, rays: Rays, limit: float, distance: Floats) -> NDArray[np.int64]:
        """Rays that may meet the actor: those towards a sphere about where it is meanwhile."""
        places = actor.path.poses(np.linspace(rays.times[0], rays.times[-1], 3))[:, :3, 3]
        centre = 0.5 * (places.min(axis=0) + places.max(axis=0))
        radius = actor.radius + 0.5 * float(np.linalg.norm(np.ptp(places, axis=0))) + rays.spread
        away = float(np.linalg.norm(centre - rays.middle))
        if away > limit + radius:
            return np.empty(0, np.int64)
        near = rays.towards(centre, radius)
        return near[distance[near] > away - radius]
