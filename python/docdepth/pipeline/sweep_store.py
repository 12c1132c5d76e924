"""The frames and classes of a run as the store that classification works on."""

from __future__ import annotations

from bisect import bisect_right
from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

import docdepth._core as _core
from docdepth.concurrency import Timer
from docdepth.diagnostics.results import count_classes
from docdepth.dynamics.classes import Labels
from docdepth.dynamics.sweep_classifier import Evidence
from docdepth.dynamics.tracking import TakeSweep, TrackedSweep
from docdepth.dynamics.voting import Votes
from docdepth.errors import DamagedFileError
from docdepth.geometry.lidar_frame import LidarFrame
from docdepth.geometry.track import Track
from docdepth.geometry.trajectory import Trajectory
from docdepth.ground.growing import Chunk, chunks
from docdepth.io.labels import write_labels
from docdepth.io.run_folder import RunFolder
from docdepth.io.tracks import TRACKS, write_tracks
from docdepth.pipeline.resources import parameters_within_budget
from docdepth.pipeline.stage import Stage
from docdepth.pipeline.stored_arrays import (
    Offsets,
    are_stored,
    array_offsets,
    read_arrays,
    store_tracks,
    stored_sweeps,
    stored_tracks,
    write_arrays,
)

EVIDENCE = "evidence"
"""Folder in the state of a run with what an interrupted stage goes on with."""

GROUND, TRACKING = "ground", "tracks"
"""Folders in the state of a run. With them, single frames are classified again."""

_OF_EVIDENCE, _OF_DETECTIONS = 5, 3
"""Arrays of a file of evidence."""

_HELD_DETECTIONS = 64
"""Sweeps whose detections stay in memory: half a megabyte each by a LiDAR of 64 beams."""


def write_classified(
    run: RunFolder, index: int, frame: LidarFrame, made_of: dict[str, str]
) -> None:
    """Write the classes of a frame, and labels of all rows of its input."""
    key = {**made_of, "frame": str(index)}
    labels, classes = run.path / "labels" / f"{frame.name}.label", run.classes_path(index)
    if run.key(labels) != key:
        write_labels(labels, frame, run.writer(key))
    if run.key(classes) != key:
        run.write_classes(index, frame, key)


def ground_file(run: RunFolder, chunk: Chunk) -> Path:
    """Where the ground labels of a chunk of the drive are kept."""
    return run.state_dir / GROUND / f"chunk_{chunk.sweeps[0]:06d}.npy"


class _GroundLabels:
    """Ground labels of all frames, in a file for each chunk of the drive."""

    def __init__(self, run: RunFolder, trajectory: Trajectory) -> None:
        found = chunks(trajectory, parameters_within_budget(run).ground)
        self._first = [chunk.sweeps[0] for chunk in found]
        self._files = [ground_file(run, chunk) for chunk in found]
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


class FrameStore:
    """The frames of a run as a :class:`docdepth.dynamics.sweep_classifier.SweepStore`.

    Parameters
    ----------
    key : dict
        What classes are made of.
    trajectory : Trajectory
    timer : Timer, optional
    stage : Stage, optional
        Tells which sweeps are classified. A worker has none: it does all that it is given.

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
        stage: Stage | None = None,
    ) -> None:
        self.run, self.key, self._trajectory, self._stage = run, key, trajectory, stage
        self._detections: OrderedDict[int, _core.Detections] = OrderedDict()
        self._keeping = Lock()
        self._ground = _GroundLabels(run, trajectory)
        self.timer = timer or Timer()
        self.counts = np.zeros(3, np.int64)

    @property
    def _tracking(self) -> Path:
        return self.run.state_dir / TRACKING

    def _evidence_file(self, index: int) -> Path:
        return self.run.state_dir / EVIDENCE / self.key["classify"] / f"{index:06d}.npy"

    def is_done(self, index: int) -> bool:
        if not self.has_tracks() and not are_stored(self.run, self._tracking, self.key):
            return False  # tracks are made of all sweeps
        return self._stage is not None and self._stage.is_made(index)

    def tracked(self) -> Sequence[TrackedSweep] | None:
        if not are_stored(self.run, self._tracking, self.key):
            return None
        return stored_sweeps(self._tracking, len(self._trajectory))

    def store_tracks(self, find: Callable[[TakeSweep], list[Track]]) -> None:
        store_tracks(self.run, self._tracking, self.key, find)
        self._detections.clear()

    def has_tracks(self) -> bool:
        """Whether the file of tracks is there, where there should be one."""
        wanted = self.run.parameters.dynamics.evidence == "tracks"
        return not wanted or self.run.key(self.run.path / TRACKS) == self.key

    def write_tracks(self) -> None:
        """Write the file of tracks, if it is not there."""
        if self.has_tracks() or not are_stored(self.run, self._tracking, self.key):
            return
        found, write = stored_tracks(self._tracking), self.run.writer(self.key)
        write_tracks(self.run.path / TRACKS, found, self._trajectory.times, write)

    def has_evidence(self, index: int) -> bool:
        return self.run.key(self._evidence_file(index)) == self.key

    def read(self, index: int) -> LidarFrame:
        with self.timer("read"):
            frame = self.run.deskewed(index)
            ground = np.unpackbits(self._ground.read(index), count=len(frame)).view(np.bool_)
        return frame.with_ground(ground)

    def store_evidence(self, index: int, evidence: Evidence, detections: _core.Detections) -> None:
        self._hold(index, detections)
        labels, objects, occupied_once = evidence
        arrays: list[NDArray[Any]] = [objects, labels.votes.static, labels.votes.dynamic]
        arrays += [labels.classid, np.packbits(occupied_once), *detections.arrays]
        with self.timer("write"):
            write_arrays(self.run, self._evidence_file(index), self.key, arrays)

    def evidence(self, index: int) -> Evidence:
        with self.timer("read"):
            objects, static, dynamic, classid, packed = read_arrays(
                self._evidence_file(index), _OF_EVIDENCE
            )
        once = np.unpackbits(packed, count=len(objects)).view(np.bool_)
        return Evidence(Labels(classid, Votes(static, dynamic)), objects, once)

    def detections(self, index: int) -> _core.Detections:
        with self._keeping:
            held = self._detections.get(index)
        if held is None:
            with self.timer("read"):
                arrays = read_arrays(
                    self._evidence_file(index), _OF_DETECTIONS, skipped=_OF_EVIDENCE
                )
                held = _core.Detections.of(*arrays)
            self._hold(index, held)
        return held

    def _hold(self, index: int, detections: _core.Detections) -> None:
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
            write_classified(self.run, index, classified, self.key)
