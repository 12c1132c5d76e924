"""Atomic writes: a file is whole or not there."""

from __future__ import annotations

import contextlib
import errno
import io
import os
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from docdepth.errors import RunError

WriteFile = Callable[[Path, Callable[[BinaryIO], object]], None]
"""A function like :func:`write_atomically`."""


_CHUNK = 1 << 22  # bytes that are read at once for a checksum
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


@dataclass(frozen=True)
class Written:
    """What was written into a file that still has its temporary name.

    Attributes
    ----------
    size : int
        Bytes.
    time : int
        Of the last change, nanoseconds.
    checksum : int
        CRC-32 of the content.
    """

    size: int
    time: int
    checksum: int


def write_atomically(
    path: Path,
    write: Callable[[BinaryIO], object],
    *,
    sync: bool = True,
    before_rename: Callable[[Written], object] | None = None,
) -> None:
    """Write a file so that it has its final name only when it is whole.

    The content is written to a temporary file beside it, synced to disk and renamed. A killed run
    or a full disk leaves the old file or none.

    Parameters
    ----------
    path : Path
    write : callable
        Called with the file.
    sync : bool
        False for intermediate files that the same stage reads again and deletes. They are whole
        after a killed run, but perhaps not after a power failure.
    before_rename : callable, optional
        Called when the content is on disk.

    Raises
    ------
    RunError
        The disk is full or the folder cannot be written; earlier files are intact.
    """
    part = path.with_name(f".{path.name}.part")
    try:
        with contextlib.suppress(FileExistsError):  # opening the file says that it is no folder
            path.parent.mkdir(parents=True, exist_ok=True)
        with part.open("wb") as stream:
            write(stream)
            stream.flush()
            if sync:
                os.fsync(stream.fileno())
            known = os.fstat(stream.fileno())
        if before_rename:
            before_rename(Written(known.st_size, known.st_mtime_ns, checksum(part)))
        os.replace(part, path)
    except OSError as error:
        with contextlib.suppress(OSError):
            part.unlink()
        remedy = "make room" if error.errno in _FULL else "choose a folder that can be written"
        raise RunError(
            f"cannot write {path}: {error.strerror}; {remedy} and run the same command again; it "
            "continues where it stopped"
        ) from error
    except BaseException:
        part.unlink(missing_ok=True)
        raise


def npz_bytes(*, compressed: bool = False, **arrays: Any) -> bytes:
    """The content of an NPZ file with these arrays."""
    stream = io.BytesIO()
    (np.savez_compressed if compressed else np.savez)(stream, **arrays)
    return stream.getvalue()


def checksum(path: Path) -> int:
    """CRC-32 of the content of a file."""
    found = 0
    with path.open("rb") as stream:
        while data := stream.read(_CHUNK):
            found = zlib.crc32(data, found)
    return found
