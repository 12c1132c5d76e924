"""A sweep as the surface that it measured: triangles between neighbouring returns."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from docdepth import _core
from docdepth.config import SurfaceParameters
from docdepth.errors import InputError


@dataclass(frozen=True)
class Surface:
    """The surface of one sweep, of any sensor; no rings or columns need to be known.

    Two returns are neighbours when the Delaunay triangulation of azimuth and elevation says so
    (counted in 65536ths of a turn; it closes at +-180 degrees). The result depends on the points
    alone, not on threads or machine.

    Parameters
    ----------
    points : ndarray of float32, shape (N, 3)
        LiDAR frame (z up), metres. Points at the origin are no returns: they take no part.
    parameters : SurfaceParameters, optional

    Attributes
    ----------
    triangles : ndarray of uint32, shape (M, 3)
        Rows of ``points``; counterclockwise where azimuth is drawn to the right and elevation up.
    cut : ndarray of bool, shape (M,)
        The triangle spans a depth jump: nothing was measured between its corners.
    loose : ndarray of uint32, shape (K,)
        Returns that no uncut triangle uses (poles, twigs, wires), ascending.

    Raises
    ------
    InputError
        ``points`` has another shape or dtype, or contains NaN or infinite values.
    """

    points: NDArray[np.float32]
    parameters: SurfaceParameters | None = None
    triangles: NDArray[np.uint32] = field(init=False)
    cut: NDArray[np.bool_] = field(init=False)
    loose: NDArray[np.uint32] = field(init=False)

    def __post_init__(self) -> None:
        points, p = self.points, self.parameters or SurfaceParameters()
        if not isinstance(points, np.ndarray) or points.ndim != 2 or points.shape[1] != 3:
            raise InputError(
                f"points must have shape (N, 3), got {np.shape(points)}; pass x, y, z of one sweep"
            )
        if points.dtype != np.float32:
            raise InputError(
                f"points must be float32, got {points.dtype}; convert them with astype(np.float32)"
            )
        if not np.isfinite(points).all():
            raise InputError("points contain NaN or infinite values; drop these rows first")
        triangles, cut, loose = _core.surface(np.ascontiguousarray(points), core_parameters(p))
        object.__setattr__(self, "triangles", triangles)
        object.__setattr__(self, "cut", cut.view(np.bool_))
        object.__setattr__(self, "loose", loose)


def core_parameters(parameters: SurfaceParameters) -> _core.SurfaceParameters:
    """The same parameters for the core, angles in radians."""
    core = _core.SurfaceParameters()
    core.max_gap = float(np.radians(parameters.max_gap_deg))
    core.jump_ratio, core.noise = parameters.jump_ratio, parameters.noise
    core.flatness = parameters.flatness
    return core
