"""Which sweeps are drawn into an image (paper V-B)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from docdepth.config import RenderParameters
from docdepth.geometry.trajectory import Trajectory

MOVING = 4
"""Sweeps that moving objects are drawn from, as triangles."""


def static_frames(
    trajectory: Trajectory, time: int, parameters: RenderParameters | None = None
) -> NDArray[np.int64]:
    """Sweeps whose static points are drawn into the image taken at ``time`` [ns] (paper III-D).

    Those with ``-behind < arc length from the image < ahead``. As splats they are taken in order of
    path and at least ``step`` apart. As triangles the one nearest in time comes first, being the
    most trustworthy, and then others by their distance. The path is cut every ``step``, and of
    these cuts every second, fourth, eighth ... is used farther away: images one after the other
    share their sweeps. Where the ego stands, many sweeps have one arc length: of these only the one
    nearest in time can be taken.

    Returns
    -------
    ndarray of int64, shape (k,)
        Indices of the trajectory, in the order in which they are drawn.
    """
    p = parameters or RenderParameters()
    arc = trajectory.arc_length
    ahead = arc - trajectory.arc_length_at(time)[0]
    window = np.flatnonzero((-p.behind < ahead) & (ahead < p.ahead))
    delay = np.abs(trajectory.times - np.int64(time))
    kept: list[int] = []
    if p.surface == "splats":
        for place in np.unique(arc[window]):
            if not kept or place - arc[kept[-1]] >= p.step:
                here = window[arc[window] == place]
                kept.append(int(here[np.argmin(delay[here])]))
        return np.array(kept, dtype=np.int64)

    nearest = trajectory.nearest(time)
    cut = (arc // p.step).astype(np.int64)
    for k in window[np.diff(cut, prepend=-1)[window] > 0]:
        passed = range(cut[k - 1] + 1 if k else 0, cut[k] + 1)
        spacing = p.step * max(n & -n or np.inf for n in passed)  # of the widest cutting passed
        if abs(arc[k] - arc[nearest]) >= p.step / 2 and p.step_growth * abs(ahead[k]) <= spacing:
            kept.append(int(k))
    kept.sort(key=lambda k: abs(ahead[k]))
    return np.array([nearest, *kept], dtype=np.int64)


def dynamic_frame(trajectory: Trajectory, time: int) -> int:
    """The sweep whose moving points are drawn: the nearest in time to ``time`` [ns]."""
    return trajectory.nearest(time)


def _moving_frames(trajectory: Trajectory, time: int, parameters: RenderParameters) -> list[int]:
    """Sweeps that tell of what moves, the nearest in time first."""
    nearest = dynamic_frame(trajectory, time)
    if parameters.surface == "splats":
        return [nearest]
    around = np.arange(max(nearest - MOVING, 0), min(nearest + MOVING + 1, len(trajectory)))
    delay = np.abs(trajectory.times[around] - np.int64(time))
    return [int(i) for i in around[np.argsort(delay, kind="stable")[:MOVING]]]


def needed_frames(
    trajectory: Trajectory, time: int, parameters: RenderParameters | None = None
) -> set[int]:
    """Every sweep that :func:`render` asks for; all others can be forgotten."""
    p = parameters or RenderParameters()
    world, moving = drawn_sweeps(trajectory, time, p)
    return {*world, *moving}


def drawn_sweeps(
    trajectory: Trajectory, time: int, parameters: RenderParameters
) -> tuple[list[int], list[int]]:
    """Sweeps that are drawn, as the core numbers them: of the world, then of what moves."""
    moving = _moving_frames(trajectory, time, parameters)
    return static_frames(trajectory, time, parameters).tolist(), moving
