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
from docdepth.errors import InputError
from docdepth.geometry.points import DYNAMIC, GROUND, STATIC, ShortRepr
from docdepth.geometry.scan_mesh import ScanMesh
from docdepth.geometry.track import Track


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
    votes : Votes
    parameters : DynamicsParameters, optional
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
