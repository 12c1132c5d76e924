"""Composite rendering of depth maps (paper V-B)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

import docdepth._core as _core
from docdepth.config import RenderParameters
from docdepth.errors import InputError
from docdepth.geometry.camera import Camera
from docdepth.geometry.se3 import inverse
from docdepth.geometry.track import Tracks
from docdepth.geometry.trajectory import Trajectory
from docdepth.render.backends import Renderer
from docdepth.render.frame import Frame, Part
from docdepth.render.selection import drawn_frames
from docdepth.render.sightings import View, boxes_in_view, sighted_objects

NEAR = 0.1
"""Near plane of the core's renderers [m]: points closer to the image plane are not drawn."""


def compose_depth(
    camera: Camera,
    T_camera_lidar: NDArray[np.float64],
    trajectory: Trajectory,
    time: int,
    frames: Callable[[int], Frame],
    parameters: RenderParameters | None = None,
    threads: int = 0,
    renderer: Renderer | None = None,
    tracks: Tracks | None = None,
) -> NDArray[np.float32]:
    """Render the depth map of one image from many sweeps (paper V-B).

    :func:`~docdepth.render.scene.render_depth` does the same without explicit frames.

    Parameters
    ----------
    camera : Camera
    T_camera_lidar : ndarray of float64, shape (4, 4)
        Transforms LiDAR points to the camera.
    trajectory : Trajectory
        Poses and times of all sweeps.
    time : int
        When the image was taken [ns]; within the trajectory.
    frames : callable
        Returns the :class:`Frame` of a sweep by its index. Only those of
        :func:`~docdepth.render.selection.needed_frames` are asked for.
    parameters : RenderParameters, optional
    threads : int
        0 takes all cores. The result does not depend on it.
    renderer : Renderer, optional
        What draws; the CPU if absent.
    tracks : Tracks, optional
        Of the frames' objects. Objects without a track are drawn where the nearest sweep saw them.
        Used by triangles only.

    Returns
    -------
    ndarray of float32, shape (height, width)
        z along the optical axis in metres; NaN where nothing was drawn.

    Raises
    ------
    InputError
        ``time`` lies outside the trajectory, or a frame was prepared for another ``primitive``.
    BackendError
        The renderer failed.
    """
    p = parameters or RenderParameters()
    core = (renderer or Renderer()).core
    draw = core.render_splats if p.primitive == "splats" else core.render_meshes
    arguments = core_arguments(camera, T_camera_lidar, trajectory, time, frames, p, tracks)
    if p.primitive == "triangles":
        arguments["nearest_frames"] = len(frames(trajectory.nearest(int(time))).parts)
        if tracks:
            T_camera_world = T_camera_lidar @ inverse(trajectory.interpolate(time)[0])
            view = View(camera, T_camera_world, int(time))
            arguments["boxes"] = boxes_in_view(view, trajectory, tracks)
    depth: NDArray[np.float32] = draw(**arguments, threads=threads)
    # The nearest depth wins, so cutting the map at the far plane is cutting the points.
    depth[depth > p.max_depth] = np.nan
    return depth


def core_arguments(
    camera: Camera,
    T_camera_lidar: NDArray[np.float64],
    trajectory: Trajectory,
    time: int,
    frames: Callable[[int], Frame],
    p: RenderParameters,
    tracks: Tracks | None = None,
) -> dict[str, Any]:
    """Arguments that the core's functions for depth and for layers share.

    Internal to this package.
    """
    splats = p.primitive == "splats"
    kind = _core.Frame if splats else _core.MeshFrame
    T_camera_world = T_camera_lidar @ inverse(trajectory.interpolate(time)[0])
    drawn = drawn_frames(trajectory, time, p, tracks)

    def placed(index: int, parts: list[Part]) -> list[Part]:
        """The parts of a sweep with their poses ``T_camera_sensor``."""
        if not isinstance(parts[0][0], kind):
            raise InputError(
                f"frame {index} was not made for {p.primitive}; give Frame the same parameters"
            )
        T_camera_sweep = T_camera_world @ trajectory.poses[index]
        return [(core, T_camera_sweep @ T_lidar_sensor) for core, T_lidar_sensor in parts]

    static = [part for i in drawn.static for part in placed(i, frames(i).parts)]
    image = {"K": camera.K, "width": camera.width, "height": camera.height}
    if splats:
        return image | {
            "static_frames": static,
            "dynamic_frames": [part for i in drawn.dynamic for part in placed(i, frames(i).parts)],
            "static_size": p.static_size,
            "dynamic_size": p.dynamic_size,
        }
    view = View(camera, T_camera_world, int(time))
    objects = sighted_objects(view, trajectory, frames, drawn, tracks or Tracks(), len(static))
    around = [
        (*part, float((np.int64(time) - trajectory.times[i]) * 1e-9))
        for i in drawn.dynamic
        for part in placed(i, frames(i).parts)
    ]
    return image | {
        "static_frames": static,
        "shutter_frames": around,
        "objects": objects,
        "visibility_sweeps": sum(len(frames(i).parts) for i in drawn.static[: p.visibility_sweeps]),
    }
