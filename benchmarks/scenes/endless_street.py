"""A street without end, made piece by piece: what stands on a piece, and who meets the ego there.

A piece depends on the seed and its number alone. So any part of the street is made again bit for
bit, and nothing has to be kept of what was passed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from docdepth.synthetic.actors import Actor, Pace, Path
from docdepth.synthetic.mesh import Mesh, merged
from docdepth.synthetic.road import Floats, Road
from docdepth.synthetic.street import Street, waves
from docdepth.synthetic.urban_street import add_furniture, add_houses, away_from, blocks, urban_road
from scenes.moving import arrive, rounded

TILE = 600.0
"""The road repeats its bends and hills after this length [m]."""

PIECE = 60.0
"""Length of a piece of the street [m]."""

SPEED = 9.0
"""Of the ego, in the mean [m/s]."""

LANE = 1.75
"""Centre of a lane, from the centre line [m]."""

_KERB, _WALK = 5.6, 9.6  # from the centre line [m]
_JUNCTIONS = ((150.0, 5.0), (450.0, 5.0))  # of a tile: s and half width [m]; inside of pieces
_APART = 150.0  # metres from the ego where actors come and go, unseen
_ACTORS = 16  # numbers of a piece
_BEFORE = 1000  # pieces before the first, whose passers are seen from it
_NUMBERS = 30000  # instances of actors, and those of parked cars, come round after so many


@dataclass(frozen=True)
class EndlessRoad(Road):
    """A road from 0 on, of which each tile is the one before, moved and turned by ``turn`` [rad].

    With a turn of 360 degrees over a whole number it comes back to where it began.
    """

    turn: float = 0.0

    def point(self, s: ArrayLike, d: ArrayLike, above: float = 0.0) -> Floats:
        s, d = np.broadcast_arrays(np.asarray(s, np.float64), np.asarray(d, np.float64))
        tile = np.floor(s / self.end)
        x, y, z = np.moveaxis(super().point(s - tile * self.end, d, above), -1, 0)
        # Each tile begins where the one before ends: a sum of turned steps.
        step = complex(*(np.interp(self.end, self.line[:, 0], self.line[:, k]) for k in (1, 2)))
        turned = np.exp(1j * self.turn * tile)
        begin = step * (tile if not self.turn else (turned - 1) / (np.exp(1j * self.turn) - 1))
        place = begin + turned * (x + 1j * y)
        return np.stack([place.real, place.imag, z], axis=-1)

    def cuts_between(self, start: float, end: float) -> Sequence[float]:
        tile = self.end * np.floor(start / self.end)
        return [cut + tile for cut in self.s_cuts if start < cut + tile < end]


def endless_road(turn: float) -> EndlessRoad:
    """A street with kerbs that climbs and bends; each tile turns it by ``turn`` [rad]."""
    bends = waves((0.10, 300.0, 0.4), (0.05, 200.0, 2.0))
    hills = ((5.0, 600.0, 0.0), (1.2, 200.0, 1.0), (0.2, 75.0, 0.3))
    tile = urban_road(0.0, TILE, (), hills, _KERB, _WALK, _JUNCTIONS, parking=3.5)

    def heading(s: Floats) -> Floats:
        return np.asarray(bends(s) + turn * np.asarray(s) / TILE)

    def profile(s: Floats, d: Floats) -> Floats:
        return tile.profile(np.mod(s, TILE), d)

    def paint(s: Floats, d: Floats) -> NDArray[np.int64]:
        return tile.paint(np.mod(s, TILE), d)

    form = (heading, tile.elevation, profile, paint, tile.paints, tile.d_cuts, tile.s_cuts)
    return EndlessRoad(0.0, TILE, *form, turn=turn)


class Passer(NamedTuple):
    """An actor, its instance, and the seconds of the drive in which the ego may see it."""

    actor: Actor
    instance: int
    begin: float
    end: float


class EndlessStreet:
    """The pieces of a street.

    Parameters
    ----------
    seed : int
    tiles : int
        After so many the street comes back to where it began: what stands there is the same, the
        traffic is not.
    turn_deg : float, optional
        Of a tile. With another than 360 over ``tiles`` the same houses stand beside the first ones.
    """

    def __init__(self, seed: int, tiles: int, turn_deg: float | None = None) -> None:
        turn = 2 * np.pi / tiles if turn_deg is None else np.radians(turn_deg)
        self.seed, self.road = seed, endless_road(float(turn))
        self._comes_back = turn_deg is None
        self._pieces = round(tiles * TILE / PIECE)

    def static(self, piece: int) -> Mesh:
        """The ground of a piece and what stands on it, frame of the road."""
        number = piece % self._pieces
        rng = np.random.default_rng([self.seed, 1, number])
        street = Street(self.road, rng, instances=_NUMBERS + 40 * number % _NUMBERS)
        # A street that comes back is the same piece, made at the same place.
        start = PIECE * (number if self._comes_back else piece)
        end = start + PIECE
        tile = TILE * np.floor(start / TILE)
        junctions = [(s + tile, half) for s, half in _JUNCTIONS if start < s + tile < end]
        add_houses(street, blocks(start, end, junctions), _WALK, 13.0)
        add_furniture(street, start, end, _KERB, junctions, 0.6)
        for side in (-1.0, 1.0):
            spots = away_from(np.arange(start + 3, end - 3, 6.1), junctions, 7.0)
            if side > 0:  # some places are left to those that come and go
                spots = np.delete(spots, slice(2, 7))
            street.parked_row(spots, side * 4.55, 0.7, 0.0 if side < 0 else np.pi)
        return merged([self.road.ground(1.0, (start, end)), *street.meshes])

    def passers(self, piece: int) -> list[Passer]:
        """Those that the ego meets on a piece, by the second at which it comes there."""
        rng = np.random.default_rng([self.seed, 2, piece + _BEFORE])
        street, start, then = Street(self.road, rng), PIECE * piece, PIECE * piece / SPEED
        seen: list[tuple[float, float]] = []  # seconds before and after ``then``

        def meets(kind: str, s: float, d: float, speed: float) -> None:
            """One that goes along the road and is beside the ego at that time."""
            points = [(s, d), (s + np.sign(speed), d)]
            street.send(kind, points, Pace(abs(speed)), -abs(speed) * then)
            seen.append((_APART / abs(SPEED - speed), _APART / abs(SPEED - speed)))

        speed, d = ((1.2, -7.3), (-1.1, 7.7), (-1.4, -8.6))[piece % 3]
        meets("pedestrian", start + rng.uniform(0, PIECE), d, speed + rng.uniform(-0.2, 0.2))
        # Between parked cars, out of a house and into another.
        points = [(start + 24.4, 8.3), (start + 24.4, -8.3)]
        street.send("pedestrian", points, Pace(1.3), 11.0 - 1.3 * then)
        seen.append((_APART / 6, _APART / 6))
        if piece % 2 == 0 or piece % 5 == 2:
            meets("van" if rng.random() < 0.2 else "car", start, LANE, -rng.uniform(8.5, 10.0))
        else:
            s = start + 18.0
            leaves = [(s, 4.5), (s - 9.0, LANE), (s - 200.0, LANE)]
            street.send("car", leaves, Pace(8.0, departure=then - 3.0))
            arrives = rounded(
                [(s + 105.0, LANE), (s + 24.0, LANE), (s + 18.5, 4.5), (s + 15.0, 4.5)], 3.0
            )
            arrive(street, "car", arrives, 7.0, then - 2.0)
            seen += 2 * [(_APART / 7, _APART / 7)]
        if piece % 4 == 1:
            meets("cyclist", start, -3.05, 4.6)
        if piece % 5 == 2:  # at the junction a car crosses before the ego
            s = start + 0.5 * PIECE + 1.8
            points = [(s, 95.0), (s, -95.0)]
            street.send("car", points, Pace(8.5), 80.0 - 8.5 * then)
            seen.append((_APART / 8, _APART / 8))
        first = 1 + _ACTORS * piece % _NUMBERS
        return [
            Passer(actor, first + k, then - before, then + after)
            for k, (actor, (before, after)) in enumerate(zip(street.actors, seen, strict=True))
        ]


def passes(begin: float, end: float) -> range:
    """The pieces whose passers may be seen between two seconds of the drive."""
    longest = _APART / (SPEED - 4.6)
    first = int((begin - longest) * SPEED // PIECE)
    return range(first, int((end + longest) * SPEED // PIECE) + 1)


def ego_path(road: EndlessRoad) -> Path:
    """Of the ego, on the right lane."""
    return Path(road, np.array([(0.0, -LANE), (1.0, -LANE)]), Pace(SPEED, wave=0.05))
