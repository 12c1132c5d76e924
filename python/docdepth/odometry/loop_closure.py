"""Loop closure: a street seen again is one map.

Odometry drifts, so a street that the vehicle comes back to lies elsewhere on its second visit.
Places on the way are looked for in places of earlier visits, in a radius that grows with the path
since. A find has to pass checks that refuse what only looks alike. A pose graph then spreads the
drift over the path. Without a find all poses stay as they are.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from docdepth.concurrency import Progress, null_progress
from docdepth.geometry.se3 import inverse, se3_log
from docdepth.geometry.trajectory import Trajectory
from docdepth.odometry.places import Placed, Places, locate
from docdepth.odometry.pose_graph import Edge, between_nodes, misfits, optimized
from docdepth.odometry.registration import Found
from docdepth.odometry.registration_log import RegistrationLog
from docdepth.odometry.sweeps import ThinnedSweeps

log = logging.getLogger(__name__)

SPACING = 10.0
"""From place to place along the path [m]."""

LEAST_PATH = 100.0
"""Of path from a visit to the next [m]: before, the map of odometry holds the street still."""

_RADIUS = 2.0  # metres; at which places are looked for, beside the drift
_NEAR = 15.0  # metres from pose to pose, so that places share most of what they see
_VISITS = 2  # the latest ones, which drifted least since; more cost time and tell little more
_TURN = 4.0  # radians by which the axes of a place may turn, per drift as a share of the path

# What a find has to show. On synthetic streets, and in spite of other traffic, right places have a
# likeness of 0.77 to 0.94, a lead of 1.3 and an overlap of 0.73 or more; wrong ones have at most
# 0.50, 1.2 and 0.49.
_LIKENESS, _LEAD = 0.6, 1.1  # of maps seen from above; over the best other answer
_OVERLAP = 0.6  # share of what stands in either place
_BACK_TURN, _BACK_SHIFT = 0.005, 0.1  # radians, metres, of registration the other way
# Several finds have to tell the same drift.
_AROUND = 60.0  # metres of path on both visits
_SAME_TURN, _SAME_SHIFT = 0.01, 0.2  # radians, metres; and per metre of path between them:
_STEP_DRIFT = 0.01
_COMPANIONS = 2  # finds around one that tell its drift
_MISFIT = 3.0  # standard deviations that a closure may be off in the end, or times the median


@dataclass(frozen=True)
class Revisit:
    """A place that may have been seen before."""

    # earlier, later: numbers of the nodes
    earlier: int
    later: int
    # radius, turn: by which poses may have drifted in between [m, rad]
    radius: float
    turn: float


def close_loops(
    sweeps: ThinnedSweeps,
    poses: NDArray[np.float64],
    drift: float,
    progress: Progress = null_progress,
    kept: RegistrationLog | None = None,
) -> NDArray[np.float64]:
    """Correct the drift of poses where the drive comes back to streets it knows.

    Parameters
    ----------
    poses : ndarray of float64, shape (n, 4, 4)
        ``T_world_lidar`` of odometry, which moved and turned little at any sweep.
    drift : float
        How far off a pose may be, as a share of the path since the earlier visit.
    kept : RegistrationLog, optional
        What an interrupted search found is taken from there, and what is found is added.

    Returns
    -------
    ndarray of float64, shape (n, 4, 4)
        ``poses`` itself if no place was found again.
    """
    trajectory = Trajectory(sweeps.times, poses)
    nodes = trajectory.subsample(SPACING)
    at_nodes, arc = poses[nodes], trajectory.arc_length[nodes]
    visits = revisits(at_nodes[:, :3, 3], arc, drift)
    places = Places(sweeps, poses, trajectory.arc_length)
    kept, edges = RegistrationLog() if kept is None else kept, []
    for number, visit in enumerate(visits):
        found = kept.found(number)
        if found is None:
            placed = locate_again(places, nodes, at_nodes, visit)
            edge = _edge(at_nodes, visit, placed.pose)
            found = Found(edge, np.zeros((6, 6)), passes(placed))
            kept.add(found)
        if found.usable:
            edges.append(Edge(visit.earlier, visit.later, found.pose))
        progress("loop closure", number + 1, len(visits))
    closures = consistent(edges, at_nodes, arc)
    if not closures:
        return poses
    moved = optimized(at_nodes, closures)
    # One that the others contradict is worse than they are.
    while (off := misfits(moved, closures)).max() > _MISFIT * max(1.0, float(np.median(off))):
        del closures[int(off.argmax())]
        moved = optimized(at_nodes, closures)
    corrected = between_nodes(poses, nodes, moved, trajectory.arc_length)
    log.info(
        "%d of %d places are seen again; poses move by up to %.2f m",
        len(closures), len(visits), np.linalg.norm((corrected - poses)[:, :3, 3], axis=1).max(),
    )  # fmt: skip
    return corrected


def revisits(
    positions: NDArray[np.float64], arc_length: NDArray[np.float64], drift: float
) -> list[Revisit]:
    """Which nodes may lie where others lay before: of the last visits the nearest of each.

    Parameters
    ----------
    positions : ndarray of float64, shape (m, 3)
    arc_length : ndarray of float64, shape (m,)
        Of the path to each node, ascending.
    drift : float
        As for :func:`close_loops`.
    """
    found = []
    for later in range(len(positions)):
        since = arc_length[later] - arc_length[:later]
        radius = _RADIUS + drift * since
        away = np.linalg.norm((positions[:later] - positions[later])[:, :2], axis=1)
        near = np.flatnonzero((since >= LEAST_PATH) & (away <= radius + _NEAR))
        for visit in np.split(near, np.flatnonzero(np.diff(near) > 1) + 1)[-_VISITS:]:
            if len(visit):
                earlier = int(visit[away[visit].argmin()])
                found.append(Revisit(earlier, later, float(radius[earlier]), _TURN * drift))
    return found


def locate_again(
    places: Places, nodes: NDArray[np.int64], poses: NDArray[np.float64], visit: Revisit
) -> Placed:
    """Find the place of a later visit within that of an earlier one."""
    one, other = (places.at(int(nodes[k])) for k in (visit.earlier, visit.later))
    away = poses[visit.later, :2, 3] - poses[visit.earlier, :2, 3]
    return locate(one, other, away, visit.radius, visit.turn)


def passes(placed: Placed, likeness: float = _LIKENESS, overlap: float = _OVERLAP) -> bool:
    """Whether a place is the one that it was found in, as far as both alone can tell."""
    return (
        placed.likeness >= likeness
        and placed.lead >= _LEAD
        and placed.overlap >= overlap
        and placed.turn <= _BACK_TURN
        and placed.shift <= _BACK_SHIFT
    )


def _edge(
    poses: NDArray[np.float64], visit: Revisit, placed: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Pose of the later node in the frame of the earlier; places have the axes of the world."""
    one, other = (np.eye(4), np.eye(4))
    one[:3, :3], other[:3, :3] = poses[visit.earlier, :3, :3], poses[visit.later, :3, :3]
    edge: NDArray[np.float64] = inverse(one) @ placed @ other
    return edge


def consistent(
    edges: Sequence[Edge], poses: NDArray[np.float64], arc_length: NDArray[np.float64]
) -> list[Edge]:
    """Those that tell the same drift as most around them, and as two at least."""
    ends = arc_length[np.array([(e.a, e.b) for e in edges], np.int64).reshape(-1, 2)]
    kept = []
    for k, edge in enumerate(edges):
        apart = np.abs(ends - ends[k])
        around = [j for j in np.flatnonzero(apart.max(axis=1) <= _AROUND).tolist() if j != k]
        agree = sum(_agree(edge, edges[j], poses, float(apart[j].sum())) for j in around)
        if agree >= _COMPANIONS and 2 * agree > len(around):
            kept.append(edge)
    return kept


def _agree(edge: Edge, other: Edge, poses: NDArray[np.float64], path: float) -> bool:
    """Whether both closures, with odometry between them, come round to where they began."""
    there = inverse(poses[edge.b]) @ poses[other.b]
    back = inverse(poses[other.a]) @ poses[edge.a]
    turn, shift = se3_log(edge.pose @ there @ inverse(other.pose) @ back)
    slack = 1 + _STEP_DRIFT * path / _SAME_SHIFT
    return bool(
        np.linalg.norm(turn) <= _SAME_TURN * slack and np.linalg.norm(shift) <= _SAME_SHIFT * slack
    )
