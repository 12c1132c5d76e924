"""What tracks found in each sweep, in a file: a drive may be too long to hold all of it."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, BinaryIO, overload

import numpy as np
from numpy.typing import NDArray

from docdepth.dynamics.tracking import TakeSweep, TrackedSweep
from docdepth.errors import DamagedFileError, InputError
from docdepth.geometry.track import KINDS, Track
from docdepth.io.npy import ArrayError, read_next_array, skip_next_array
from docdepth.io.run_folder import RunFolder

Offsets = NDArray[np.int64]
"""Where each array of a file begins, in bytes."""


def write_array(stream: BinaryIO, array: NDArray[Any]) -> int:
    """Write an array behind others; the stream needs the method ``write`` only.

    Returns
    -------
    int
        Bytes that were written.
    """
    content = io.BytesIO()
    np.save(content, array)
    stream.write(content.getbuffer())
    return content.tell()


def write_arrays(
    run: RunFolder, path: Path, key: dict[str, str], arrays: Iterable[NDArray[Any]]
) -> None:
    """Write arrays into one file; they may be made while it is written."""

    def write(stream: BinaryIO) -> None:
        for array in arrays:
            write_array(stream, array)

    run.write(path, write, key, sync=False)


def read_arrays(path: Path, count: int, skipped: int = 0, offset: int = 0) -> list[NDArray[Any]]:
    """Read some arrays of a file: ``count`` after ``skipped`` ones, from a byte on.

    Raises
    ------
    DamagedFileError
    """
    try:
        with path.open("rb") as stream:
            size = path.stat().st_size
            stream.seek(offset)
            for _ in range(skipped):
                skip_next_array(stream, size - stream.tell())
            return [read_next_array(stream, size - stream.tell()) for _ in range(count)]
    except (OSError, ArrayError) as error:
        raise DamagedFileError(path, str(error)) from None


def array_offsets(path: Path) -> Offsets:
    """Where the arrays of a file begin.

    Raises
    ------
    DamagedFileError
    """
    offsets = []
    try:
        size = path.stat().st_size
        with path.open("rb") as stream:
            while stream.tell() < size:
                offsets.append(stream.tell())
                skip_next_array(stream, size - stream.tell())
            if stream.tell() != size:
                raise ArrayError("the last array is cut off")
    except (OSError, ArrayError) as error:
        raise DamagedFileError(path, str(error)) from None
    return np.array(offsets, np.int64)


_SWEEPS, _PATHS = "sweeps.npy", "paths.npy"
"""The arrays of each sweep; where those of each begin, and the tracks of the drive."""

_OF_SWEEP = len(TrackedSweep._fields)  # arrays


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


def store_tracks(
    run: RunFolder, folder: Path, key: dict[str, str], find: Callable[[TakeSweep], list[Track]]
) -> None:
    """Write what ``find`` hands over sweep by sweep, and the tracks that it returns."""
    offsets: list[int] = []
    tracks: list[Track] = []

    def write(stream: BinaryIO) -> None:
        size = 0

        def take(sweep: TrackedSweep) -> None:
            nonlocal size
            offsets.append(size)
            size += sum(write_array(stream, array) for array in sweep)

        tracks.extend(find(take))

    run.write(folder / _SWEEPS, write, key, sync=False)
    about = [(t.id, KINDS.index(t.kind), len(t)) for t in tracks]
    paths = [
        (t.times, t.poses, t.velocities, t.points, t.deviations, t.surface_deviations)
        for t in tracks
    ]
    arrays = [
        np.array(offsets, np.int64),
        np.array(about, np.int64).reshape(-1, 3),
        np.array([t.size for t in tracks]).reshape(-1, 3),
        *(np.concatenate(of_all) for of_all in zip(*paths, strict=True)),
    ]
    write_arrays(run, folder / _PATHS, key, arrays)


def are_stored(run: RunFolder, folder: Path, key: dict[str, str]) -> bool:
    """Whether both files of :func:`store_tracks` are whole and made of ``key``."""
    return all(run.key(folder / name) == key for name in (_SWEEPS, _PATHS))


def stored_sweeps(folder: Path, count: int) -> TrackedSweeps:
    """What tracks found in each of so many sweeps, as :func:`store_tracks` wrote it.

    Raises
    ------
    DamagedFileError
    """
    (offsets,) = read_arrays(folder / _PATHS, 1)
    if offsets.shape != (count,):
        reason = f"it tells of {len(offsets)} sweeps, the drive has {count}"
        raise DamagedFileError(folder / _PATHS, reason)
    return TrackedSweeps(folder / _SWEEPS, offsets)


def stored_tracks(folder: Path) -> list[Track]:
    """The tracks of the drive, as :func:`store_tracks` wrote them.

    Raises
    ------
    DamagedFileError
    """
    path = folder / _PATHS
    about, sizes = read_arrays(path, 2, skipped=1)
    if not len(about):
        return []
    try:
        paths = [
            np.split(of_all, np.cumsum(about[:, 2])[:-1])
            for of_all in read_arrays(path, 6, skipped=3)
        ]
        return [
            Track(int(number), KINDS[int(kind)], times, poses, velocities, size, *rest)
            for (number, kind, _), size, times, poses, velocities, *rest in zip(
                about, sizes, *paths, strict=True
            )
        ]
    except (InputError, ValueError, IndexError, TypeError) as error:
        raise DamagedFileError(path, str(error)) from None
