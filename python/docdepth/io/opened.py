"""Files that others have written are opened here, and nowhere else: regular files alone.

A pipe would be waited for without end, and a device read without end.
"""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path
from typing import BinaryIO


def open_file(path: Path | str) -> BinaryIO:
    """A regular file, opened to be read.

    Raises
    ------
    OSError
        As for ``open``; or it is a pipe, a device or a socket.
    """
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        mode = os.fstat(descriptor).st_mode
        if stat.S_ISDIR(mode):
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
        if not stat.S_ISREG(mode):
            raise OSError(errno.EINVAL, "it is no regular file", str(path))
        return os.fdopen(descriptor, "rb")
    except BaseException:
        os.close(descriptor)
        raise


def read_file(path: Path | str) -> bytes:
    """The content of a regular file."""
    with open_file(path) as stream:
        return stream.read()


def read_text(path: Path | str, encoding: str = "utf-8") -> str:
    """The content of a text file, its ends of lines as ``\\n``."""
    return read_file(path).decode(encoding).replace("\r\n", "\n").replace("\r", "\n")
