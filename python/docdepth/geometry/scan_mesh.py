"""A sweep as a mesh: triangles between neighbouring returns."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import docdepth._core as _core
from docdepth.geometry.lidar_frame import LidarView, SensorRig, lidar_views
from docdepth.geometry.points import check_points


class LidarMesh(NamedTuple):
    """The mesh of what one LiDAR of a rig measured."""

    view: LidarView
    core: _core.ScanMesh


class ScanMesh:
    """The mesh of one sweep, of any sensor: no rings or columns need to be known.

    Returns are neighbours when the Delaunay triangulation of their azimuth and elevation connects
    them. Angles are integers, 65536 a turn, and the triangulation closes at +-180 degrees. The mesh
    depends on the points alone, not on threads or the machine.

    Parameters
    ----------
    points : ndarray of float32, shape (N, 3)
        LiDAR frame (z up), metres. Points that are not finite or lie at the origin are no returns:
        the mesh leaves them out.
    sensor_rig : SensorRig, optional
        Where the sweep was measured from; each of several LiDARs has a mesh of its own. With an
        ``ego_displacement`` angles are seen from where the LiDAR was when it measured each return.
    parameters : _core.MeshParameters, optional
        Where a triangle spans a depth jump; the defaults are constants of the C++ structure.

    Attributes
    ----------
    triangles : ndarray of uint32, shape (M, 3)
        Rows of ``points``; counterclockwise where azimuth is drawn to the right and elevation up.
    discontinuity : ndarray of bool, shape (M,)
        The triangle spans a depth jump: nothing was measured between its corners.
    isolated : ndarray of uint32, shape (K,)
        Ascending rows of returns in no continuous triangle (poles, twigs, wires).
    parts : list of LidarMesh
        One for each LiDAR.
    """

    def __init__(
        self,
        points: NDArray[np.float32],
        sensor_rig: SensorRig | None = None,
        parameters: _core.MeshParameters | None = None,
    ) -> None:
        parameters = parameters or _core.MeshParameters()
        self.parts = [
            LidarMesh(view, _core.ScanMesh(view.motion_corrected(), parameters))
            for view in lidar_views(check_points(points), sensor_rig)
        ]
        cores = [part.core for part in self.parts]
        self.core = cores[0] if len(cores) == 1 else _core.join_meshes(cores)
        self.triangles = self.core.triangles
        self.discontinuity = self.core.discontinuity.view(np.bool_)
        self.isolated = self.core.isolated


def share_in_triangles(points: NDArray[np.float32], rig: SensorRig | None) -> float:
    """Share of the points that are corners of continuous triangles of the sweep's mesh.

    Returns on both sides of missing ones are neighbours here: what is seen of them tells where the
    LiDAR is, though nothing is drawn between them.
    """
    parameters = _core.MeshParameters()
    parameters.gap_jump_ratio = parameters.jump_ratio
    mesh = ScanMesh(points, rig, parameters)
    used = np.zeros(len(points), np.bool_)
    used[mesh.triangles[~mesh.discontinuity].ravel()] = True
    return float(used.mean())
