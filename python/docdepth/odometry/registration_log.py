"""What registration found, sweep by sweep, in a file: an interrupted pass goes on behind it.

The map of a pass is not kept. It is built again from the last sweeps, which are inserted where they
were registered before. So the poses are those of a pass that was not interrupted, to the last bit.
"""

from __future__ import annotations

import errno
import logging
import os
import zlib
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from docdepth.errors import RunError
from docdepth.io.untrusted import read_file
from docdepth.odometry.registration import Found

log = logging.getLogger(__name__)

# As RegistrationOptions of the core: every tenth insertion, the map deletes the voxels that the
# last hundred did not touch.
_HORIZON, CLEAR_CYCLE = 100, 10
FORGOTTEN = _HORIZON + CLEAR_CYCLE
"""Insertions after which a voxel that none of them touches is no longer in the map."""

_ROW = np.dtype(
    [
        ("pose", "<f8", (4, 4)), ("covariance", "<f8", (6, 6)), ("usable", "<u4"),
        ("fitting", "<f8"), ("sum", "<u4"),
    ]
)  # fmt: skip
_SUMMED = _ROW.itemsize - 4  # bytes of a row before its checksum


class RegistrationLog:
    """What one pass found, in a file to which each sweep adds a row.

    Rows have checksums: those behind one that a power failure tore are not taken.

    Parameters
    ----------
    path : Path, optional
        Nothing is kept without it.
    key : str
        What the results depend on: a file with another key is begun anew.
    """

    def __init__(self, path: Path | None = None, key: str = "") -> None:
        self._path = path
        # A path in the key may be of any bytes.
        self._head = key.replace("\n", " ").encode("utf-8", "surrogateescape") + b"\n"
        self._rows = np.zeros(0, _ROW) if path is None else _read(path, self._head)
        self._count = len(self._rows)
        self._stream: BinaryIO | None = None

    def __len__(self) -> int:
        return self._count

    def found(self, index: int) -> Found | None:
        """What an earlier command found of a sweep; None if it is still to be registered."""
        if index >= len(self._rows):
            return None
        row = self._rows[index]
        pose, covariance = row["pose"].copy(), row["covariance"].copy()
        return Found(pose, covariance, bool(row["usable"]), float(row["fitting"]))

    def add(self, found: Found) -> None:
        """Add the next sweep."""
        if self._path is None:
            return
        row = np.zeros((), _ROW)
        row["pose"], row["covariance"], row["usable"], row["fitting"] = found
        data = row.tobytes()[:_SUMMED]
        data += _checksum(data, self._count)
        try:
            if self._stream is None:
                self._stream = self._opened(self._path)
            if self._stream.write(data) < len(data):  # what was left of the disk
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        except OSError as error:
            raise RunError(
                f"cannot write {self._path}: {error.strerror}; make room or choose a folder that "
                "can be written, and run the same command again; it continues where it stopped"
            ) from error
        self._count += 1

    def _opened(self, path: Path) -> BinaryIO:
        """The file, cut behind its last whole row."""
        path.parent.mkdir(parents=True, exist_ok=True)
        stream = path.open("r+b" if len(self._rows) else "wb", buffering=0)
        stream.write(self._head)
        stream.truncate(stream.seek(len(self._head) + self._rows.nbytes))
        return stream

    def close(self) -> None:
        """Let go of the file."""
        if self._stream is not None:
            self._stream.close()
        self._stream = None

    def first_needed(self, reach: float) -> int:
        """The first sweep that the map behind the last row is made of; see `first_insertion`."""
        inserted = np.flatnonzero(self._rows["usable"])
        first = first_insertion(self._rows["pose"][inserted, :3, 3], reach)
        return int(inserted[first]) if first else 0


def first_insertion(positions: NDArray[np.float64], reach: float) -> int:
    """The first insertion that a map still shows.

    A voxel of the map was touched by one of the last :data:`FORGOTTEN` insertions, and only by
    those within reach of it. It is new where as many in a row left it out.

    Parameters
    ----------
    positions : ndarray of float64, shape (n, 3)
        Of the sensor at each insertion.
    reach : float
        Insertions farther apart touch no voxel both [m].

    Returns
    -------
    int
        A multiple of :data:`CLEAR_CYCLE`, so that voxels are deleted at the same insertions.
    """
    recent = positions[-FORGOTTEN:]
    low, high = (recent.min(0), recent.max(0)) if len(recent) else (np.zeros(3), np.zeros(3))
    outside = np.maximum(np.maximum(low - positions, positions - high), 0)
    near = np.flatnonzero(np.linalg.norm(outside, axis=1) <= reach)
    before = np.concatenate([[-FORGOTTEN - 1], near[:-1]])
    begins = near[near - before > FORGOTTEN]
    return int(begins[-1]) // CLEAR_CYCLE * CLEAR_CYCLE if len(begins) else 0


def _read(path: Path, head: bytes) -> NDArray[np.void]:
    """The whole rows of a file that begins with ``head``."""
    try:
        content = read_file(path)
    except OSError:
        content = b""
    body = content[len(head) :] if content.startswith(head) else b""
    rows = np.frombuffer(body, _ROW, len(body) // _ROW.itemsize)
    for k in range(len(rows)):
        begin = k * _ROW.itemsize
        row = body[begin : begin + _ROW.itemsize]
        if _checksum(row[:_SUMMED], k) != row[_SUMMED:]:
            rows = rows[:k]
            break
    if len(rows):
        log.info("odometry continues after %d sweeps of %s", len(rows), path.name)
    return rows


def _checksum(data: bytes, number: int) -> bytes:
    return np.array(zlib.crc32(data, number), "<u4").tobytes()
