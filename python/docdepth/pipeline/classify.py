"""Ground, votes and class of every point of a run (paper IV); or the classes that it was given."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from functools import partial
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from docdepth.concurrency import Progress, Timer, null_progress
from docdepth.dynamics.classes import find_unlikely_classes
from docdepth.dynamics.sweep_classifier import SweepClassifier
from docdepth.dynamics.tracking import track_objects
from docdepth.errors import DatasetError
from docdepth.geometry.points import DYNAMIC
from docdepth.geometry.trajectory import Trajectory
from docdepth.ground.growing import Chunk, chunks, label_chunk
from docdepth.io.frames import read_frame_name, read_input_points
from docdepth.io.run_folder import RunFolder, stage_key
from docdepth.io.tracks import TRACKS, write_tracks
from docdepth.pipeline.execution import parameters_within_budget
from docdepth.pipeline.label_folder import LabelFolder
from docdepth.pipeline.parallel import ChunkContext, WorkerPool
from docdepth.pipeline.plan import classify_stage
from docdepth.pipeline.stage import Stage, remove_others
from docdepth.pipeline.sweep_store import (
    EVIDENCE,
    GROUND,
    TRACKING,
    FrameStore,
    sweep_file,
    write_arrays,
    write_classified,
)

log = logging.getLogger(__name__)


def run_classify(
    run: RunFolder,
    threads: int = 0,
    progress: Progress = null_progress,
    workers: WorkerPool | None = None,
    stage: Stage | None = None,
) -> None:
    """Write the class, votes and track of every point: ``classes/``, ``labels/``, ``tracks.csv``.

    Parameters
    ----------
    run : RunFolder
        Its odometry is done.
    workers : WorkerPool, optional
        Who does the work; this process with its threads if absent.
    stage : Stage, optional
        :func:`~.plan.classify_stage` of the run.
    """
    if run.manifest.inputs is not None and run.manifest.inputs.labels is not None:
        return take_labels(run, progress, stage)
    workers = workers or WorkerPool(threads)
    with run.lock("classify"):
        stage, trajectory = stage or classify_stage(run), run.trajectory()
        store = FrameStore(run, stage.made_of, len(trajectory))
        has_tracks = stage.is_made_once()
        # Tracks are made of all sweeps, and change their labels.
        known = has_tracks or store.tracks.is_whole()
        left = stage.left() if known else [*range(len(trajectory))]
        if not left and has_tracks:
            return
        of_ground = parameters_within_budget(run).ground.model_dump()
        ground_key = {
            "ground": stage_key(stage.inputs["version"], stage.inputs["odometry"], of_ground)
        }
        with stage.working() as profile:
            store.timer = profile.timer
            _grow_ground(run, trajectory, ground_key, profile.timer, workers, progress)
            if left:
                _classify(store, trajectory, left, workers, progress)
            profile.frames = len(left)
            if not has_tracks:
                write = run.writer(stage.made_of)
                write_tracks(run.path / TRACKS, store.tracks.tracks(), trajectory.times, write)
            profile.add(find_unlikely_classes(store.counts))
            run.remove_tree(run.state_dir / EVIDENCE)
            remove_others(run, run.state_dir / GROUND, ground_key)
            remove_others(run, run.state_dir / TRACKING, stage.made_of)
            stage.remove_outdated()


def _classify(
    store: FrameStore,
    trajectory: Trajectory,
    left: list[int],
    workers: WorkerPool,
    progress: Progress,
) -> None:
    """Classify the sweeps that are not classified yet."""
    run, timer, every = store.run, store.timer, range(len(trajectory))
    parameters = run.parameters.dynamics
    by_tracks = parameters.evidence == "tracks"
    finds_tracks = by_tracks and not store.tracks.is_whole()
    # Tracks are made of the evidence of all sweeps. Where they are known, few sweeps are missing.
    without = [
        i
        for i in (every if finds_tracks else left)
        if not (by_tracks and run.key(store.evidence_file(i)) == store.key)
    ]
    kept = len(every) - len(without)
    progress("classify", kept, len(every))

    def map_chunks(step: _Step, sweeps: list[int], done: Callable[[int], None]) -> None:
        chunks = workers.cut(sweeps, trajectory.arc_length[sweeps])
        on_chunk = partial(_classify_chunk, step, store.key)
        for _, counts in workers.map_frames(run, on_chunk, chunks, timer, done):
            store.counts += counts

    map_chunks("votes", without, lambda done: progress("classify", kept + done, len(every)))
    if finds_tracks:
        with timer("tracks"):
            tracks = track_objects(
                store.detections,
                trajectory,
                store.tracks.take,
                workers.threads,
                lambda done: progress("track", done, len(every)),
            )
        store.tracks.write(tracks)
    if by_tracks:
        map_chunks("tracks", left, lambda done: None)


def _grow_ground(
    run: RunFolder,
    trajectory: Trajectory,
    key: dict[str, str],
    timer: Timer,
    workers: WorkerPool,
    progress: Progress,
) -> None:
    """Ground labels of every frame; those of each chunk are kept in a file."""
    total = len(trajectory)
    left = [
        chunk
        for chunk in chunks(trajectory, parameters_within_budget(run).ground)
        if not all(run.key(sweep_file(run, GROUND, k)) == key for k in chunk.sweeps)
    ]
    kept = total - sum(len(chunk.sweeps) for chunk in left)
    grown = workers.map_frames(
        run,
        partial(_label_ground, key),
        left,
        timer,
        lambda done: progress("ground", kept + done, total),
        lambda chunk: len(chunk.sweeps),
    )
    for _ in grown:
        pass
    progress("ground", total, total)


def _label_ground(key: dict[str, str], context: ChunkContext, chunk: Chunk) -> None:
    """Write the ground labels of a chunk."""
    run, timer = context.run, context.timer

    def read(index: int) -> NDArray[np.float32]:
        with timer("read"):
            return run.points(index)

    trajectory, p = run.trajectory(), parameters_within_budget(run).ground
    labels = label_chunk(
        chunk,
        read,
        trajectory,
        p,
        context.threads,
        lambda share: context.progress(int(share * len(chunk.sweeps))),
        timer,
    )
    for index, ground in zip(chunk.sweeps, labels, strict=True):
        packed = {"ground": np.packbits(ground)}
        write_arrays(run, sweep_file(run, GROUND, index), key, packed)


_Step: TypeAlias = Literal["votes", "tracks"]
"""Of classification; what tracks find is known when all sweeps have voted."""


def _classify_chunk(
    step: _Step, key: dict[str, str], context: ChunkContext, sweeps: list[int]
) -> NDArray[np.int64]:
    """Do a step on some sweeps; the counts of those that were written."""
    run, timer = context.run, context.timer
    trajectory = run.trajectory()
    store = FrameStore(run, key, len(trajectory), timer)
    classifier = SweepClassifier(trajectory, run.parameters.dynamics, timer)
    if step == "votes":
        classifier.vote_on(store, sweeps, context.progress, context.threads)
    else:
        classifier.label_by_tracks(store, store.tracks, sweeps, context.progress)
    return store.counts


def open_labels(run: RunFolder) -> LabelFolder:
    """The labels that a run was given."""
    labels = run.inputs.labels
    assert labels is not None
    given = LabelFolder(labels)
    if given.folder.resolve().is_relative_to(run.path.resolve()):
        raise DatasetError(
            f"{given.folder} lies in the run {run.path} itself; name a folder of other labels"
        )
    return given


def take_labels(run: RunFolder, progress: Progress, stage: Stage | None = None) -> None:
    """Write the classes that a run was given into ``classes/`` and ``labels/``.

    Ground is not grown and key frames do not vote. Tracks are those of the run whose labels these
    are, if any.

    Parameters
    ----------
    run : RunFolder
        Its odometry is done, and its inputs name the labels.
    stage : Stage, optional
        :func:`~.plan.classify_stage` of the run.
    """
    with run.lock("classify"):
        trajectory, stage = run.trajectory(), stage or classify_stage(run)
        left, count, key = stage.left(), len(trajectory), stage.made_of
        if not left and stage.is_made_once():
            return
        given = open_labels(run)
        _check(given, run, left)
        with stage.working() as profile:
            tracks = given.tracks(trajectory)
            profile.more |= {"labels": str(given.folder), "tracks": tracks is not None}
            if tracks is not None:
                content = tracks
                run.write(run.path / TRACKS, content, key)
            something_moves = False
            for index in left:
                with profile.timer("read"):
                    classified = given.classified(run.deskewed(index), index)
                assert classified.classid is not None
                something_moves |= bool((classified.classid >= DYNAMIC).any())
                with profile.timer("write"):
                    write_classified(run, index, classified, key)
                profile.frames += 1
                progress("classify", count - len(left) + profile.frames, count)
            if not something_moves and len(left) == count:
                log.warning(
                    "no point of %s is dynamic: what moves has the class 251 to 259 in .label "
                    "files, 100 and above in .npy files, or True, the intensity 1 in .pcd files",
                    given.folder,
                )  # fmt: skip
            stage.remove_outdated()
            remove_others(run, run.state_dir / TRACKING, key)


def _check(given: LabelFolder, run: RunFolder, frames: Sequence[int]) -> None:
    """Refuse labels that do not fit, before any class is written."""
    for frame in frames:
        path = run.frame_path(frame)
        points = read_input_points(path)
        given.check_count(read_frame_name(path), frame, points, partial(_returns, run, frame))


def _returns(run: RunFolder, frame: int) -> NDArray[np.uint32]:
    return run.deskewed(frame).index
