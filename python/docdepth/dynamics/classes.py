"""Classes of points from the votes on them, and how sure they are (paper IV-C).

Votes are shared within the objects of a sweep (ours, beyond the paper).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import docdepth._core as _core
from docdepth.config import DynamicsParameters
from docdepth.dynamics.voting import Votes
from docdepth.errors import Finding, InputError
from docdepth.geometry.points import DYNAMIC, GROUND, STATIC, ShortRepr
from docdepth.geometry.scan_mesh import ScanMesh
from docdepth.geometry.track import Track

# Each threshold lies between what right recordings give and what wrong ones give.
_LEAST_GROUND = 0.01  # share of returns on the ground: 0.3 to 0.7
# Share of dynamic points of those above the ground: 0.01 to 0.45, the most at a busy crossing; 0.79
# between lorries on a motorway, which is right, too.
_MOST_DYNAMIC = 0.5


@dataclass(frozen=True, eq=False, repr=False)
class Labels(ShortRepr):
    """Class and votes of every point of one sweep.

    Attributes
    ----------
    classid : ndarray of uint16, shape (N,)
        0 ground, 50 static, 100 dynamic.
    votes : Votes
    instance : ndarray of uint16, shape (N,), optional
        Track of each dynamic point, 0 if it is of none; absent without tracks.
    """

    classid: NDArray[np.uint16]
    votes: Votes
    instance: NDArray[np.uint16] | None = None


class DriveLabels(list[Labels]):
    """The labels of each sweep of a drive, and ``tracks``, the objects that move."""

    tracks: Sequence[Track] = ()


def cluster_objects(
    points: NDArray[np.float32], ground: NDArray[np.bool_], mesh: ScanMesh | None = None
) -> NDArray[np.uint32]:
    """Cluster the points above the ground into objects, along the edges of the sweep's mesh.

    Parameters
    ----------
    points : ndarray of float32, shape (N, 3)
        The deskewed sweep, LiDAR frame, metres.
    ground : ndarray of bool, shape (N,)
    mesh : ScanMesh, optional
        Of these points; made here when not given.

    Returns
    -------
    ndarray of uint32, shape (N,)
        For each point the first row of its object; a ground point is an object of its own.
    """
    return _core.cluster_objects(points, ground, (mesh or ScanMesh(points)).core)


def classify(
    ground: NDArray[np.bool_],
    votes: Votes,
    parameters: DynamicsParameters | None = None,
    points: NDArray[np.float32] | None = None,
    mesh: ScanMesh | None = None,
    objects: NDArray[np.uint32] | None = None,
) -> NDArray[np.uint16]:
    """Turn votes into classes: dynamic where more key frames vote dynamic than static.

    Ties and points without a vote are static. With ``points``, and unless ``evidence`` is
    ``"points"``, votes are shared within objects: dynamic points without dynamic neighbours become
    static. An object is dynamic as a whole when most of its points are; also when it stood for a
    while, and enough of its points were observed free before or after. Votes without their order
    (``votes.occupancy``) do not find what stood.

    Parameters
    ----------
    ground : ndarray of bool, shape (N,)
    points : ndarray of float32, shape (N, 3), optional
        The deskewed sweep, LiDAR frame, metres.
    mesh : ScanMesh, optional
        Of these points; made here when needed and not given.
    objects : ndarray of uint32, shape (N,), optional
        From :func:`cluster_objects`; made here when needed and not given.

    Returns
    -------
    ndarray of uint16, shape (N,)
        0 ground, 50 static, 100 dynamic. Where surfaces vote, ground points can be dynamic, too.
    """
    p = parameters or DynamicsParameters()
    if p.evidence != "points" and points is not None:
        mesh = mesh or ScanMesh(points)
        if objects is None:
            objects = cluster_objects(points, ground, mesh)
        once = votes.occupancy.occupied_once if votes.occupancy else np.zeros(len(points), bool)
        dynamic = _core.classify_objects(
            points, ground, objects, votes.static, votes.dynamic, once, mesh.core
        ).view(np.bool_)
    else:
        dynamic = votes.dynamic > votes.static
    if p.vote_model == "range_image":
        dynamic &= ~ground
    return np.where(dynamic, DYNAMIC, np.where(ground, GROUND, STATIC)).astype(np.uint16)


def confidence(votes: Votes) -> NDArray[np.float32]:
    """How sure the votes on each point are, 0 to 1.

    With d dynamic and s static votes, Laplace's rule estimates the share of dynamic votes as
    (d + 1) / (d + s + 2). Its distance from one half, doubled, is |d - s| / (d + s + 2): 0 without
    votes or on a tie, 1/3 after one vote, 1/2 after two that agree, 1 in the limit.

    Parameters
    ----------
    votes : Votes
        As a frame keeps them (``votes_static``, ``votes_dynamic``), so a threshold on the
        confidence needs no new votes.

    Returns
    -------
    ndarray of float32, shape (N,)
    """
    static, dynamic = votes.static.astype(np.float32), votes.dynamic.astype(np.float32)
    if static.shape != dynamic.shape:
        raise InputError(
            f"votes.static {static.shape} and votes.dynamic {dynamic.shape} differ in shape; "
            "give both counts of the same points"
        )
    return np.asarray(np.abs(dynamic - static) / (dynamic + static + 2), np.float32)


def count_classes(classid: NDArray[np.uint16]) -> NDArray[np.int64]:
    """Points of a sweep: all, of the ground, and dynamic ones."""
    ground, dynamic = classid == GROUND, classid >= DYNAMIC
    return np.array([len(classid), np.count_nonzero(ground), np.count_nonzero(dynamic)])


def find_unlikely_classes(counts: NDArray[np.int64]) -> list[Finding]:
    """Whether there is next to no ground, or moving points are everywhere.

    Parameters
    ----------
    counts : ndarray of int64, shape (3,)
        The sum of those of each sweep, from :func:`count_classes`.
    """
    points, ground, dynamic = counts.tolist()
    above, found = points - ground, []
    if ground < _LEAST_GROUND * points:
        text = (
            f"only {100 * ground / points:.1f} % of the points are ground: the LiDAR's z axis may "
            "not point up, the poses may be wrong, or the points may not be in metres"
        )
        found.append(Finding("no-ground", "", text))
    if dynamic > _MOST_DYNAMIC * above:
        text = (
            f"{100 * dynamic / above:.0f} % of the points above the ground are called dynamic: "
            "unless traffic is all around, the poses or the order of the sweeps may be wrong, or "
            "the points may not be in the frame of the LiDAR"
        )
        found.append(Finding("much-dynamic", "", text))
    return found
