"""The frames and classes of a run as the store that classification works on."""

from __future__ import annotations

import itertools
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np

import docdepth._core as _core
from docdepth.concurrency import Timer
from docdepth.datasets.base import ReadSequence
from docdepth.dynamics.classes import Labels, count_classes
from docdepth.dynamics.sweep_classifier import Evidence
from docdepth.dynamics.tracking import TrackedSweep
from docdepth.dynamics.voting import Votes
from docdepth.errors import DamagedFileError, InputError
from docdepth.geometry.lidar_frame import LidarFrame
from docdepth.geometry.track import Track
from docdepth.io.frames import write_classes
from docdepth.io.labels import write_labels
from docdepth.io.run_folder import RunFolder
from docdepth.io.untrusted import read_kept_arrays

EVIDENCE, GROUND, TRACKING = "evidence", "ground", "tracks"
"""Folders in the state of a run with a file for each sweep: an interrupted stage goes on with them.
Ground and tracks stay when it is done, so that single frames are classified again."""

_OF_EVIDENCE = ("objects", "votes_static", "votes_dynamic", "classid", "porous")
_OF_DETECTIONS = ("rows", "samples", "borders")
"""Arrays of a file of evidence."""

_OF_TRACK = ("id", "kind", "size")
_OF_POSES = ("times", "poses", "velocities", "points", "deviations", "surface_deviations")
"""Arrays of the file of tracks: of each track, and of each of its poses."""

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
        write_classes(classes, frame, run.writer(key))


def sweep_file(run: RunFolder, kind: str, index: int) -> Path:
    """The arrays of a sweep in one of the folders above."""
    return run.state_dir / kind / f"{index:06d}.npz"


def write_arrays(
    run: RunFolder, path: Path, key: dict[str, str], arrays: Mapping[str, Any]
) -> None:
    """Write arrays that the same stage reads again."""
    run.write(path, lambda stream: np.savez(stream, **arrays), key, sync=False)


class TrackStore(ReadSequence[TrackedSweep]):
    """What tracks found in each sweep, and the tracks of the drive.

    Each sweep has its file: a drive may be too long to hold all of it. They stay when the stage is
    done, and with them single frames are classified again.
    """

    def __init__(self, run: RunFolder, key: dict[str, str], count: int) -> None:
        self._run, self._key, self._count = run, key, count
        self._paths, self._numbers = run.state_dir / TRACKING / "paths.npz", itertools.count()

    def __len__(self) -> int:
        return self._count

    def read(self, index: int) -> TrackedSweep:
        """What tracks found in sweep ``index``."""
        path = sweep_file(self._run, TRACKING, index)
        return TrackedSweep(*read_kept_arrays(path, *TrackedSweep._fields))

    def is_whole(self) -> bool:
        """Whether all files are whole and made of the key."""
        files = (sweep_file(self._run, TRACKING, k) for k in range(len(self)))
        return all(self._run.key(file) == self._key for file in (self._paths, *files))

    def take(self, sweep: TrackedSweep) -> None:
        """Write what tracks found in the next sweep."""
        path = sweep_file(self._run, TRACKING, next(self._numbers))
        write_arrays(self._run, path, self._key, sweep._asdict())

    def write(self, tracks: Sequence[Track]) -> None:
        """Write the tracks, when all sweeps are taken."""
        arrays = {name: np.array([getattr(t, name) for t in tracks]) for name in _OF_TRACK}
        arrays["length"] = np.array([len(t) for t in tracks], np.int64)
        for name in _OF_POSES if tracks else ():
            arrays[name] = np.concatenate([getattr(t, name) for t in tracks])
        write_arrays(self._run, self._paths, self._key, arrays)

    def tracks(self) -> list[Track]:
        """The tracks of the drive."""
        *about, lengths = read_kept_arrays(self._paths, *_OF_TRACK, "length")
        if not len(lengths):
            return []
        borders = np.cumsum(lengths)[:-1]
        try:
            of_poses = [np.split(a, borders) for a in read_kept_arrays(self._paths, *_OF_POSES)]
            return [
                Track(
                    int(number), kind.item(), size=size, **dict(zip(_OF_POSES, rest, strict=True))
                )
                for number, kind, size, *rest in zip(*about, *of_poses, strict=True)
            ]
        except (InputError, ValueError, TypeError) as error:
            raise DamagedFileError(self._paths, str(error)) from None


class FrameStore:
    """The frames of a run as a :class:`docdepth.dynamics.sweep_classifier.SweepStore`.

    Attributes
    ----------
    counts : ndarray of int64, shape (3,)
        Points of the sweeps that were written, from
        :func:`docdepth.dynamics.classes.count_classes`.
    """

    def __init__(
        self, run: RunFolder, key: dict[str, str], sweeps: int, timer: Timer | None = None
    ) -> None:
        self.run, self.key, self.timer = run, key, timer or Timer()
        self.tracks = TrackStore(run, key, sweeps)
        self.counts = np.zeros(3, np.int64)
        self._detections: OrderedDict[int, _core.Detections] = OrderedDict()
        self._keeping = Lock()

    def evidence_file(self, index: int) -> Path:
        """What is known of a sweep before tracks, and what tracks are made of."""
        return sweep_file(self.run, f"{EVIDENCE}/{self.key['classify']}", index)

    def read(self, index: int) -> LidarFrame:
        with self.timer("read"):
            frame = self.run.deskewed(index)
            (packed,) = read_kept_arrays(sweep_file(self.run, GROUND, index), "ground")
            ground = np.unpackbits(packed, count=len(frame)).view(np.bool_)
        return frame.with_ground(ground)

    def store_evidence(self, index: int, evidence: Evidence, detections: _core.Detections) -> None:
        self._hold(index, detections)
        labels, objects, porous = evidence
        of_evidence = objects, labels.votes.static, labels.votes.dynamic, labels.classid
        named = zip(
            (*_OF_EVIDENCE, *_OF_DETECTIONS),
            (*of_evidence, np.packbits(porous), *detections.arrays),
            strict=True,
        )
        with self.timer("write"):
            write_arrays(self.run, self.evidence_file(index), self.key, dict(named))

    def evidence(self, index: int) -> Evidence:
        with self.timer("read"):
            objects, static, dynamic, classid, packed = read_kept_arrays(
                self.evidence_file(index), *_OF_EVIDENCE
            )
        porous = np.unpackbits(packed, count=len(objects)).view(np.bool_)
        return Evidence(Labels(classid, Votes(static, dynamic)), objects, porous)

    def detections(self, index: int) -> _core.Detections:
        with self._keeping:
            held = self._detections.get(index)
        if held is None:
            with self.timer("read"):
                arrays = read_kept_arrays(self.evidence_file(index), *_OF_DETECTIONS)
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
