"""Which points move: classes from votes, of a sweep and of a drive (paper III-C2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from docdepth.config import DynamicsParameters, SurfaceParameters
from docdepth.dynamics.clustering import classify_objects, cluster_objects
from docdepth.dynamics.key_frames import key_frames
from docdepth.dynamics.tracking import (
    Detections,
    apply_tracks,
    local_poses,
    track_objects,
    uses_tracking,
)
from docdepth.dynamics.voting import KeyFrame, Votes, vote
from docdepth.errors import InputError
from docdepth.geometry.points import DYNAMIC, GROUND, STATIC, check_sweep
from docdepth.geometry.scan_mesh import ScanMesh
from docdepth.geometry.sensor_rig import SensorRig
from docdepth.geometry.trajectory import Trajectory


@dataclass(frozen=True)
class Labels:
    """Class and votes of every point of one sweep.

    Attributes
    ----------
    classid : ndarray of uint16, shape (N,)
        0 ground, 50 static, 100 dynamic.
    votes : Votes
    """

    classid: NDArray[np.uint16]
    votes: Votes


def classify(
    ground: NDArray[np.bool_],
    votes: Votes,
    parameters: DynamicsParameters | None = None,
    points: NDArray[np.float32] | None = None,
    surface: ScanMesh | None = None,
    objects: NDArray[np.uint32] | None = None,
) -> NDArray[np.uint16]:
    """Turn votes into classes: dynamic where more key frames say so than say static.

    Ties and points without a vote are static. With ``points``, and unless the parameters say
    otherwise, evidence is shared within connected objects: dynamic points that stand alone are
    withdrawn, the other points of an object follow most of them, and an object that stands for a
    while is dynamic when enough of its place was seen free at another time.

    Parameters
    ----------
    ground : ndarray of bool, shape (N,)
    votes : Votes
    parameters : DynamicsParameters, optional
    points : ndarray of float32, shape (N, 3), optional
        The deskewed sweep, LiDAR frame, metres.
    surface : Surface, optional
        Of these points, which connects those of an object; made here when needed and left out.
    objects : ndarray of uint32, shape (N,), optional
        Of these points, from :func:`docdepth.dynamics.clustering.cluster_objects`; made here when
        needed and left out.

    Returns
    -------
    ndarray of uint16, shape (N,)
        0 ground, 50 static, 100 dynamic. Points of the ground are dynamic, too, where key frames
        that vote by their surface say so.

    Raises
    ------
    InputError
        A shape or dtype is wrong.
    """
    p = parameters or DynamicsParameters()
    if p.objects and points is not None:
        points, ground = check_sweep(points, ground)
        surface = surface or ScanMesh(points)
        if objects is None:
            objects = cluster_objects(points, ground, surface, p)
        dynamic = classify_objects(points, ground, objects, votes.static, votes.dynamic, surface, p)
    else:
        dynamic = votes.dynamic > votes.static
    if p.against == "pixels":
        dynamic &= ~ground
    return np.where(dynamic, DYNAMIC, np.where(ground, GROUND, STATIC)).astype(np.uint16)


def confidence(votes: Votes) -> NDArray[np.float32]:
    """How sure the votes of each point are of its being static or dynamic, 0..1.

    The share of dynamic votes by Laplace's rule is (d + 1) / (d + s + 2); its distance from one
    half, doubled, is |d - s| / (d + s + 2). So it is 0 where nobody voted or votes are even, 1/3
    after a single vote, 1/2 after two that agree, and 1 in the limit.

    Parameters
    ----------
    votes : Votes
        As a frame keeps them (``votes_static``, ``votes_dynamic``): thresholds on this need no
        voting again. Points of the ground that nobody was asked about have no votes, thus 0.

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


def classify_drive(
    sweeps: Sequence[NDArray[np.float32]],
    trajectory: Trajectory,
    parameters: DynamicsParameters | None = None,
    threads: int = 0,
    ground: Sequence[NDArray[np.bool_]] | None = None,
    surface: SurfaceParameters | None = None,
    sensor_rig: Sequence[SensorRig] | None = None,
) -> list[Labels]:
    """Classify a drive that fits into memory.

    Parameters
    ----------
    sweeps : sequence of ndarray of float32, shape (N, 3)
        Deskewed sweeps, LiDAR frame, metres.
    trajectory : Trajectory
        One pose a sweep.
    parameters : DynamicsParameters, optional
    threads : int
        0 for all cores.
    ground : sequence of ndarray of bool, optional
        Ground labels of each sweep; grown when left out.
    surface : SurfaceParameters, optional
        Of the surfaces of key frames and objects.
    sensor_rig : sequence of Sensors, optional
        Where each sweep was measured from, if not from the origin.

    Returns
    -------
    list of Labels
        One a sweep.

    Raises
    ------
    InputError
        The numbers of sweeps, poses and ground labels differ, or an array is wrong.
    """
    if ground is None:
        from docdepth.ground.growing import grow_ground

        ground = grow_ground(sweeps, trajectory.poses, threads=threads)
    seen_by = [None] * len(sweeps) if sensor_rig is None else list(sensor_rig)
    if not len(sweeps) == len(trajectory) == len(ground) == len(seen_by):
        raise InputError(
            f"{len(sweeps)} sweeps, {len(trajectory)} poses and {len(ground)} ground labels do not "
            "belong to the same drive; give one of each a sweep"
        )
    surfaces = [
        surface_for(sweep, parameters, surface, seen)
        for sweep, seen in zip(sweeps, seen_by, strict=True)
    ]
    chosen = key_frames(trajectory, parameters)
    frames = {
        int(j): KeyFrame(sweeps[j], ground[j], parameters, surfaces[j], seen_by[j])
        for j in np.unique(np.concatenate(chosen))
    }
    local = local_poses(trajectory)
    labels: list[Labels] = []
    objects: list[NDArray[np.uint32]] = []
    detections: list[Detections] = []
    for i, sweep in enumerate(sweeps):
        asked = [frames[int(j)] for j in chosen[i]]
        votes = vote(
            sweep,
            ground[i],
            trajectory.poses[i],
            asked,
            trajectory.poses[chosen[i]],
            parameters,
            threads,
        )
        if not uses_tracking(parameters):
            labels.append(Labels(classify(ground[i], votes, parameters, sweep, surfaces[i]), votes))
            continue
        surface_i = surfaces[i] or ScanMesh(sweep)
        objects.append(cluster_objects(sweep, ground[i], surface_i, parameters))
        classid = classify(ground[i], votes, parameters, sweep, surface_i, objects[i])
        detections.append(Detections(sweep, ground[i], objects[i], classid >= DYNAMIC, local[i]))
        labels.append(Labels(classid, votes))
    if detections:
        carried = track_objects(detections, trajectory.times, parameters, threads)
        p = parameters or DynamicsParameters()
        for i, found in enumerate(carried):
            if found:
                votes, old = labels[i].votes, labels[i].classid
                classid = apply_tracks(
                    sweeps[i], objects[i], found, votes.static, votes.dynamic, old, local[i], p
                )
                labels[i] = Labels(classid, votes)
    return labels


def surface_for(
    points: NDArray[np.float32],
    parameters: DynamicsParameters | None = None,
    surface: SurfaceParameters | None = None,
    sensor_rig: SensorRig | None = None,
) -> ScanMesh | None:
    """The surface of a sweep, where key frames or objects need one: to be handed to both."""
    p = parameters or DynamicsParameters()
    return ScanMesh(points, surface, sensor_rig) if p.objects or p.against == "surface" else None
