"""What the core draws into one image: sweeps and objects with their poses."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

import docdepth._core as _core
from docdepth.config import RenderParameters
from docdepth.errors import InputError
from docdepth.geometry.track import Tracks
from docdepth.geometry.trajectory import Trajectory
from docdepth.render.object_views import ObjectViews, object_views
from docdepth.render.render_sweep import Part, RenderSweep
from docdepth.render.selection import drawn_sweeps
from docdepth.render.view import View

PartAround: TypeAlias = tuple[Any, NDArray[np.float64], float]
"""A part with its pose, and the seconds from its sweep to the image."""


class RenderList(NamedTuple):
    """Parts of sweeps with their poses ``T_camera_sensor``.

    Attributes
    ----------
    static : list of Part
        Those whose static points are drawn.
    around : list of PartAround
        Those around the image, the nearest in time first.
    objects : list of ObjectViews
        Triangles only.
    visibility : int
        So many of ``static`` tell what is visible. Triangles only.
    sweeps : list of int
        The sweep of each part, as the core numbers parts.
    """

    static: list[Part]
    around: list[PartAround]
    objects: list[ObjectViews]
    visibility: int
    sweeps: list[int]

    @property
    def dynamic(self) -> list[Part]:
        """The parts around the image, without their times."""
        return [(core, pose) for core, pose, _ in self.around]


def render_list(
    view: View,
    trajectory: Trajectory,
    sweeps: Callable[[int], RenderSweep],
    p: RenderParameters,
    tracks: Tracks,
) -> RenderList:
    """Choose and place what is drawn into an image.

    Raises
    ------
    InputError
        A sweep was prepared for another ``primitive``.
    """
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

    static = [part for i in drawn.static for part in placed(i)]
    around = [
        (*part, float((np.int64(view.time) - trajectory.times[i]) * 1e-9))
        for i in drawn.dynamic
        for part in placed(i)
    ]
    moving = drawn.dynamic if splats else drawn.with_objects
    objects = [] if splats else object_views(view, trajectory, sweeps, drawn, tracks, len(static))
    return RenderList(
        static,
        around,
        objects,
        sum(len(sweeps(i).parts) for i in drawn.static[: p.visibility_sweeps]),
        [i for i in (*drawn.static, *moving) for _ in sweeps(i).parts],
    )
