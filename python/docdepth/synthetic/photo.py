"""Renders the camera: exact depth and labels of each pixel, and a simply shaded image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from docdepth.geometry.camera import Camera
from docdepth.synthetic.casting import Hits, Rays, World

Floats = NDArray[np.float64]
# Surfaces farther away are sky [m].
_FAR = 300.0
# Direction towards the sun, scene frame.
_SUN = np.array((0.450, 0.350, 0.822), np.float32)

_HAZE = np.array((0.78, 0.83, 0.90), np.float32)
_HORIZON = np.array((0.80, 0.86, 0.93), np.float32)
_ZENITH = np.array((0.40, 0.58, 0.85), np.float32)


@dataclass(frozen=True)
class View:
    """One image with exact ground truth."""

    depth: NDArray[np.float32]  # (h, w): depth along the optical axis [m]; NaN = no surface
    labels: NDArray[np.uint32]  # (h, w): as for the points of a sweep; 0 for the sky
    # (h, w, 3): of the surface in the camera frame, towards the camera; 0 where there is none
    normals: NDArray[np.float32]
    colour: NDArray[np.uint8]  # (h, w, 3): red, green, blue


def photograph(world: World, camera: Camera, T_scene_camera: Floats, second: float) -> View:
    """Cast a ray through the centre of each pixel at one moment [s]."""
    K, shape = camera.K, (camera.height, camera.width)
    v, u = np.indices(shape, np.float64).reshape(2, -1)
    x, y = (u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1]
    local = np.stack([x, y, np.ones(len(x))], axis=1) / np.sqrt(x * x + y * y + 1.0)[:, None]
    along = local[:, 2]  # depth of a point one metre along the ray
    directions = np.einsum("ij,kj->ki", T_scene_camera[:3, :3], local)
    origin = T_scene_camera[None, :3, 3]
    which = np.zeros(len(directions), np.int64)
    origins = np.broadcast_to(origin, directions.shape)
    hits = world.cast(Rays(origins, directions, np.array([second]), which), _FAR)
    depth = np.where(np.isfinite(hits.range), hits.range * along, np.nan)
    colour = _shade(hits, world.surface["colour"][hits.face], origin, directions)
    normals = np.einsum("ij,ki->kj", T_scene_camera[:3, :3].astype(np.float32), hits.normals)
    return View(
        depth.reshape(shape).astype(np.float32),
        hits.labels.reshape(shape),
        np.where(hits.face[:, None] < 0, 0, normals).reshape(*shape, 3),
        colour.reshape(*shape, 3),
    )


def _shade(
    hits: Hits, colours: NDArray[np.float32], origin: Floats, directions: Floats
) -> NDArray[np.uint8]:
    """Shade the hits: sunlight, a texture fixed to the surfaces, haze, and sky."""
    hit = np.isfinite(hits.range)
    distance = np.where(hit, hits.range, 0.0).astype(np.float32)
    light = 0.5 + 0.5 * np.maximum(np.einsum("ij,j->i", hits.normals, _SUN), 0.0)
    points = origin + directions * distance[:, None]
    x, y, z = np.floor(12.0 * points.T).astype(np.int32)
    grain = x * np.int32(73856093) ^ y * np.int32(19349663) ^ z * np.int32(83492791)
    grain = (grain ^ grain >> 15) * np.int32(739982445)
    grain = (grain >> 12) & 255
    light *= 0.92 + 0.16 * (grain.astype(np.float32) / 255.0)
    haze = (1.0 - np.exp(-distance / 220.0))[:, None]
    colour = colours * light[:, None] * (1.0 - haze) + haze * _HAZE
    up = np.clip(directions[:, 2:3].astype(np.float32) * 2.0, 0.0, 1.0)
    sky = (1 - up) * _HORIZON + up * _ZENITH
    colour = np.where(hit[:, None], colour, sky)
    return (235.0 * np.sqrt(np.clip(colour, 0, 1))).astype(np.uint8)
