"""The stages of a run, one after the other: each reads what the one before wrote.

Every stage can be killed and goes on where it stopped; what is done is known from the files.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from docdepth import dynamics
from docdepth.datasets.base import Dataset, usable_points
from docdepth.depth_maps import run_render
from docdepth.errors import DatasetError
from docdepth.ground import GroundMap, chunks
from docdepth.io.atomic import write_atomically
from docdepth.io.ply import FrameRecord, write_trajectory
from docdepth.io.run_folder import RunFolder, stage_key
from docdepth.odometry import odometry
from docdepth.stages import Progress, Stopwatch, finish_stage, stage_is_done, teller
from docdepth.surface import Surface
from docdepth.trajectory import Trajectory

__all__ = ["run_classify", "run_odometry", "run_render"]

log = logging.getLogger(__name__)

_MOVING, _STATIC = 251, 9  # SemanticKITTI's moving-object labels


def run_odometry(
    run: RunFolder,
    dataset: Dataset,
    poses: NDArray[np.float64] | None = None,
    progress: Progress | None = None,
) -> None:
    """Poses of every sweep, and the sweeps deskewed to their stamp, into ``frames/``.

    Parameters
    ----------
    poses : ndarray of float64, shape (n, 4, 4), optional
        ``T_world_lidar`` of another SLAM; registered here when there are none.

    Raises
    ------
    DatasetError
        A sweep is damaged or empty.
    """
    parameters = run.parameters.odometry
    key = stage_key(run.manifest["source"], parameters.model_dump())
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

        estimate = odometry(dataset, parameters, poses, registered, checkpoint)
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
            )
            with watch("write"):
                run.write_frame(index, record)
        tell(index + 1, total)
    finish_stage(run, "odometry", watch, worked)


def run_classify(run: RunFolder, threads: int = 0, progress: Progress | None = None) -> None:
    """Ground, votes and class of every point into ``frames/`` and ``labels/``.

    Parameters
    ----------
    threads : int
        0 takes every core.
    """
    parameters = run.parameters
    trajectory = run.trajectory()
    key = stage_key(
        run.stage("odometry").get("key"),
        parameters.ground.model_dump(),
        parameters.surface.model_dump(),
        parameters.dynamics.model_dump(),
    )
    if stage_is_done(run, "classify", key):
        return
    watch, total = Stopwatch(), len(trajectory)
    run.set_stage("classify", state="running", key=key)
    grounds = run.path / ".ground"
    _grow_ground(run, trajectory, grounds, watch, threads, teller(progress, "ground"))

    def ground_of(index: int, count: int) -> NDArray[np.bool_]:
        return np.unpackbits(np.load(grounds / f"{index:06d}.npy"), count=count).astype(bool)

    def finish(
        index: int,
        record: FrameRecord,
        ground: NDArray[np.bool_],
        votes: dynamics.Votes,
        surface: Surface | None,
    ) -> None:
        with watch("objects"):
            classid = dynamics.classify(ground, votes, parameters.dynamics, record.points, surface)
        with watch("write"):
            _write_classified(run, index, replace(record, classid=classid))

    voters = dynamics.key_frames(trajectory, parameters.dynamics)
    asked: dict[int, dynamics.KeyFrame] = {}
    surfaces: dict[int, Surface | None] = {}  # of key frames whose own turn is still to come

    def surface_of(k: int, points: NDArray[np.float32]) -> Surface | None:
        if k not in surfaces:
            with watch("surfaces"):
                surfaces[k] = dynamics.surface_for(points, parameters.dynamics, parameters.surface)
        return surfaces[k]

    tell = teller(progress, "classify")
    worked = 0
    with ThreadPoolExecutor(1) as writer:
        pending: Future[None] | None = None
        for index in range(total):
            if run.frame_key(index).get("classify") != key:
                worked += 1
                wanted = voters[index]
                asked = {k: asked[k] for k in asked if k in set(wanted.tolist())}
                for k in (int(k) for k in wanted if int(k) not in asked):
                    with watch("read"):
                        record = run.frame(k)
                        ground = ground_of(k, len(record.points))
                    surface = surface_of(k, record.points)
                    with watch("key frames"):
                        asked[k] = dynamics.KeyFrame(
                            record.points, ground, parameters.dynamics, surface
                        )
                with watch("read"):
                    record = run.frame(index)
                    ground = ground_of(index, len(record.points))
                with watch("vote"):
                    votes = dynamics.vote(
                        record.points,
                        ground,
                        trajectory.poses[index],
                        [asked[int(k)] for k in wanted],
                        trajectory.poses[wanted],
                        parameters.dynamics,
                        threads,
                    )
                surface = surface_of(index, record.points)
                surfaces = {k: surfaces[k] for k in surfaces if k > index}
                record = replace(
                    record,
                    key={**record.key, "classify": key},
                    votes_static=votes.static,
                    votes_dynamic=votes.dynamic,
                )
                # The next sweep is voted on meanwhile.
                with watch("wait for objects and files"):
                    if pending:
                        pending.result()
                    pending = writer.submit(finish, index, record, ground, votes, surface)
            tell(index + 1, total)
        if pending:
            pending.result()
    for path in grounds.glob("*"):
        path.unlink()
    finish_stage(run, "classify", watch, worked)


def _grow_ground(
    run: RunFolder,
    trajectory: Trajectory,
    folder: Path,
    watch: Stopwatch,
    threads: int,
    tell: Callable[[int, int], None],
) -> None:
    """Ground labels of every frame as packed bits, a chunk of path length at a time."""
    parameters = run.parameters.ground
    key = stage_key(run.stage("odometry").get("key"), parameters.model_dump())
    marker = folder / "key"
    if not (marker.is_file() and marker.read_text() == key):
        for path in folder.glob("*"):
            path.unlink()
        write_atomically(marker, lambda stream: stream.write(key.encode()))
    done = 0
    for frames, merged in chunks(trajectory, parameters):
        paths = {i: folder / f"{i:06d}.npy" for i in frames}
        if not all(path.is_file() for path in paths.values()):
            ground_map = GroundMap(parameters, threads)
            for step, index in enumerate(merged):
                with watch("read"):
                    record = run.frame(index)
                with watch("ground: insert"):
                    ground_map.insert(record.points, trajectory.poses[index])
                tell(done + len(paths) * step // (2 * len(merged)), len(trajectory))
            with watch("ground: grow"):
                ground_map.grow()
            for step, (index, path) in enumerate(paths.items()):
                with watch("read"):
                    record = run.frame(index)
                with watch("ground: label"):
                    bits = np.packbits(ground_map.label(record.points, trajectory.poses[index]))
                write_atomically(path, lambda out, bits=bits: np.save(out, bits))  # type: ignore[misc]
                tell(done + (len(paths) + step) // 2, len(trajectory))
        done += len(frames)
    tell(len(trajectory), len(trajectory))


def _write_classified(run: RunFolder, index: int, record: FrameRecord) -> None:
    assert record.classid is not None
    labels = np.full(record.input_points, _STATIC, np.uint32)
    labels[record.index[record.classid >= 100]] = _MOVING
    path = run.path / "labels" / f"{record.name}.label"
    write_atomically(path, lambda stream: stream.write(labels.tobytes()))
    # Last, because its key says that this frame is done.
    run.write_frame(index, record)
