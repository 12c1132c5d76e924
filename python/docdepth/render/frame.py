"""A sweep made ready to be drawn (paper V-B)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from docdepth import _core
from docdepth.config import RenderParameters
from docdepth.errors import InputError
from docdepth.geometry.scan_mesh import LidarMesh, ScanMesh
from docdepth.geometry.sensor_rig import SensorRig


class Frame:
    """A sweep made ready to be drawn: static and moving parts apart, neighbours together.

    Make it once a sweep and keep it for all images that see the sweep.

    Parameters
    ----------
    points : ndarray of float32, shape (N, 3)
        LiDAR frame, metres, deskewed to the sweep's time. Points that are not finite are left out.
    classid : ndarray of uint16, shape (N,)
        Below 50 ground, below 100 static, moving from 100 on.
    parameters : RenderParameters, optional
        Its ``surface`` says what is made; :func:`render` wants the same.
    time_offset : ndarray of float32, shape (N,), optional
        When each point was measured, seconds after the sweep's time. Known, it tells better where
        moving objects were.
    sensor_rig : Sensors, optional
        Where the sweep was measured from, if not from the origin. Each of several LiDARs has a
        surface and lines of sight of its own.
    velocity : array_like of float64, shape (3,), optional
        Of the LiDAR in its own frame, metres a second (:meth:`Trajectory.velocity`). With
        ``time_offset`` known, lines of sight begin where it was when it measured each point.

    Raises
    ------
    InputError
        Shapes or dtypes are wrong.
    """

    def __init__(
        self,
        points: NDArray[np.float32],
        classid: NDArray[np.uint16],
        parameters: RenderParameters | None = None,
        time_offset: NDArray[np.float32] | None = None,
        sensor_rig: SensorRig | None = None,
        velocity: ArrayLike | None = None,
    ) -> None:
        points, classid = np.asarray(points), np.asarray(classid)
        if points.ndim != 2 or points.shape[1] != 3 or points.dtype != np.float32:
            raise InputError(
                f"points must be float32 of shape (N, 3), got {points.dtype} {points.shape}"
            )
        if classid.shape != (len(points),) or classid.dtype != np.uint16:
            raise InputError(
                f"classid must be uint16 of shape ({len(points)},), one for each point; "
                f"got {classid.dtype} {classid.shape}"
            )
        if time_offset is not None and time_offset.shape != (len(points),):
            raise InputError(f"time_offset must have shape ({len(points)},), a time a point")
        p = parameters or RenderParameters()
        points, classid = np.ascontiguousarray(points), np.ascontiguousarray(classid)
        self.parts: list[_Part]
        self.dynamic_part: _Part
        if p.surface == "splats":
            self.dynamic_part = (_core.Frame(points, classid, p.crop), np.eye(4))
            self.parts = [self.dynamic_part]
            return
        with np.errstate(invalid="ignore", over="ignore"):
            drawn = np.einsum("ij,ij->i", points, points, dtype=np.float64) < p.crop**2
        points, classid = points.compress(drawn, axis=0), classid[drawn]
        if time_offset is not None and velocity is not None:
            sensor_rig = (
                sensor_rig or SensorRig.single((0, 0, 0), len(time_offset))
            ).with_ego_motion(velocity, time_offset)
        time_offset = None if time_offset is None else time_offset[drawn].astype(np.float32)
        sensor_rig = None if sensor_rig is None else sensor_rig.select(drawn)
        seen = ScanMesh(points, sensor_rig)
        self.parts = [
            (_surface_frame(part, classid, p, time_offset), part.view.T_lidar_sensor)
            for part in seen.parts
        ]
        self.dynamic_part = self.parts[0]
        if len(self.parts) > 1:  # what moves is small, and drawn as if the first had seen all of it
            first = SensorRig.single(seen.parts[0].view.T_lidar_sensor[:3, 3], len(points))
            first = replace(
                first, ego_displacement=None if sensor_rig is None else sensor_rig.ego_displacement
            )
            (whole,) = ScanMesh(points, first).parts
            self.dynamic_part = (
                _surface_frame(whole, classid, p, time_offset),
                whole.view.T_lidar_sensor,
            )


_Part = tuple[_core.Frame | _core.SurfaceFrame, NDArray[np.float64]]
"""What is drawn, and where it stands in the LiDAR's frame."""


def _surface_frame(
    part: LidarMesh,
    classid: NDArray[np.uint16],
    parameters: RenderParameters,
    time_offset: NDArray[np.float32] | None,
) -> _core.SurfaceFrame:
    """Rows that are not finite are no points of this surface."""
    points, ray_origins = part.view.points, part.view.ray_origins()
    triangles, cut, loose = part.core.triangles, part.core.cut, part.core.loose
    if not np.isfinite(points).all():
        own = np.isfinite(points).all(axis=1)
        row = np.cumsum(own, dtype=np.uint32) - np.uint32(1)
        points, classid, time_offset = (
            points[own],
            classid[own],
            None if time_offset is None else time_offset[own],
        )
        ray_origins = None if ray_origins is None else ray_origins[own]
        triangles, loose = row[triangles], row[loose]
    angle = float(np.radians(parameters.loose_deg))
    return _core.SurfaceFrame(
        points, classid, triangles, cut, loose, angle, time_offset, ray_origins
    )
