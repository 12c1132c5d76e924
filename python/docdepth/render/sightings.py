"""What the sweeps of an image saw of the objects that move, placed at the time of the image (ours).

A car is rigid, so every sweep that saw it tells about it. A person is not: only the sweeps around
the image do.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from docdepth import _core
from docdepth.geometry.trajectory import Trajectory
from docdepth.render.frame import Frame
from docdepth.render.moving_objects import Tracks, carried
from docdepth.render.selection import DrawnFrames

SOFT_SECONDS = 0.25
"""Sweeps farther in time from the image tell nothing about what is not rigid [s]. A step of a person
takes half a second."""

MOST_SIGHTINGS = 12
"""Sweeps that an object is drawn from."""

MOST_RAYS = 12
"""Sweeps whose rays tell where an object ends."""

_Placed: TypeAlias = "tuple[_core.MeshFrame, NDArray[np.float64]]"
_Sighting: TypeAlias = "tuple[_core.MeshFrame, int, NDArray[np.float64], int]"
_Object: TypeAlias = "tuple[int, list[_Sighting], list[_Sighting], list[_Placed]]"


class _Seen(NamedTuple):
    """An object in one sweep."""

    sweep: int
    owner: int
    time: int


def sighted_objects(
    T_camera_world: NDArray[np.float64],
    trajectory: Trajectory,
    time: int,
    frames: Callable[[int], Frame],
    drawn: DrawnFrames,
    tracks: Tracks,
    first_number: int,
) -> list[_Object]:
    """The argument ``objects`` of the core's renderers.

    Sweep ``k`` of ``drawn.sighted`` has the number ``first_number + k``.
    """
    number = {sweep: first_number + k for k, sweep in enumerate(drawn.sighted)}
    seen: dict[int, list[_Seen]] = {}
    for sweep in drawn.sighted:
        objects = frames(sweep).objects
        for k, instance in enumerate(objects.instances):
            seen.setdefault(instance, []).append(_Seen(sweep, k + 1, objects.times[k]))
    found = []
    for instance in sorted(seen):
        track = tracks.get(instance)
        around, others = _chosen(seen[instance], drawn, track is not None and track.kind, time)

        def placed(view: _Seen, track=track) -> _Placed:
            core, T_lidar_sensor = frames(view.sweep).dynamic_part
            T_world_lidar = carried(track, view.time, time, trajectory.poses[view.sweep])
            return core, T_camera_world @ T_world_lidar @ T_lidar_sensor

        def sighting(view: _Seen) -> _Sighting:
            core, T_camera_sensor = placed(view)
            return core, view.owner, T_camera_sensor, number[view.sweep]

        if not around and not others:
            continue
        rays = [placed(view) for view in (around + others)[:MOST_RAYS]]
        found.append(
            (
                instance,
                [sighting(view) for view in around[:1]],
                [sighting(view) for view in around[1:] + others],
                rays,
            )
        )
    return found


def _chosen(
    seen: list[_Seen], drawn: DrawnFrames, kind: str | bool, time: int
) -> tuple[list[_Seen], list[_Seen]]:
    """The views of an object from the sweeps around the image, and from others."""
    if not kind:
        return [view for view in seen if view.sweep == drawn.dynamic[0]], []
    around = [view for view in seen if view.sweep in drawn.dynamic]
    around.sort(key=lambda view: abs(view.time - time))
    if kind != "vehicle":
        return [v for v in around if abs(v.time - time) <= SOFT_SECONDS * 1e9], []
    others = [view for view in seen if view.sweep not in drawn.dynamic]
    others.sort(key=lambda view: abs(view.time - time))
    return around, others[: MOST_SIGHTINGS - len(around)]
