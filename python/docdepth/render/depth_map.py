"""Composite rendering of depth maps (paper III-D)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth import _core
from docdepth.config import RenderParameters
from docdepth.errors import InputError
from docdepth.geometry.camera import Camera
from docdepth.geometry.se3 import inverse
from docdepth.geometry.trajectory import Trajectory
from docdepth.render.backends import Renderer
from docdepth.render.frame import Frame
from docdepth.render.selection import drawn_sweeps

NEAR = 0.1
"""Nothing nearer to the image plane is drawn [m]."""


def render(
    camera: Camera,
    T_camera_lidar: NDArray[np.float64],
    trajectory: Trajectory,
    time: int,
    frames: Callable[[int], Frame],
    parameters: RenderParameters | None = None,
    threads: int = 0,
    renderer: Renderer | None = None,
) -> NDArray[np.float32]:
    """Depth map of the camera at one moment, composed of many sweeps (paper III-D).

    Parameters
    ----------
    camera : Camera
    T_camera_lidar : ndarray of float64, shape (4, 4)
        Takes LiDAR points to the camera.
    trajectory : Trajectory
        Poses and times of all sweeps.
    time : int
        When the image was taken [ns]; within the trajectory.
    frames : callable
        Gives the :class:`Frame` of a sweep by its index; asked only for sweeps that are drawn.
    parameters : RenderParameters, optional
    threads : int
        0 takes all cores. The result does not depend on it.
    renderer : Renderer, optional
        What draws, from :func:`docdepth.render.backends.choose`; the processor if absent.

    Returns
    -------
    ndarray of float32, shape (height, width)
        z along the optical axis in metres; NaN where nothing was drawn.

    Raises
    ------
    InputError
        ``time`` lies outside the trajectory, or a frame was made for another ``surface``.
    BackendError
        The renderer failed.
    """
    p = parameters or RenderParameters()
    core = (renderer or Renderer()).core
    draw = core.render_splats if p.surface == "splats" else core.render_meshes
    depth: NDArray[np.float32] = draw(
        **arguments(camera, T_camera_lidar, trajectory, time, frames, p), threads=threads
    )
    # The far plane: nearest wins, so cutting the result is cutting the points.
    depth[depth > p.max_depth] = np.nan
    return depth


def arguments(
    camera: Camera,
    T_camera_lidar: NDArray[np.float64],
    trajectory: Trajectory,
    time: int,
    frames: Callable[[int], Frame],
    p: RenderParameters,
) -> dict[str, Any]:
    """What the core draws, or looks at, for one image."""
    T_camera_world = T_camera_lidar @ inverse(trajectory.interpolate(time)[0])
    kind = _core.Frame if p.surface == "splats" else _core.MeshFrame

    def frame(index: int) -> Frame:
        found = frames(index)
        if not isinstance(found.dynamic_part[0], kind):
            raise InputError(f"frame {index} was not made for {p.surface}; give Frame parameters")
        return found

    T_camera_sweep = T_camera_world @ trajectory.poses
    world, moving = drawn_sweeps(trajectory, time, p)
    image = {"K": camera.K, "width": camera.width, "height": camera.height}
    fixed = [(core, T_camera_sweep[i] @ T) for i in world for core, T in frame(i).parts]
    dynamic_part = [
        (core, T_camera_sweep[i] @ T) for i in moving for core, T in [frame(i).dynamic_part]
    ]
    if p.surface == "splats":
        return image | {
            "static_frames": fixed,
            "dynamic_frames": dynamic_part,
            "static_size": (p.static_size_max, p.static_size_min),
            "dynamic_size": (p.dynamic_size_max, p.dynamic_size_min),
        }
    since = (np.int64(time) - trajectory.times[moving]) * 1e-9
    return image | {
        "static_frames": fixed,
        "dynamic_frames": [(*part, float(t)) for part, t in zip(dynamic_part, since, strict=True)],
        "max_speed": p.max_speed,
        "visibility_sweeps": p.witnesses,
    }
