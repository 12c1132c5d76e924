"""Builds streets with kerbs and pavements: the road, rows of houses, trees and furniture."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from docdepth.synthetic import houses, road_users, roadside
from docdepth.synthetic.road import Floats, Road
from docdepth.synthetic.street import PAINTS, Street, bumps, waves


def urban_road(
    start: float,
    end: float,
    heading: Sequence[tuple[float, float, float]],
    elevation: Sequence[tuple[float, float, float]],
    kerb: float,
    walk: float,
    junctions: Sequence[tuple[float, float]] = (),
    parking: float = 99.0,
    yard: int = 5,
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
        Material beyond the pavement, index into ``PAINTS``: 3 grass, 5 courtyards.
    """
    lines = [(s - half, s + half) for s, half in junctions]

    def open_to_traffic(s: Floats) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
        inside = np.zeros(np.shape(s), bool)
        for low, high in lines:
            inside |= (s > low) & (s < high)
        return inside

    def profile(s: Floats, d: Floats) -> Floats:
        across = np.abs(d)
        raised = (across > kerb) & ~open_to_traffic(s)
        road = -0.02 * np.minimum(across, kerb)
        pavement = 0.12 + 0.02 * np.clip(across - kerb, 0, walk - kerb)
        far = np.clip((across - walk) / 3.0, 0.0, 1.0) * bumps(s, d) * (yard == 3)
        result: Floats = road + np.where(raised, pavement + far, 0.0)
        return result

    def paint(s: Floats, d: Floats) -> np.ndarray[tuple[int, ...], np.dtype[np.int64]]:
        across, crossing = np.abs(d), open_to_traffic(s)
        beside = np.zeros(len(s), bool)
        for low, high in lines:
            beside |= (s > low - 3.0) & (s < high + 3.0)
        kind = np.where(across > walk, np.where(beside, 2, yard), 2)
        kind = np.where((across > kerb - 0.02) & (across < kerb + 0.15), 6, kind)
        kind = np.where(across < kerb, np.where(across > parking, 4, 0), kind)
        dashes = (across < 0.07) & (np.mod(s, 6.0) < 3.0)
        kind = np.where(dashes, 1, kind)
        kind = np.where(crossing, 0, kind)
        for low, high in lines:  # crosswalk stripes before and behind the junction
            stripes = ((s > low - 4) & (s < low - 1)) | ((s < high + 4) & (s > high + 1))
            kind = np.where(stripes & (across < kerb - 0.3) & (np.mod(d, 1.0) < 0.5), 1, kind)
        return kind.astype(np.int64)

    cuts = [0.0, 0.07, kerb - 0.01, kerb + 0.01, kerb + 0.15, walk, *np.arange(0.5, walk + 4, 0.5)]
    cuts += [parking] if parking < kerb else []
    cuts += [*np.arange(walk + 4, 30.0, 2.0), *np.arange(30.0, 96.0, 5.0)]
    sides = np.array(cuts)
    edges = [v + e for low, high in lines for v in (low, high) for e in (-0.01, 0.01)]
    edges += [v + e for low, high in lines for v in (low, high) for e in (-4, -3, -1, 1, 3, 4)]
    return Road(
        start,
        end,
        waves(*heading),
        waves(*elevation),
        profile,
        paint,
        PAINTS,
        np.concatenate([-sides, sides]).tolist(),
        edges,
    )


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
                house = houses.building(rng, length, depth, height, shop=rng.random() < 0.5)
                yaw = 0.0 if side > 0 else np.pi
                street.put(house, s + 0.5 * length, side * (face + setback + 0.5 * depth), yaw)
                s += length + float(rng.choice([0.0, 0.0, 0.0, 2.5]))
    for low, high in blocks:
        for side in (-1.0, 1.0):
            for d in np.arange(face + 23.0, 85.0, 17.0):
                for s in (low + 5.0, high - 5.0):
                    house = houses.building(rng, 10.0, 15.0, float(rng.uniform(0.7, 1.2)) * tall)
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
    rng = street.rng
    for side in (-1.0, 1.0):
        d = side * (kerb + 0.8)
        spots = away_from(np.arange(start + 5 + 4 * side, end, 13.0), junctions, 6.0)
        street.row(lambda: roadside.tree(rng, float(rng.uniform(6, 9.5))), spots, d, trees, 0.8)
        poles = away_from(np.arange(start + 11 + 8 * side, end, 26.0), junctions, 3.0)
        yaw = np.pi if side > 0 else 0.0
        street.row(partial(roadside.pole, 7.0, 1.5), poles, side * (kerb + 0.5), 1, 0.2, yaw)
        spots = np.arange(start + 20, end, 31.0)
        street.row(lambda: roadside.sign(rng), spots, side * (kerb + 0.4), 0.8, 3.0, yaw)
        street.row(
            roadside.bollard,
            away_from(np.arange(start, end, 2.5), junctions, 1.0),
            side * (kerb + 0.3),
            0.12,
            0.1,
        )
        spots = np.arange(start + 7, end, 17.0)
        street.row(lambda: roadside.refuse_bin(rng), spots, side * (kerb + 3.6), 0.5, 2.0)
        street.row(road_users.bicycle, spots + 8.0, side * (kerb + 3.7), 0.6, 2.0)
    for s, half in junctions:
        for side in (-1.0, 1.0):
            yaw = 0.0 if side < 0 else np.pi
            street.put(roadside.traffic_light(), s + side * (half + 0.6), side * (kerb + 0.5), yaw)
