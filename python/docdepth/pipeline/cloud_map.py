"""The static cloud of a drive, and each moving object gathered along its track (paper Fig. 5)."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from docdepth.concurrency import Progress, null_progress
from docdepth.errors import InputError
from docdepth.geometry.points import DYNAMIC, GROUND, STATIC
from docdepth.geometry.se3 import transform_points
from docdepth.io.ply import write_vertices
from docdepth.io.run_folder import RunFolder
from docdepth.io.tracks import tracks_in
from docdepth.pipeline.plan import require
from docdepth.render.dynamic_objects import dynamic_objects
from docdepth.visualization.image_views import track_color
from docdepth.visualization.pictures import GROUND_COLOR, STATIC_COLOR

VOXEL = 0.1
"""Default side of a voxel of the map [m]."""
_OF_OBJECTS = 0.5  # side of a voxel of an object, as a share of the map's

_BITS = 21  # of a voxel's number along an axis
_ROW = np.dtype([("key", "i8"), ("points", "u4"), ("ground", "u4"), ("sum", "f4", 3)])
_RGB = [(name, "u1") for name in ("red", "green", "blue")]
_CLOUD = np.dtype(
    [(name, "<f8") for name in "xyz"] + [("classid", "<u2"), ("points", "<u4")] + _RGB
)
_OBJECT = np.dtype([(name, "<f4") for name in "xyz"] + [("points", "<u4")] + _RGB)
# Points get lighter from the lowest of their column upwards: one grey for all would show no shape.
_COLUMN, _LIGHT = 1.0, 4.0  # side of a column, and height of full light [m]
_DARKEST = 0.4
_LEAST_MERGED = 1_000_000  # voxels; sorting the map for fewer takes too long


class CloudMap(NamedTuple):
    """A point for each voxel with static points.

    Attributes
    ----------
    points : ndarray of float64, shape (n, 3)
        The mean of its points, in the world [m].
    classid : ndarray of uint16, shape (n,)
        What most of them are: 0 ground, 50 static.
    counts : ndarray of uint32, shape (n,)
        How many there are.
    """

    points: NDArray[np.float64]
    classid: NDArray[np.uint16]
    counts: NDArray[np.uint32]


class VoxelCloud:
    """A cloud with one point for each voxel: the mean of those that fell into it.

    Memory is bounded by the thinned cloud, at about 100 bytes a voxel.

    Parameters
    ----------
    voxel : float
        Side of a voxel [m].
    origin : ndarray of float64, shape (3,)
        A place near the points [m].
    """

    def __init__(self, voxel: float, origin: NDArray[np.float64]) -> None:
        self._voxel, self._origin = voxel, origin
        self._rows = np.empty(0, _ROW)
        self._new: list[NDArray[np.void]] = []

    def add(self, points: NDArray[np.float64], is_ground: NDArray[np.bool_]) -> None:
        """Add points (N, 3) [m]."""
        scaled = (points - self._origin) / self._voxel
        cells = np.floor(scaled).astype(np.int64)
        half = 1 << (_BITS - 1)
        if len(cells) and np.abs(cells).max() >= half:
            raise InputError(
                f"the map reaches farther than {half * self._voxel / 1000:.0f} km from its "
                "beginning; take larger voxels (`voxel`)"
            )
        rows = np.empty(len(points), _ROW)
        rows["key"] = (cells + half) @ (1 << 2 * _BITS, 1 << _BITS, 1)
        rows["points"], rows["ground"], rows["sum"] = 1, is_ground, scaled - cells
        self._new.append(_merged(rows))
        if sum(map(len, self._new)) > max(len(self._rows), _LEAST_MERGED):
            self._merge()

    def cloud(self) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.uint32]]:
        """Mean points (n, 3) [m], which are ground, and of how many points each is the mean."""
        self._merge()
        rows = self._rows
        shifts = np.array([2 * _BITS, _BITS, 0])
        cells = (rows["key"][:, None] >> shifts & ((1 << _BITS) - 1)) - (1 << (_BITS - 1))
        means = cells + rows["sum"].astype(np.float64) / rows["points"][:, None]
        is_ground = 2 * rows["ground"].astype(np.int64) > rows["points"]
        return self._origin + self._voxel * means, is_ground, rows["points"].copy()

    def _merge(self) -> None:
        self._rows = _merged(np.concatenate([self._rows, *self._new]))
        self._new = []


def _merged(rows: NDArray[np.void]) -> NDArray[np.void]:
    """Rows with one row a voxel, ordered."""
    if not len(rows):
        return rows
    rows = rows[np.argsort(rows["key"], kind="stable")]
    first = np.flatnonzero(np.diff(rows["key"], prepend=rows["key"][0] - 1))
    merged = rows[first]
    for name in ("points", "ground", "sum"):
        merged[name] = np.add.reduceat(rows[name], first, axis=0)
    return merged


def write_map(run: RunFolder, voxel: float = VOXEL, progress: Progress = null_progress) -> Path:
    """Write ``map/map.ply`` and ``map/objects/ID_KIND.ply``.

    The map has what stands, in the world; each object has what was seen of it, in the frame of its
    box: x forward, z up, the origin below its middle. Moving points of no track are in neither.

    Parameters
    ----------
    voxel : float
        Side of a voxel of the map [m]; those of objects are half as large.
    """
    require(run, "classify")
    world, objects = gather_map(run, voxel, progress)
    return _write(run, world, objects)


def gather_map(
    run: RunFolder, voxel: float, progress: Progress = null_progress
) -> tuple[CloudMap, dict[int, VoxelCloud]]:
    """The map and the clouds of objects that :func:`write_map` writes, these by track.

    The arguments and errors are those of :func:`write_map`; classes may be out of date.
    """
    trajectory, tracks = run.trajectory(), tracks_in(run.path)
    world = VoxelCloud(voxel, trajectory.poses[0, :3, 3])
    objects: dict[int, VoxelCloud] = {}
    for k, pose in enumerate(trajectory.poses):
        record, classid = run.classified_frame(k)
        kept = (classid < DYNAMIC) & np.isfinite(record.points).all(axis=1)
        points = record.points[kept].astype(np.float64)
        world.add(transform_points(pose, points), classid[kept] < STATIC)
        found = dynamic_objects(record, int(trajectory.times[k]), pose, tracks)
        for number, of in enumerate(found.instances):
            if not of:
                continue
            own = found.object_index == number + 1
            points = record.points[own].astype(np.float64)
            if found.displacement is not None:
                points += found.displacement[own]
            T = found.T_object_lidar[number]
            cloud = objects.setdefault(of, VoxelCloud(voxel * _OF_OBJECTS, np.zeros(3)))
            cloud.add(transform_points(T, points), np.zeros(len(points), bool))
        progress("map", k + 1, len(trajectory))
    points, is_ground, counts = world.cloud()
    return CloudMap(points, np.where(is_ground, GROUND, STATIC).astype(np.uint16), counts), objects


def _shade(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """How light each point is, by its height above the lowest of its column; (n, 1)."""
    columns = np.floor(points[:, :2] / _COLUMN)
    order = np.lexsort(columns.T)
    first = np.flatnonzero(np.diff(columns[order], axis=0, prepend=np.nan).any(axis=1))
    lowest = np.minimum.reduceat(points[order, 2], first) if len(first) else np.empty(0)
    height = np.empty(len(points))
    height[order] = points[order, 2] - np.repeat(lowest, np.diff(first, append=len(points)))
    return (_DARKEST + (1 - _DARKEST) * np.clip(height / _LIGHT, 0, 1))[:, None]


def _paint(rows: NDArray[np.void], colors: NDArray[np.float64]) -> None:
    """Set the colours of rows, BGR."""
    rows["blue"], rows["green"], rows["red"] = np.rint(colors).astype(np.uint8).T


def _write(run: RunFolder, world: CloudMap, objects: dict[int, VoxelCloud]) -> Path:
    """Write the clouds, and remove objects of an earlier map."""
    write, tracks = run.writer({"classify": run.stage("classify").key or ""}), tracks_in(run.path)
    path, folder = run.path / "map" / "map.ply", run.path / "map" / "objects"
    names = {number: f"{number:05d}_{tracks[number].kind}.ply" for number in objects}
    with run.lock("map"):
        for name in set(run.records(folder).names()) - set(names.values()):
            run.remove(folder / name)
        for number, name in sorted(names.items()):
            points, _, counts = objects[number].cloud()
            rows = np.empty(len(points), _OBJECT)
            rows["x"], rows["y"], rows["z"] = points.T
            rows["points"] = counts
            _paint(rows, _shade(points) * track_color(number))
            write_vertices(folder / name, rows, ["frame of the box: x forward, z up"], write)
        rows = np.empty(len(world.points), _CLOUD)
        rows["x"], rows["y"], rows["z"] = world.points.T
        rows["classid"], rows["points"] = world.classid, world.counts
        is_ground = world.classid[:, None] < STATIC
        _paint(rows, np.where(is_ground, GROUND_COLOR, _shade(world.points) * STATIC_COLOR))
        write_vertices(path, rows, ["world [m]"], write)
    return path
