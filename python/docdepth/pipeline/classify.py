"""Ground, votes and class of every point of a run (paper III-C)."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from docdepth import dynamics, objects, voting
from docdepth.ground import GroundMap, chunks
from docdepth.io.atomic import write_atomically
from docdepth.io.ply import FrameRecord
from docdepth.io.run_folder import RunFolder, stage_key
from docdepth.pipeline.stage import (
    Progress,
    Stopwatch,
    finish_stage,
    made_ahead,
    stage_is_done,
    teller,
)
from docdepth.surface import Surface
from docdepth.trajectory import Trajectory

_MOVING, _STATIC, _OUTLIER = 251, 9, 1  # SemanticKITTI's labels


class _Sweep(NamedTuple):
    """A sweep made ready to be voted on, and to become a key frame."""

    record: FrameRecord
    ground: NDArray[np.bool_]
    surface: Surface | None


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
    grounds = run.path / ".ground"
    _grow_ground(run, trajectory, grounds, watch, threads, teller(progress, "ground"))

    over_time = objects.carries_evidence(parameters.dynamics)
    local = objects.poses_near_start(trajectory)
    seen = run.path / ".objects" / key
    voters = voting.key_frames(trajectory, parameters.dynamics)

    keys = {"votes": votes_key, "classify": key}

    def is_classified(index: int) -> bool:
        if over_time:
            return (seen / f"{index:06d}.npy").is_file()
        return run.frame_key(index).get("classify") == key

    def prepare(index: int) -> _Sweep:
        with watch("read"):
            record = run.frame(index)
            bits = np.load(grounds / f"{index:06d}.npy")
            ground = np.unpackbits(bits, count=len(record.points)).astype(bool)
        with watch("surfaces"):
            surface = dynamics.surface_for(
                record.points, parameters.dynamics, parameters.surface, run.sensors(record)
            )
        return _Sweep(record, ground, surface)

    def make_key_frame(sweep: Future[_Sweep]) -> voting.KeyFrame:
        record, ground, surface = sweep.result()
        with watch("key frames"):
            return voting.KeyFrame(
                record.points, ground, parameters.dynamics, surface, run.sensors(record)
            )

    def finish(index: int, sweep: _Sweep, votes: voting.Votes) -> None:
        (record, ground, surface), first = sweep, None
        with watch("objects"):
            if over_time:
                first = objects.connect_objects(record.points, ground, surface, parameters.dynamics)
            classid = dynamics.classify(
                ground, votes, parameters.dynamics, record.points, surface, first
            )
        if first is None:
            with watch("write"):
                _write_classified(run, index, record, keys, votes, classid)
            return
        with watch("sightings"):
            moving = classid >= dynamics.DYNAMIC
            sighting = objects.Sighting(record.points, ground, first, moving, local[index])
        with watch("write"):
            arrays = (*sighting.arrays, first, votes.static, votes.dynamic, classid)
            _write_arrays(seen / f"{index:06d}.npy", *arrays)

    left = [index for index in range(total) if not is_classified(index)]
    voted = {index for index in left if run.frame_key(index).get("votes") == votes_key}
    tell = teller(progress, "classify")
    tell(total - len(left), total)
    sweeps: dict[int, Future[_Sweep]] = {}
    key_frames: dict[int, Future[voting.KeyFrame]] = {}
    # Sweeps of the next votes are prepared, and the last votes made classes, during a vote: two of
    # them, since each alone would leave a core idle when the vote is done first. Workers take jobs
    # in order, so that a key frame never waits for a sweep that waits for a worker; the third one,
    # since one mostly waits for the disk.
    with ThreadPoolExecutor(3) as pool:
        pending: Future[None] | None = None
        for done, index in enumerate(left):
            ahead = left[done : done + 3]
            asked = {k for i in ahead if i not in voted for k in voters[i].tolist()}
            sweeps = {k: sweeps[k] for k in sweeps if k >= index}
            key_frames = {k: key_frames[k] for k in key_frames if k in asked}
            for k in sorted({*ahead, *asked} - sweeps.keys() - key_frames.keys()):
                sweeps[k] = pool.submit(prepare, k)
            for k in sorted(asked - key_frames.keys()):
                key_frames[k] = pool.submit(make_key_frame, sweeps[k])
            with watch("wait for sweeps"):
                sweep = sweeps[index].result()
            if index in voted:
                votes = _votes_of(sweep.record)
            else:
                with watch("wait for sweeps"):
                    answering = [key_frames[k].result() for k in voters[index].tolist()]
                with watch("vote"):
                    votes = voting.vote(
                        sweep.record.points,
                        sweep.ground,
                        trajectory.poses[index],
                        answering,
                        trajectory.poses[voters[index]],
                        parameters.dynamics,
                        threads,
                    )
            with watch("wait for objects and files"):
                if pending:
                    pending.result()
                pending = pool.submit(finish, index, sweep, votes)
            tell(total - len(left) + done + 1, total)
        if pending:
            pending.result()
    if over_time:
        _carry_evidence(run, trajectory, seen, keys, watch, threads)
        shutil.rmtree(seen.parent)
    for path in grounds.glob("*"):
        path.unlink()
    finish_stage(run, "classify", watch, len(left))


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

    def read(index: int) -> NDArray[np.float32]:
        with watch("read"):
            return run.points(index)

    def label(ground_map: GroundMap, index: int) -> None:
        points = read(index)
        with watch("ground: label"):
            bits = np.packbits(ground_map.label(points, trajectory.poses[index]))
        write_atomically(folder / f"{index:06d}.npy", lambda out: np.save(out, bits))

    done = 0
    with ThreadPoolExecutor(2) as pool:
        for frames, merged in chunks(trajectory, parameters):
            if not all((folder / f"{index:06d}.npy").is_file() for index in frames):
                ground_map = GroundMap(parameters, threads)
                for step, points in enumerate(made_ahead(pool, read, merged)):
                    with watch("ground: insert"):
                        ground_map.insert(points, trajectory.poses[merged[step]])
                    tell(done + len(frames) * step // (2 * len(merged)), len(trajectory))
                with watch("ground: grow"):
                    ground_map.grow()
                labelled = made_ahead(pool, partial(label, ground_map), frames)
                for step, _ in enumerate(labelled):
                    tell(done + (len(frames) + step) // 2, len(trajectory))
            done += len(frames)
    tell(len(trajectory), len(trajectory))


def _carry_evidence(
    run: RunFolder,
    trajectory: Trajectory,
    seen: Path,
    keys: dict[str, str],
    watch: Stopwatch,
    threads: int,
) -> None:
    """Classes of objects that move at another time; the same again when it was interrupted."""

    local = objects.poses_near_start(trajectory)

    def read_sighting(index: int) -> objects.Sighting:
        with watch("read"):
            return objects.Sighting.of(_read_arrays(seen / f"{index:06d}.npy", 3))

    def classify_again(index: int) -> None:
        with watch("read"):
            record = run.frame(index)
            arrays = _read_arrays(seen / f"{index:06d}.npy", 7)
        first, static, dynamic, classid = arrays[3:]
        if carried[index]:
            classid = objects.add_carried(
                record.points,
                first,
                carried[index],
                static,
                dynamic,
                classid,
                local[index],
                run.parameters.dynamics,
            )
        with watch("write"):
            votes = voting.Votes(static, dynamic)
            _write_classified(run, index, record, keys, votes, classid)

    # Many workers, since most of them wait for the disk.
    with ThreadPoolExecutor(6) as pool:
        sightings = list(pool.map(read_sighting, range(len(trajectory))))
        with watch("tracks"):
            carried = objects.follow(sightings, trajectory.times, run.parameters.dynamics, threads)
        for _ in made_ahead(pool, classify_again, range(len(trajectory)), 6):
            pass


def _write_arrays(path: Path, *arrays: NDArray[Any]) -> None:
    """One after the other into one file."""

    def write(out: BinaryIO) -> None:
        for array in arrays:
            np.save(out, array)

    write_atomically(path, write)


def _read_arrays(path: Path, count: int) -> list[NDArray[Any]]:
    """The first ones of a file."""
    with path.open("rb") as stream:
        return [np.load(stream) for _ in range(count)]


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
    labels[record.index] = np.where(classid >= dynamics.DYNAMIC, _MOVING, _STATIC)
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
