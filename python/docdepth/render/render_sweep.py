"""Sweeps prepared for rendering, and kept as long as images need them (paper V-B)."""

from __future__ import annotations

from collections.abc import Callable, Collection
from concurrent.futures import Executor, Future
from threading import Lock
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

import docdepth._core as _core
from docdepth.config import RenderParameters
from docdepth.geometry.lidar_frame import LidarFrame, SensorRig
from docdepth.geometry.points import DYNAMIC
from docdepth.geometry.scan_mesh import LidarMesh, ScanMesh
from docdepth.geometry.track import Tracks
from docdepth.geometry.trajectory import Trajectory
from docdepth.render.dynamic_objects import DynamicObjects, dynamic_objects
from docdepth.render.selection import near_vehicles

ISOLATED_SIZE_DEG = 0.1
"""Triangles: half the diagonal of the square drawn for a return that belongs to no triangle, as the
LiDAR sees it [deg]. Half the angle between two returns of a common spinning LiDAR."""

WIDENING = 0.2
"""Triangles: share of the width of a beam by which things are seen too wide on each side, and drawn
narrower [-]. Half of it is too much: a beam returns from what gives the stronger echo, not from the
nearer thing, and other sweeps see other parts of an edge."""

DUST_FREE_RATIO = 2
"""Triangles: a static return that belongs to no triangle is not drawn where more than so many times
as many key frames found its place free as occupied [-]: dust, rain, an insect."""

Part: TypeAlias = tuple[Any, NDArray[np.float64]]
"""What the core draws (``_core.Frame`` of splats, ``_core.MeshFrame`` of triangles), and the pose
``T_lidar_sensor`` of the LiDAR that measured it."""


class RenderSweep:
    """A sweep prepared for rendering: static and dynamic points apart, neighbours together.

    Prepare a sweep once and use it for all images that need it;
    :class:`~docdepth.render.scene.Scene` does so.

    Parameters
    ----------
    frame : LidarFrame
        With classes. Points that are not finite are left out. Times and the sensor rig are used by
        triangles only; each of several LiDARs gets a mesh and rays of its own.
    parameters : RenderParameters, optional
        ``primitive`` and ``crop`` are used; give the same to
        :func:`~docdepth.render.depth_map.compose_depth`.
    velocity : array_like of float64, shape (3,), optional
        Velocity of the LiDAR in its own frame, m/s (:meth:`Trajectory.velocity`). Together with the
        times it gives each return its own ray origin.
    objects : DynamicObjects, optional
        To which object each dynamic point belongs
        (:func:`~docdepth.render.dynamic_objects.dynamic_objects`). If absent, none is followed.
        Used by triangles only.

    Attributes
    ----------
    parts : list of Part
        One for each LiDAR.
    objects : DynamicObjects
        Of the points that are drawn. Triangles only.
    returns : int
        So many points are drawn.
    """

    parts: list[Part]
    objects: DynamicObjects
    returns: int

    def __init__(
        self,
        frame: LidarFrame,
        parameters: RenderParameters | None = None,
        velocity: ArrayLike | None = None,
        objects: DynamicObjects | None = None,
    ) -> None:
        p = parameters or RenderParameters()
        drawn = _within_crop(frame.points, frame.classes, p.crop)
        if not drawn.all():
            frame, objects = frame.select(drawn), objects and objects.select(drawn)
        points, classid = frame.points, frame.classes
        self.returns = len(points)
        if p.primitive == "splats":
            self.parts = [(_core.Frame(points, classid, np.inf), np.eye(4))]
            return
        time_offset, sensor_rig = frame.time_offset, frame.sensor_rig
        if time_offset is not None and velocity is not None:
            rig = sensor_rig or SensorRig.single((0, 0, 0), len(points))
            sensor_rig = rig.with_ego_motion(velocity, time_offset)
        self.objects = objects or dynamic_objects(frame)
        # This mesh differs from the one that votes use: its ray origins move with the vehicle,
        # which changes which returns are neighbours, and points beyond the crop are missing.
        meshes = ScanMesh(points, sensor_rig=sensor_rig).parts
        widening = WIDENING * (sensor_rig.beam_width if sensor_rig is not None else 0.0)
        drawn_alone = ~_in_passing(frame)
        self.parts = [_part(mesh, classid, drawn_alone, self.objects, widening) for mesh in meshes]
        # Rows of other LiDARs are NaN.
        indices = [
            self.objects.object_index[np.isfinite(mesh.view.points[:, 0])] for mesh in meshes
        ]
        count = len(self.objects.instances) + 1
        self._returns = np.array([np.bincount(of, minlength=count) for of in indices])

    def seen_by(self, object_index: int) -> list[int]:
        """The parts whose LiDARs measured an object, that of most returns first."""
        returns = self._returns[:, object_index]
        order = np.argsort(-returns, kind="stable")
        return [k for k in order.tolist() if returns[k]]


def prepare_sweep(
    frame: LidarFrame,
    index: int,
    trajectory: Trajectory,
    parameters: RenderParameters,
    tracks: Tracks | None,
    whole: bool,
    is_drawn: Callable[[int, int], bool] | None = None,
) -> RenderSweep:
    """Prepare a classified sweep for rendering, or what of it is near vehicles.

    Parameters
    ----------
    frame : LidarFrame
        Usable returns, with classes.
    index : int
        Of its pose in the trajectory.
    whole : bool
        False: only the points near vehicles
        (:func:`~docdepth.render.selection.near_vehicles`).
    is_drawn : callable, optional
        That of :func:`~docdepth.render.dynamic_objects.dynamic_objects`.
    """
    if not whole:
        frame = frame.select(near_vehicles(frame, tracks or Tracks()))
    time, pose = int(trajectory.times[index]), trajectory.poses[index]
    objects = dynamic_objects(frame, time, pose, tracks, is_drawn)
    return RenderSweep(frame, parameters, trajectory.velocity(index), objects)


class SweepCache:
    """Prepares each sweep the first time it is needed and forgets it when it no longer is.

    Safe to use from several threads.

    Parameters
    ----------
    load : callable
        Prepares a sweep, given its index and whether it is needed whole; called from
        the threads of an executor.
    """

    def __init__(self, load: Callable[[int, bool], RenderSweep]) -> None:
        self._load = load
        self._sweeps: dict[tuple[int, bool], Future[RenderSweep]] = {}
        self._lock = Lock()

    def request(
        self, needed: Collection[tuple[int, bool]], executor: Executor
    ) -> dict[tuple[int, bool], Future[RenderSweep]]:
        """Start to prepare the missing sweeps of ``needed``; forget all others.

        Returns
        -------
        dict of (int, bool) to Future
            The needed sweeps. They stay valid when another thread requests others.
        """
        with self._lock:
            kept = {i: sweep for i, sweep in self._sweeps.items() if i in needed}
            for i in sorted(needed):
                if i not in kept or (kept[i].done() and kept[i].exception() is not None):
                    kept[i] = executor.submit(self._load, *i)
            self._sweeps = kept
            return dict(kept)


def _within_crop(
    points: NDArray[np.float32], classid: NDArray[np.uint16], crop: float
) -> NDArray[np.bool_]:
    """Dynamic points, and static points nearer than ``crop`` [m]; none that are not finite."""
    with np.errstate(invalid="ignore", over="ignore"):
        squared = np.einsum("ij,ij->i", points, points, dtype=np.float64)
        within: NDArray[np.bool_] = squared < crop**2
    return within | (np.isfinite(squared) & (classid >= DYNAMIC))


def _in_passing(frame: LidarFrame) -> NDArray[np.bool_]:
    """Which static points lie where the air is free but for a moment, by the votes of a run."""
    if frame.votes_static is None or frame.votes_dynamic is None:
        return np.zeros(len(frame), np.bool_)
    free = frame.votes_dynamic > DUST_FREE_RATIO * frame.votes_static.astype(np.int64)
    return np.asarray(free & (frame.classes < DYNAMIC))


def _part(
    mesh: LidarMesh,
    classid: NDArray[np.uint16],
    drawn_alone: NDArray[np.bool_],
    objects: DynamicObjects,
    widening: float,
) -> Part:
    """The mesh of one LiDAR as the core draws it; rows of other LiDARs are NaN and left out."""
    points, ray_origins = mesh.view.points, mesh.view.ray_origins()
    triangles, isolated = mesh.core.triangles, mesh.core.isolated
    isolated = isolated[drawn_alone[isolated]]
    turn = mesh.view.T_lidar_sensor[:3, :3].astype(np.float32)
    motion = objects.motion.copy()
    motion[:, :3] = motion[:, :3] @ turn
    if not np.isfinite(points).all():
        own = np.asarray(np.isfinite(points).all(axis=1))
        row = np.cumsum(own, dtype=np.uint32) - np.uint32(1)
        points, classid, objects = points[own], classid[own], objects.select(own)
        ray_origins = None if ray_origins is None else ray_origins[own]
        triangles, isolated = row[triangles], row[isolated]
    displacement = objects.displacement
    if displacement is not None:
        displacement = displacement.copy()
        moved = np.flatnonzero(objects.object_index)
        displacement[moved] = displacement[moved] @ turn
    core = _core.MeshFrame(
        points,
        classid,
        triangles,
        mesh.core.discontinuity,
        isolated,
        float(np.radians(ISOLATED_SIZE_DEG)),
        objects.object_index,
        motion,
        objects.time_offset,
        displacement,
        ray_origins,
        objects.visible,
        widening,
    )
    return core, mesh.view.T_lidar_sensor
