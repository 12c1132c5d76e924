"""What tracks found in each sweep, in a file: a drive may be too long to hold all of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import BinaryIO, overload

import numpy as np

from docdepth.dynamics.tracking import TakeSweep, TrackedSweep, Tracking
from docdepth.errors import DamagedFileError, InputError
from docdepth.geometry.track import KINDS, Track
from docdepth.io.run_folder import RunFolder
from docdepth.pipeline.array_files import Offsets, array_offsets, read_arrays, write_array

_OF_SWEEP, _OF_TRACK = len(TrackedSweep._fields), 8  # arrays


class TrackedSweeps(Sequence[TrackedSweep]):
    """Reads what tracks found in a sweep when it is asked for.

    Parameters
    ----------
    path : Path
    offsets : ndarray of int64, shape (n,)
        Where each sweep begins.
    """

    def __init__(self, path: Path, offsets: Offsets) -> None:
        self._path, self._offsets = path, offsets

    def __len__(self) -> int:
        return len(self._offsets)

    @overload
    def __getitem__(self, index: int) -> TrackedSweep: ...
    @overload
    def __getitem__(self, index: slice) -> list[TrackedSweep]: ...
    def __getitem__(self, index: int | slice) -> TrackedSweep | list[TrackedSweep]:
        if isinstance(index, slice):
            return [self[k] for k in range(len(self))[index]]
        offset = int(self._offsets[index])
        return TrackedSweep(*read_arrays(self._path, _OF_SWEEP, offset=offset))


def keep_tracking(
    run: RunFolder, path: Path, key: dict[str, str], find: Callable[[TakeSweep], list[Track]]
) -> None:
    """Write what ``find`` hands over sweep by sweep, and the tracks that it returns."""

    def write(stream: BinaryIO) -> None:
        def take(sweep: TrackedSweep) -> None:
            for array in sweep:
                write_array(stream, array)

        for t in find(take):
            about = np.array([t.id, KINDS.index(t.kind)])
            known = (t.deviations, t.surface_deviations)
            for array in (about, t.times, t.poses, t.velocities, t.size, t.points, *known):
                write_array(stream, array)

    run.write(path, write, key, sync=False)


def kept_tracking(path: Path, sweeps: int) -> Tracking:
    """What :func:`keep_tracking` wrote of so many sweeps.

    Raises
    ------
    DamagedFileError
    """
    offsets = array_offsets(path)
    first = _OF_SWEEP * sweeps
    if len(offsets) < first or (len(offsets) - first) % _OF_TRACK:
        reason = f"{len(offsets)} arrays are not the tracks of {sweeps} sweeps"
        raise DamagedFileError(path, reason)
    tracks = []
    try:
        for offset in offsets[first::_OF_TRACK].tolist():
            (number, kind), *rest = read_arrays(path, _OF_TRACK, offset=offset)
            tracks.append(Track(int(number), KINDS[int(kind)], *rest))
    except (InputError, ValueError, IndexError) as error:
        raise DamagedFileError(path, str(error)) from None
    return Tracking(TrackedSweeps(path, offsets[:first:_OF_SWEEP]), tracks)
