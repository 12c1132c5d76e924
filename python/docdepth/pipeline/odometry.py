"""The odometry stage of a run: poses, and deskewed sweeps as frames (paper III-B)."""

from __future__ import annotations

import logging
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.base import Dataset, Sweep
from docdepth.errors import ConfigError, DatasetError
from docdepth.geometry.points import usable_points
from docdepth.geometry.sensor_rig import SensorRig
from docdepth.io.frames import FrameRecord, write_trajectory
from docdepth.io.run_folder import RunFolder, stage_key
from docdepth.odometry.blooming import blooming_points
from docdepth.odometry.odometry import Odometry, register_drive
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
    """Write ``traj_odometry.ply``, and each sweep deskewed to its stamp into ``frames/``.

    Parameters
    ----------
    run : RunFolder
    dataset : Dataset
    poses : ndarray of float64, shape (n, 4, 4), optional
        ``T_world_lidar`` of another SLAM; estimated when left out.
    progress : callable, optional
    threads : int
        Passes of the registration that may run at once; 0 takes every core.

    Raises
    ------
    DatasetError
        A sweep is damaged or holds no usable point.
    ConfigError
        Ghost returns are to be removed, but sweeps have no intensity.
    OdometryError
        Poses cannot be estimated, or the given ones do not fit.
    """
    sensor_rig = dataset.sweep(0).sensor_rig
    key = _key(run, sensor_rig)
    if stage_is_done(run, "odometry", key):
        return
    watch = Stopwatch()
    run.set_stage("odometry", state="running", key=key)
    with watch("poses"):
        odometry = register_drive(
            dataset,
            run.parameters,
            poses,
            _registration_progress(progress),
            run.path / ".odometry" / key,
            threads,
        )
    write_trajectory(run.trajectory_path, odometry.trajectory, np.arange(len(dataset)))
    written = _write_frames(run, odometry, key, watch, progress)
    if sensor_rig is not None:
        run.write_sensors(sensor_rig)
    finish_stage(run, "odometry", watch, written)


def _key(run: RunFolder, sensor_rig: SensorRig | None) -> str:
    """Of all that the frames depend on."""
    places = None if sensor_rig is None else sensor_rig.T_lidar_sensor.tolist()
    return stage_key(run.manifest["source"], run.parameters.odometry.model_dump(), places)


def _registration_progress(progress: Progress | None) -> Callable[[int, int, str], None]:
    def report(done: int, total: int, what: str) -> None:
        log.debug("%s", what)
        if progress:
            progress("register", done, total)

    return report


def _write_frames(
    run: RunFolder, odometry: Odometry, key: str, watch: Stopwatch, progress: Progress | None
) -> int:
    """Write the frames that are missing or of other parameters; returns how many."""
    report = progress_callback(progress, "odometry")
    dataset = odometry.sweeps.dataset
    blooming_deg = run.parameters.odometry.blooming_deg
    total = len(dataset)
    # float32, so that time_offset is too.
    period = np.float32(np.median(np.diff(dataset.times)) * 1e-9 if total > 1 else 0)
    written = 0
    for index in range(total):
        if run.frame_key(index).get("odometry") != key:
            with watch("deskew"):
                measured = dataset.sweep(index)
                deskewed = odometry.sweeps.deskewed(index, measured)
                usable = usable_points(deskewed.points)
                if blooming_deg:
                    usable &= ~_ghost_returns(dataset, measured, blooming_deg)
                if not usable.any():
                    raise DatasetError(
                        f"{dataset.path}: sweep {measured.name} (frame {index}) holds no usable "
                        "point; leave this frame out of the recording"
                    )
                record = _frame(deskewed, usable, period, key)
            with watch("write"):
                run.write_frame(index, record)
            written += 1
        report(index + 1, total)
    return written


def _frame(sweep: Sweep, usable: NDArray[np.bool_], period: np.float32, key: str) -> FrameRecord:
    """The usable points of a deskewed sweep; ``period`` is a sweep's duration in seconds."""
    relative_time, sensor_rig = sweep.relative_time, sweep.sensor_rig
    return FrameRecord(
        np.ascontiguousarray(sweep.points[usable]),
        np.flatnonzero(usable).astype(np.uint32),
        sweep.name,
        len(sweep.points),
        {"odometry": key},
        time_offset=None if relative_time is None else period * relative_time[usable],
        sensor=None if sensor_rig is None else sensor_rig.index[usable],
    )


def _ghost_returns(dataset: Dataset, sweep: Sweep, blooming_deg: float) -> NDArray[np.bool_]:
    """Ghost returns of a sweep as measured."""
    if sweep.intensity is None:
        raise ConfigError(
            f"{dataset.path}: sweep {sweep.name} has no intensity, which tells reflectors; "
            "leave odometry.blooming_deg at 0"
        )
    return blooming_points(sweep.points, sweep.intensity, blooming_deg)
