"""The one place that turns what went wrong into a sentence and an exit code."""

from __future__ import annotations

import errno
import os
import re
import sys
import tempfile
import traceback
from pathlib import Path

import typer
import yaml

from docdepth._text import explain_yaml
from docdepth.cli.terminal import as_commands, err, say, volume
from docdepth.errors import DocDepthError

MISTAKE, BUG, STOPPED = 2, 1, 130
"""Exit codes: user error, internal error, interrupted."""

# The base class of typer's errors of usage, which is click's in older releases of typer.
_Usage = [c for c in typer.BadParameter.__mro__ if hasattr(c, "format_message")][-1]

_PERMISSIONS = "change its permissions, or choose another folder"
_ROOM = "make room and give the same command again"
# What is the matter with a path, and what to do about it.
_WRONG = {
    errno.ENOENT: ("is not there", "correct the path"),
    errno.EACCES: ("may not be read or written by you", _PERMISSIONS),
    errno.EPERM: ("may not be changed by you", _PERMISSIONS),
    errno.EROFS: ("lies on a disk that is read-only", "choose another folder"),
    errno.ENOSPC: ("cannot be written: the disk is full", _ROOM),
    errno.EDQUOT: ("cannot be written: your share of the disk is used up", _ROOM),
    errno.EISDIR: ("is a folder, where a file is wanted", "name the file"),
    errno.ENOTDIR: ("leads through a file as if it were a folder", "correct the path"),
    errno.EEXIST: ("is there already, and is no folder", "choose another folder, or delete it"),
    errno.ELOOP: ("is a link that leads back to itself", "name the file or folder that is meant"),
    errno.ENAMETOOLONG: ("is longer than the file system allows", "choose a shorter name"),
    errno.EMFILE: ("cannot be opened: too many files are open", "raise the limit: ulimit -n 4096"),
    errno.EIO: ("cannot be read or written: the disk fails", "copy the files to another disk"),
}


def explain(error: BaseException) -> str | None:
    """The sentence for an error; None where it is a mistake of docdepth's own."""
    if isinstance(error, KeyboardInterrupt):
        return "stopped; the same command continues"
    if isinstance(error, _Usage):
        return _of_usage(error)
    if isinstance(error, DocDepthError):
        return as_commands(str(error))
    if isinstance(error, OSError):
        return _of_path(error)
    if isinstance(error, RuntimeError) and "Symlink loop" in str(error):
        return f"{error}: this link leads back to itself; name the folder that is meant"
    if isinstance(error, MemoryError):
        said = f" ({error})" if str(error) else ""
        return (
            f"there is not enough memory{said}; reduce --size or --image-size, the range or the "
            "number of sweeps, or use a machine with more memory; the same command continues"
        )
    if isinstance(error, yaml.YAMLError):
        return f"this is not YAML: {explain_yaml(error)}"
    if isinstance(error, UnicodeEncodeError):
        return f"a path cannot be written as text ({error}); rename it, in letters"
    if isinstance(error, UnicodeError):
        return (
            f"a text is not UTF-8 ({error}); was a binary file given where a text file is wanted?"
        )
    return None


def print_error(error: BaseException) -> int:
    """Print what went wrong, and return the exit code."""
    sentence = explain(error)
    code = MISTAKE if sentence is not None else BUG
    if isinstance(error, KeyboardInterrupt) or type(error).__name__ == "NoArgsIsHelpError":
        err.print(sentence, end="\n" if sentence else "", markup=False)
        return STOPPED if isinstance(error, KeyboardInterrupt) else code
    err.print("error:", style="red", end=" ")
    say(_of_bug(error) if sentence is None else sentence, to=err)
    return code


def _of_usage(error: BaseException) -> str:
    context = getattr(error, "ctx", None)
    verb = context.command_path if context else "docdepth"
    said = str(error.format_message()).rstrip(".")  # type: ignore[attr-defined]
    if type(error).__name__ == "NoArgsIsHelpError":
        return said  # the help itself, or nothing where typer has printed it
    return f"{said}; {verb} --help explains it"


def _of_path(error: OSError) -> str:
    path = os.fsdecode(error.filename) if isinstance(error.filename, str | bytes) else ""
    # A file in the making is hidden beside its final name.
    path = re.sub(r"(^|/)\.([^/]+)\.part$", r"\1\2", path)
    what, remedy = _WRONG.get(error.errno or 0, ("", ""))
    way = (Path(path), *Path(path).parents)
    links = [place for place in way if os.path.islink(place) and not os.path.exists(place)]
    if error.errno == errno.ENOENT and not path:
        remedy = "the current directory does not exist any more; change to another"
    elif error.errno == errno.ENOENT and links:
        points = f"{links[-1]} is a link to {os.readlink(links[-1])}"
        what = f"cannot be opened: {points}, which is not there"
        remedy = "restore what it points to, or delete the link"
    elif error.errno == errno.ENOTDIR and (file := next(filter(Path.is_file, way[1:]), None)):
        what, remedy = f"cannot be: {file} is a file", "name a folder"
    if not what:
        return f"{path}: {error.strerror or error}" if path else str(error.strerror or error)
    return f"{path or 'a file'} {what}; {remedy}"


def _of_bug(error: BaseException) -> str:
    text = "".join(traceback.format_exception(error))
    about = f"docdepth has a bug: {type(error).__name__}: {error}"
    if volume.verbose:
        sys.stderr.write(text)
        return f"{about}; please report it with this text"
    try:
        with tempfile.NamedTemporaryFile(
            "w", prefix="docdepth-bug-", suffix=".txt", delete=False, errors="backslashreplace"
        ) as file:
            file.write(f"{sys.argv}\n{text}")
    except OSError:
        return f"{about}; please report it with what the same command prints with --verbose"
    return f"{about}; please report it with the text in {file.name}"
