"""The odometry stage of a run: poses, and deskewed sweeps as frames (paper III-B)."""

from __future__ import annotations

import logging
import shutil

import numpy as np
from numpy.typing import NDArray

from docdepth.concurrency import Progress, null_progress
from docdepth.datasets.base import Dataset, Sweep
from docdepth.datasets.files import suggest_skipping
from docdepth.diagnostics.sweeps import find_lonely_returns
from docdepth.errors import ConfigError, DatasetError
from docdepth.geometry.points import usable_points
from docdepth.io.frames import write_trajectory
from docdepth.io.run_folder import RunFolder
from docdepth.odometry.blooming import blooming_points
from docdepth.odometry.odometry import Odometry, register_drive
from docdepth.odometry.pose_checks import find_misfit
from docdepth.pipeline.plan import keeps_given_poses, odometry_stage
from docdepth.pipeline.stage import Profile, Stage

log = logging.getLogger(__name__)


def run_odometry(
    run: RunFolder,
    dataset: Dataset,
    poses: NDArray[np.float64] | None = None,
    progress: Progress = null_progress,
    threads: int = 0,
    stage: Stage | None = None,
) -> None:
    """Write ``traj_odometry.ply``, and each sweep deskewed to its stamp into ``frames/``.

    Parameters
    ----------
    poses : ndarray of float64, shape (n, 4, 4), optional
        ``T_world_lidar`` of another SLAM; estimated when left out.
    stage : Stage, optional
        :func:`~.plan.odometry_stage` of these arguments.
    """
    with run.lock("odometry"):
        if run.manifest.frames_deleted is not None:
            run.manifest.frames_deleted = stage = None
            run.save()
        first = dataset.sweep(0)
        stage = stage or odometry_stage(run, dataset, poses, first)
        left, key = stage.left(), stage.made_of
        if not left and stage.is_made_once():
            return
        with stage.working() as profile:
            checkpoint = run.state_dir / _CHECKPOINTS / stage.key
            for folder in checkpoint.parent.glob("*"):
                if folder != checkpoint:  # of other parameters
                    shutil.rmtree(folder, ignore_errors=True)
            with profile.timer("poses"):
                odometry = register_drive(
                    dataset,
                    run.parameters,
                    poses,
                    progress,
                    checkpoint,
                    threads,
                    keeps_given_poses(run),
                )
            profile.findings += odometry.findings
            if first.sensor_rig is not None:
                run.write_sensors(first.sensor_rig, key)
            indices = np.arange(len(dataset))
            write_trajectory(run.trajectory_path, odometry.trajectory, indices, run.writer(key))
            _write_frames(run, odometry, left, key, profile, progress)
            stage.remove_outdated()
            with profile.timer("check"):
                poses = odometry.trajectory.poses
                profile.add(find_lonely_returns(run.deskewed, len(dataset)))
                profile.add(find_misfit(run.points, poses, dataset.times, run.parameters.odometry))


_CHECKPOINTS = "odometry"
"""Folder in the state of a run with what each pass found. An interrupted stage goes on from there,
and frames are made again, bit for bit."""


def _write_frames(
    run: RunFolder,
    odometry: Odometry,
    left: list[int],
    key: dict[str, str],
    profile: Profile,
    progress: Progress,
) -> None:
    """Write the frames that are missing, damaged or made of something else."""
    dataset, timer = odometry.sweeps.dataset, profile.timer
    blooming_deg = run.parameters.odometry.blooming_deg
    total = len(dataset)
    for index in left:
        progress("odometry", total - len(left) + profile.frames, total)
        with timer("deskew"):
            with suggest_skipping():
                measured = dataset.sweep(index)
            deskewed = odometry.sweeps.deskewed(index, measured)
            usable = usable_points(deskewed.points)
            if blooming_deg:
                usable &= ~_ghost_returns(dataset, measured, blooming_deg)
            if not usable.any():
                raise DatasetError(
                    f"{dataset.path}: sweep {measured.name} (frame {index}) holds no usable point",
                    "leave it out by `on_error='skip'`",
                    code="empty-sweep",
                )
            frame = deskewed.select(usable)
        with timer("write"):
            run.write_frame(index, frame, key)
        profile.frames += 1
    progress("odometry", total, total)


def _ghost_returns(dataset: Dataset, sweep: Sweep, blooming_deg: float) -> NDArray[np.bool_]:
    """Ghost returns of a sweep as measured."""
    if sweep.intensity is None:
        raise ConfigError(
            f"{dataset.path}: sweep {sweep.name} has no intensity, which tells reflectors; "
            "leave odometry.blooming_deg at 0"
        )
    return blooming_points(sweep.points, sweep.intensity, blooming_deg)
