"""What happens to one sweep: mesh, key frame, votes, objects, classes (paper IV-C)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from docdepth.concurrency import Watch, unwatched
from docdepth.config import DynamicsParameters
from docdepth.dynamics import voting
from docdepth.dynamics.clustering import classify_objects, cluster_objects
from docdepth.dynamics.key_frames import key_frames
from docdepth.dynamics.tracking import (
    Detections,
    TrackingResult,
    apply_tracks,
    local_poses,
    track_objects,
)
from docdepth.dynamics.voting import KeyFrame, Votes
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


@dataclass(frozen=True)
class InputSweep:
    """A deskewed sweep as the classifier gets it.

    Attributes
    ----------
    points : ndarray of float32, shape (N, 3)
        LiDAR frame, metres.
    ground : ndarray of bool, shape (N,)
    sensor_rig : SensorRig, optional
        Where it was measured from, if not from the origin.
    votes : Votes, optional
        Kept from an earlier run; cast anew when missing.
    record
        What the sweep's store needs to write its labels.
    """

    points: NDArray[np.float32]
    ground: NDArray[np.bool_]
    sensor_rig: SensorRig | None = None
    votes: Votes | None = None
    record: Any = None


class PreparedSweep(NamedTuple):
    """A sweep with its mesh, which its key frame, its objects and its classes share."""

    sweep: InputSweep
    mesh: ScanMesh | None


class Evidence(NamedTuple):
    """What is known of a sweep before tracks: labels by its own votes, and its objects.

    Attributes
    ----------
    labels : Labels
    objects : ndarray of uint32, shape (N,)
        From :func:`docdepth.dynamics.clustering.cluster_objects`.
    """

    labels: Labels
    objects: NDArray[np.uint32]


class SweepClassifier:
    """The steps from a sweep to its labels. Steps of different sweeps may run in parallel.

    Parameters
    ----------
    trajectory : Trajectory
        One pose a sweep.
    parameters : DynamicsParameters
    watch : callable, optional
        Takes the times of the steps.

    Attributes
    ----------
    key_frames : list of ndarray of int64
        For each sweep the indices of the key frames that vote on it.
    uses_tracks : bool
        Whether classes wait for :meth:`track`, which needs the detections of all sweeps.
    """

    def __init__(
        self, trajectory: Trajectory, parameters: DynamicsParameters, watch: Watch = unwatched
    ) -> None:
        self.key_frames = key_frames(trajectory, parameters)
        self.uses_tracks = parameters.evidence == "tracks"
        self._trajectory, self._parameters, self._watch = trajectory, parameters, watch
        self._local_poses = local_poses(trajectory)

    def prepare(self, sweep: InputSweep) -> PreparedSweep:
        """Make the mesh of a sweep, if key frames or objects need one."""
        p, rig = self._parameters, sweep.sensor_rig
        if p.vote_model == "range_image" and p.evidence == "points":
            return PreparedSweep(sweep, None)
        # This mesh is seen from the LiDAR's place at the stamp, that of rendering from where the
        # LiDAR was when it measured each return. So they are two. Votes with moving ray origins
        # were tried: F1 0.9940 instead of 0.9941.
        if rig is not None and rig.ego_displacement is not None:
            rig = replace(rig, ego_displacement=None)
            sweep = replace(sweep, sensor_rig=rig)
        with self._watch("meshes"):
            return PreparedSweep(sweep, ScanMesh(sweep.points, rig))

    def key_frame(self, prepared: PreparedSweep) -> KeyFrame:
        """Prepare a sweep to vote."""
        sweep, mesh = prepared
        with self._watch("key frames"):
            return KeyFrame(sweep.points, sweep.ground, self._parameters, mesh, sweep.sensor_rig)

    def vote(self, index: int, sweep: InputSweep, key_frames: Sequence[KeyFrame]) -> Votes:
        """Let the key frames of sweep ``index`` vote on it, in one thread."""
        poses = self._trajectory.poses
        with self._watch("vote"):
            return voting.vote(
                sweep.points,
                sweep.ground,
                poses[index],
                key_frames,
                poses[self.key_frames[index]],
                threads=1,
            )

    def classify(self, prepared: PreparedSweep, votes: Votes) -> Labels:
        """Labels of a sweep when no tracks are used."""
        sweep, mesh = prepared
        with self._watch("objects"):
            classid = classify(sweep.ground, votes, self._parameters, sweep.points, mesh)
        return Labels(classid, votes)

    def detect(
        self, index: int, prepared: PreparedSweep, votes: Votes
    ) -> tuple[Evidence, Detections]:
        """Labels of a sweep by its own votes, and the detections that tracks are made of."""
        sweep, mesh = prepared
        points, ground = sweep.points, sweep.ground
        with self._watch("objects"):
            objects = cluster_objects(points, ground, mesh)
            classid = classify(ground, votes, self._parameters, points, mesh, objects)
        with self._watch("detections"):
            detections = Detections(
                points, ground, objects, classid >= DYNAMIC, self._local_poses[index]
            )
        return Evidence(Labels(classid, votes), objects), detections

    def track(self, detections: Sequence[Detections], threads: int = 0) -> list[TrackingResult]:
        """Track objects through the drive, from the detections of all sweeps in order."""
        with self._watch("tracks"):
            return track_objects(detections, self._trajectory.times, threads)

    def add_tracks(
        self, index: int, sweep: InputSweep, evidence: Evidence, result: TrackingResult
    ) -> Labels:
        """Labels of a sweep with what tracks found in it."""
        labels, objects = evidence
        if not result:
            return labels
        pose = self._local_poses[index]
        classid = apply_tracks(sweep.points, objects, labels.votes, labels.classid, result, pose)
        return Labels(classid, labels.votes)


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
    ``"points"``, votes are shared within objects
    (:func:`docdepth.dynamics.clustering.classify_objects`).

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
        From :func:`docdepth.dynamics.clustering.cluster_objects`; made here when needed and not
        given.

    Returns
    -------
    ndarray of uint16, shape (N,)
        0 ground, 50 static, 100 dynamic. Where surfaces vote, ground points can be dynamic, too.

    Raises
    ------
    InputError
        A shape or dtype is wrong.
    """
    p = parameters or DynamicsParameters()
    if p.evidence != "points" and points is not None:
        points, ground = check_sweep(points, ground)
        mesh = mesh or ScanMesh(points)
        if objects is None:
            objects = cluster_objects(points, ground, mesh)
        dynamic = classify_objects(points, ground, objects, votes.static, votes.dynamic, mesh)
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
