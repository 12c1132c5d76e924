"""Ground, votes and class of every point of a run (paper IV)."""

from __future__ import annotations

from bisect import bisect_right
from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property, partial
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth.concurrency import Progress, Timer, null_progress
from docdepth.diagnostics.results import check_classes, count_classes
from docdepth.dynamics.classes import Labels
from docdepth.dynamics.scheduling import SweepWork, classify_sweeps
from docdepth.dynamics.sweep_classifier import Evidence, SweepClassifier
from docdepth.dynamics.tracking import Detections, TakeSweep, TrackedSweep
from docdepth.dynamics.voting import Votes
from docdepth.errors import DamagedFileError
from docdepth.geometry.lidar_frame import LidarFrame
from docdepth.geometry.track import Track
from docdepth.geometry.trajectory import Trajectory
from docdepth.ground.growing import Chunk, chunks, label_chunk
from docdepth.io.run_folder import RunFolder, stage_key
from docdepth.io.tracks import TRACKS, write_tracks
from docdepth.pipeline.array_files import Offsets, array_offsets, read_arrays, write_arrays
from docdepth.pipeline.classified_files import (
    GROUND_FOLDER,
    TRACKING,
    is_classified,
    remove_outdated,
    write_classified,
)
from docdepth.pipeline.given_labels import take_labels
from docdepth.pipeline.graph import classify_parts, label_files
from docdepth.pipeline.input_files import InputFiles
from docdepth.pipeline.memory import parameters_within_budget
from docdepth.pipeline.parallel import ChunkContext, WorkerPool
from docdepth.pipeline.stage import stage
from docdepth.pipeline.stored_tracks import are_stored, store_tracks, stored_sweeps, stored_tracks

_EVIDENCE = "evidence"
"""Folder in the notes of a run with what an interrupted stage goes on with."""

_OF_EVIDENCE, _OF_DETECTIONS = 4, 3
"""Arrays of a file of evidence."""

_HELD_DETECTIONS = 64
"""Sweeps whose detections stay in memory: half a megabyte each by a LiDAR of 64 beams."""


def run_classify(
    run: RunFolder,
    threads: int = 0,
    progress: Progress | None = None,
    workers: WorkerPool | None = None,
) -> None:
    """Write ground, votes, class and track of every point into ``frames/``, ``labels/`` and tracks.

    Parameters
    ----------
    run : RunFolder
        Its odometry is done.
    threads : int
        0 for all cores.
    progress : callable, optional
        Called with the step (``ground``, ``classify``), the frames done and their number.
    workers : WorkerPool, optional
        Who does the work; this process with its threads if absent.

    Raises
    ------
    RunError
        A file of the run is damaged.
    """
    if run.manifest.inputs is not None and run.manifest.inputs.labels is not None:
        return take_labels(run, progress)
    p, workers = run.parameters, workers or WorkerPool(threads)
    with run.lock("classify"):
        trajectory = run.trajectory()
        parts = classify_parts(run, run.stage("odometry").key, InputFiles(run))
        of_ground = parameters_within_budget(run).ground.model_dump()
        made_of = parts["version"], parts["odometry"], of_ground
        key = {"classify": stage_key(parts)}
        store = _FrameStore(run, key, trajectory)
        if all(store.is_done(i) for i in range(len(trajectory))) and store.has_tracks():
            return
        with stage(run, "classify", parts, len(trajectory)) as profile:
            store.timer = timer = profile.timer
            ground_key = {"ground": stage_key(*made_of)}
            _grow_ground(run, trajectory, ground_key, timer, workers, progress)

            def map_chunks(
                work: SweepWork, sweeps: list[int], report: Callable[[int], None]
            ) -> None:
                chunks = workers.cut(sweeps, trajectory.arc_length[sweeps])
                on_chunk = partial(_classify_chunk, work, key)
                for _, counts in workers.map_frames(run, on_chunk, chunks, timer, report):
                    store.counts += counts

            profile.frames = classify_sweeps(
                store, trajectory, p.dynamics, progress, threads, timer, map_chunks
            )
            store.write_tracks()
            profile.add(check_classes(store.counts))
            run.remove_tree(run.notes / _EVIDENCE)
            remove_outdated(run, ground_key, key)


class _GroundLabels:
    """Ground labels of all frames, in a file for each chunk of the drive."""

    def __init__(self, run: RunFolder, trajectory: Trajectory) -> None:
        found = chunks(trajectory, parameters_within_budget(run).ground)
        self._first = [chunk.sweeps[0] for chunk in found]
        self._files = [_ground_file(run, chunk) for chunk in found]
        self._offsets: dict[Path, Offsets] = {}

    def read(self, index: int) -> NDArray[np.uint8]:
        """Of a frame, as packed bits."""
        chunk = bisect_right(self._first, index) - 1
        file, place = self._files[chunk], index - self._first[chunk]
        if file not in self._offsets:
            self._offsets[file] = array_offsets(file)
        offsets = self._offsets[file]
        if place >= len(offsets):
            raise DamagedFileError(file, f"it has labels of {len(offsets)} frames")
        packed: NDArray[np.uint8] = read_arrays(file, 1, offset=int(offsets[place]))[0]
        return packed


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
    left = [chunk for chunk in found if run.key(_ground_file(run, chunk)) != key]
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
    write_arrays(run, _ground_file(run, chunk), key, map(np.packbits, labels))


def _sweep_count(chunk: Chunk) -> int:
    return len(chunk.sweeps)


def _ground_file(run: RunFolder, chunk: Chunk) -> Path:
    return run.notes / GROUND_FOLDER / f"chunk_{chunk.sweeps[0]:06d}.npy"


def _classify_chunk(
    work: SweepWork, key: dict[str, str], context: ChunkContext, sweeps: list[int]
) -> NDArray[np.int64]:
    """Do a step of classification on some sweeps; the counts of those that were written."""
    run, timer = context.run, context.timer
    trajectory = run.trajectory()
    store = _FrameStore(run, key, trajectory, timer)
    classifier = SweepClassifier(trajectory, run.parameters.dynamics, timer)
    work(classifier, store, sweeps, context.progress, context.threads)
    return store.counts


class _FrameStore:
    """The frames of a run as a :class:`docdepth.dynamics.scheduling.SweepStore`.

    Parameters
    ----------
    key : dict
        What classes are made of.
    trajectory : Trajectory
    timer : Timer, optional

    Attributes
    ----------
    counts : ndarray of int64, shape (3,)
        Points of the sweeps that were written, from
        :func:`docdepth.diagnostics.results.count_classes`.
    """

    def __init__(
        self,
        run: RunFolder,
        key: dict[str, str],
        trajectory: Trajectory,
        timer: Timer | None = None,
    ) -> None:
        self._run, self._key, self._trajectory = run, key, trajectory
        self._detections: OrderedDict[int, Detections] = OrderedDict()
        self._keeping = Lock()
        self._ground = _GroundLabels(run, trajectory)
        self.timer = timer or Timer()
        self.counts = np.zeros(3, np.int64)

    @cached_property
    def _labels(self) -> dict[int, Path]:
        return label_files(self._run)

    @property
    def _tracking(self) -> Path:
        return self._run.notes / TRACKING

    def _evidence_file(self, index: int) -> Path:
        return self._run.notes / _EVIDENCE / self._key["classify"] / f"{index:06d}.npy"

    def is_done(self, index: int) -> bool:
        if not self.has_tracks() and not are_stored(self._run, self._tracking, self._key):
            return False  # tracks are made of all sweeps
        return is_classified(self._run, index, self._labels.get(index), self._key)

    def tracked(self) -> Sequence[TrackedSweep] | None:
        if not are_stored(self._run, self._tracking, self._key):
            return None
        return stored_sweeps(self._tracking, len(self._trajectory))

    def store_tracks(self, find: Callable[[TakeSweep], list[Track]]) -> None:
        store_tracks(self._run, self._tracking, self._key, find)
        self._detections.clear()

    def has_tracks(self) -> bool:
        """Whether the file of tracks is there, where there should be one."""
        wanted = self._run.parameters.dynamics.evidence == "tracks"
        return not wanted or self._run.key(self._run.path / TRACKS) == self._key

    def write_tracks(self) -> None:
        """Write the file of tracks, if it is not there."""
        if self.has_tracks() or not are_stored(self._run, self._tracking, self._key):
            return
        found, write = stored_tracks(self._tracking), self._run.writer(self._key)
        write_tracks(self._run.path / TRACKS, found, self._trajectory.times, write)

    def has_evidence(self, index: int) -> bool:
        return self._run.key(self._evidence_file(index)) == self._key

    def read(self, index: int) -> LidarFrame:
        with self.timer("read"):
            frame = self._run.frame(index)
            ground = np.unpackbits(self._ground.read(index), count=len(frame)).view(np.bool_)
        return frame.with_ground(ground)

    def store_detections(self, index: int, evidence: Evidence, detections: Detections) -> None:
        self._hold(index, detections)
        labels, objects = evidence
        arrays: list[NDArray[Any]] = [objects, labels.votes.static, labels.votes.dynamic]
        arrays += [labels.classid, *detections.arrays]
        with self.timer("write"):
            write_arrays(self._run, self._evidence_file(index), self._key, arrays)

    def evidence(self, index: int) -> Evidence:
        with self.timer("read"):
            objects, static, dynamic, classid = read_arrays(
                self._evidence_file(index), _OF_EVIDENCE
            )
        return Evidence(Labels(classid, Votes(static, dynamic)), objects)

    def detections(self, index: int) -> Detections:
        with self._keeping:
            held = self._detections.get(index)
        if held is None:
            with self.timer("read"):
                arrays = read_arrays(
                    self._evidence_file(index), _OF_DETECTIONS, skipped=_OF_EVIDENCE
                )
                held = Detections.of(arrays)
            self._hold(index, held)
        return held

    def _hold(self, index: int, detections: Detections) -> None:
        """Keep those of the last sweeps, which tracks ask for several times."""
        with self._keeping:
            self._detections[index] = detections
            if len(self._detections) > _HELD_DETECTIONS:
                self._detections.popitem(last=False)

    def write(self, index: int, frame: LidarFrame, labels: Labels) -> None:
        counts = count_classes(labels.classid)
        with self._keeping:
            self.counts += counts
        with self.timer("write"):
            classified = replace(
                frame,
                votes_static=labels.votes.static,
                votes_dynamic=labels.votes.dynamic,
                classid=labels.classid,
                instance=labels.instance,
            )
            write_classified(self._run, index, classified, self._key)
