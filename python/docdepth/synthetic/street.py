"""Builds scenes: objects stand on a road, actors move along it."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from docdepth.synthetic import road_users
from docdepth.synthetic.actors import Actor, Pace, Part, Path, Speeds
from docdepth.synthetic.mesh import Mesh, Paint, merged
from docdepth.synthetic.road import Floats, Road

ASPHALT = Paint(40, (0.30, 0.30, 0.31), 0.17)
MARKING = Paint(60, (0.85, 0.85, 0.82), 0.6)
PAVEMENT = Paint(48, (0.55, 0.53, 0.50), 0.3)
GRASS = Paint(72, (0.33, 0.42, 0.18), 0.4)
PARKING = Paint(44, (0.38, 0.37, 0.37), 0.2)
COURT = Paint(49, (0.48, 0.46, 0.41), 0.3)
KERB = Paint(48, (0.66, 0.65, 0.62), 0.35)
PAINTS = (ASPHALT, MARKING, PAVEMENT, GRASS, PARKING, COURT, KERB)


@dataclass(frozen=True)
class Scene:
    """A street, its static objects and its actors.

    Attributes
    ----------
    name : str
    seed : int
    static : Mesh
        Everything that never moves, world frame [m].
    actors : list of Actor
    ego : Path
        Path of the point on the road below the LiDAR.
    duration : float
        Time after 0 for which the street is long enough [s].
    """

    name: str
    seed: int
    static: Mesh
    actors: list[Actor]
    ego: Path
    duration: float


@dataclass
class Street:
    """Collects the parts of a scene.

    Attributes
    ----------
    road : Road
    rng : Generator
    """

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
        labels = mesh.labels | np.uint32(self.instances << 16)
        mesh = Mesh(mesh.vertices, mesh.faces, labels, mesh.colours, mesh.reflectivity)
        self.meshes.append(mesh.moved(self.road.resting(s, d, yaw, 2.6, 1.5)))

    def send(
        self,
        kind: str,
        points: ArrayLike,
        pace: Pace | Speeds,
        start: float = 0.0,
        name: str = "",
        parts: Sequence[Part] = (),
    ) -> None:
        """Add an actor that moves along the points (s, d); with parts of its own if it has any."""
        make, label, moving, length, width = KINDS[kind]
        path = Path(self.road, np.asarray(points, np.float64), pace, start, length, width)
        name = name or f"{kind} {len(self.actors) + 1}"
        self.actors.append(Actor(name, parts or make(self.rng), path, label, moving))

    def arrive(
        self,
        kind: str,
        points: ArrayLike,
        speed: float,
        stop: float,
        deceleration: float = 2.0,
        name: str = "",
    ) -> None:
        """Add an actor that stands at the end of the points from ``stop`` [s] on."""
        pace = Speeds((stop - speed / deceleration, stop), (speed, 0.0))
        along = np.linalg.norm(np.diff(np.asarray(points, np.float64), axis=0), axis=1).sum()
        start = float(along - pace.distance(stop))
        self.send(kind, points, pace, start, name or f"{kind} that arrives")

    def walk(self, s: float, d: float, speed: float, to: float | None = None) -> None:
        """Add a pedestrian along the road from (s, d); with a negative speed, against the road."""
        sign = 1.0 if speed > 0 else -1.0
        points = [(s, d), (s + sign * 20.0, d if to is None else to)]
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

    def scene(self, name: str, seed: int, ego: Path, duration: float, step: float = 1.0) -> Scene:
        """The finished scene."""
        static = merged([self.road.ground(step), *self.meshes])
        return Scene(name, seed, static, self.actors, ego, duration)


def _one(mesh: Mesh) -> list[Part]:
    return [Part(mesh)]


KINDS: dict[str, tuple[Callable[[np.random.Generator], list[Part]], int, int, float, float]] = {
    "car": (lambda rng: _one(road_users.car(rng, 10)), 10, 252, 2.6, 1.5),
    "van": (lambda rng: _one(road_users.van(rng, 20)), 20, 259, 3.2, 1.7),
    "truck": (lambda rng: _one(road_users.truck(rng, 18)), 18, 258, 5.5, 2.1),
    "cyclist": (lambda rng: road_users.cyclist(rng, 31), 31, 253, 1.04, 0.1),
    "pedestrian": (lambda rng: road_users.pedestrian(rng, 30), 30, 254, 0.4, 0.2),
}
"""Parts, label, label while it moves, and distance of the wheels along and across [m] by kind."""


def generator(name: str, seed: int) -> np.random.Generator:
    """A random generator that depends only on the name of the scene and the seed."""
    return np.random.default_rng([zlib.crc32(name.encode()), seed])


def waves(*terms: tuple[float, float, float]) -> Callable[[Floats], Floats]:
    """A smooth function of ``s``: a sum of sines (amplitude, wavelength, phase)."""

    def value(s: Floats) -> Floats:
        s = np.asarray(s, np.float64)
        total = np.zeros(s.shape)
        for amplitude, length, phase in terms:
            total = total + amplitude * np.sin(2 * np.pi * s / length + phase)
        return total

    return value


def bumps(s: Floats, d: Floats) -> Floats:
    """Height of uneven ground, about 3 cm up and down [m]."""
    first = np.sin(0.9 * s + 1.3 * np.sin(0.37 * d)) * np.sin(1.1 * d + 0.8)
    second = np.sin(2.1 * s - 0.7 * d) * np.sin(1.7 * d + 0.5 * s)
    result: Floats = 0.02 * first + 0.015 * second
    return result


def level_road(start: float = -150.0, end: float = 350.0) -> Road:
    """A plane: x = s, y = d, z = 0."""

    def nothing(s: Floats, d: Floats | None = None) -> Floats:
        return np.zeros(np.shape(s))

    def asphalt(s: Floats, d: Floats) -> NDArray[np.int64]:
        return np.zeros(np.shape(s), np.int64)

    cuts = np.linspace(-100.0, 100.0, 9).tolist()
    return Road(start, end, nothing, nothing, nothing, asphalt, PAINTS, cuts)


def plain_scene(
    static: Sequence[Mesh] = (),
    actors: Sequence[Actor] = (),
    speed: float = 0.0,
    duration: float = 30.0,
) -> Scene:
    """A small scene on a plane; the ego moves along x from the origin.

    Parameters
    ----------
    static : sequence of Mesh
        In the frame of the plane; ``Mesh.moved(pose_of(x, y, z, yaw))`` places them.
    actors : sequence of Actor
        For instance on paths along :func:`level_road`.
    speed : float
        Speed of the ego [m/s].
    """
    road = level_road(end=max(350.0, 150.0 + speed * duration))
    ground = road.ground(step=25.0)
    ego = Path(road, np.array([(0.0, 0.0), (1.0, 0.0)]), Pace(speed))
    return Scene("plain", 0, merged([ground, *static]), list(actors), ego, duration)
