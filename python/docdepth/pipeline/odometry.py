"""Poses and deskewed sweeps of a run (paper III-B)."""

from __future__ import annotations

import logging

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.base import Dataset, Sweep
from docdepth.errors import ConfigError, DatasetError
from docdepth.geometry.points import usable_points
from docdepth.io.frames import FrameRecord, write_trajectory
from docdepth.io.run_folder import RunFolder, stage_key
from docdepth.odometry.blooming import blooming_points
from docdepth.odometry.odometry import odometry
from docdepth.pipeline.stage import (
    Progress,
    Stopwatch,
    finish_stage,
    progress_callback,
    stage_is_done,
)

log = logging.getLogger(__name__)


def run_odometry(
    run: RunFolder,
    dataset: Dataset,
    poses: NDArray[np.float64] | None = None,
    progress: Progress | None = None,
    threads: int = 0,
) -> None:
    """Poses of every sweep, and the sweeps deskewed to their stamp, into ``frames/``.

    Parameters
    ----------
    poses : ndarray of float64, shape (n, 4, 4), optional
        ``T_world_lidar`` of another SLAM; registered here when there are none.
    threads : int
        How many passes of the registration may run at once; 0 takes every core.

    Raises
    ------
    DatasetError
        A sweep is damaged or empty.
    """
    parameters = run.parameters.odometry
    sensor_rig = dataset.sweep(0).sensor_rig
    places = None if sensor_rig is None else sensor_rig.T_lidar_sensor.tolist()
    key = stage_key(run.manifest["source"], parameters.model_dump(), places)
    if stage_is_done(run, "odometry", key):
        return
    watch, total = Stopwatch(), len(dataset)
    run.set_stage("odometry", state="running", key=key)
    tell = progress_callback(progress, "odometry")
    with watch("poses"):
        checkpoint = run.path / ".odometry" / key

        def registered(done: int, total: int, what: str) -> None:
            log.debug("%s", what)
            if progress:
                progress("register", done, total)

        estimate = odometry(dataset, parameters, poses, registered, checkpoint, threads)
    write_trajectory(run.trajectory_path, estimate.trajectory, np.arange(total))
    period = np.float32(np.median(np.diff(dataset.times)) * 1e-9 if total > 1 else 0)
    worked = 0
    for index in range(total):
        if run.frame_key(index).get("odometry") != key:
            worked += 1
            with watch("deskew"):
                sweep = dataset.sweep(index)
                points = estimate.points(index)
                usable = usable_points(points)
                if parameters.blooming_deg:
                    usable &= ~_phantoms(dataset, sweep, parameters.blooming_deg)
            if not usable.any():
                raise DatasetError(
                    f"{dataset.path}: sweep {sweep.name} (frame {index}) holds no usable point; "
                    "leave this frame out of the recording"
                )
            record = FrameRecord(
                np.ascontiguousarray(points[usable]),
                np.flatnonzero(usable).astype(np.uint32),
                sweep.name,
                len(points),
                {"odometry": key},
                time_offset=None
                if sweep.relative_time is None
                else period * sweep.relative_time[usable],
                sensor=sweep.sensor_rig.index[usable] if sweep.sensor_rig else None,
            )
            with watch("write"):
                run.write_frame(index, record)
        tell(index + 1, total)
    if sensor_rig is not None:
        run.write_sensors(sensor_rig)
    finish_stage(run, "odometry", watch, worked)


def _phantoms(dataset: Dataset, sweep: Sweep, blooming_deg: float) -> NDArray[np.bool_]:
    if sweep.intensity is None:
        raise ConfigError(
            f"{dataset.path}: sweep {sweep.name} has no intensity, by which reflectors are known; "
            "leave odometry.blooming_deg at 0"
        )
    return blooming_points(sweep.points, sweep.intensity, blooming_deg)
