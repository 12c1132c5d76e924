"""Ground, votes and class of every point of a run (paper III-C)."""

from __future__ import annotations

import shutil
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from docdepth.concurrency import thread_count
from docdepth.dynamics import classifier as dynamics
from docdepth.dynamics import clustering as objects
from docdepth.dynamics import voting
from docdepth.dynamics.key_frames import key_frames as select_key_frames
from docdepth.dynamics.tracking import (
    Detections,
    apply_tracks,
    local_poses,
    track_objects,
    uses_tracking,
)
from docdepth.errors import RunError
from docdepth.geometry.points import DYNAMIC
from docdepth.geometry.scan_mesh import ScanMesh
from docdepth.geometry.trajectory import Trajectory
from docdepth.ground.growing import GroundMap, chunks
from docdepth.io.atomic import write_atomically
from docdepth.io.frames import FrameRecord
from docdepth.io.run_folder import RunFolder, stage_key
from docdepth.pipeline.stage import (
    Progress,
    Stopwatch,
    finish_stage,
    prefetch,
    progress_callback,
    stage_is_done,
)

_GROUND = ".ground"
_MOVING, _STATIC, _OUTLIER = 251, 9, 1  # SemanticKITTI's labels


class _Sweep(NamedTuple):
    """A sweep made ready to be voted on, and to become a key frame."""

    record: FrameRecord
    ground: NDArray[np.bool_]
    surface: ScanMesh | None


def run_classify(run: RunFolder, threads: int = 0, progress: Progress | None = None) -> None:
    """Ground, votes and class of every point into ``frames/`` and ``labels/``.

    Votes that are there are kept when only what makes classes of them has changed.

    Parameters
    ----------
    threads : int
        0 takes every core.
    """
    parameters = run.parameters
    trajectory = run.trajectory()
    made_of = (
        run.stage("odometry").get("key"),
        parameters.ground.model_dump(),
        parameters.surface.model_dump(),
    )
    key = stage_key(*made_of, parameters.dynamics.model_dump())
    votes_key = stage_key(*made_of, parameters.dynamics.voting())
    if stage_is_done(run, "classify", key):
        return
    watch, total = Stopwatch(), len(trajectory)
    run.set_stage("classify", state="running", key=key)
    grounds = _grow_ground(run, trajectory, watch, threads, progress_callback(progress, "ground"))

    over_time = uses_tracking(parameters.dynamics)
    local = local_poses(trajectory)
    seen, detections = run.path / ".objects" / key, dict[int, Detections]()
    voters = select_key_frames(trajectory, parameters.dynamics)

    keys = {"votes": votes_key, "classify": key}

    def is_classified(index: int) -> bool:
        if over_time:
            return (seen / f"{index:06d}.npy").is_file()
        return run.frame_key(index).get("classify") == key

    def prepare(index: int) -> _Sweep:
        with watch("read"):
            record = run.frame(index)
            ground = np.unpackbits(grounds[index], count=len(record.points)).view(np.bool_)
        with watch("surfaces"):
            surface = dynamics.surface_for(
                record.points, parameters.dynamics, parameters.surface, run.sensor_rig(record)
            )
        return _Sweep(record, ground, surface)

    def make_key_frame(sweep: Future[_Sweep]) -> voting.KeyFrame:
        record, ground, surface = sweep.result()
        with watch("key frames"):
            return voting.KeyFrame(
                record.points, ground, parameters.dynamics, surface, run.sensor_rig(record)
            )

    def vote(index: int, sweep: _Sweep, asked: list[Future[voting.KeyFrame]]) -> voting.Votes:
        if index in voted:
            return _votes_of(sweep.record)
        answering = [key_frame.result() for key_frame in asked]
        with watch("vote"):
            return voting.vote(
                sweep.record.points,
                sweep.ground,
                trajectory.poses[index],
                answering,
                trajectory.poses[voters[index]],
                parameters.dynamics,
                threads=1,
            )

    def classify(
        index: int, made: Future[_Sweep], asked: list[Future[voting.KeyFrame]]
    ) -> Future[None]:
        sweep = made.result()
        votes, (record, ground, surface), first = vote(index, sweep, asked), sweep, None
        with watch("objects"):
            if over_time:
                first = objects.cluster_objects(record.points, ground, surface, parameters.dynamics)
            classid = dynamics.classify(
                ground, votes, parameters.dynamics, record.points, surface, first
            )
        if first is None:
            return writers.submit(write, index, record, votes, classid)
        with watch("sightings"):
            moving = classid >= DYNAMIC
            detections[index] = Detections(record.points, ground, first, moving, local[index])
        return writers.submit(write_first, index, first, votes, classid)

    def write(
        index: int, record: FrameRecord, votes: voting.Votes, classid: NDArray[np.uint16]
    ) -> None:
        with watch("write"):
            _write_classified(run, index, record, keys, votes, classid)

    def write_first(
        index: int, first: NDArray[np.uint32], votes: voting.Votes, classid: NDArray[np.uint16]
    ) -> None:
        with watch("write"):
            arrays = (first, votes.static, votes.dynamic, classid)
            _write_arrays(seen / f"{index:06d}.npy", *arrays, *detections[index].arrays)

    left = [index for index in range(total) if not is_classified(index)]
    voted = {index for index in left if run.frame_key(index).get("votes") == votes_key}
    tell = progress_callback(progress, "classify")
    tell(total - len(left), total)
    sweeps: dict[int, Future[_Sweep]] = {}
    key_frames: dict[int, Future[voting.KeyFrame]] = {}

    def asked_by(ahead: list[int]) -> set[int]:
        return {k for i in ahead if i not in voted for k in voters[i].tolist()}

    # A job takes one thread, since a sweep alone has too little to do for many. Workers take jobs
    # in order, so that none waits for one that waits for a worker; and what a job needs is begun
    # some jobs before, so that it seldom waits at all. For the disk wait others.
    workers = thread_count(threads)
    with ThreadPoolExecutor(2) as writers, ThreadPoolExecutor(workers) as pool:
        working: deque[Future[Future[None]]] = deque()
        for done, index in enumerate(left):
            ahead = left[done : done + workers + 2]
            asked, later = asked_by(ahead[: workers + 1]), asked_by(ahead)
            key_frames = {k: key_frames[k] for k in key_frames if k in asked}
            sweeps = {k: sweeps[k] for k in sweeps if k >= index or k in later - key_frames.keys()}
            for k in sorted({*ahead, *later} - sweeps.keys() - key_frames.keys()):
                sweeps[k] = pool.submit(prepare, k)
            for k in sorted(asked - key_frames.keys()):
                key_frames[k] = pool.submit(make_key_frame, sweeps[k])
            answering = [] if index in voted else [key_frames[k] for k in voters[index].tolist()]
            working.append(pool.submit(classify, index, sweeps[index], answering))
            if len(working) > workers:
                working.popleft().result().result()
            tell(total - len(left) + done + 1 - len(working), total)
        while working:
            working.popleft().result().result()
            tell(total - len(working), total)
    if over_time:
        _carry_evidence(run, trajectory, seen, detections, keys, watch, threads)
        shutil.rmtree(seen.parent)
    shutil.rmtree(run.path / _GROUND)
    finish_stage(run, "classify", watch, len(left))


def _grow_ground(
    run: RunFolder,
    trajectory: Trajectory,
    watch: Stopwatch,
    threads: int,
    tell: Callable[[int, int], None],
) -> list[NDArray[np.uint8]]:
    """Ground labels of every frame as packed bits, a chunk of path length at a time."""
    parameters = run.parameters.ground
    key = stage_key(run.stage("odometry").get("key"), parameters.model_dump())

    def read(index: int) -> NDArray[np.float32]:
        with watch("read"):
            return run.points(index)

    def label(ground_map: GroundMap, index: int) -> NDArray[np.uint8]:
        points = read(index)
        with watch("ground: label"):
            return np.packbits(ground_map.label(points, trajectory.poses[index]))

    grounds: list[NDArray[np.uint8]] = []
    with ThreadPoolExecutor(thread_count(threads) + 1) as pool:
        for frames, merged in chunks(trajectory, parameters):
            kept = run.path / _GROUND / f"{key}_{frames[0]:06d}.npy"
            if not kept.is_file():
                done = len(grounds)
                found: list[NDArray[np.uint8]] = []
                ground_map = GroundMap(parameters, threads)
                for step, points in enumerate(prefetch(pool, read, merged)):
                    with watch("ground: insert"):
                        ground_map.insert(points, trajectory.poses[merged[step]])
                    tell(done + len(frames) * step // (2 * len(merged)), len(trajectory))
                with watch("ground: grow"):
                    ground_map.grow()
                for bits in prefetch(pool, partial(label, ground_map), frames):
                    tell(done + (len(frames) + len(found)) // 2, len(trajectory))
                    found.append(bits)
                _write_arrays(kept, *found)
            grounds += _read_arrays(kept, len(frames))
    tell(len(trajectory), len(trajectory))
    return grounds


def _carry_evidence(
    run: RunFolder,
    trajectory: Trajectory,
    seen: Path,
    detections: dict[int, Detections],
    keys: dict[str, str],
    watch: Stopwatch,
    threads: int,
) -> None:
    """Classes of objects that move at another time; the same again when it was interrupted.

    ``detections`` are those that need not be read, because they were not made by an earlier run.
    """
    local, parameters = local_poses(trajectory), run.parameters.dynamics

    def sighting_of(index: int) -> Detections:
        if index in detections:
            return detections[index]
        with watch("read"):
            return Detections.of(_read_arrays(seen / f"{index:06d}.npy", 7)[4:])

    def classify_again(index: int) -> None:
        with watch("read"):
            record = run.frame(index)
            first, static, dynamic, classid = _read_arrays(seen / f"{index:06d}.npy", 4)
        if carried[index]:
            classid = apply_tracks(
                record.points,
                first,
                carried[index],
                static,
                dynamic,
                classid,
                local[index],
                parameters,
            )
        with watch("write"):
            votes = voting.Votes(static, dynamic)
            _write_classified(run, index, record, keys, votes, classid)

    # Many workers, since most of them wait for the disk.
    with ThreadPoolExecutor(5) as pool:
        everything = list(pool.map(sighting_of, range(len(trajectory))))
        with watch("tracks"):
            carried = track_objects(everything, trajectory.times, parameters, threads)
        for _ in prefetch(pool, classify_again, range(len(trajectory)), 5):
            pass
        list(pool.map(Path.unlink, seen.iterdir()))


def _write_arrays(path: Path, *arrays: NDArray[Any]) -> None:
    """One after the other into one file."""

    def write(out: BinaryIO) -> None:
        for array in arrays:
            np.save(out, array)

    write_atomically(path, write, sync=False)


def _read_arrays(path: Path, count: int) -> list[NDArray[Any]]:
    """The first ones of a file."""
    try:
        with path.open("rb") as stream:
            return [np.load(stream) for _ in range(count)]
    except (EOFError, ValueError) as error:
        raise RunError(f"{path} is damaged ({error}); delete it and run the stage again") from None


def _votes_of(record: FrameRecord) -> voting.Votes:
    assert record.votes_static is not None
    assert record.votes_dynamic is not None
    return voting.Votes(record.votes_static, record.votes_dynamic)


def _write_classified(
    run: RunFolder,
    index: int,
    record: FrameRecord,
    keys: dict[str, str],
    votes: voting.Votes,
    classid: NDArray[np.uint16],
) -> None:
    labels = np.full(record.input_points, _OUTLIER, np.uint32)
    labels[record.index] = np.where(classid >= DYNAMIC, _MOVING, _STATIC)
    path = run.path / "labels" / f"{record.name}.label"
    write_atomically(path, lambda stream: stream.write(labels.tobytes()))
    # Last, because its key says that this frame is done.
    classified = replace(
        record,
        key={**record.key, **keys},
        votes_static=votes.static,
        votes_dynamic=votes.dynamic,
        classid=classid,
    )
    run.write_frame(index, classified)
