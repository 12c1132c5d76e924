"""A drive through a street whose every point is known, as a dataset."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from docdepth.datasets import Sweep
from docdepth.geometry.se3 import inverse, se3_exp, se3_log
from lidar_rays import scan_rays

MOTION = se3_exp(np.array([0.002, -0.004, 0.06]), np.array([1.1, 0.05, -0.01]))


def nearest_box(
    origins: np.ndarray, directions: np.ndarray, low: np.ndarray, high: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Distance along rays to the first of boxes (inf: none), and which box it is."""
    best, which = np.full(len(directions), np.inf), np.zeros(len(directions), np.int64)
    # By rows of x, y and z: numpy is slow along a short last axis.
    start, along = np.atleast_2d(origins).T.copy(), directions.T.copy()
    with np.errstate(divide="ignore", invalid="ignore"):
        for k, (near, far) in enumerate(zip(low[..., None], high[..., None], strict=True)):
            a, b = (near - start) / along, (far - start) / along
            enter, leave = np.minimum(a, b).max(axis=0), np.maximum(a, b).min(axis=0)
            hit = (enter < leave) & (enter > 0) & (enter < best)
            best[hit], which[hit] = enter[hit], k
    return best, which


class Street:
    """Ground, facades, boxes along a street: rays against axis-aligned boxes, in plain numpy."""

    def __init__(self) -> None:
        rng = np.random.default_rng(5)
        boxes = [((-100, -100, -3), (200, 100, 0))]
        for side in (-1, 1):
            x = -60.0
            while x < 120:
                length, depth, gap = rng.uniform([6, 4, 1], [14, 9, 5])
                inner = rng.uniform(9, 13)
                y = sorted((side * inner, side * (inner + depth)))
                boxes.append(((x, y[0], 0), (x + length, y[1], rng.uniform(4, 12))))
                x += length + gap
            for x in np.arange(-50, 110, 8.0):
                car = side * rng.uniform(4.5, 5.0)
                boxes.append(((x, car - 0.9, 0), (x + rng.uniform(3.5, 5), car + 0.9, 1.5)))
        self.low = np.array([low for low, _ in boxes], dtype=np.float64)
        self.high = np.array([high for _, high in boxes], dtype=np.float64)

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Distance of points to the nearest surface."""
        nearest = np.full(len(points), np.inf)
        for low, high in zip(self.low, self.high, strict=True):
            beyond = np.maximum(np.maximum(low - points, points - high), 0)
            outside = np.linalg.norm(beyond, axis=1)
            inside = np.minimum(points - low, high - points).min(axis=1)
            nearest = np.minimum(nearest, np.where(outside > 0, outside, np.abs(inside)))
        return nearest


@dataclass
class Drive:
    """A spinning LiDAR on a screw motion through the street, as a dataset."""

    count: int
    motion: np.ndarray = field(default_factory=lambda: MOTION)
    raw: bool = True
    name: str = "exact"
    path: Path = Path("exact")
    poses: None = None

    def __post_init__(self) -> None:
        self.street = Street()
        self.cameras: dict = {}
        self.times = np.arange(self.count, dtype=np.int64) * 10**8
        start = np.eye(4)
        start[:3, 3] = (0, -1, 1.8)
        steps = [np.linalg.matrix_power(self.motion, k) for k in range(self.count)]
        self.exact = start @ np.array(steps)
        column = np.linspace(np.pi, -np.pi, 360, endpoint=False)
        self._rays = scan_rays(np.deg2rad(np.linspace(-24, 8, 24)), column).reshape(-1, 3)
        shares = column * (-0.5 / np.pi if self.raw else 0.0)
        omega, velocity = se3_log(self.motion)
        self._moved = np.array([se3_exp(f * omega, f * velocity) for f in shares])
        self._relative_time = np.tile(shares, 24).astype(np.float32)
        self.read: list[int] = []
        self._sweeps: dict[int, Sweep] = {}

    def __len__(self) -> int:
        return self.count

    def sweep_files(self, index: int) -> list[Path]:
        return []

    def labels(self, index: int) -> None:
        return None

    def sweep(self, index: int) -> Sweep:
        self.read.append(index)
        if index not in self._sweeps:
            self._sweeps[index] = self._measure(index)
        return self._sweeps[index]

    def _measure(self, index: int) -> Sweep:
        pose, ray = np.tile(self.exact[index] @ self._moved, (24, 1, 1)), self._rays
        direction = np.einsum("nij,nj->ni", pose[:, :3, :3], ray)
        street = self.street
        distance, _ = nearest_box(pose[:, :3, 3], direction, street.low, street.high)
        points = ray * np.where(np.isfinite(distance), distance, 0)[:, None]
        return Sweep(
            points.astype(np.float32),
            f"{index:06d}",
            int(self.times[index]),
            relative_time=self._relative_time.copy() if self.raw else None,
        )


def pose_errors(poses: np.ndarray, exact: np.ndarray) -> np.ndarray:
    """Distances between two trajectories that start in the same place, in metres."""
    return np.linalg.norm((poses - inverse(exact[0]) @ exact)[:, :3, 3], axis=1)
