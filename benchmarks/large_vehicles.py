"""Depth of vehicles higher than the beams: what of them is empty, and where the world is drawn.

    python benchmarks/large_vehicles.py drives -o large --seed 7 --images 20

Poses are exact, classes and tracks are the run's own. Counted are the pixels up to 80 m that show
a lorry, a bus or a trailer which moves and is at least 2.5 m high. A pixel is *empty* without
depth. It is the *world* if its depth lies behind the vehicle, and more than half a metre outside
its box. Its surface was *seen* if earlier sweeps had a return within 0.2 m of it, in the frame of
the vehicle, as rings of an HDL-64 are as far apart at 25 m, and one as high within 0.3 m of it:
nothing tells how far a surface goes on above the highest return.

After a change of the code, give another -o.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from cells import Cell, ExactDrive, add_cell_arguments, cells_of
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter
from scipy.spatial import cKDTree

from docdepth.config import Parameters, parameters
from docdepth.errors import DocDepthError
from docdepth.evaluation import Table
from docdepth.evaluation.tables import number
from docdepth.geometry.se3 import inverse
from docdepth.geometry.track import Track
from docdepth.render.scene import render_depth
from docdepth.synthetic import sensors

MIN_HEIGHT = 2.5
"""Of a large vehicle [m]."""

MARGIN = 0.5
"""Around the box of a vehicle [m]."""

SEEN = 0.2
"""Around a return that has seen the surface of a vehicle [m]."""

BESIDE, CELL = 0.3, 0.1
"""A return so near, seen from above, tells that the surface is at least as high [m]. Heights are
kept in cells of this size."""

FARTHEST = 80.0
"""Depth up to which pixels are counted [m]."""

COLUMNS = ("pixels", "empty %", "world %", "seen: pixels", "seen: empty %", "seen: world %")

Counts = NDArray[np.int64]
"""Shape (2, 3): all pixels or those seen before; how many there are, are empty, are the world."""


class Vehicle:
    """A large vehicle, and where earlier sweeps have seen its surface."""

    def __init__(self, track: Track) -> None:
        self.track = track
        self._returns: list[NDArray[np.float64]] = []

    def local(self, world: NDArray[np.float64], time: int) -> NDArray[np.float64]:
        """Points of the world in the frame of the vehicle: x forward, z up, the bottom's centre."""
        T = inverse(self.track.pose_at(time))
        return np.asarray(world @ T[:3, :3].T + T[:3, 3])

    def add(self, world: NDArray[np.float64], time: int) -> None:
        self._returns.append(self.local(world, time))

    def has_seen(self, surface: NDArray[np.float64]) -> NDArray[np.bool_]:
        returns = np.concatenate([np.zeros((0, 3)), *self._returns])
        if not len(returns):
            return np.zeros(len(surface), bool)
        near = cKDTree(returns).query(surface, distance_upper_bound=SEEN)[0] <= SEEN
        return np.asarray(near & (surface[:, 2] <= _heights(returns, surface)))

    def is_outside(self, local: NDArray[np.float64]) -> NDArray[np.bool_]:
        length, width, height = self.track.size
        off = np.abs(local - (0, 0, height / 2)) - (length / 2, width / 2, height / 2)
        return np.asarray(off.max(axis=-1) > MARGIN)


def _heights(returns: NDArray[np.float64], places: NDArray[np.float64]) -> NDArray[np.float64]:
    """Height of the highest return beside each place."""
    low = returns[:, :2].min(axis=0) - 2 * BESIDE
    size = np.ceil((returns[:, :2].max(axis=0) + 2 * BESIDE - low) / CELL).astype(int) + 1
    heights = np.full(size, -np.inf)
    np.maximum.at(heights, tuple(((returns[:, :2] - low) / CELL).astype(int).T), returns[:, 2])
    reach = np.arange(-BESIDE, BESIDE + CELL / 2, CELL)
    disc = np.hypot(*np.meshgrid(reach, reach)) <= BESIDE + 1e-9
    heights = maximum_filter(heights, footprint=disc, mode="constant", cval=-np.inf)
    of = np.clip(((places[:, :2] - low) / CELL).astype(int), 0, size - 1)
    return np.asarray(heights[tuple(of.T)])


def counts(cell: Cell, out: Path, p: Parameters, images: int, threads: int) -> Counts:
    """Pixels of the large vehicles of a drive."""
    exact, run = ExactDrive(cell), cell.run(out / cell.name, p)
    scene = exact.own_scene(run, p, threads)
    found = np.zeros((2, 3), np.int64)
    vehicles = {
        track.id: Vehicle(track)
        for track in exact.drive.tracks()
        if track.kind == "vehicle" and track.size[2] >= MIN_HEIGHT
    }
    seen = 0
    for k in exact.images(images, ends=False):
        time = int(exact.camera.times[k])
        while exact.trajectory.times[seen] < time:
            _look(vehicles, exact, seen)
            seen += 1
        found += _count(vehicles, exact, k, render_depth(scene, exact.camera, k, threads=threads))
    return found


def _look(vehicles: dict[int, Vehicle], exact: ExactDrive, sweep: int) -> None:
    """Add the returns of a sweep to the vehicles, each where it was when the ray met it."""
    true, pose = exact.drive.sweep(sweep), exact.trajectory.poses[sweep]
    instance = true.labels >> 16
    late = true.relative_time * exact.drive.sensor.period
    for of, vehicle in vehicles.items():
        own = instance == of
        if not own.any():
            continue
        time = int(exact.trajectory.times[sweep])
        world = true.points[own].astype(np.float64) @ pose[:3, :3].T + pose[:3, 3]
        world -= late[own, None] * vehicle.track.velocity_at(time)
        vehicle.add(world, time)


def _count(
    vehicles: dict[int, Vehicle], exact: ExactDrive, image: int, depth: NDArray[np.float32]
) -> Counts:
    truth, time = exact.drive.image(image), int(exact.camera.times[image])
    T_world_camera = exact.trajectory.interpolate(time)[0] @ inverse(exact.camera.T_camera_lidar)
    found = np.zeros((2, 3), np.int64)

    def world(rows: NDArray[np.bool_], of: NDArray[np.float32]) -> NDArray[np.float64]:
        v, u = np.nonzero(rows)
        rays = np.linalg.inv(exact.camera.camera.K) @ np.array([u, v, np.ones(len(u))])
        points = (of[rows] * rays).T
        return np.asarray(points @ T_world_camera[:3, :3].T + T_world_camera[:3, 3])

    for of, vehicle in vehicles.items():
        rows = (truth.labels >> 16 == of) & (truth.depth <= FARTHEST)
        if not rows.any():
            continue
        was_seen = vehicle.has_seen(vehicle.local(world(rows, truth.depth), time))
        empty = ~np.isfinite(depth[rows])
        behind = depth[rows] > truth.depth[rows]
        behind &= vehicle.is_outside(vehicle.local(world(rows, depth), time))
        for row, of_row in zip(found, (np.ones_like(was_seen), was_seen), strict=True):
            row += (of_row.sum(), (of_row & empty).sum(), (of_row & behind).sum())
    return found


def row(name: str, found: Counts) -> tuple[str, ...]:
    """Pixels, and of these how many are empty and how many the world [%]."""
    cells = []
    for pixels, *some in found.tolist():
        cells.append(str(pixels))
        cells += [number(100 * of / max(pixels, 1), 2) for of in some]
    return (name, *cells)


def main(arguments: list[str] | None = None) -> dict[str, Counts]:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    add_cell_arguments(parser, images=20)
    parser.add_argument("-o", "--out", type=Path, required=True, help="folder of the runs")
    parser.set_defaults(scenes=["overtaking"])
    args = parser.parse_args(arguments)
    args.sensors = args.sensors or list(sensors())
    p, out = parameters(args.preset), args.out / f"seed{args.seed}"
    cells: dict[str, Counts] = {}
    for cell in cells_of(args):
        cells[cell.name] = counts(cell, out, p, args.images, args.threads)
        print(*row(cell.name, cells[cell.name]), sep="  ", file=sys.stderr, flush=True)
    lines = tuple(row(name, found) for name, found in cells.items())
    print(Table(f"large vehicles, seed {args.seed}, exact poses", ("cell", *COLUMNS), lines))
    return cells


if __name__ == "__main__":
    try:
        main()
    except DocDepthError as error:
        sys.exit(str(error))
