"""Ground, votes and class of every point of a run (paper IV)."""

from __future__ import annotations

from bisect import bisect_right
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth.concurrency import Watch, unwatched
from docdepth.dynamics.classes import Labels
from docdepth.dynamics.scheduling import classify_sweeps
from docdepth.dynamics.sweep_classifier import Evidence, InputSweep
from docdepth.dynamics.tracking import Detections, TakeSweep, Tracking
from docdepth.dynamics.voting import Votes
from docdepth.errors import DamagedFileError
from docdepth.geometry.track import Track
from docdepth.geometry.trajectory import Trajectory
from docdepth.ground.growing import chunk_progress, chunks, label_chunk
from docdepth.io.run_folder import RunFolder, stage_key
from docdepth.io.tracks import TRACKS, write_tracks
from docdepth.pipeline.array_files import Offsets, array_offsets, read_arrays, write_arrays
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
from docdepth.pipeline.kept_tracks import keep_tracking, kept_tracking
from docdepth.pipeline.sanity import count_classes, warn_of_classes
from docdepth.pipeline.stage import Profile, Progress, progress_callback, stage

_EVIDENCE = "evidence"
"""Folder in the notes of a run with what an interrupted stage goes on with."""

_OF_EVIDENCE, _OF_DETECTIONS = 4, 6
"""Arrays of a file of evidence."""

_HELD_DETECTIONS = 64
"""Sweeps whose detections stay in memory: half a megabyte each by a LiDAR of 64 beams."""


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


class _GroundLabels:
    """Ground labels of all frames, in a file for each chunk of the drive."""

    def __init__(self) -> None:
        self._files: list[Path] = []
        self._first: list[int] = []
        self._offsets: list[Offsets] = []

    def add(self, file: Path, first: int) -> None:
        """The labels of the frames from ``first`` on."""
        self._files.append(file)
        self._first.append(first)
        self._offsets.append(array_offsets(file))

    def read(self, index: int) -> NDArray[np.uint8]:
        """Of a frame, as packed bits."""
        chunk = bisect_right(self._first, index) - 1
        file, offsets = self._files[chunk], self._offsets[chunk]
        place = index - self._first[chunk]
        if place >= len(offsets):
            raise DamagedFileError(file, f"it has labels of {len(offsets)} frames")
        packed: NDArray[np.uint8] = read_arrays(file, 1, offset=int(offsets[place]))[0]
        return packed


def _grow_ground(
    run: RunFolder,
    trajectory: Trajectory,
    key: dict[str, str],
    profile: Profile,
    threads: int,
    progress: Progress | None,
) -> _GroundLabels:
    """Ground labels of every frame; those of each chunk are kept in a file."""
    p, watch = run.parameters.ground, profile.watch

    def read(index: int) -> NDArray[np.float32]:
        with watch("read"):
            return run.points(index)

    ground = _GroundLabels()
    for chunk in chunks(trajectory, p):
        kept = run.notes / GROUND / f"chunk_{chunk.frames[0]:06d}.npy"
        if run.key(kept) != key:
            done = partial(chunk_progress, progress, chunk, len(trajectory))
            labels = label_chunk(chunk, read, trajectory, p, threads, done, watch)
            write_arrays(run, kept, key, map(np.packbits, labels))
        ground.add(kept, chunk.frames[0])
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
    ground : _GroundLabels
        Set before frames are read.
    watch : callable
    counts : list of tuple of int
        Points of each sweep that was written, by class.
    """

    def __init__(self, run: RunFolder, key: dict[str, str], trajectory: Trajectory) -> None:
        self._run, self._key, self._trajectory = run, key, trajectory
        self._labels = label_files(run)
        self._detections: OrderedDict[int, Detections] = OrderedDict()
        self._keeping = Lock()
        self.ground = _GroundLabels()
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
        return kept_tracking(self._tracks, len(self._trajectory))

    def keep_tracks(self, find: Callable[[TakeSweep], list[Track]]) -> Tracking:
        found = keep_tracking(self._run, self._tracks, self._key, find)
        self._detections.clear()
        return found

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
            ground = np.unpackbits(self.ground.read(index), count=len(record.points))
        return InputSweep(
            record.points,
            ground.view(np.bool_),
            self._run.sensor_rig(record),
            record.time_offset,
            record,
        )

    def keep(self, index: int, evidence: Evidence, detections: Detections) -> None:
        self._hold(index, detections)
        labels, objects = evidence
        arrays: list[NDArray[Any]] = [objects, labels.votes.static, labels.votes.dynamic]
        arrays += [labels.classid, *detections.arrays]
        with self.watch("write"):
            write_arrays(self._run, self._kept(index), self._key, arrays)

    def evidence(self, index: int) -> Evidence:
        with self.watch("read"):
            objects, static, dynamic, classid = read_arrays(self._kept(index), _OF_EVIDENCE)
        return Evidence(Labels(classid, Votes(static, dynamic)), objects)

    def detections(self, index: int) -> Detections:
        with self._keeping:
            held = self._detections.get(index)
        if held is None:
            with self.watch("read"):
                arrays = read_arrays(self._kept(index), _OF_DETECTIONS, skipped=_OF_EVIDENCE)
                held = Detections.of(arrays)
            self._hold(index, held)
        return held

    def _hold(self, index: int, detections: Detections) -> None:
        """Keep those of the last sweeps, which tracks ask for several times."""
        with self._keeping:
            self._detections[index] = detections
            if len(self._detections) > _HELD_DETECTIONS:
                self._detections.popitem(last=False)

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
