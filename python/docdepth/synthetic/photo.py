"""The camera: exact depth and classes of every pixel, and a picture good enough to look at."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from docdepth.render import Camera
from docdepth.synthetic.casting import Hits, Rays, World

Floats = NDArray[np.float64]
_FAR = 300.0
_SUN = np.array((0.45, 0.35, 0.82)) / np.linalg.norm((0.45, 0.35, 0.82))


@dataclass(frozen=True)
class View:
    """What the camera sees.

    Attributes
    ----------
    depth : ndarray of float32, shape (h, w)
        Metres along the optical axis; NaN where there is no surface.
    labels : ndarray of uint32, shape (h, w)
        As of a sweep's points; 0 for the sky.
    speed : ndarray of float32, shape (h, w)
    colour : ndarray of uint8, shape (h, w, 3)
        Red, green, blue.
    """

    depth: NDArray[np.float32]
    labels: NDArray[np.uint32]
    speed: NDArray[np.float32]
    colour: NDArray[np.uint8]


def photograph(world: World, camera: Camera, T_scene_camera: Floats, second: float) -> View:
    """Cast a ray through the centre of every pixel at one moment."""
    shape = (camera.height, camera.width)
    v, u = np.indices(shape, dtype=np.float64).reshape(2, -1)
    K = camera.K
    y = (v - K[1, 2]) / K[1, 1]
    x = (u - K[0, 2] - K[0, 1] * y) / K[0, 0]
    local = np.stack([x, y, np.ones(len(x))], axis=1)
    along = 1.0 / np.sqrt(x * x + y * y + 1.0)  # depth of a point one metre along the ray
    directions = (local * along[:, None]) @ T_scene_camera[:3, :3].T
    origins = np.broadcast_to(T_scene_camera[:3, 3], directions.shape)
    which = np.zeros(len(directions), np.int64)
    hits = world.cast(Rays(origins, directions, np.array([second]), which), _FAR)
    depth = np.where(np.isfinite(hits.range), hits.range * along, np.nan)
    colour = _shade(hits, origins, directions)
    return View(
        depth.reshape(shape).astype(np.float32),
        hits.labels.reshape(shape),
        hits.speed.reshape(shape),
        colour.reshape(*shape, 3),
    )


def _shade(hits: Hits, origins: Floats, directions: Floats) -> NDArray[np.uint8]:
    """Sunlight, a little grain that sticks to surfaces, haze, and a sky."""
    met = np.isfinite(hits.range)
    distance = np.where(met, hits.range, 0.0).astype(np.float32)
    light = 0.5 + 0.5 * np.maximum(hits.normals @ _SUN.astype(np.float32), 0.0)
    places = (origins + directions * distance[:, None]).astype(np.float32)
    cells = np.floor(places * np.float32(12.0)).astype(np.int64)
    grain = (cells @ np.array([73856093, 19349663, 83492791])) & 255
    light *= 0.92 + 0.16 * (grain.astype(np.float32) / 255.0)
    haze = (1.0 - np.exp(-distance / 220.0))[:, None]
    colour = hits.colours * light[:, None] * (1.0 - haze) + haze * np.float32((0.78, 0.83, 0.9))
    up = np.clip(directions[:, 2:3].astype(np.float32) * 2.0, 0.0, 1.0)
    sky = (1 - up) * np.float32((0.80, 0.86, 0.93)) + up * np.float32((0.40, 0.58, 0.85))
    colour = np.where(met[:, None], colour, sky)
    return np.clip(255.0 * np.sqrt(np.clip(colour, 0, 1)) * 0.92, 0, 255).astype(np.uint8)
