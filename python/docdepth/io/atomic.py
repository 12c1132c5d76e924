"""Files written so that each is whole or not there, by one process, and never over a user's own."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import io
import logging
import os
import shutil
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from functools import cache
from pathlib import Path
from typing import Any, BinaryIO

import deflate
import numpy as np

from docdepth.errors import ConfigError, RunError
from docdepth.io.untrusted import open_file

log = logging.getLogger(__name__)

Content = bytes | Callable[[BinaryIO], object]
"""What a file is to hold, or what writes that into it."""

WriteFile = Callable[[Path, Content], None]
"""A function like :func:`write_atomically`."""

_CHUNK = 1 << 22  # bytes that are read at once for a checksum
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, None)  # numpy tells no number
_TRIES, _PAUSE = 4, 0.05  # seconds
_MARK = "user.docdepth"  # attribute of a file with the checksum of what docdepth wrote into it


@dataclass(frozen=True)
class Written:
    """What was written into a file that still has its temporary name."""

    size: int  # bytes
    time: int  # of the last change, nanoseconds
    checksum: int  # CRC-32 of the content


def write_atomically(
    path: Path,
    content: Content,
    *,
    sync: bool = True,
    before_rename: Callable[[Written], object] | None = None,
) -> None:
    """Write a file so that it has its final name only when it is whole.

    The content is written to a temporary file beside it, synced to disk and renamed. A killed run
    or a full disk leaves the old file or none.

    Parameters
    ----------
    sync : bool
        False for intermediate files that the same stage reads again and deletes. They are whole
        after a killed run, but perhaps not after a power failure.
    before_rename : callable, optional
        Called when the content is on disk.
    """
    part = _part_of(path)
    try:
        with contextlib.suppress(FileExistsError):  # opening the file says that it is no folder
            path.parent.mkdir(parents=True, exist_ok=True)
        with part.open("wb") as stream:
            if isinstance(content, bytes):
                stream.write(content)
            else:
                content(stream)
            stream.flush()
            if sync:
                _sync(stream.fileno())
            known = os.fstat(stream.fileno())
        if before_rename:
            before_rename(Written(known.st_size, known.st_mtime_ns, checksum(part)))
        os.replace(part, path)
    except OSError as error:
        with contextlib.suppress(OSError):
            part.unlink()
        remedy = "make room" if error.errno in _FULL else "choose a folder that can be written"
        raise RunError(
            f"cannot write {path}: {error.strerror or error}; {remedy} and run the same command "
            "again; it continues where it stopped"
        ) from error
    except BaseException:
        part.unlink(missing_ok=True)
        raise


def _sync(descriptor: int) -> None:
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP):  # some file systems cannot
            raise


def npz_bytes(*, compressed: bool = False, **arrays: Any) -> bytes:
    """The content of an NPZ file with these arrays."""
    stream = io.BytesIO()
    (np.savez_compressed if compressed else np.savez)(stream, **arrays)
    return stream.getvalue()


def checksum(path: Path) -> int:
    """CRC-32 of the content of a file."""
    found = 0
    with open_file(path) as stream:
        while data := stream.read(_CHUNK):
            found = deflate.crc32(data, found)
    return found


def write_output(path: Path, content: Content) -> None:
    """Write a file in a folder that a user named; one of the user's own becomes ``NAME.old``."""

    def keep(written: Written) -> None:
        _make_way(path, _part_of(path), written)

    write_atomically(path, content, before_rename=keep)


def replace_output(part: Path, path: Path) -> None:
    """Give a whole file of another name its own, as :func:`write_output` does."""
    _make_way(path, part, Written(part.stat().st_size, 0, checksum(part)))
    os.replace(part, path)


def _make_way(path: Path, part: Path, written: Written) -> None:
    """Move a file aside unless docdepth wrote it as it is; mark the one that takes its place."""
    mark = _mark(path)
    if not has_content(path, written) and (mark is None or mark != b"%d" % checksum(path)):
        move_aside(path)
    with contextlib.suppress(OSError, AttributeError):  # systems without such marks
        os.setxattr(part, _MARK, b"%d" % written.checksum)


def _mark(path: Path) -> bytes | None:
    try:
        return os.getxattr(path, _MARK)
    except (OSError, AttributeError):
        return None


def _part_of(path: Path) -> Path:
    """What a file is called until it is whole."""
    return path.with_name(f".{path.name}.part")


@contextmanager
def new_output(path: Path) -> Iterator[None]:
    """Write a new file or folder inside: one that is there is refused, but an empty folder.

    If that fails nothing is left of it, so the same command may be given again.
    """
    there = os.path.lexists(path)
    if there and (path.is_symlink() or not path.is_dir() or any(path.iterdir())):
        raise ConfigError(f"{path} is there; name another, or remove it")
    try:
        yield
    except BaseException as error:
        if path.is_dir():
            shutil.rmtree(path)
            if there:
                path.mkdir()
        else:
            path.unlink(missing_ok=True)
        if isinstance(error, OSError) and error.filename is None:
            error.filename = str(path)
        raise


def has_content(path: Path, written: Written) -> bool:
    """Whether a file is not there, or has the content of one that was written."""
    try:
        return path.stat().st_size == written.size and checksum(path) == written.checksum
    except FileNotFoundError:
        return True
    except OSError:
        return False


def move_aside(path: Path) -> None:
    """Give a file that docdepth did not write, or that was changed since, another name."""
    aside, number = path.with_name(f"{path.name}.old"), 1
    while aside.exists():
        number += 1
        aside = path.with_name(f"{path.name}.old{number}")
    with contextlib.suppress(FileNotFoundError):
        path.rename(aside)
        log.warning(
            "%s was not written by docdepth, or was changed since, and is %s now", path, aside.name
        )


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
    """
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        stream = file.open("a+", encoding="utf-8")
    except OSError as error:
        raise RunError(
            f"cannot write into {folder}: {error.strerror}; choose another folder"
        ) from None
    with stream:
        if not _is_taken(stream.fileno(), folder):
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
            except (BlockingIOError, PermissionError):
                return stream.read() or "another process"
    except (OSError, UnicodeDecodeError):
        pass
    return None


def _is_taken(descriptor: int, folder: Path) -> bool:
    for _ in range(_TRIES):  # who asks for the holder has the lock for an instant
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return True
        except (BlockingIOError, PermissionError):
            time.sleep(_PAUSE)
        except OSError as error:
            _warn_of_no_locks(folder, error.strerror)
            return True
    return False


@cache
def _warn_of_no_locks(folder: Path, why: str) -> None:
    log.warning(
        "%s lies on a file system without locks (%s); have one process at a time work there",
        folder, why,
    )  # fmt: skip


def _write(descriptor: int, text: str) -> None:
    with contextlib.suppress(OSError):  # a full disk: the lock holds, without a name
        os.ftruncate(descriptor, 0)
        os.pwrite(descriptor, text.encode(), 0)
