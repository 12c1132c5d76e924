"""Atomic writes: a file is whole or not there."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

from docdepth.errors import RunError


def write_atomically(path: Path, write: Callable[[BinaryIO], object], *, sync: bool = True) -> None:
    """Write a file so that it has its final name only when it is whole.

    The content is written to a temporary file beside it, synced to disk and renamed. A killed run
    or a full disk leaves the old file or none.

    Parameters
    ----------
    path : Path
    write : callable
        Called with a binary file that is open for writing.
    sync : bool
        False for intermediate files that the same stage reads again and deletes. They are whole
        after a killed run, but perhaps not after a power failure.

    Raises
    ------
    RunError
        The disk is full or the folder cannot be written; earlier files are intact.
    """
    part = path.with_name(f".{path.name}.part")
    try:
        with _opened(part) as stream:
            write(stream)
            stream.flush()
            if sync:
                os.fsync(stream.fileno())
        os.replace(part, path)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise RunError(
            f"cannot write {path}: {error.strerror}; make room or choose another folder and run "
            "the same command again; it continues where it stopped"
        ) from error
    except BaseException:
        part.unlink(missing_ok=True)
        raise


def _opened(path: Path) -> BinaryIO:
    try:
        return path.open("wb")
    except FileNotFoundError:
        path.parent.mkdir(parents=True, exist_ok=True)
        return path.open("wb")
