"""Composite rendering of depth maps (paper V-B): what is drawn into an image, and its depth."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

import docdepth._core as _core
from docdepth.config import RenderParameters
from docdepth.errors import InputError
from docdepth.geometry.camera import View
from docdepth.geometry.track import Tracks
from docdepth.geometry.trajectory import Trajectory
from docdepth.render.backends import Renderer
from docdepth.render.object_views import ObjectViews, PlacedBox, boxes_in_view, object_views
from docdepth.render.render_sweep import Part, RenderSweep
from docdepth.render.selection import DrawnSweeps, drawn_sweeps

NEAR = 0.1
"""Near plane of the core's renderers [m]: points closer to the image plane are not drawn."""

_CUT_OFF = 0.9
"""A sweep of fewer returns than this share of the fullest one around it may lack a part of its
view. From sweep to sweep they differ by a few hundredths."""

PartAround: TypeAlias = tuple[Any, NDArray[np.float64], float]
"""A part with its pose, and the seconds from its sweep to the image."""


class RenderList(NamedTuple):
    """What the core draws into an image: parts of sweeps with their poses ``T_camera_sensor``."""

    view: View
    parameters: RenderParameters
    static: list[Part]  # those whose static points are drawn
    around: list[PartAround]  # those around the image, the nearest in time first
    # (n,): seconds from the image to the sweep of each part, as the core numbers parts
    delays: NDArray[np.float64]
    objects: list[ObjectViews]  # triangles only, as all that follows
    visibility: int  # so many of ``static`` tell what is visible
    nearest: int  # so many of ``around`` are of the nearest sweep
    boxes: list[PlacedBox]  # behind which the world is drawn only where it was seen

    @property
    def dynamic(self) -> list[Part]:
        """The parts around the image, without their times."""
        return [(core, pose) for core, pose, _ in self.around]


def render_list(
    view: View,
    trajectory: Trajectory,
    sweeps: Callable[[int], RenderSweep],
    parameters: RenderParameters | None = None,
    tracks: Tracks | None = None,
) -> RenderList:
    """Choose and place what is drawn into an image.

    Parameters
    ----------
    view : View
        The camera, where it is, and when; within the trajectory.
    trajectory : Trajectory
        Poses and times of all sweeps.
    sweeps : callable
        Returns the :class:`RenderSweep` of a sweep by its index. Only those of
        :func:`~docdepth.render.selection.needed_sweeps` are asked for.
    tracks : Tracks, optional
        Of the sweeps' objects. Objects without a track are drawn where the nearest sweep saw them.
        Used by triangles only.
    """
    p, tracks = parameters or RenderParameters(), tracks or Tracks()
    splats = p.primitive == "splats"
    kind = _core.Frame if splats else _core.MeshFrame
    drawn = drawn_sweeps(trajectory, view.time, p, tracks)

    def placed(index: int) -> list[Part]:
        parts = sweeps(index).parts
        if not isinstance(parts[0][0], kind):
            raise InputError(
                f"sweep {index} was not made for {p.primitive}; give RenderSweep the same "
                "parameters"
            )
        T_camera_sweep = view.T_camera_world @ trajectory.poses[index]
        return [(core, T_camera_sweep @ T_lidar_sensor) for core, T_lidar_sensor in parts]

    if not splats:
        drawn = _completed(drawn, sweeps)
    static = [part for i in drawn.static for part in placed(i)]
    around = [
        (*part, float((np.int64(view.time) - trajectory.times[i]) * 1e-9))
        for i in drawn.dynamic
        for part in placed(i)
    ]
    moving = drawn.dynamic if splats else drawn.with_objects
    of_parts = [i for i in (*drawn.static, *moving) for _ in sweeps(i).parts]
    delays = (trajectory.times[of_parts] - np.int64(view.time)).astype(np.float64) * 1e-9
    if splats:
        return RenderList(view, p, static, around, delays, [], 0, 0, [])
    return RenderList(
        view,
        p,
        static,
        around,
        delays,
        object_views(view, trajectory, sweeps, drawn, tracks, len(static)),
        sum(len(sweeps(i).parts) for i in drawn.static[: p.visibility_sweeps]),
        len(sweeps(drawn.dynamic[0]).parts),
        boxes_in_view(view, trajectory, tracks) if tracks else [],
    )


def _completed(drawn: DrawnSweeps, sweeps: Callable[[int], RenderSweep]) -> DrawnSweeps:
    """Behind a sweep that was cut off, the fullest around the image: all may be from one place."""
    nearest, fullest = drawn.dynamic[0], max(drawn.dynamic, key=lambda i: sweeps(i).returns)
    whole = sweeps(nearest).returns >= _CUT_OFF * sweeps(fullest).returns
    if whole or fullest in drawn.static:
        return drawn
    return drawn._replace(static=[nearest, fullest, *drawn.static[1:]])


def compose_depth(
    drawn: RenderList, threads: int = 0, renderer: Renderer | None = None
) -> NDArray[np.float32]:
    """Render the depth map of one image from many sweeps (paper V-B).

    :func:`~docdepth.render.scene.render_depth` does the same without explicit sweeps.

    Parameters
    ----------
    drawn : RenderList
        From :func:`render_list`.
    renderer : Renderer, optional
        What draws; the CPU if absent.

    Returns
    -------
    ndarray of float32, shape (height, width)
        z along the optical axis in metres; NaN where nothing was drawn.
    """
    p, camera, core = drawn.parameters, drawn.view.camera, (renderer or Renderer()).core
    image = camera.K, camera.width, camera.height
    depth: NDArray[np.float32]
    if p.primitive == "splats":
        depth = core.render_splats(
            *image, drawn.static, drawn.dynamic, p.static_size, p.dynamic_size, threads
        )
    else:
        depth = core.render_meshes(
            *image, drawn.static, drawn.objects, drawn.visibility,
            threads, drawn.around, drawn.boxes, drawn.nearest,
        )  # fmt: skip
    # The nearest depth wins, so cutting the map at the far plane is cutting the points.
    depth[depth > p.max_depth] = np.nan
    if camera.mask is not None:
        depth[~camera.mask] = np.nan
    return depth
