"""Builds scenes: objects stand on a road, actors move along it."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from docdepth.synthetic import road_users
from docdepth.synthetic.actors import Actor, Pace, Part, Path, SpeedProfile
from docdepth.synthetic.mesh import Mesh, Paint, merged
from docdepth.synthetic.road import Floats, Road

Ground = IntEnum("Ground", "ASPHALT MARKING PAVEMENT GRASS PARKING COURT KERB", start=0)
"""What the ground is made of, as an index into :data:`PAINTS`."""
PAINTS = (
    Paint(40, (0.30, 0.30, 0.31), 0.17),
    Paint(60, (0.85, 0.85, 0.82), 0.6),
    Paint(48, (0.55, 0.53, 0.50), 0.3),
    Paint(72, (0.33, 0.42, 0.18), 0.4),
    Paint(44, (0.38, 0.37, 0.37), 0.2),
    Paint(49, (0.48, 0.46, 0.41), 0.3),
    Paint(48, (0.66, 0.65, 0.62), 0.35),
)


@dataclass(frozen=True)
class Scene:
    """A street, its static objects and its actors.

    Attributes
    ----------
    static : Mesh
        Everything that never moves, world frame [m].
    ego : Path
        Path of the point on the road below the LiDAR.
    duration : float
        Time after 0 for which the street is long enough [s].
    """

    name: str
    static: Mesh
    actors: list[Actor]
    ego: Path
    duration: float


@dataclass
class Street:
    """Collects the parts of a scene."""

    road: Road
    rng: np.random.Generator
    meshes: list[Mesh] = field(default_factory=list)
    actors: list[Actor] = field(default_factory=list)
    instances: int = 1000

    def put(self, mesh: Mesh, s: float, d: float, yaw: float = 0.0, above: float = 0.0) -> None:
        """Place an upright object on the ground."""
        self.meshes.append(mesh.moved(self.road.upright(s, d, yaw, above)))

    def park(self, mesh: Mesh, s: float, d: float, yaw: float = 0.0) -> None:
        """Place a parked vehicle on its wheels, as an instance of its own."""
        self.instances += 1
        surface = mesh.surface.copy()
        surface["label"] |= np.uint32(self.instances << 16)
        pose = self.road.resting(s, d, yaw, 2.6, 1.5)
        self.meshes.append(replace(mesh.moved(pose), surface=surface))

    def send(
        self,
        kind: str,
        points: ArrayLike,
        pace: SpeedProfile,
        start: float = 0.0,
        name: str = "",
        parts: Sequence[Part] = (),
    ) -> None:
        """Add an actor that moves along the points (s, d); with parts of its own if it has any."""
        make, label, moving, length, width = KINDS[kind]
        path = Path(self.road, points, pace, start, length, width)
        name = name or f"{kind} {len(self.actors) + 1}"
        self.actors.append(Actor(name, parts or make(self.rng), path, label, moving))

    def walk(self, s: float, d: float, speed: float) -> None:
        """Add a pedestrian along the road from (s, d); with a negative speed, against the road."""
        points = [(s, d), (s + (20.0 if speed > 0 else -20.0), d)]
        self.send("pedestrian", points, Pace(abs(speed), wave=0.05, period=5.0))

    def row(
        self,
        make: Callable[[], Mesh],
        spots: Sequence[float] | NDArray[np.float64],
        d: float,
        chance: float = 1.0,
        jitter: float = 0.3,
        yaw: float = 0.0,
    ) -> None:
        """Place objects of one kind along the road, each with a probability and a jitter."""
        for s in spots:
            keep, shift = self.rng.random() < chance, self.rng.normal(0, jitter, 2)
            if keep:
                self.put(make(), float(s + shift[0]), float(d + 0.3 * shift[1]), yaw)

    def parked_row(
        self, spots: Sequence[float] | NDArray[np.float64], d: float, chance: float, yaw: float
    ) -> None:
        """Place parked cars and some vans, with gaps and slightly out of line."""
        for s in spots:
            if self.rng.random() < chance:
                make = road_users.car if self.rng.random() < 0.88 else road_users.van
                shift = self.rng.normal(0, (0.2, 0.06, 0.015))
                self.park(make(self.rng), s + shift[0], d + shift[1], yaw + shift[2])

    def scene(self, name: str, ego: Path, duration: float, step: float = 1.0) -> Scene:
        """The finished scene."""
        static = merged([self.road.ground(step), *self.meshes])
        return Scene(name, static, self.actors, ego, duration)


KINDS: dict[str, tuple[Callable[[np.random.Generator], list[Part]], int, int, float, float]] = {
    "car": (lambda rng: [Part(road_users.car(rng))], 10, 252, 2.6, 1.5),
    "van": (lambda rng: [Part(road_users.van(rng))], 20, 259, 3.2, 1.7),
    "cyclist": (road_users.cyclist, 31, 253, 1.04, 0.1),
    "pedestrian": (road_users.pedestrian, 30, 254, 0.4, 0.2),
}
"""Parts, label, label while it moves, and distance of the wheels along and across [m] by kind."""


def generator(name: str, seed: int) -> np.random.Generator:
    """A random generator that depends only on the name of the scene and the seed."""
    return np.random.default_rng([zlib.crc32(name.encode()), seed])


def waves(*terms: tuple[float, float, float]) -> Callable[[Floats], Floats]:
    """A smooth function of ``s``: a sum of sines (amplitude, wavelength, phase)."""

    def value(s: Floats) -> Floats:
        s = np.asarray(s, np.float64)
        sines = (a * np.sin(2 * np.pi * s / length + phase) for a, length, phase in terms)
        return sum(sines, np.zeros(s.shape))

    return value


def bumps(s: Floats, d: Floats) -> Floats:
    """Height of uneven ground, about 3 cm up and down [m]."""
    first = np.sin(0.9 * s + 1.3 * np.sin(0.37 * d)) * np.sin(1.1 * d + 0.8)
    second = np.sin(2.1 * s - 0.7 * d) * np.sin(1.7 * d + 0.5 * s)
    return 0.02 * first + 0.015 * second
