"""Ground, votes and class of every point of a run (paper IV)."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from docdepth.concurrency import Watch, unwatched
from docdepth.dynamics.classes import Labels
from docdepth.dynamics.scheduling import classify_sweeps
from docdepth.dynamics.sweep_classifier import Evidence, InputSweep
from docdepth.dynamics.tracking import Detections, Tracking, packed, unpacked
from docdepth.dynamics.voting import Votes
from docdepth.errors import DamagedFileError, InputError
from docdepth.geometry.trajectory import Trajectory
from docdepth.ground.growing import chunk_progress, chunks, label_chunk
from docdepth.io.arrays import ArrayError, read_next_array
from docdepth.io.run_folder import RunFolder, stage_key
from docdepth.io.tracks import TRACKS, write_tracks
from docdepth.pipeline.classified_files import (
    GROUND,
    TRACKING,
    is_classified,
    remove_outdated,
    write_classified,
)
from docdepth.pipeline.given_labels import take_labels
from docdepth.pipeline.graph import classify_parts, label_files
from docdepth.pipeline.input_files import InputFiles
from docdepth.pipeline.sanity import count_classes, warn_of_classes
from docdepth.pipeline.stage import Profile, Progress, progress_callback, stage

_EVIDENCE = "evidence"
"""Folder in the notes of a run with what an interrupted stage goes on with."""


def run_classify(run: RunFolder, threads: int = 0, progress: Progress | None = None) -> None:
    """Write ground, votes, class and track of every point into ``frames/``, ``labels/`` and tracks.

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
        A file of the run is damaged.
    """
    if run.manifest["source"].get("labels"):
        return take_labels(run, progress)
    p = run.parameters
    with run.lock("classify"):
        trajectory = run.trajectory()
        parts = classify_parts(run, run.stage("odometry").get("key"), InputFiles(run))
        made_of = parts["odometry"], p.ground.model_dump()
        key = {"classify": stage_key(parts)}
        store = _FrameStore(run, key, trajectory)
        if all(store.is_done(i) for i in range(len(trajectory))) and store.has_tracks():
            return
        with stage(run, "classify", parts, len(trajectory)) as profile:
            store.watch = profile.watch
            ground_key = {"ground": stage_key(*made_of)}
            store.ground = _grow_ground(run, trajectory, ground_key, profile, threads, progress)
            told = progress_callback(progress, "classify")
            profile.frames = classify_sweeps(
                store, trajectory, p.dynamics, told, threads, profile.watch
            )
            store.write_tracks()
            warn_of_classes(store.counts)
            run.remove_tree(run.notes / _EVIDENCE)
            remove_outdated(run, ground_key, key)


def _grow_ground(
    run: RunFolder,
    trajectory: Trajectory,
    key: dict[str, str],
    profile: Profile,
    threads: int,
    progress: Progress | None,
) -> list[NDArray[np.uint8]]:
    """Ground labels of every frame as packed bits; each chunk is kept in a file."""
    p, watch = run.parameters.ground, profile.watch

    def read(index: int) -> NDArray[np.float32]:
        with watch("read"):
            return run.points(index)

    ground: list[NDArray[np.uint8]] = []
    for chunk in chunks(trajectory, p):
        kept = run.notes / GROUND / f"chunk_{chunk.frames[0]:06d}.npy"
        if run.key(kept) != key:
            done = partial(chunk_progress, progress, chunk, len(trajectory))
            labels = label_chunk(chunk, read, trajectory, p, threads, done, watch)
            _write_arrays(run, kept, key, *[np.packbits(flags) for flags in labels])
        ground += _read_arrays(kept, len(chunk.frames))
    progress_callback(progress, "ground")(len(trajectory), len(trajectory))
    return ground


class _FrameStore:
    """The frames of a run as a :class:`docdepth.dynamics.scheduling.SweepStore`.

    Parameters
    ----------
    key : dict
        What classes are made of.
    trajectory : Trajectory

    Attributes
    ----------
    ground : list of ndarray of uint8
        Ground labels of each frame as packed bits; set before frames are read.
    watch : callable
    counts : list of tuple of int
        Points of each sweep that was written, by class.
    """

    def __init__(self, run: RunFolder, key: dict[str, str], trajectory: Trajectory) -> None:
        self._run, self._key, self._trajectory = run, key, trajectory
        self._labels = label_files(run)
        # Only those that were made by an earlier run are read from their files.
        self._detections: dict[int, Detections] = {}
        self.ground: list[NDArray[np.uint8]] = []
        self.watch: Watch = unwatched
        self.counts: list[tuple[int, int, int]] = []

    @property
    def _tracks(self) -> Path:
        return self._run.notes / TRACKING / "tracks.npy"

    def _kept(self, index: int) -> Path:
        return self._run.notes / _EVIDENCE / self._key["classify"] / f"{index:06d}.npy"

    def is_done(self, index: int) -> bool:
        if not self.has_tracks() and self._run.key(self._tracks) != self._key:
            return False  # tracks are made of all sweeps
        return is_classified(self._run, index, self._labels.get(index), self._key)

    def tracks(self) -> Tracking | None:
        if self._run.key(self._tracks) != self._key:
            return None
        arrays = _read_arrays(self._tracks, None)
        try:
            return unpacked(arrays, len(self._trajectory))
        except (InputError, ValueError) as error:
            raise DamagedFileError(self._tracks, str(error)) from None

    def keep_tracks(self, found: Tracking) -> None:
        _write_arrays(self._run, self._tracks, self._key, *packed(found))

    def has_tracks(self) -> bool:
        """Whether the file of tracks is there, where there should be one."""
        wanted = self._run.parameters.dynamics.evidence == "tracks"
        return not wanted or self._run.key(self._run.path / TRACKS) == self._key

    def write_tracks(self) -> None:
        """Write the file of tracks, if it is not there."""
        found = None if self.has_tracks() else self.tracks()
        if found is not None:
            write = self._run.writer(self._key)
            write_tracks(self._run.path / TRACKS, found.tracks, self._trajectory.times, write)

    def has_evidence(self, index: int) -> bool:
        return self._run.key(self._kept(index)) == self._key

    def read(self, index: int) -> InputSweep:
        with self.watch("read"):
            record = self._run.frame(index)
            ground = np.unpackbits(self.ground[index], count=len(record.points))
        return InputSweep(
            record.points,
            ground.view(np.bool_),
            self._run.sensor_rig(record),
            record.time_offset,
            record,
        )

    def keep(self, index: int, evidence: Evidence, detections: Detections) -> None:
        self._detections[index] = detections
        labels, objects = evidence
        arrays: list[NDArray[Any]] = [objects, labels.votes.static, labels.votes.dynamic]
        arrays += [labels.classid, *detections.arrays]
        with self.watch("write"):
            _write_arrays(self._run, self._kept(index), self._key, *arrays)

    def evidence(self, index: int) -> Evidence:
        with self.watch("read"):
            objects, static, dynamic, classid = _read_arrays(self._kept(index), 4)
        return Evidence(Labels(classid, Votes(static, dynamic)), objects)

    def detections(self, index: int) -> Detections:
        if index in self._detections:
            return self._detections[index]
        with self.watch("read"):
            return Detections.of(_read_arrays(self._kept(index), 10)[4:])

    def write(self, index: int, sweep: InputSweep, labels: Labels) -> None:
        self.counts.append(count_classes(labels.classid))
        with self.watch("write"):
            classified = replace(
                sweep.record,
                votes_static=labels.votes.static,
                votes_dynamic=labels.votes.dynamic,
                classid=labels.classid,
                instance=labels.instance,
            )
            write_classified(self._run, index, classified, self._key)


def _write_arrays(run: RunFolder, path: Path, key: dict[str, str], *arrays: NDArray[Any]) -> None:
    """Write arrays into one file, one after the other."""

    def write(out: BinaryIO) -> None:
        for array in arrays:
            np.save(out, array)

    run.write(path, write, key, sync=False)


def _read_arrays(path: Path, count: int | None) -> list[NDArray[Any]]:
    """Read the first arrays of a file; None reads all."""
    try:
        with path.open("rb") as stream:
            size, arrays = path.stat().st_size, list[NDArray[Any]]()
            while stream.tell() < size if count is None else len(arrays) < count:
                arrays.append(read_next_array(stream, size - stream.tell()))
            return arrays
    except (OSError, ArrayError) as error:
        raise DamagedFileError(path, str(error)) from None
