"""Ground, votes and class of every point of a run (paper IV)."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from docdepth.concurrency import Progress, Timer, null_progress
from docdepth.config import DynamicsParameters
from docdepth.diagnostics.results import check_classes
from docdepth.dynamics.sweep_classifier import SweepClassifier
from docdepth.errors import RunError
from docdepth.geometry.trajectory import Trajectory
from docdepth.ground.growing import Chunk, chunks, label_chunk
from docdepth.io.run_folder import RunFolder, stage_key
from docdepth.pipeline.given_labels import take_labels
from docdepth.pipeline.parallel import ChunkContext, WorkerPool
from docdepth.pipeline.plan import classify_stage
from docdepth.pipeline.resources import parameters_within_budget
from docdepth.pipeline.stage import Stage, remove_others
from docdepth.pipeline.stored_arrays import write_arrays
from docdepth.pipeline.sweep_store import EVIDENCE, GROUND, TRACKING, FrameStore, ground_file


def run_classify(
    run: RunFolder,
    threads: int = 0,
    progress: Progress | None = None,
    workers: WorkerPool | None = None,
    stage: Stage | None = None,
) -> None:
    """Write the class, votes and track of every point: ``classes/``, ``labels/``, ``tracks.csv``.

    Parameters
    ----------
    run : RunFolder
        Its odometry is done.
    threads : int
        0 for all cores.
    progress : callable, optional
        Called with the step (``ground``, ``classify``, ``track``), the frames done and their
        number.
    workers : WorkerPool, optional
        Who does the work; this process with its threads if absent.
    stage : Stage, optional
        :func:`~.plan.classify_stage` of the run.

    Raises
    ------
    RunError
        A file of the run is damaged.
    """
    if run.manifest.inputs is not None and run.manifest.inputs.labels is not None:
        return take_labels(run, progress, stage)
    p, workers = run.parameters, workers or WorkerPool(threads)
    with run.lock("classify"):
        stage, trajectory = stage or classify_stage(run), run.trajectory()
        of_ground = parameters_within_budget(run).ground.model_dump()
        ground_key = {
            "ground": stage_key(stage.inputs["version"], stage.inputs["odometry"], of_ground)
        }
        key, store = stage.made_of, FrameStore(run, stage.made_of, trajectory, stage=stage)
        if all(store.is_done(i) for i in range(len(trajectory))) and store.has_tracks():
            return
        with stage.working() as profile:
            store.timer = timer = profile.timer
            _grow_ground(run, trajectory, ground_key, timer, workers, progress)
            profile.frames = _classify(store, trajectory, p.dynamics, timer, workers, progress)
            store.write_tracks()
            profile.add(check_classes(store.counts))
            run.remove_tree(run.state_dir / EVIDENCE)
            remove_others(run, run.state_dir / GROUND, ground_key)
            remove_others(run, run.state_dir / TRACKING, key)
            stage.remove_outdated()


def _classify(
    store: FrameStore,
    trajectory: Trajectory,
    parameters: DynamicsParameters,
    timer: Timer,
    workers: WorkerPool,
    progress: Progress | None,
) -> int:
    """Classify the sweeps that are not classified yet; how many these were."""
    report, every = progress or null_progress, range(len(trajectory))
    left = [i for i in every if not store.is_done(i)]
    if not left:
        return 0
    by_tracks, known = parameters.evidence == "tracks", store.tracked() is not None
    # Tracks are made of the evidence of all sweeps. Where they are known, few sweeps are missing.
    needed = every if by_tracks and not known else left
    without = [i for i in needed if not (by_tracks and store.has_evidence(i))]
    kept = len(every) - len(without)
    report("classify", kept, len(every))

    def map_chunks(step: _Step, sweeps: list[int], done: Callable[[int], None]) -> None:
        chunks = workers.cut(sweeps, trajectory.arc_length[sweeps])
        on_chunk = partial(_classify_chunk, step, store.key)
        for _, counts in workers.map_frames(store.run, on_chunk, chunks, timer, done):
            store.counts += counts

    map_chunks("votes", without, lambda done: report("classify", kept + done, len(every)))
    if by_tracks:
        if not known:
            classifier = SweepClassifier(trajectory, parameters, timer)
            store.store_tracks(
                lambda take: classifier.track(
                    store.detections,
                    take,
                    lambda done: report("track", done, len(every)),
                    workers.threads,
                )
            )
        map_chunks("tracks", left, lambda done: None)
    return len(left)


def _grow_ground(
    run: RunFolder,
    trajectory: Trajectory,
    key: dict[str, str],
    timer: Timer,
    workers: WorkerPool,
    progress: Progress | None,
) -> None:
    """Ground labels of every frame; those of each chunk are kept in a file."""
    report, total = progress or null_progress, len(trajectory)
    found = chunks(trajectory, parameters_within_budget(run).ground)
    left = [chunk for chunk in found if run.key(ground_file(run, chunk)) != key]
    kept = total - sum(map(_sweep_count, left))

    def done_of_left(done: int) -> None:
        report("ground", kept + done, total)

    work = partial(_label_ground, key)
    for _ in workers.map_frames(run, work, left, timer, done_of_left, _sweep_count):
        pass
    report("ground", total, total)


def _label_ground(key: dict[str, str], context: ChunkContext, chunk: Chunk) -> None:
    """Write the ground labels of a chunk."""
    run, timer = context.run, context.timer

    def read(index: int) -> NDArray[np.float32]:
        with timer("read"):
            return run.points(index)

    def done(share: float) -> None:
        context.progress(int(share * _sweep_count(chunk)))

    trajectory, p = run.trajectory(), parameters_within_budget(run).ground
    labels = label_chunk(chunk, read, trajectory, p, context.threads, done, timer)
    write_arrays(run, ground_file(run, chunk), key, map(np.packbits, labels))


def _sweep_count(chunk: Chunk) -> int:
    return len(chunk.sweeps)


_Step: TypeAlias = Literal["votes", "tracks"]
"""Of classification; what tracks find is known when all sweeps have voted."""


def _classify_chunk(
    step: _Step, key: dict[str, str], context: ChunkContext, sweeps: list[int]
) -> NDArray[np.int64]:
    """Do a step on some sweeps; the counts of those that were written."""
    run, timer = context.run, context.timer
    trajectory = run.trajectory()
    store = FrameStore(run, key, trajectory, timer)
    classifier = SweepClassifier(trajectory, run.parameters.dynamics, timer)
    if step == "votes":
        classifier.vote_on(store, sweeps, context.progress, context.threads)
        return store.counts
    tracked = store.tracked()
    if tracked is None:
        raise RunError("there are no tracks to add; run the same command again")
    classifier.label_by_tracks(store, tracked, sweeps, context.progress)
    return store.counts
