"""Beams that are wider than a line, and ghost returns around what reflects very well."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth.synthetic.casting import Hits, Rays, World

Floats = NDArray[np.float64]

_RING = 0.7
"""Six rays of a beam stand around the middle one, so far out as a share of half its width."""

_RING_POWER = float(np.exp(-2 * _RING**2))
"""What each carries of the power of the middle one: a Gaussian beam, whose width is where the
intensity has fallen to 1/e^2."""

_PULSE = 0.45
"""Echoes nearer to each other than this merge [m]: a pulse of 3 ns."""


def cast_beams(world: World, rays: Rays, width: float, limit: float) -> Hits:
    """The strongest echo of each beam.

    At the edge of an object a part of the beam passes. Then the echo of the object or that of what
    stands behind is the stronger one. Where both are nearer to each other than a pulse, they are
    one echo in between.

    Parameters
    ----------
    width : float
        Full angle of a beam [rad].
    limit : float
        Nothing returns from beyond [m].

    Returns
    -------
    Hits
        ``range`` is the mean over the echo; the rest is that of the ray that gives it most.
    """
    hits = [world.cast(some, limit) for some in _spread(rays, width)]
    ranges = np.stack([hit.range for hit in hits], axis=1)
    power = np.stack([_echo(world, hit) for hit in hits], axis=1)
    power[:, 1:] *= _RING_POWER
    order = np.argsort(ranges, axis=1)
    ranges, power = (np.take_along_axis(values, order, axis=1) for values in (ranges, power))
    with np.errstate(invalid="ignore"):  # inf - inf
        echo = np.cumsum(np.diff(ranges, axis=1, prepend=ranges[:, :1]) > _PULSE, axis=1)
    shares = [np.where(echo == n, power, 0).sum(axis=1) for n in range(len(hits))]
    strongest = np.argmax(shares, axis=0)
    of_ray = np.where(echo == strongest[:, None], power, 0)
    total = of_ray.sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = np.where(of_ray > 0, of_ray * ranges, 0).sum(axis=1) / total
    rows = np.arange(len(rays))
    source = order[rows, of_ray.argmax(axis=1)]

    def of_source(name: str) -> Any:
        return np.stack([getattr(hit, name) for hit in hits])[source, rows]

    others = ("face", "labels", "speed", "cosine", "normals")
    return Hits(np.where(total > 0, mean, np.inf), **{name: of_source(name) for name in others})


def _spread(rays: Rays, width: float) -> list[Rays]:
    """The middle of each beam, and six rays around it."""
    middle = rays.directions
    side = np.cross(middle, (0.0, 0.0, 1.0))  # a beam straight up stays a line
    side /= np.maximum(np.linalg.norm(side, axis=1, keepdims=True), 1e-9)
    up = np.cross(middle, side)
    spread = [rays]
    for angle in np.arange(6) * np.pi / 3:
        aside = np.tan(_RING * width / 2) * (np.cos(angle) * side + np.sin(angle) * up)
        turned = (middle + aside) / np.sqrt(1 + np.einsum("ij,ij->i", aside, aside))[:, None]
        spread.append(Rays(rays.origins, turned, rays.times, rays.which))
    return spread


def _echo(world: World, hits: Hits) -> Floats:
    """How strongly each ray returns; as in :meth:`~docdepth.synthetic.sensors.Sensor.returned`."""
    reflectivity = world.surface["reflectivity"][hits.face].astype(np.float64)
    return reflectivity * np.sqrt(np.maximum(hits.cosine, 1e-3)) / hits.range**2


def with_blooming(
    hits: Hits,
    reflectivity: NDArray[np.float32],
    directions: Floats,
    blooming: float,
    rng: np.random.Generator,
) -> tuple[Hits, NDArray[np.float32]]:
    """Add ghost returns around retro-reflectors, up to ``blooming`` radians from them.

    A ray that passes close to a retro-reflector returns weakly from its range; the closer, the more
    likely. Ghost returns have class 1 (outlier) and no speed.
    """
    bright = np.flatnonzero((reflectivity > 1) & np.isfinite(hits.range))
    if not len(bright):
        return hits, reflectivity
    source, cosine = np.empty(len(directions), np.int64), np.empty(len(directions))
    for rows in np.array_split(np.arange(len(directions)), len(directions) // 8192 + 1):
        cosines = directions[rows] @ directions[bright].T
        source[rows], cosine[rows] = bright[cosines.argmax(axis=1)], cosines.max(axis=1)
    ghost = rng.random(len(cosine)) < 1 - np.arccos(np.clip(cosine, -1, 1)) / blooming
    ghost &= (reflectivity <= 1) & (hits.range > hits.range[source] + 0.3)
    values = replace(
        hits,
        range=np.where(ghost, hits.range[source], hits.range),
        cosine=np.where(ghost, 1, hits.cosine),
        labels=np.where(ghost, 1, hits.labels).astype(hits.labels.dtype),
        speed=np.where(ghost, 0, hits.speed).astype(hits.speed.dtype),
    )
    return values, np.where(ghost, 0.3, reflectivity).astype(np.float32)
