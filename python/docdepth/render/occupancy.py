"""Occupancy around the vehicle: voxels that are free, occupied or not observed (ours).

What stands is gathered from the sweeps of many seconds by the poses of the LiDAR, each moving
object from the same sweeps by its track. So no box has to be drawn by hand.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import docdepth._core as _core
from docdepth.errors import InputError
from docdepth.geometry.camera import Camera
from docdepth.geometry.ground_plane import find_ground, level_turn
from docdepth.geometry.lidar_frame import LidarFrame, SensorRig, lidar_views
from docdepth.geometry.points import ShortRepr
from docdepth.geometry.se3 import inverse, rigid
from docdepth.geometry.track import Track, Tracks
from docdepth.geometry.trajectory import Trajectory
from docdepth.render.dynamic_objects import dynamic_objects

DYNAMIC, GROUND, STATIC, FREE = 0, 1, 2, 17
"""Values of ``semantics``. Free is that of Occ3D, whose other classes docdepth does not know."""

VOXEL, SIZE, CORNER = 0.4, (200, 200, 16), (-40.0, -40.0, -1.0)
"""Side of a voxel [m], voxels along x, y and z, and the lowest corner of the grid [m]: Occ3D's."""

REACH, STEP = 40.0, 1.0
"""Sweeps on this much of the way before and after are merged, one on each step of it [m]."""
_PER_SECOND = 1.0  # metres of the way: while the vehicle stands, others uncover what they hid
_CELL = VOXEL  # rays that end in one are merged [m]
_KEPT = 160  # sweeps whose rays are kept, 0.7 MB each


@dataclass(frozen=True, eq=False, repr=False)
class Occupancy(ShortRepr):
    """The voxels around the vehicle at the stamp of a sweep.

    The frame of the grid is that of the vehicle: x forward, y left, z up, and the origin on the
    ground below the LiDAR. Voxel ``[i, j, k]`` begins at ``CORNER + VOXEL * (i, j, k)``.

    Attributes
    ----------
    semantics : ndarray of uint8, shape (200, 200, 16)
        :data:`DYNAMIC`, :data:`GROUND`, :data:`STATIC`, or :data:`FREE`, which it also is where
        nothing was observed.
    mask_lidar : ndarray of bool, shape (200, 200, 16)
        Observed: free or occupied.
    mask_camera : ndarray of bool, shape (200, 200, 16)
        Observed, and some camera sees it: on a line from the camera to the middle of a voxel, it
        comes up to the first that is occupied.
    instance : ndarray of uint16, shape (200, 200, 16)
        The track of each voxel of a moving object; 0 elsewhere, and where it is of no track.
    flow : ndarray of float32, shape (200, 200, 16, 2)
        Velocity of moving objects over the ground, along x and y of the grid [m/s]; 0 elsewhere.
    T_world_grid : ndarray of float64, shape (4, 4)
    time : int
        Nanoseconds.
    """

    semantics: NDArray[np.uint8]
    mask_lidar: NDArray[np.bool_]
    mask_camera: NDArray[np.bool_]
    instance: NDArray[np.uint16]
    flow: NDArray[np.float32]
    T_world_grid: NDArray[np.float64]
    time: int


class MountedCamera(NamedTuple):
    """A camera on the vehicle, and ``T_camera_lidar`` (4, 4)."""

    camera: Camera
    T_camera_lidar: NDArray[np.float64]


class _Sweep(NamedTuple):
    """The rays of a sweep, and the number of each track among its objects; 0 is of no track."""

    rays: _core.SweepRays
    numbers: dict[int, int]


class OccupancyGrids:
    """Occupancy at each sweep of a classified drive, found when it is asked for.

    Ask in order of time: consecutive sweeps share most of the rays, which are kept.

    Parameters
    ----------
    sweeps : sequence of LidarFrame
        Usable returns, deskewed to their stamps, with classes.
    cameras : sequence of MountedCamera
        For ``mask_camera``.
    """

    def __init__(
        self,
        sweeps: Sequence[LidarFrame],
        trajectory: Trajectory,
        tracks: Tracks,
        cameras: Sequence[MountedCamera] = (),
    ) -> None:
        self._sweeps, self._trajectory, self._tracks = sweeps, trajectory, tracks
        self._cameras = cameras
        self._rays: dict[int, _Sweep] = {}
        seconds = (trajectory.times - trajectory.times[0]) * 1e-9
        self._way = trajectory.arc_length + _PER_SECOND * seconds
        self.T_grid_lidar = _grid_frame(sweeps)

    def around(self, index: int) -> list[int]:
        """Sweeps that are merged for sweep ``index``: itself, and one on each step of the way."""
        near = np.flatnonzero(np.abs(self._way - self._way[index]) <= REACH)
        # Steps belong to the drive and not to the sweep, so consecutive sweeps share theirs.
        step = (self._way[near] // STEP).astype(int)
        first = near[np.diff(step, prepend=-1) > 0]
        return sorted({index, *first.tolist()})

    def at(self, index: int) -> Occupancy:
        """Occupancy at the stamp of sweep ``index``."""
        trajectory, time = self._trajectory, int(self._trajectory.times[index])
        T_grid_world = self.T_grid_lidar @ inverse(trajectory.poses[index])
        tracks = self._tracks_near(time, T_grid_world)
        grid = _core.OccupancyGrid(_options())
        for number, track in enumerate(tracks, 1):
            grid.add_object(number, T_grid_world @ track.pose_at(time), track.size)
        for k in self.around(index):
            sweep = self._sweep(k)
            pose, when = trajectory.poses[k], int(trajectory.times[k])
            unfollowed = sweep.numbers.get(0, 0) if k == index else 0
            grid.add_sweep(sweep.rays, T_grid_world @ pose, unfollowed)
            for number, track in enumerate(tracks, 1):
                if track.covers(when):
                    T_grid_object = T_grid_world @ track.pose_at(time)
                    T = T_grid_object @ inverse(track.pose_at(when)) @ pose
                    velocity = track.velocity_at(when) @ pose[:3, :3]
                    of_sweep = sweep.numbers.get(track.id, 0)
                    grid.add_sweep_of_object(number, of_sweep, sweep.rays, T, velocity)
        found = grid.classify([
            _core.GridCamera(c.K, c.width, c.height, self.T_grid_lidar @ inverse(T))
            for c, T in self._cameras
        ])  # fmt: skip
        ids = np.array([0, *(track.id for track in tracks)], np.uint16)
        velocities = [np.zeros(3), *(track.velocity_at(time) for track in tracks)]
        flows = (np.array(velocities) @ T_grid_world[:3, :3].T)[:, :2].astype(np.float32)
        return Occupancy(
            np.array([FREE, STATIC, GROUND, DYNAMIC], np.uint8)[found["occupied"]],
            found["observed"].astype(np.bool_),
            found["seen"].astype(np.bool_),
            ids[found["object"]],
            flows[found["object"]],
            inverse(T_grid_world),
            time,
        )

    def _tracks_near(self, time: int, T_grid_world: NDArray[np.float64]) -> list[Track]:
        """Tracks that may reach into the grid at ``time`` [ns]."""
        high = np.add(CORNER, np.multiply(SIZE, VOXEL))

        def is_near(track: Track) -> bool:
            place = T_grid_world[:3, :3] @ track.pose_at(time)[:3, 3] + T_grid_world[:3, 3]
            reach = float(np.linalg.norm(track.size))
            return bool((place + reach > CORNER).all() and (place - reach < high).all())

        return [track for track in self._tracks.between(time, time) if is_near(track)]

    def _sweep(self, index: int) -> _Sweep:
        if index in self._rays:
            return self._rays.setdefault(index, self._rays.pop(index))  # the last one used
        frame, time = self._sweeps[index], int(self._trajectory.times[index])
        objects = dynamic_objects(frame, time, self._trajectory.poses[index], self._tracks)
        late = frame.time_offset
        rays = _core.SweepRays(
            frame.points,
            _ray_origins(frame, self._trajectory.velocity(index)),
            np.zeros(len(frame), np.float32) if late is None else late,
            objects.object_index,
            frame.ground,
            _CELL,
        )
        if len(self._rays) == _KEPT:
            del self._rays[next(iter(self._rays))]
        numbers = {track: number for number, track in enumerate(objects.instances, 1)}
        return self._rays.setdefault(index, _Sweep(rays, numbers))


def _options() -> _core.OccupancyOptions:
    options = _core.OccupancyOptions()
    options.voxel, options.size, options.corner = VOXEL, SIZE, CORNER
    return options


def _grid_frame(sweeps: Sequence[LidarFrame]) -> NDArray[np.float64]:
    """``T_grid_lidar``: levelled on the ground that the vehicle drives on."""
    some = dict.fromkeys(np.linspace(0, len(sweeps) - 1, 9).round().astype(int).tolist())
    frames = [sweeps[k] for k in some]
    ground = find_ground([frame.points[frame.ground] for frame in frames])
    if ground is None:
        raise InputError("no ground is found below the vehicle, on which the voxels would stand")
    T = rigid(level_turn(ground.up))
    T[2, 3] = ground.height
    return T


def _ray_origins(frame: LidarFrame, velocity: NDArray[np.float64]) -> NDArray[np.float32]:
    """Where each ray begins, (N, 3) in the LiDAR frame at the stamp [m]."""
    rig = frame.sensor_rig or SensorRig.single((0, 0, 0), len(frame))
    if frame.time_offset is not None:
        rig = rig.with_ego_motion(velocity, frame.time_offset)
    origins = np.zeros((len(frame), 3), np.float32)
    for view in lidar_views(frame.points, rig):
        own, found = np.isfinite(view.points[:, 0]), view.ray_origins()
        T = view.T_lidar_sensor.astype(np.float32)
        origins[own] = T[:3, 3] if found is None else found[own] @ T[:3, :3].T + T[:3, 3]
    return origins
