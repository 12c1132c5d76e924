"""Files that are whole or not there."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

from docdepth.errors import RunError


def write_atomically(path: Path, write: Callable[[BinaryIO], object], *, sync: bool = True) -> None:
    """Write a file under its final name only when it is whole.

    The content goes beside it first, is synced to disk and then renamed, so that a killed run or
    a full disk leaves the old file or none.

    Parameters
    ----------
    path : Path
    write : callable
        Called with the open binary file.
    sync : bool
        False for what the same stage reads again and deletes: the disk then need not see it. It is
        whole after a killed run all the same, but perhaps not after the power went.

    Raises
    ------
    RunError
        The disk is full or the folder cannot be written; everything written before is intact.
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
            "the same command again, it goes on where it stopped"
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
