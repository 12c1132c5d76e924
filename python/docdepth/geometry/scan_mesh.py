"""A sweep as the surface that it measured: triangles between neighbouring returns."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from docdepth import _core
from docdepth.config import SurfaceParameters
from docdepth.errors import InputError
from docdepth.geometry.sensor_rig import LidarView, SensorRig, lidar_views


class LidarMesh(NamedTuple):
    """What one LiDAR saw of a sweep, and the surface of it."""

    view: LidarView
    core: _core.ScanMesh


class ScanMesh:
    """The surface of one sweep, of any sensor; no rings or columns need to be known.

    Two returns are neighbours when the Delaunay triangulation of azimuth and elevation says so
    (counted in 65536ths of a turn; it closes at +-180 degrees), as seen from where the LiDAR had
    come to when it measured each. The result depends on the points alone, not on threads or
    machine. Make it once a sweep: key frames and objects take it.

    Parameters
    ----------
    points : ndarray of float32, shape (N, 3)
        LiDAR frame (z up), metres. Points that are not finite or lie at the origin are no returns:
        they take no part.
    parameters : SurfaceParameters, optional
    sensor_rig : Sensors, optional
        Where the sweep was measured from; each of several LiDARs has a surface of its own.

    Attributes
    ----------
    triangles : ndarray of uint32, shape (M, 3)
        Rows of ``points``; counterclockwise where azimuth is drawn to the right and elevation up.
    cut : ndarray of bool, shape (M,)
        The triangle spans a depth jump: nothing was measured between its corners.
    loose : ndarray of uint32, shape (K,)
        Returns that no uncut triangle uses (poles, twigs, wires), ascending.

    parts : list of SurfacePart
        One a LiDAR.

    Raises
    ------
    InputError
        ``points`` has another shape or dtype.
    """

    def __init__(
        self,
        points: NDArray[np.float32],
        parameters: SurfaceParameters | None = None,
        sensor_rig: SensorRig | None = None,
    ) -> None:
        points, p = np.asarray(points), parameters or SurfaceParameters()
        if points.ndim != 2 or points.shape[1] != 3:
            raise InputError(
                f"points must have shape (N, 3), got {points.shape}; pass x, y, z of one sweep"
            )
        if points.dtype != np.float32:
            raise InputError(
                f"points must be float32, got {points.dtype}; convert them with astype(np.float32)"
            )
        core = _core.MeshParameters()
        core.max_gap = float(np.radians(p.max_gap_deg))
        core.jump_ratio, core.noise, core.flatness = p.jump_ratio, p.noise, p.flatness
        self.parts = [
            LidarMesh(view, _core.ScanMesh(view.motion_corrected(), core))
            for view in lidar_views(np.ascontiguousarray(points), sensor_rig)
        ]
        cores = [part.core for part in self.parts]
        self.core = cores[0] if len(cores) == 1 else _core.join_meshes(cores)
        self.triangles = self.core.triangles
        self.cut = self.core.discontinuity.view(np.bool_)
        self.loose = self.core.isolated
