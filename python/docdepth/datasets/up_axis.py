"""Which way is up in a recording, and recordings of LiDARs mounted at an angle, with z up."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from docdepth.datasets.base import Dataset, LidarStream, Sweep
from docdepth.datasets.files import readable
from docdepth.datasets.merged_lidars import Place, lidar_ends, rig_in_order
from docdepth.datasets.views import View
from docdepth.geometry.ground_plane import GroundPlane, find_ground, level_turn
from docdepth.geometry.lidar_frame import SensorRig
from docdepth.geometry.points import usable_points
from docdepth.geometry.scan_mesh import share_in_triangles
from docdepth.geometry.se3 import inverse

LEVEL_DEG = 6.0
"""Frames whose z is nearer to up stay as they are: vehicles pitch and roads slope by as much."""

_GROUND_SWEEPS = 12  # sweeps of a drive that tell where its ground is
_SAMPLES = 3  # sweeps that tell in which frame returns have neighbours


def ground_of(
    recording: Dataset, rotations: NDArray[np.float64] | None = None
) -> GroundPlane | None:
    """The ground around the LiDAR of a drive, by some of its sweeps; None if they do not agree.

    ``rotations`` (n, 3, 3) take each sweep's points into the frame that the ground is wanted in;
    it is the LiDAR frame if they are left out.
    """
    clouds = []
    for k in sorted({int(k) for k in np.linspace(0, len(recording) - 1, _GROUND_SWEEPS)}):
        points = recording.sweep(k).points
        points = points[usable_points(points)]
        clouds.append(points if rotations is None else points @ rotations[k].T.astype(np.float32))
    return find_ground(clouds)


class LevelledRecording(View):
    """A recording with what was found of the mount of its LiDAR.

    Its LiDAR frame is turned so that z is up: points, poses, extrinsics of cameras and places of
    LiDARs belong to the turned frame. Rows and their times stay.

    Parameters
    ----------
    tilted : Dataset
    up : array_like, shape (3,), optional
        Unit vector that points up, LiDAR frame of the recording. Without it nothing is turned.
    sensor_origin : array_like, shape (3,) or (k, 3), optional
        Where the rays of the LiDAR begin, metres in the LiDAR frame of the recording; of several
        LiDARs, in the order of their returns in a sweep.

    Attributes
    ----------
    T_level_lidar : ndarray of float64, shape (4, 4)
        Takes points from the LiDAR frame of the recording to the turned one.
    """

    def __init__(
        self, tilted: Dataset, up: ArrayLike | None = None, sensor_origin: ArrayLike | None = None
    ) -> None:
        super().__init__(tilted)
        self._up = up
        places = np.array([] if sensor_origin is None else sensor_origin, np.float64).reshape(-1, 3)
        self._places: list[Place] = [(x, y, z) for x, y, z in places.tolist()]
        self._lidar_ends: dict[int, NDArray[np.intp]] = {}
        self.T_level_lidar = np.eye(4)
        if up is not None:
            self.T_level_lidar[:3, :3] = level_turn(up)
        self._back = inverse(self.T_level_lidar)
        self.cameras = {
            name: replace(stream, T_camera_lidar=stream.T_camera_lidar @ self._back)
            for name, stream in tilted.cameras.items()
        }

    @cached_property
    def partial_poses(self) -> NDArray[np.float64] | None:
        """Poses of the turned frame."""
        known = super().partial_poses
        return None if known is None else known @ self._back

    def _lidar(self, lidar: LidarStream) -> LidarStream:
        """The first one leans in the turned frame."""
        return replace(lidar, T_lidar_sensor=self.T_level_lidar @ lidar.T_lidar_sensor)

    def sweep(self, index: int) -> Sweep:
        """Sweep ``index``, turned."""
        sweep = super().sweep(index)
        if self._places and sweep.sensor_rig is None:
            sweep = replace(sweep, sensor_rig=self._rig(index, sweep.points))
        return sweep if self._up is None else self._turned(sweep, self._leans)

    def _rig(self, index: int, points: NDArray[np.float32]) -> SensorRig:
        """Which LiDAR measured each point; it is found once for each sweep."""
        if len(self._places) == 1:
            return SensorRig.single(self._places[0], len(points))
        if index not in self._lidar_ends:
            self._lidar_ends[index] = lidar_ends(points, self._places)
        return rig_in_order(self._places, self._lidar_ends[index])

    def _turned(self, sweep: Sweep, leans: bool) -> Sweep:
        points = sweep.points.astype(np.float64) @ self.T_level_lidar[:3, :3].T
        rig = sweep.sensor_rig
        if rig is None and leans:
            rig = SensorRig.single((0, 0, 0), len(points))
        if rig is not None:
            rig = replace(rig, T_lidar_sensor=self.T_level_lidar @ rig.T_lidar_sensor)
        return replace(sweep, points=points.astype(np.float32), sensor_rig=rig)

    @cached_property
    def _leans(self) -> bool:
        """Whether the LiDAR itself leans, and not only the frame its points are given in.

        Its mesh is drawn around the axis about which it turns: around another one, returns near the
        poles lack neighbours.
        """
        shares = np.zeros(2)
        wanted = sorted({int(k) for k in np.linspace(0, len(self) - 1, _SAMPLES)})
        for sweep in readable(self.whole.sweep, wanted, len(self)).values():
            usable = usable_points(sweep.points)
            for leans in (False, True):
                turned = self._turned(sweep, leans)
                rig = turned.sensor_rig
                rig = None if rig is None else rig.select(usable)
                points = np.ascontiguousarray(turned.points[usable])
                shares[int(leans)] += share_in_triangles(points, rig)
        return bool(shares[1] > shares[0])
