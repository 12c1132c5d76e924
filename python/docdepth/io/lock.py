"""One process at a time in a run folder."""

from __future__ import annotations

import contextlib
import fcntl
import os
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path

from docdepth.errors import RunError

_TRIES, _PAUSE = 4, 0.05  # seconds


@contextmanager
def locked(file: Path, folder: Path, what: str) -> Iterator[None]:
    """Keep other processes from working in a folder.

    The system lets go of the lock when the process ends, however it ends.

    Parameters
    ----------
    file : Path
        The lock; it names who works there. Created if it is not there.
    folder : Path
        For messages.
    what : str
        What the process does, for the others' message.

    Raises
    ------
    RunError
        Another process works in the folder, or the folder cannot be written.
    """
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        stream = file.open("a+", encoding="utf-8")
    except OSError as error:
        raise RunError(
            f"cannot write into {folder}: {error.strerror}; choose another folder"
        ) from None
    with stream:
        if not _taken(stream.fileno()):
            raise RunError(
                f"{folder} is in use by {holder(file) or 'another process'}; wait until it ends, "
                "or stop it"
            )
        now = datetime.now().isoformat(sep=" ", timespec="seconds")
        _write(stream.fileno(), f"process {os.getpid()} on {socket.gethostname()} ({what}, {now})")
        try:
            yield
        finally:
            _write(stream.fileno(), "")


def holder(file: Path) -> str | None:
    """Who has a lock; None if nobody does."""
    try:
        with file.open(encoding="utf-8") as stream:
            try:
                fcntl.flock(stream, fcntl.LOCK_SH | fcntl.LOCK_NB)
            except OSError:
                return stream.read() or "another process"
    except (OSError, UnicodeDecodeError):
        pass
    return None


def _taken(descriptor: int) -> bool:
    for _ in range(_TRIES):  # who asks for the holder has the lock for an instant
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return True
        except OSError:
            time.sleep(_PAUSE)
    return False


def _write(descriptor: int, text: str) -> None:
    with contextlib.suppress(OSError):  # a full disk: the lock holds, without a name
        os.ftruncate(descriptor, 0)
        os.pwrite(descriptor, text.encode(), 0)
