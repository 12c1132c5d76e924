"""Moving objects: a path on the road, a speed profile, and swinging parts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from docdepth.geometry.track import Kind
from docdepth.synthetic.mesh import Mesh
from docdepth.synthetic.road import Floats, Road, resting_poses

# SemanticKITTI: a moving bicyclist, person and motorcyclist.
_PEOPLE = (253, 254, 255)

Swing = Callable[[Floats, Floats, Floats], Floats]
"""Poses (n, 4, 4) in the actor's frame, from times [s], distances [m] and speeds [m/s], (n,)."""


class SpeedProfile(Protocol):
    """How far something has travelled, and how fast it is, at times [s]."""

    def distance(self, times: ArrayLike) -> Floats:
        """Distance travelled [m]."""

    def at(self, times: ArrayLike) -> Floats:
        """Speed [m/s]."""


@dataclass(frozen=True)
class Pace:
    """Speed profile: stands until ``departure``, then accelerates up to ``speed``."""

    speed: float  # final speed [m/s]
    departure: float = -np.inf  # start of the motion [s]; minus infinity = has always been moving
    acceleration: float = 1.8  # [m/s^2]
    wave: float = 0.0  # amplitude of a speed variation, as a share of ``speed``
    period: float = 7.0  # period of that variation [s]

    def distance(self, times: ArrayLike) -> Floats:
        """Distance travelled by ``times`` [s], metres; 0 at time 0 if it has always been moving."""
        t = np.asarray(times, np.float64)
        if np.isinf(self.departure):
            turn = 2 * np.pi / self.period
            return self.speed * (t + self.wave * np.sin(turn * t) / turn)
        ramp = self.speed / self.acceleration
        since = np.clip(t - self.departure, 0.0, None)
        gaining = np.minimum(since, ramp)
        return 0.5 * self.acceleration * gaining**2 + self.speed * (since - gaining)

    def at(self, times: ArrayLike) -> Floats:
        """Speed at ``times`` [s], m/s."""
        t = np.asarray(times, np.float64)
        half = 1e-3
        return (self.distance(t + half) - self.distance(t - half)) / (2 * half)


@dataclass(frozen=True)
class Path:
    """A polyline of points (s, d) on the road, travelled with a speed profile."""

    road: Road
    points: ArrayLike  # (k, 2)
    pace: SpeedProfile
    start: float = 0.0  # position along the path at which the distance of ``pace`` is 0 [m]
    # length, width: distances between the four points that rest on the ground [m]; corners are
    # rounded over ``length``
    length: float = 2.6
    width: float = 1.5

    def along(self, distance: Floats) -> Floats:
        """Points (s, d) at a distance along the path, which extends straight beyond its ends."""
        points = np.asarray(self.points, np.float64)
        step = np.diff(points, axis=0)
        length = np.linalg.norm(step, axis=1)
        knots = np.concatenate([[0.0], np.cumsum(length)])
        piece = np.clip(np.searchsorted(knots, distance, side="right") - 1, 0, len(step) - 1)
        share = (distance - knots[piece]) / length[piece]
        return points[piece] + share[..., None] * step[piece]

    def distance(self, times: ArrayLike) -> Floats:
        """Position along the path at ``times`` [s], metres."""
        return self.start + self.pace.distance(times)

    def poses(self, times: ArrayLike) -> Floats:
        """``T_world_actor`` (n, 4, 4); x forward, z up, origin on the ground."""
        distance = self.distance(np.atleast_1d(times))
        front = self.along(distance + 0.5 * self.length)
        rear = self.along(distance - 0.5 * self.length)
        forward = front - rear
        forward = forward / np.linalg.norm(forward, axis=1, keepdims=True)
        left = 0.5 * self.width * np.stack([-forward[:, 1], forward[:, 0]], axis=1)
        centre = 0.5 * (front + rear)
        ends = [front, rear, centre + left, centre - left]
        points = self.road.point(*np.concatenate(ends).T)
        return resting_poses(*points.reshape(4, -1, 3))


@dataclass(frozen=True)
class Part:
    """A rigid part of an actor; ``swing`` gives its poses (n, 4, 4) from time, distance, speed."""

    mesh: Mesh
    swing: Swing | None = None


@dataclass(frozen=True)
class Actor:
    """An object that moves or may move."""

    name: str
    parts: Sequence[Part]
    path: Path
    label: int  # SemanticKITTI class if it never moves during the drive
    moving_label: int  # SemanticKITTI class if it moves at any time of the drive

    @cached_property
    def radius(self) -> float:
        """Of a sphere around its origin that holds its parts wherever they swing [m]."""
        return 0.3 + max(float(np.linalg.norm(p.mesh.vertices, axis=1).max()) for p in self.parts)

    @property
    def box(self) -> tuple[Floats, Floats]:
        """Low and high corner of its parts at rest, in its own frame [m]."""
        vertices = np.concatenate([part.mesh.vertices for part in self.parts]).astype(np.float64)
        return vertices.min(axis=0), vertices.max(axis=0)

    @property
    def kind(self) -> Kind:
        """What it is, by its SemanticKITTI class: person or cyclist, else a vehicle."""
        return "person" if self.moving_label in _PEOPLE else "vehicle"

    def speed(self, times: ArrayLike) -> Floats:
        """Speed at ``times`` [s], m/s, shape (n,)."""
        return self.path.pace.at(np.atleast_1d(times))

    def moves_between(self, start: float, end: float) -> bool:
        """Whether it travels more than 5 cm between two times [s]."""
        covered = self.path.distance(np.linspace(start, end, 101))
        return bool(np.ptp(covered) > 0.05)

    def part_poses(self, times: NDArray[np.float64]) -> list[Floats]:
        """``T_world_part`` (n, 4, 4) of each part at ``times`` [s]."""
        poses = self.path.poses(times)
        distance, speed = self.path.distance(times), self.speed(times)
        return [
            poses if part.swing is None else poses @ part.swing(times, distance, speed)
            for part in self.parts
        ]


def swinging(pivot: ArrayLike, amplitude: float, stride: float, phase: float) -> Swing:
    """A limb that swings around the y axis through ``pivot``, once per ``stride`` metres."""
    x, _, z = np.asarray(pivot, np.float64)

    def swing(times: Floats, distance: Floats, speed: Floats) -> Floats:
        # The amplitude fades below 0.5 m/s, so that limbs rest while the person stands.
        angle = amplitude * np.clip(speed / 0.5, 0.0, 1.0)
        angle = angle * np.sin(2 * np.pi * distance / stride + phase)
        poses = np.zeros((len(angle), 4, 4))
        cos, sin = np.cos(angle), np.sin(angle)
        poses[:, 0, 0], poses[:, 0, 2] = cos, sin
        poses[:, 2, 0], poses[:, 2, 2] = -sin, cos
        poses[:, 1, 1] = poses[:, 3, 3] = 1.0
        poses[:, 0, 3] = x - cos * x - sin * z
        poses[:, 2, 3] = z + sin * x - cos * z
        return poses

    return swing
