"""LiDAR odometry: a pose for each sweep, and the sweeps deskewed to their stamps (paper III-B).

The sweeps are registered in two passes, distribution to distribution. The first finds the
poses in coarse voxels, on sweeps deskewed with the motion before them. The second refines them in
fine voxels, on sweeps deskewed with the motion around them. In both, positions are filtered and
smoothed (see :mod:`docdepth.odometry.smoothing`). The second pass follows the first a few sweeps
behind, so each sweep is read and thinned once for both. Parts between gaps are registered each by
itself and then laid together (see :mod:`docdepth.odometry.parts`). Loop closure is an option (see
:mod:`docdepth.odometry.loop_closure`).
"""

from __future__ import annotations

import logging
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

import docdepth._core as _core
from docdepth.concurrency import Progress, null_progress, thread_count
from docdepth.config import OdometryParameters, Parameters, checked_parameters
from docdepth.datasets.base import Dataset
from docdepth.datasets.sensor_pose import LEVEL_DEG, ground_of
from docdepth.errors import Finding, InputError, log_findings
from docdepth.geometry.ground_plane import level_turn
from docdepth.geometry.points import ShortRepr
from docdepth.geometry.se3 import rigid
from docdepth.geometry.trajectory import Trajectory, parts_of
from docdepth.odometry.clock import find_clock_steps
from docdepth.odometry.deskewing import NEIGHBORS, centred_motion
from docdepth.odometry.first_motion import FIRST_SWEEPS, first_motion
from docdepth.odometry.first_poses import USED, with_first_poses
from docdepth.odometry.loop_closure import close_loops
from docdepth.odometry.parts import joined_parts
from docdepth.odometry.passes import KnownPoses, fine_registration, register
from docdepth.odometry.places import KEPT_SWEEPS
from docdepth.odometry.pose_checks import (
    check_given_poses,
    check_period,
    find_camera_poses,
    find_jumps,
    find_no_motion,
    find_other_motion,
    places_compared,
)
from docdepth.odometry.pose_graph import check_solver
from docdepth.odometry.refinement import refine_poor
from docdepth.odometry.registration import FEWEST_POINTS, Found
from docdepth.odometry.registration_log import RegistrationLog
from docdepth.odometry.smoothing import LAG, smoothed
from docdepth.odometry.sweeps import FINE_SAMPLING, DeskewedSweeps, SweepPart, ThinnedSweeps

log = logging.getLogger(__name__)

PASSES = 2
"""Registrations of the whole drive: the first finds the poses, the second refines them. A third
does not improve accuracy."""


@dataclass(frozen=True, eq=False, repr=False)
class Odometry(ShortRepr):
    """Where each sweep was taken, and the sweeps deskewed to that instant.

    Attributes
    ----------
    trajectory : Trajectory
        ``T_world_lidar`` at each sweep's stamp.
    sweeps : sequence of LidarFrame
        Item ``i`` reads sweep ``i`` once and deskews it. It has a row for each row of the input;
        rows without a usable return stay as they are.
    findings : tuple of Finding
        What looks wrong with the poses; each is logged as well.
    """

    trajectory: Trajectory
    sweeps: DeskewedSweeps
    findings: tuple[Finding, ...] = ()


def register_drive(
    dataset: Dataset,
    parameters: Parameters | None = None,
    poses: Trajectory | ArrayLike | None = None,
    progress: Progress | None = None,
    checkpoint: Path | None = None,
    threads: int = 0,
    poses_as_given: bool = False,
) -> Odometry:
    """Estimate the pose of each sweep of a drive, or take given poses, and deskew the sweeps.

    Parameters
    ----------
    dataset : Dataset
    parameters : Parameters, optional
        ``parameters.odometry`` is used.
    poses : Trajectory, or array_like of float64, shape (n, 4, 4), optional
        ``T_world_lidar`` of each sweep from another SLAM; a trajectory of other times is
        interpolated. They are kept if sweeps that are ten
        apart fit each other to centimetres, and refined by registration if not.
    progress : callable, optional
        Called with the step (``register``, ``loop closure``), the sweeps or places done and their
        number.
    checkpoint : Path, optional
        Folder in which each pass keeps what it found. An estimation that was interrupted goes on
        behind it, with the same poses.
    threads : int
        0 for all cores. The poses do not depend on it.
    poses_as_given : bool
        Keep ``poses``, however well they fit.

    Returns
    -------
    Odometry
        Poses are in the frame of the first sweep, or in that of ``poses``, turned if its z is not
        up.

    Raises
    ------
    OdometryError
        A sweep cannot be registered, or ``poses`` are not rigid or not one for each sweep.
    InputError
        ``dataset`` or ``parameters`` are of another type.
    """
    settings, threads = checked_parameters(parameters).odometry, thread_count(threads)
    if not hasattr(dataset, "sweep") or not hasattr(dataset, "times"):
        raise InputError(
            "dataset must be one from docdepth.open_dataset, or have the members of "
            f"docdepth.Dataset; it is {type(dataset).__name__}"
        )
    if isinstance(poses, Trajectory):
        poses = poses.interpolate(dataset.times)
    if poses is not None:
        checked = check_given_poses(dataset, poses)
        findings = [*find_no_motion(dataset, checked, settings), *find_camera_poses(checked)]
        known = _level_world(dataset, checked, findings)
        if not poses_as_given:
            sweeps = _thinned_sweeps(dataset, settings, 1)

            def logs(part: range) -> list[RegistrationLog]:
                return _logs(dataset, settings, checkpoint, part, "refined", PASSES)

            known, said = refine_poor(sweeps, known, settings, threads, logs)
            findings += said
    else:
        findings, sweeps = [], _thinned_sweeps(dataset, settings, PASSES)
        known = estimate_poses(
            dataset,
            settings,
            progress or null_progress,
            checkpoint,
            threads,
            PASSES,
            findings,
            sweeps,
        )
        findings += find_other_motion(sweeps, known)
    trajectory = Trajectory(dataset.times, known)
    findings += [*find_clock_steps(trajectory), *find_jumps(trajectory)]
    log_findings(log, findings)
    motions = centred_motion(known, dataset.times)
    return Odometry(trajectory, DeskewedSweeps(dataset, motions.__getitem__), tuple(findings))


def _level_world(
    dataset: Dataset, poses: NDArray[np.float64], findings: list[Finding]
) -> NDArray[np.float64]:
    """Given poses (n, 4, 4) in a world that is turned so that z is up, if it leans clearly.

    The world of a SLAM may be the frame of a camera or of a LiDAR that leans.
    """
    z = poses[:, :3, 2].mean(axis=0)
    if np.degrees(np.arccos(np.clip(z[2] / np.linalg.norm(z), -1, 1))) < LEVEL_DEG:
        return poses
    ground = ground_of(dataset, poses[:, :3, :3])
    if ground is None or ground.tilt_deg < LEVEL_DEG:
        return poses
    text = (
        f"the z axis of the poses is {ground.tilt_deg:.0f} degrees from up, by the ground; the "
        "run's world is turned so that z is up"
    )
    findings.append(Finding("leaning-world", "", text))
    turn = rigid(level_turn(ground.up))
    levelled: NDArray[np.float64] = turn @ poses
    return levelled


def estimate_poses(
    dataset: Dataset,
    parameters: OdometryParameters | None = None,
    progress: Progress = null_progress,
    checkpoint: Path | None = None,
    threads: int = 0,
    passes: int = PASSES,
    findings: list[Finding] | None = None,
    sweeps: ThinnedSweeps | None = None,
) -> NDArray[np.float64]:
    """Poses ``T_world_lidar`` (n, 4, 4) in the frame of the first sweep.

    The first arguments are those of :func:`register_drive`. ``passes`` is the number of
    registrations, to ``findings`` is added what looks wrong, and ``sweeps`` are those of
    ``dataset``, if the caller needs them, too.
    """
    findings = [] if findings is None else findings
    parameters, count = parameters or OdometryParameters(), len(dataset)
    if count > 1:
        check_period(dataset)
    if parameters.loop_closure:
        check_solver()
    sweeps = sweeps or _thinned_sweeps(dataset, parameters, passes)
    paths = []
    for part in parts_of(dataset.times):
        (motion_log,) = _logs(dataset, parameters, checkpoint, part, "first_motion")
        (poses_log,) = _logs(dataset, parameters, checkpoint, part, "first_poses")
        logs = _logs(dataset, parameters, checkpoint, part, "pass", passes)
        of_part = SweepPart(sweeps, part)
        firsts = motion_log, poses_log
        paths.append(_registered(of_part, parameters, threads, firsts, logs, findings, progress))
    poses = joined_parts(sweeps, paths, findings)
    if parameters.loop_closure:
        (kept,) = _logs(dataset, parameters, checkpoint, range(count), "loops")
        again = ThinnedSweeps(dataset, parameters, FINE_SAMPLING, KEPT_SWEEPS)
        try:
            poses = close_loops(again, poses, parameters.loop_closure, progress, kept)
        finally:
            kept.close()
    return poses


def _registered(
    sweeps: SweepPart,
    parameters: OdometryParameters,
    threads: int,
    firsts: tuple[RegistrationLog, RegistrationLog],
    logs: Sequence[RegistrationLog],
    findings: list[Finding],
    progress: Progress,
) -> NDArray[np.float64]:
    """Poses (n, 4, 4) of a part in the frame of its first sweep, by a pass for each of ``logs``.

    ``firsts`` keep its first motion and its first poses.
    """
    stream, count = None, len(sweeps)
    motion = _first_motion(sweeps, firsts[0])
    for log_of_pass in logs:
        states = register(
            sweeps, parameters, motion, stream, thread_count(threads), log_of_pass, findings
        )
        found = smoothed(states)
        if log_of_pass is logs[-1]:
            fine = fine_registration(thread_count(threads))
            found = with_first_poses(found, sweeps, fine, firsts[1])
        stream = _pose_stream(found, count)
    assert stream is not None
    try:
        for k in range(count):
            poses = stream(k)
            progress("register", sweeps.first + k + 1, sweeps.total)
    finally:
        for log_of_pass in logs:
            log_of_pass.close()
    return poses


def _thinned_sweeps(dataset: Dataset, parameters: OdometryParameters, passes: int) -> ThinnedSweeps:
    """Sweeps of which the passes, and the check of the motion behind them, read each once."""
    # The last pass is this far behind the first, which looks ahead at its start.
    behind = (passes - 1) * (LAG + NEIGHBORS) + LAG + USED
    checked = {k + j for k in places_compared(len(dataset)) for j in range(FIRST_SWEEPS)}
    return ThinnedSweeps(dataset, parameters, FINE_SAMPLING, behind + FIRST_SWEEPS, checked)


def _first_motion(sweeps: SweepPart, kept: RegistrationLog) -> NDArray[np.float64] | None:
    """The first motion, which an interrupted estimation may have found."""
    found = kept.found(0)
    if found is None:
        # The first sweeps of a LiDAR that starts up may be empty.
        count = len(sweeps)
        begin = next((k for k in range(count) if len(sweeps[k].points) >= FEWEST_POINTS), 0)
        motion = first_motion(sweeps, range(begin, count))
        known = motion is not None
        found = Found(motion if motion is not None else np.eye(4), np.zeros((6, 6)), known)
        kept.add(found)
        kept.close()
    return found.pose if found.usable else None


def _logs(
    dataset: Dataset,
    parameters: OdometryParameters,
    folder: Path | None,
    part: range,
    name: str,
    passes: int = 1,
) -> list[RegistrationLog]:
    """What each pass over a part, or loop closure, found before it was interrupted."""
    if folder is None:
        return [RegistrationLog() for _ in range(passes)]
    times = zlib.crc32(np.asarray(dataset.times, "<i8").tobytes())
    place = Path(dataset.path).resolve()
    made_by = f"docdepth {_core.__version__}"
    key = f"{place} {len(dataset)} {times} {made_by} {parameters.model_dump_json()}"
    files = [folder / f"{name}_{k + 1}_from_{part.start}.log" for k in range(passes)]
    return [RegistrationLog(file, key) for file in files]


def _pose_stream(made: Iterator[NDArray[np.float64]], count: int) -> KnownPoses:
    """Poses of a pass of so many sweeps, which are made when they are asked for."""
    poses, known = np.repeat(np.eye(4)[None], count, axis=0), 0

    def up_to(k: int) -> NDArray[np.float64]:
        nonlocal known
        while known <= k:
            poses[known] = next(made)
            known += 1
        return poses

    return up_to
