"""Which points move: key frames, votes and classes (paper III-C2, Algorithm 1)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from docdepth import _core
from docdepth.config import DynamicsParameters, SurfaceParameters
from docdepth.errors import InputError
from docdepth.objects import (
    Sighting,
    add_carried,
    carries_evidence,
    check_sweep,
    connect_objects,
    follow,
    moving_points,
    poses_near_start,
)
from docdepth.sensors import Sensors, views
from docdepth.surface import Surface, SurfacePart
from docdepth.trajectory import Trajectory, check_rigid

GROUND, STATIC, DYNAMIC = 0, 50, 100
"""Values of ``classid``, as ``frames/*.ply`` stores it."""


@dataclass(frozen=True)
class Votes:
    """What the key frames said about the points of one sweep.

    Attributes
    ----------
    static : ndarray of uint16, shape (N,)
        Key frames that saw a surface at the place of the point.
    dynamic : ndarray of uint16, shape (N,)
        Key frames that looked through it.
    """

    static: NDArray[np.uint16]
    dynamic: NDArray[np.uint16]


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
        union = np.unique(np.concatenate(near)).astype(np.int64)
        chosen.append(union[union != i])
    return chosen


class KeyFrame:
    """A sweep made ready to be asked about the places of other points.

    It is the paper's range image, or one whose pixels know the triangles of the sweep's surface.

    Parameters
    ----------
    points : ndarray of float32, shape (N, 3)
        The deskewed sweep, LiDAR frame, metres. Rows that are not finite or lie at the origin are
        no returns and are left out.
    ground : ndarray of bool, shape (N,)
    parameters : DynamicsParameters, optional
        Its ``against`` says whether pixels or the sweep's surface answer.
    surface : Surface, optional
        Of these points; made here when needed and left out.
    sensors : Sensors, optional
        Where the sweep was measured from; each of several LiDARs answers from its own place.

    Raises
    ------
    InputError
        A shape or dtype is wrong.
    """

    def __init__(
        self,
        points: NDArray[np.float32],
        ground: NDArray[np.bool_],
        parameters: DynamicsParameters | None = None,
        surface: Surface | None = None,
        sensors: Sensors | None = None,
    ) -> None:
        p = parameters or DynamicsParameters()
        points, ground = check_sweep(points, ground)
        self._views: list[tuple[_core.KeyFrame, NDArray[np.float64]]]
        if p.against == "pixels":
            self._views = [
                (_range_image(view.points, ground, p), view.T_lidar_sensor)
                for view in views(points, sensors)
            ]
        else:
            parts = (surface or Surface(points, None, sensors)).parts
            self._views = [
                (_surface_image(part, ground, p), part.view.T_lidar_sensor) for part in parts
            ]


def vote(
    points: NDArray[np.float32],
    ground: NDArray[np.bool_],
    T_world_lidar: NDArray[np.float64],
    key_frames: Sequence[KeyFrame],
    poses: NDArray[np.float64],
    parameters: DynamicsParameters | None = None,
    threads: int = 0,
) -> Votes:
    """Ask key frames about every point of a sweep (Algorithm 1).

    Against pixels, ground points are static without a vote; against surfaces every point is voted
    on, those called ground with the narrower margin ``ground_across``. Rows that are not finite get
    no votes.

    Parameters
    ----------
    points : ndarray of float32, shape (N, 3)
        The deskewed sweep, LiDAR frame, metres.
    ground : ndarray of bool, shape (N,)
    T_world_lidar : ndarray of float64, shape (4, 4)
        Pose of the sweep.
    key_frames : sequence of KeyFrame, length k
    poses : ndarray of float64, shape (k, 4, 4)
        ``T_world_lidar`` of each key frame.
    parameters : DynamicsParameters, optional
    threads : int
        0 for all cores. The votes do not depend on it.

    Returns
    -------
    Votes

    Raises
    ------
    InputError
        A shape or dtype is wrong, or a pose is not rigid.
    """
    points, ground = check_sweep(points, ground)
    pose = np.ascontiguousarray(T_world_lidar, dtype=np.float64)
    poses = np.ascontiguousarray(poses, dtype=np.float64)
    if not key_frames:
        poses = np.zeros((0, 4, 4))
    if pose.shape != (4, 4) or poses.shape != (len(key_frames), 4, 4):
        raise InputError(
            f"voting needs a (4, 4) pose of the sweep and one of each of the {len(key_frames)} key "
            f"frames; got {pose.shape} and {poses.shape}"
        )
    check_rigid(np.concatenate([pose[None], poses]))
    answering = [
        (core, T_world_lidar @ T_lidar_sensor)
        for frame, T_world_lidar in zip(key_frames, poses, strict=True)
        for core, T_lidar_sensor in frame._views
    ]
    static, dynamic = _core.vote(
        points,
        ground,
        pose,
        [core for core, _ in answering],
        np.array([T for _, T in answering]).reshape(-1, 4, 4),
        threads,
    )
    return Votes(static, dynamic)


def classify(
    ground: NDArray[np.bool_],
    votes: Votes,
    parameters: DynamicsParameters | None = None,
    points: NDArray[np.float32] | None = None,
    surface: Surface | None = None,
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
        Of these points, from :func:`docdepth.objects.connect_objects`; made here when needed and
        left out.

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
        surface = surface or Surface(points)
        if objects is None:
            objects = connect_objects(points, ground, surface, p)
        dynamic = moving_points(points, ground, objects, votes.static, votes.dynamic, surface, p)
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
    sensors: Sequence[Sensors] | None = None,
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
        Ground labels of each sweep; grown by :func:`docdepth.ground.grow_ground` when left out.
    surface : SurfaceParameters, optional
        Of the surfaces of key frames and objects.
    sensors : sequence of Sensors, optional
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
        from docdepth.ground import grow_ground

        ground = grow_ground(sweeps, trajectory.poses, threads=threads)
    seen_by = [None] * len(sweeps) if sensors is None else list(sensors)
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
    local = poses_near_start(trajectory)
    labels: list[Labels] = []
    objects: list[NDArray[np.uint32]] = []
    sightings: list[Sighting] = []
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
        if not carries_evidence(parameters):
            labels.append(Labels(classify(ground[i], votes, parameters, sweep, surfaces[i]), votes))
            continue
        surface_i = surfaces[i] or Surface(sweep)
        objects.append(connect_objects(sweep, ground[i], surface_i, parameters))
        classid = classify(ground[i], votes, parameters, sweep, surface_i, objects[i])
        sightings.append(Sighting(sweep, ground[i], objects[i], classid >= DYNAMIC, local[i]))
        labels.append(Labels(classid, votes))
    if sightings:
        carried = follow(sightings, trajectory.times, parameters, threads)
        p = parameters or DynamicsParameters()
        for i, found in enumerate(carried):
            if found:
                votes, old = labels[i].votes, labels[i].classid
                classid = add_carried(
                    sweeps[i], objects[i], found, votes.static, votes.dynamic, old, local[i], p
                )
                labels[i] = Labels(classid, votes)
    return labels


def surface_for(
    points: NDArray[np.float32],
    parameters: DynamicsParameters | None = None,
    surface: SurfaceParameters | None = None,
    sensors: Sensors | None = None,
) -> Surface | None:
    """The surface of a sweep, where key frames or objects need one: to be handed to both."""
    p = parameters or DynamicsParameters()
    return Surface(points, surface, sensors) if p.objects or p.against == "surface" else None


def _range_image(
    points: NDArray[np.float32], ground: NDArray[np.bool_], p: DynamicsParameters
) -> _core.KeyFrame:
    return _core.RangeImage(points, ground, np.radians(p.resolution_deg), p.window, p.tolerance)


def _surface_image(
    part: SurfacePart, ground: NDArray[np.bool_], p: DynamicsParameters
) -> _core.KeyFrame:
    image = _core.SurfaceImageParameters()
    image.resolution = float(np.radians(p.resolution_deg))
    image.window, image.tolerance = p.window, p.tolerance
    image.upright = _core.Margins(p.across, p.along, p.along_growth)
    image.level = _core.Margins(p.level_across, p.level_along, 0.0)
    image.ground_across = p.ground_across
    image.level_cosine = float(np.cos(np.radians(p.level_lean_deg)))
    image.beam = p.beam
    return _core.SurfaceImage(part.view.points, ground, part.core, image)
