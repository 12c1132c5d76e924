"""Ground, votes and class of every point of a run (paper IV)."""

from __future__ import annotations

import shutil
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from docdepth.dynamics.classifier import classify_sweeps
from docdepth.dynamics.sweep_classifier import Evidence, InputSweep, Labels
from docdepth.dynamics.tracking import Detections
from docdepth.dynamics.voting import Votes
from docdepth.errors import RunError
from docdepth.geometry.points import DYNAMIC, MOVING_LABEL, OUTLIER_LABEL, STATIC_LABEL
from docdepth.geometry.trajectory import Trajectory
from docdepth.ground.growing import chunk_progress, chunks, label_chunk
from docdepth.io.atomic import write_atomically
from docdepth.io.frames import FrameRecord
from docdepth.io.run_folder import RunFolder, stage_key
from docdepth.pipeline.stage import (
    Progress,
    Stopwatch,
    finish_stage,
    progress_callback,
    stage_is_done,
)

_GROUND, _EVIDENCE = ".ground", ".objects"
"""Folders of a run with what an interrupted stage goes on with."""


def run_classify(run: RunFolder, threads: int = 0, progress: Progress | None = None) -> None:
    """Write ground, votes and class of every point into ``frames/``, and ``labels/``.

    Votes in ``frames/`` are kept when only parameters have changed that make classes of them.

    Parameters
    ----------
    run : RunFolder
        Its odometry is done.
    threads : int
        0 for all cores.
    progress : callable, optional
        Called with the step (``ground``, ``classify``), the frames done and their number.

    Raises
    ------
    RunError
        A file of an interrupted run is damaged.
    """
    p, trajectory = run.parameters, run.trajectory()
    made_of = run.stage("odometry").get("key"), p.ground.model_dump()
    keys = {
        "votes": stage_key(*made_of, p.dynamics.voting()),
        "classify": stage_key(*made_of, p.dynamics.model_dump()),
    }
    if stage_is_done(run, "classify", keys["classify"]):
        return
    watch = Stopwatch()
    run.set_stage("classify", state="running", key=keys["classify"])
    ground = _grow_ground(run, trajectory, watch, threads, progress)
    store = _FrameStore(run, ground, keys, p.dynamics.evidence == "tracks", watch)
    told = progress_callback(progress, "classify")
    left = classify_sweeps(store, trajectory, p.dynamics, told, threads, watch)
    for folder in (_GROUND, _EVIDENCE):
        shutil.rmtree(run.path / folder, ignore_errors=True)
    finish_stage(run, "classify", watch, left)


def _grow_ground(
    run: RunFolder,
    trajectory: Trajectory,
    watch: Stopwatch,
    threads: int,
    progress: Progress | None,
) -> list[NDArray[np.uint8]]:
    """Ground labels of every frame as packed bits; each chunk is kept in a file."""
    p = run.parameters.ground
    key = stage_key(run.stage("odometry").get("key"), p.model_dump())

    def read(index: int) -> NDArray[np.float32]:
        with watch("read"):
            return run.points(index)

    ground: list[NDArray[np.uint8]] = []
    for chunk in chunks(trajectory, p):
        kept = run.path / _GROUND / f"{key}_{chunk.frames[0]:06d}.npy"
        if not kept.is_file():
            done = partial(chunk_progress, progress, chunk, len(trajectory))
            labels = label_chunk(chunk, read, trajectory, p, threads, done, watch)
            _write_arrays(kept, *[np.packbits(flags) for flags in labels])
        ground += _read_arrays(kept, len(chunk.frames))
    progress_callback(progress, "ground")(len(trajectory), len(trajectory))
    return ground


class _FrameStore:
    """The frames of a run as a :class:`docdepth.dynamics.classifier.SweepStore`.

    Parameters
    ----------
    ground : list of ndarray of uint8
        Ground labels of each frame as packed bits.
    keys : dict
        What votes and classes are made of.
    uses_tracks : bool
        Evidence is kept until tracks are known, a file a frame.
    """

    def __init__(
        self,
        run: RunFolder,
        ground: list[NDArray[np.uint8]],
        keys: dict[str, str],
        uses_tracks: bool,
        watch: Stopwatch,
    ) -> None:
        self._run, self._ground, self._keys, self._watch = run, ground, keys, watch
        self._uses_tracks = uses_tracks
        # Only those that were made by an earlier run are read from their files.
        self._detections: dict[int, Detections] = {}

    def _kept(self, index: int) -> Path:
        return self._run.path / _EVIDENCE / self._keys["classify"] / f"{index:06d}.npy"

    def is_classified(self, index: int) -> bool:
        if self._uses_tracks:
            return self._kept(index).is_file()
        return self._run.frame_key(index).get("classify") == self._keys["classify"]

    def has_votes(self, index: int) -> bool:
        return self._run.frame_key(index).get("votes") == self._keys["votes"]

    def read(self, index: int) -> InputSweep:
        with self._watch("read"):
            record = self._run.frame(index)
            ground = np.unpackbits(self._ground[index], count=len(record.points))
        static, dynamic = record.votes_static, record.votes_dynamic
        return InputSweep(
            record.points,
            ground.view(np.bool_),
            self._run.sensor_rig(record),
            None if static is None or dynamic is None else Votes(static, dynamic),
            record,
        )

    def keep(self, index: int, evidence: Evidence, detections: Detections) -> None:
        self._detections[index] = detections
        labels, objects = evidence
        arrays: list[NDArray[Any]] = [objects, labels.votes.static, labels.votes.dynamic]
        arrays += [labels.classid, *detections.arrays]
        with self._watch("write"):
            _write_arrays(self._kept(index), *arrays)

    def evidence(self, index: int) -> Evidence:
        with self._watch("read"):
            objects, static, dynamic, classid = _read_arrays(self._kept(index), 4)
        return Evidence(Labels(classid, Votes(static, dynamic)), objects)

    def detections(self, index: int) -> Detections:
        if index in self._detections:
            return self._detections[index]
        with self._watch("read"):
            return Detections.of(_read_arrays(self._kept(index), 7)[4:])

    def write(self, index: int, sweep: InputSweep, labels: Labels) -> None:
        with self._watch("write"):
            _write_classified(self._run, index, sweep.record, self._keys, labels)


def _write_arrays(path: Path, *arrays: NDArray[Any]) -> None:
    """Write arrays into one file, one after the other."""

    def write(out: BinaryIO) -> None:
        for array in arrays:
            np.save(out, array)

    write_atomically(path, write, sync=False)


def _read_arrays(path: Path, count: int) -> list[NDArray[Any]]:
    """Read the first arrays of a file."""
    try:
        with path.open("rb") as stream:
            return [np.load(stream) for _ in range(count)]
    except (EOFError, ValueError) as error:
        raise RunError(f"{path} is damaged ({error}); delete it and run the stage again") from None


def _write_classified(
    run: RunFolder, index: int, record: FrameRecord, keys: dict[str, str], labels: Labels
) -> None:
    """Write labels of all rows of the input, and the frame with votes and classes."""
    rows = np.full(record.input_points, OUTLIER_LABEL, np.uint32)
    rows[record.index] = np.where(labels.classid >= DYNAMIC, MOVING_LABEL, STATIC_LABEL)
    path = run.path / "labels" / f"{record.name}.label"
    write_atomically(path, lambda stream: stream.write(rows.tobytes()))
    # Last, because its key says that this frame is done.
    classified = replace(
        record,
        key={**record.key, **keys},
        votes_static=labels.votes.static,
        votes_dynamic=labels.votes.dynamic,
        classid=labels.classid,
    )
    run.write_frame(index, classified)
