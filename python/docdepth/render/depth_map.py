"""Composite rendering of depth maps (paper V-B)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from docdepth.config import RenderParameters
from docdepth.geometry.track import Tracks
from docdepth.geometry.trajectory import Trajectory
from docdepth.render.backends import Renderer
from docdepth.render.object_views import boxes_in_view
from docdepth.render.render_list import render_list
from docdepth.render.render_sweep import RenderSweep
from docdepth.render.view import View

NEAR = 0.1
"""Near plane of the core's renderers [m]: points closer to the image plane are not drawn."""


def compose_depth(
    view: View,
    trajectory: Trajectory,
    sweeps: Callable[[int], RenderSweep],
    parameters: RenderParameters | None = None,
    threads: int = 0,
    renderer: Renderer | None = None,
    tracks: Tracks | None = None,
) -> NDArray[np.float32]:
    """Render the depth map of one image from many sweeps (paper V-B).

    :func:`~docdepth.render.scene.render_depth` does the same without explicit sweeps.

    Parameters
    ----------
    view : View
        The camera, where it is, and when; within the trajectory.
    trajectory : Trajectory
        Poses and times of all sweeps.
    sweeps : callable
        Returns the :class:`RenderSweep` of a sweep by its index. Only those of
        :func:`~docdepth.render.selection.needed_sweeps` are asked for.
    parameters : RenderParameters, optional
    threads : int
        0 takes all cores. The result does not depend on it.
    renderer : Renderer, optional
        What draws; the CPU if absent.
    tracks : Tracks, optional
        Of the sweeps' objects. Objects without a track are drawn where the nearest sweep saw them.
        Used by triangles only.

    Returns
    -------
    ndarray of float32, shape (height, width)
        z along the optical axis in metres; NaN where nothing was drawn.

    Raises
    ------
    InputError
        A sweep was prepared for another ``primitive``.
    BackendError
        The renderer failed.
    """
    p, tracks, camera = parameters or RenderParameters(), tracks or Tracks(), view.camera
    core = (renderer or Renderer()).core
    drawn = render_list(view, trajectory, sweeps, p, tracks)
    K, width, height = camera.K, camera.width, camera.height
    depth: NDArray[np.float32]
    if p.primitive == "splats":
        depth = core.render_splats(
            K, width, height, drawn.static, drawn.dynamic, p.static_size, p.dynamic_size, threads
        )
    else:
        boxes = boxes_in_view(view, trajectory, tracks) if tracks else []
        nearest = len(sweeps(trajectory.nearest(view.time)).parts)
        depth = core.render_meshes(
            K, width, height, drawn.static, drawn.objects, drawn.visibility,
            threads, drawn.around, boxes, nearest,
        )  # fmt: skip
    # The nearest depth wins, so cutting the map at the far plane is cutting the points.
    depth[depth > p.max_depth] = np.nan
    if camera.mask is not None:
        depth[~camera.mask] = np.nan
    return depth
