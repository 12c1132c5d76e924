"""Which key frames vote on each sweep (paper IV-B)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from docdepth.config import DynamicsParameters
from docdepth.geometry.trajectory import Trajectory


def key_frames(
    trajectory: Trajectory, parameters: DynamicsParameters | None = None
) -> list[NDArray[np.int64]]:
    """Choose the key frames that vote on each sweep.

    The trajectory is subsampled twice, finely and coarsely; fine key frames vote on near sweeps,
    coarse ones also on far sweeps. Where the ego crawls or stands, and near the ends of the drive,
    some more are chosen by time: what crosses a standing ego's way is seen to come and go, and the
    last sweeps have no others ahead of them. A key frame votes once, and never on itself.

    Parameters
    ----------
    trajectory : Trajectory
    parameters : DynamicsParameters, optional

    Returns
    -------
    list of ndarray of int64
        For each sweep the indices of its key frames, increasing.
    """
    p = parameters or DynamicsParameters()
    arc, time = trajectory.arc_length, (trajectory.times - trajectory.times[0]) * 1e-9
    kinds = [
        (trajectory.subsample(p.fine_spacing), p.fine_radius, np.inf),
        (trajectory.subsample(p.coarse_spacing), p.coarse_radius, np.inf),
    ]
    if p.time_spacing:
        often = trajectory.subsample(p.fine_spacing, p.time_spacing)
        kinds.append((often, p.fine_radius, p.time_radius))
    last = len(trajectory) - 1
    ends = np.append(trajectory.subsample(np.inf, p.end_spacing), last)
    chosen = []
    for i in range(len(trajectory)):
        near = [
            frames[(np.abs(arc[frames] - arc[i]) <= radius) & (np.abs(time[frames] - time[i]) <= t)]
            for frames, radius, t in kinds
        ]
        if p.end_radius and time[last] - time[i] <= p.end_radius:
            near.append(ends[ends > i])
        if p.end_radius and time[i] <= p.end_radius:
            near.append(ends[ends < i])
        chosen.append(np.array(sorted(set(np.concatenate(near).tolist()) - {i}), np.int64))
    return chosen
