"""Occupancy against exact surfaces.

    python benchmarks/occupancy.py drives -o occupancy --seed 7

A cell is a scene seen by a sensor. Its drive is made below ``drives`` if it is missing, its run
below ``occupancy``. Poses are exact and sweeps are motion compensated; classes and tracks are those
that docdepth finds.

A voxel is truly occupied if a surface lies in it. It counts if a straight line leads from the LiDAR
of one of the merged sweeps, within the elevations of its beams, to this surface, or, if it is free,
to a place in it. What is occupied though no surface lies there counts wherever it is.

`points` is what is common: the points of the same sweeps, exactly labelled, those of moving objects
placed by exact boxes; a voxel with a point is occupied, all others are free.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from functools import partial
from typing import NamedTuple

import numpy as np
from cells import Cell, ExactDrive, cell_parser, each_cell
from numpy.typing import NDArray
from results import script

from docdepth.evaluation import Table
from docdepth.evaluation.tables import number
from docdepth.geometry import points as classes
from docdepth.geometry.se3 import inverse
from docdepth.pipeline import run_classify
from docdepth.pipeline.run_reader import Run
from docdepth.render.occupancy import CORNER, DYNAMIC, FREE, SIZE, VOXEL, OccupancyGrids
from docdepth.synthetic import Drive, Mesh
from docdepth.synthetic.casting import Rays

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

SPACING = 0.05  # of the places on surfaces [m]
PLACES = 4  # in a voxel, of which one has to be seen
VIEWS = 8  # of the merged sweeps, from which they may be
MOVES = 0.2  # metres a second
SAME = 0.02  # metres by which a line may end before the surface that it leads to


def voxels_of(points: Floats) -> NDArray[np.int64]:
    """The number of the voxel of each point (N, 3) of the grid; -1 outside of it."""
    cells = np.floor((points - CORNER) / VOXEL).astype(np.int64)
    inside = ((cells >= 0) & (cells < SIZE)).all(axis=1)
    return np.where(inside, cells @ (SIZE[1] * SIZE[2], SIZE[2], 1), -1)


def places_on(mesh: Mesh, T_grid_mesh: Floats) -> Iterator[tuple[Floats, NDArray[np.int64]]]:
    """Places on the triangles that reach into the grid, in the frame of the mesh, and their voxels.

    They are at most ``SPACING`` apart along both sides of a triangle.
    """
    vertices = mesh.vertices @ T_grid_mesh[:3, :3].T + T_grid_mesh[:3, 3]
    corners, local = vertices[mesh.faces], mesh.vertices[mesh.faces]
    high: Floats = np.add(CORNER, np.multiply(SIZE, VOXEL))
    near = (corners.max(axis=1) >= CORNER).all(axis=1) & (corners.min(axis=1) <= high).all(axis=1)
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    steps = np.ceil(longest / SPACING).astype(int)
    for count in np.unique(steps[near]):
        i, j = np.mgrid[: count + 1, : count + 1].reshape(2, -1)
        i, j = i[i + j <= count], j[i + j <= count]
        weights = np.stack([count - i - j, i, j], axis=1) / count
        every = np.flatnonzero(near & (steps == count))
        for some in np.array_split(every, max(len(every) * len(weights) // 3_000_000, 1)):
            places = np.einsum("pw,fwd->fpd", weights, local[some]).reshape(-1, 3)
            yield places, voxels_of(places @ T_grid_mesh[:3, :3].T + T_grid_mesh[:3, 3])


class Places(NamedTuple):
    """Places in voxels, in the frame of a rigid part of an actor, or of the scene."""

    points: Floats
    voxels: NDArray[np.int64]
    actor: int = -1
    part: int = 0


def places_in_voxels(
    mesh: Mesh, T_grid_mesh: Floats, rng: np.random.Generator
) -> tuple[Floats, NDArray[np.int64]]:
    """Places on a mesh, chosen at random: at most :data:`PLACES` in a voxel."""
    points, voxels = np.empty((0, 3)), np.empty(0, np.int64)
    for more, of in places_on(mesh, T_grid_mesh):
        points, voxels = np.concatenate([points, more]), np.concatenate([voxels, of])
        order = rng.permutation(np.flatnonzero(voxels >= 0))
        order = order[np.argsort(voxels[order], kind="stable")]
        begins = np.flatnonzero(np.diff(voxels[order], prepend=-1))
        rank = np.arange(len(order)) - np.repeat(begins, np.diff(begins, append=len(order)))
        points, voxels = points[order[rank < PLACES]], voxels[order[rank < PLACES]]
    return points, voxels


class ExactOccupancy:
    """The exact voxels of a sweep.

    Attributes
    ----------
    occupied, moving : ndarray of bool, shape (voxels,)
        A surface lies in it; one of an object that moves at any time of the drive.
    seen, moving_seen, free_seen : ndarray of bool, shape (voxels,)
        A line leads to a surface, to one that moves now, or to a free place.
    """

    def __init__(self, drive: Drive, index: int, T_world_grid: Floats, views: list[int]) -> None:
        self._drive, self._views, rng = drive, views, np.random.default_rng(index)
        flags = np.zeros((5, int(np.prod(SIZE))), np.bool_)
        self.occupied, self.moving, self.seen, self.moving_seen, self.free_seen = flags
        T_scene_grid = drive.T_scene_world @ T_world_grid
        T_grid_scene = inverse(T_scene_grid)
        second, actors = np.array([drive.times[index] * 1e-9]), drive.scene.actors
        surfaces = [Places(*places_in_voxels(drive.scene.static, T_grid_scene, rng))]
        for k, actor in enumerate(actors):
            for part, pose in enumerate(actor.part_poses(second)):
                found = places_in_voxels(actor.parts[part].mesh, T_grid_scene @ pose[0], rng)
                surfaces.append(Places(*found, k, part))
        for of in surfaces:
            seen = of.voxels[self._reached(of, SAME)]
            self.occupied[of.voxels], self.seen[seen] = True, True
            if of.actor >= 0 and actors[of.actor].moves_between(*drive.span):
                self.moving[of.voxels] = True
                self.moving_seen[seen] |= bool(actors[of.actor].speed(second)[0] > MOVES)
        free = np.flatnonzero(~self.occupied)
        cells = np.stack(np.unravel_index(free, SIZE), axis=1)
        for _ in range(2):
            points = CORNER + VOXEL * (cells + rng.random(cells.shape))
            places = Places(points @ T_scene_grid[:3, :3].T + T_scene_grid[:3, 3], free)
            self.free_seen[free[self._reached(places, 0)]] = True

    def _reached(self, places: Places, before: float) -> Flags:
        """To which places a line leads, or ends ``before`` metres before them."""
        drive, seen = self._drive, np.zeros(len(places.points), np.bool_)
        pattern = drive.sensor.pattern(0)
        lowest, highest = pattern.directions[:, 2].min(), pattern.directions[:, 2].max()
        begin = np.zeros(3) if pattern.ray_origins is None else pattern.ray_origins.mean(axis=0)
        for view in self._views:
            second, points = np.array([drive.times[view] * 1e-9]), places.points
            if places.actor >= 0:
                T = drive.scene.actors[places.actor].part_poses(second)[places.part][0]
                points = points @ T[:3, :3].T + T[:3, 3]
            T = drive.T_scene_world @ drive.poses[view]
            origin = T[:3, :3] @ begin + T[:3, 3]
            way = points - origin
            length = np.linalg.norm(way, axis=1)
            sine = way @ T[:3, 2] / length
            able = (sine >= lowest) & (sine <= highest) & (length < drive.sensor.max_range)
            left = np.flatnonzero(able & ~seen)
            if not len(left):
                continue
            directions = way[left] / length[left, None]
            origins = np.broadcast_to(origin, directions.shape)
            rays = Rays(origins, directions, second, np.zeros(len(left), np.int64))
            hits = drive.world.cast(rays, float(length[left].max()) + 1)
            seen[left[hits.range > length[left] - before]] = True
        return seen


def figures(occupied: Flags, moving: Flags, free: Flags, exact: ExactOccupancy) -> list[float]:
    """Right, missed and wrong voxels: occupied, free, moving; those not observed, and all."""
    rows: list[float] = []
    for found, seen, truth in (
        (occupied, exact.seen, exact.occupied),
        (free, exact.free_seen, ~exact.occupied),
        (moving, exact.moving_seen, exact.moving),
    ):
        rows += [(found & seen).sum(), (~found & seen).sum(), (found & ~truth).sum()]
    observable = exact.seen | exact.free_seen
    return [*rows, (observable & ~occupied & ~free).sum(), observable.sum()]


def points_in(grids: OccupancyGrids, exact: ExactDrive, index: int) -> tuple[Flags, Flags]:
    """Voxels with points by exact labels and boxes: all, and those of what moves."""
    drive, count = exact.drive, int(np.prod(SIZE))
    occupied, moving = np.zeros((2, count), bool)
    T_grid_world = grids.T_grid_lidar @ inverse(drive.poses[index])
    tracks = {track.id: track for track in drive.tracks()}
    for k in grids.around(index):
        points, labels = exact.dataset.sweep(k).points.astype(float), exact._labels(k)
        for one in np.unique(labels.instance):
            rows = labels.instance == one
            if not one:
                rows &= labels.classid < classes.DYNAMIC
            T = drive.poses[k]
            if one:
                times = int(drive.times[index]), int(drive.times[k])
                here, there = (tracks[one].pose_at(time) for time in times)
                T = here @ inverse(there) @ T
            T = T_grid_world @ T
            voxels = voxels_of(points[rows] @ T[:3, :3].T + T[:3, 3])
            (moving if one else occupied)[voxels[voxels >= 0]] = True
    return occupied | moving, moving


def measure(cell: Cell, args: argparse.Namespace) -> dict[str, list[float]]:
    """Counts of a cell: of docdepth, and of points alone."""
    path = args.out / cell.name
    run_classify(cell.run(path), args.threads)
    run, exact = Run(path), ExactDrive(cell)
    grids = OccupancyGrids(run.sweeps, run.trajectory, run.tracks)
    sums = np.zeros((2, 11))
    for index in exact.images(args.images, ends=False):
        found = grids.at(index)
        near = grids.around(index)
        views = [near[int(k)] for k in np.linspace(0, len(near) - 1, VIEWS).round()]
        truth = ExactOccupancy(exact.drive, index, found.T_world_grid, views)
        semantics, observed = found.semantics.ravel(), found.mask_lidar.ravel()
        occupied, moving = semantics != FREE, semantics == DYNAMIC
        sums[0] += figures(occupied, moving, observed & ~occupied, truth)
        occupied, moving = points_in(grids, exact, index)
        sums[1] += figures(occupied, moving, ~occupied, truth)
    return {"docdepth": sums[0].tolist(), "points": sums[1].tolist()}


HEADER = ("cell", "", "IoU occupied", "missed %", "wrong %", "IoU free", "unobserved %",
          "IoU moving", "missed %", "wrong %")  # fmt: skip


def table(title: str, cells: dict[str, dict[str, list[float]]]) -> Table:
    """A row for docdepth and one for points, of each cell."""
    lines = []
    for name, rows in cells.items():
        for what, n in rows.items():
            occupied, free, moving = n[0:3], n[3:6], n[6:9]
            iou = [of[0] / max(sum(of), 1) for of in (occupied, free, moving)]
            missed, wrong = (
                [100 * of[k] / max(sum(of), 1) for of in (occupied, moving)] for k in (1, 2)
            )
            values = [
                iou[0],
                missed[0],
                wrong[0],
                iou[1],
                100 * n[9] / n[10],
                iou[2],
                missed[1],
                wrong[1],
            ]
            digits = 3, 1, 1, 3, 1, 3, 1, 1
            lines.append((name, what, *map(number, values, digits)))
    return Table(title, HEADER, tuple(lines))


def main(arguments: list[str] | None = None) -> None:
    parser = cell_parser(__doc__, images=3)
    parser.set_defaults(scenes=["city", "crossing", "residential"], sensors=["HDL-64", "XT-32"])
    args = parser.parse_args(arguments)
    title = f"occupancy, seed {args.seed}, exact poses"
    each_cell(args, args.out, lambda cell: measure(cell, args), partial(table, title))


if __name__ == "__main__":
    script(main)
