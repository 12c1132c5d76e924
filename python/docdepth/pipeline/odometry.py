"""Poses and deskewed sweeps of a run (paper III-B)."""

from __future__ import annotations

import logging

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.base import Dataset, Sweep, usable_points
from docdepth.errors import ConfigError, DatasetError
from docdepth.io.ply import FrameRecord, write_trajectory
from docdepth.io.run_folder import RunFolder, stage_key
from docdepth.odometry import odometry
from docdepth.phantoms import phantom_points
from docdepth.pipeline.stage import Progress, Stopwatch, finish_stage, stage_is_done, teller

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
    sensors = dataset.sweep(0).sensors
    places = None if sensors is None else sensors.T_lidar_sensor.tolist()
    key = stage_key(run.manifest["source"], parameters.model_dump(), places)
    if stage_is_done(run, "odometry", key):
        return
    watch, total = Stopwatch(), len(dataset)
    run.set_stage("odometry", state="running", key=key)
    tell = teller(progress, "odometry")
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
                if parameters.bloom_deg:
                    usable &= ~_phantoms(dataset, sweep, parameters.bloom_deg)
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
                late=None if sweep.fraction is None else period * sweep.fraction[usable],
                sensor=sweep.sensors.index[usable] if sweep.sensors else None,
            )
            with watch("write"):
                run.write_frame(index, record)
        tell(index + 1, total)
    if sensors is not None:
        run.write_sensors(sensors)
    finish_stage(run, "odometry", watch, worked)


def _phantoms(dataset: Dataset, sweep: Sweep, bloom_deg: float) -> NDArray[np.bool_]:
    if sweep.intensity is None:
        raise ConfigError(
            f"{dataset.path}: sweep {sweep.name} has no intensity, by which reflectors are known; "
            "leave odometry.bloom_deg at 0"
        )
    return phantom_points(sweep.points, sweep.intensity, bloom_deg)
