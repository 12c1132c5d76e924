"""Builds streets with kerbs and pavements: the road, rows of houses, trees and furniture."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from docdepth.synthetic import road_users, roadside
from docdepth.synthetic.mesh import Mesh
from docdepth.synthetic.road import Floats, Road
from docdepth.synthetic.street import PAINTS, Ground, Street, bumps, waves


def urban_road(
    start: float,
    end: float,
    heading: Sequence[tuple[float, float, float]],
    elevation: Sequence[tuple[float, float, float]],
    kerb: float,
    walk: float,
    junctions: Sequence[tuple[float, float]],
    parking: float = 99.0,
    yard: int = Ground.COURT,
) -> Road:
    """A street with camber, pavements and kerbs 12 cm high.

    Parameters
    ----------
    kerb, walk : float
        Start and end of the pavement, from the centre line [m].
    junctions : sequence of (s, half width)
        Crossing streets, which have no kerbs [m].
    parking : float
        Start of the parking strip, from the centre line [m].
    yard : int
        Index into ``PAINTS`` of what lies beyond the pavement.
    """
    lines = [(s - half, s + half) for s, half in junctions]

    def at_junction(s: Floats, margin: float = 0.0) -> NDArray[np.bool_]:
        inside = [(s > low - margin) & (s < high + margin) for low, high in lines]
        return np.any(inside, axis=0)

    def profile(s: Floats, d: Floats) -> Floats:
        across = np.abs(d)
        raised = (across > kerb) & ~at_junction(s)
        road = -0.02 * np.minimum(across, kerb)
        pavement = 0.12 + 0.02 * np.clip(across - kerb, 0, walk - kerb)
        far = np.clip((across - walk) / 3.0, 0.0, 1.0) * bumps(s, d) * (yard == Ground.GRASS)
        return road + np.where(raised, pavement + far, 0.0)

    def paint(s: Floats, d: Floats) -> NDArray[np.int64]:
        across = np.abs(d)
        crosswalk = at_junction(s, 4.0) & ~at_junction(s, 1.0)
        surfaces = (
            (crosswalk & (across < kerb - 0.3) & (np.mod(d, 1.0) < 0.5), Ground.MARKING),
            (at_junction(s), Ground.ASPHALT),
            ((across < 0.07) & (np.mod(s, 6.0) < 3.0), Ground.MARKING),
            ((across < kerb) & (across > parking), Ground.PARKING),
            (across < kerb, Ground.ASPHALT),
            (across < kerb + 0.15, Ground.KERB),
            ((across > walk) & ~at_junction(s, 3.0), yard),
        )
        where, what = zip(*surfaces, strict=True)
        return np.select(where, what, Ground.PAVEMENT)

    cuts = [0.0, 0.07, kerb - 0.01, kerb + 0.01, kerb + 0.15, walk, *np.arange(0.5, walk + 4, 0.5)]
    cuts += [parking] if parking < kerb else []
    cuts += [*np.arange(walk + 4, 30.0, 2.0), *np.arange(30.0, 96.0, 5.0)]
    sides = np.array(cuts)
    beside = (-4, -3, -1, -0.01, 0.01, 1, 3, 4)
    edges = [v + e for line in lines for v in line for e in beside]
    form = (waves(*heading), waves(*elevation), profile, paint, PAINTS)
    return Road(start, end, *form, np.concatenate([-sides, sides]).tolist(), edges)


def blocks(
    start: float, end: float, junctions: Sequence[tuple[float, float]]
) -> list[tuple[float, float]]:
    """Ranges of s between the junctions."""
    edges = [start, *(e for s, half in junctions for e in (s - half - 3, s + half + 3)), end]
    return list(zip(edges[::2], edges[1::2], strict=True))


def add_houses(street: Street, blocks: list[tuple[float, float]], face: float, tall: float) -> None:
    """Rows of houses on both sides, and more behind them along the crossing streets."""
    rng = street.rng
    for low, high in blocks:
        for side in (-1.0, 1.0):
            s = low
            while s < high - 7.0:
                length = min(float(rng.uniform(13, 24)), high - s)
                height = float(rng.uniform(0.7, 1.3)) * tall
                depth = float(rng.uniform(10, 13))
                setback = float(rng.choice([0.0, 0.0, 0.4, 1.2]))
                house = roadside.building(rng, length, depth, height, shop=rng.random() < 0.5)
                yaw = 0.0 if side > 0 else np.pi
                street.put(house, s + 0.5 * length, side * (face + setback + 0.5 * depth), yaw)
                s += length + float(rng.choice([0.0, 0.0, 0.0, 2.5]))
    for low, high in blocks:
        for side in (-1.0, 1.0):
            for d in np.arange(face + 23.0, 85.0, 17.0):
                for s in (low + 5.0, high - 5.0):
                    house = roadside.building(rng, 10.0, 15.0, float(rng.uniform(0.7, 1.2)) * tall)
                    street.put(house, s, side * d)


def away_from(spots: Floats, junctions: Sequence[tuple[float, float]], margin: float) -> Floats:
    """The positions s that are at least ``margin`` metres away from all junctions."""
    keep = np.ones(len(spots), bool)
    for s, half in junctions:
        keep &= np.abs(spots - s) > half + margin
    return spots[keep]


def add_furniture(
    street: Street,
    start: float,
    end: float,
    kerb: float,
    junctions: Sequence[tuple[float, float]],
    trees: float,
) -> None:
    """Trees, lamps, signs, bollards, refuse bins, bicycles and traffic lights."""
    rng = street.rng

    def free(first: float, step: float, margin: float) -> Floats:
        return away_from(np.arange(start + first, end, step), junctions, margin)

    def tree() -> Mesh:
        return roadside.tree(rng, float(rng.uniform(6, 9.5)))

    for side in (-1.0, 1.0):
        yaw = np.pi if side > 0 else 0.0
        signs, bins = np.arange(start + 20, end, 31.0), np.arange(start + 7, end, 17.0)
        for make, spots, d, chance, jitter, turn in (
            (tree, free(5 + 4 * side, 13.0, 6.0), 0.8, trees, 0.8, 0.0),
            (partial(roadside.pole, 7.0, 1.5), free(11 + 8 * side, 26.0, 3.0), 0.5, 1.0, 0.2, yaw),
            (lambda: roadside.sign(rng), signs, 0.4, 0.8, 3.0, yaw),
            (roadside.bollard, free(0, 2.5, 1.0), 0.3, 0.12, 0.1, 0.0),
            (lambda: roadside.refuse_bin(rng), bins, 3.6, 0.5, 2.0, 0.0),
            (road_users.bicycle, bins + 8.0, 3.7, 0.6, 2.0, 0.0),
        ):
            street.row(make, spots, side * (kerb + d), chance, jitter, turn)
    for s, half in junctions:
        for side in (-1.0, 1.0):
            yaw = 0.0 if side < 0 else np.pi
            street.put(roadside.traffic_light(), s + side * (half + 0.6), side * (kerb + 0.5), yaw)
