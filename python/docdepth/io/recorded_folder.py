"""A folder that knows which of its files docdepth wrote, of what, and whether they are whole."""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from threading import RLock
from typing import NamedTuple
from uuid import uuid4

from docdepth.errors import RunError
from docdepth.io.atomic import (
    Content,
    WriteFile,
    Written,
    has_content,
    locked,
    move_aside,
    write_atomically,
)
from docdepth.io.file_records import FileRecords, shared_records
from docdepth.io.manifest import RunManifest

STATE_DIR = ".docdepth"
"""Folder of a run with what docdepth needs to continue it; nothing in it is a result."""


def check_entries(folder: Path) -> None:
    """Refuse a folder that holds anything but files and folders of its own.

    A run may come from a stranger. A link in it would have files elsewhere read, replaced or
    deleted, and a device or a pipe read without end. Files that docdepth adds to, rather than put
    another in their place, have no second name elsewhere.
    """
    try:
        entries = list(os.scandir(folder))
    except OSError:  # what needs it will say so
        return
    for entry in entries:
        if entry.is_dir(follow_symlinks=False):
            check_entries(Path(entry))
        elif what := _what_else(entry):
            raise RunError(
                f"{entry.path} is {what}",
                "a run holds files of its own alone: put the file or folder itself there, or "
                "delete it",
            )


def _what_else(entry: os.DirEntry[str]) -> str:
    """What an entry is if it is no file that may be in a run."""
    if not entry.is_file(follow_symlinks=False):
        return "a link" if entry.is_symlink() else "no regular file"
    added_to = STATE_DIR in Path(entry).parts or entry.name.startswith(".")
    shared = added_to and entry.stat(follow_symlinks=False).st_nlink > 1
    return "a second name of another file" if shared else ""


class StagedFile(NamedTuple):
    """A file that a worker has written, under a name that it does not keep."""

    # part, path: what it is called now, and what it is to be called; relative to the folder
    part: str
    path: str
    written: Written
    key: dict[str, str]  # what it is made of


class RecordedFolder:
    """A folder whose files have records, in ``.docdepth/records``.

    Nothing that has no record, or differs from it, is overwritten or deleted.

    A copy in another process (the folder is pickled) is that of a worker. It reads like the folder
    itself. What it writes waits in ``.docdepth/staging`` for :meth:`commit`, so that one process
    alone gives names and keeps records.

    Attributes
    ----------
    state_dir, staging : Path
        Folder with what docdepth needs to continue the run, and in it files of workers that have no
        name yet.
    staged : list of StagedFile, or None
        What the copy of a worker has written; None for the folder itself.
    """

    manifest: RunManifest

    def __init__(self, path: Path) -> None:
        self._set_paths(Path(path))
        self.staged: list[StagedFile] | None = None
        self._records: dict[Path, FileRecords] = {}
        self._writer = uuid4().hex
        self._lock_depth, self._writing = 0, RLock()

    def __repr__(self) -> str:
        return f"{type(self).__name__}({str(self.path)!r})"

    def __getstate__(self) -> dict[str, object]:
        return {**vars(self), "path": self.path.absolute(), "_records": {}, "_writing": None}

    def __setstate__(self, state: dict[str, object]) -> None:
        vars(self).update(state, staged=[], _writing=RLock())
        self._set_paths(self.path)

    def _set_paths(self, path: Path) -> None:
        self.path, self.state_dir = path, path / STATE_DIR
        self.staging = self.state_dir / "staging"

    def commit(self, files: Iterable[StagedFile]) -> None:
        """Give files of a worker their names, and record them."""
        for file in files:
            path = self.path / file.path
            self._record(path, file.written, file.key)
            try:
                path.parent.mkdir(parents=True, exist_ok=True)
                os.replace(self.path / file.part, path)
            except OSError as error:
                raise RunError(
                    f"cannot write {path}: {error.strerror}; run the same command again; it "
                    "continues where it stopped"
                ) from error

    @contextmanager
    def lock(self, what: str) -> Iterator[None]:
        """Keep other processes from working in the folder."""
        with ExitStack() as stack:
            if not self._lock_depth:
                stack.enter_context(locked(self.state_dir / "lock", self.path, what))
                self._check_unchanged()
            self._lock_depth += 1
            try:
                yield
            finally:
                self._lock_depth -= 1

    def _check_unchanged(self) -> None:
        """Raise if another process has changed the folder since it was opened."""

    def records(self, folder: Path) -> FileRecords:
        """Records of the files in a folder of the run."""
        with self._writing:
            if folder not in self._records:
                inside = self.path in (folder, *folder.parents)
                if not inside or ".." in folder.parts[len(self.path.parts) :]:
                    raise RunError(
                        f"{folder} lies outside of {self.path}; nothing is written there"
                    )
                name = folder.relative_to(self.path).as_posix()
                file = f"{'run' if name == '.' else name}.jsonl"
                path = self.state_dir / "records" / file
                self._records[folder] = (
                    FileRecords(folder, path)
                    if self.staged is None
                    else shared_records(folder, path, self._writer)
                )
            return self._records[folder]

    def key(self, path: Path) -> dict[str, str]:
        """What a file was made of, a hash for each stage; empty if the file is not whole."""
        records = self.records(path.parent)
        is_whole = records.state(path.name) == "whole"
        return records.recorded_key(path.name) if is_whole else {}

    def recorded_key(self, path: Path) -> dict[str, str]:
        """What the record of a file says, whatever has become of the file."""
        return self.records(path.parent).recorded_key(path.name)

    def write(
        self,
        path: Path,
        content: Content,
        key: dict[str, str],
        *,
        sync: bool = True,
    ) -> None:
        """Write a file of the run and its record.

        A file of this name that docdepth did not write, or that was changed since, is kept as
        ``NAME.old``.

        Parameters
        ----------
        key : dict
            What the content is made of: a hash for each stage.
        sync : bool
            See :func:`docdepth.io.atomic.write_atomically`.
        """
        self.records(path.parent)  # refuses what lies outside
        if self.staged is None:
            write_atomically(
                path, content, sync=sync, before_rename=lambda one: self._record(path, one, key)
            )
            return
        part, staged, inside = self.staging / uuid4().hex, self.staged, path.relative_to(self.path)

        def stage(written: Written) -> None:
            staged.append(StagedFile(str(part.relative_to(self.path)), str(inside), written, key))

        write_atomically(part, content, sync=sync, before_rename=stage)

    def _record(self, path: Path, written: Written, key: dict[str, str]) -> None:
        """Note a file that gets its name next."""
        records = self.records(path.parent)
        if not records.path.is_file():
            self._adopt(path.parent)
        if records.is_foreign(path.name) and not has_content(path, written):
            move_aside(path)
        records.add(path.name, written, key)

    def _adopt(self, folder: Path) -> None:
        """Take the files of a folder for docdepth's if it has written there and records are lost.

        They are made again, each under its name; none is deleted.
        """
        name = folder.relative_to(self.path).as_posix()
        with self._writing:
            records, before = self.records(folder), self.manifest.folders_written
            if records.path.is_file():
                return  # another thread was here before
            if (before is None or name in before) and folder.is_dir():
                for file in folder.iterdir():
                    if file.is_file() and not file.name.startswith("."):
                        records.invalidate(file.name)
            records.create()
            if before is not None and name not in before:
                before.append(name)
                self.save()

    def save(self) -> None:
        """Keep what has changed in the manifest."""
        raise NotImplementedError

    def writer(self, key: dict[str, str]) -> WriteFile:
        """:meth:`write` for files that are made of ``key``."""
        return lambda path, content: self.write(path, content, key)

    def remove(self, path: Path) -> None:
        """Delete a file, if docdepth wrote it; one that was changed since becomes ``NAME.old``."""
        records = self.records(path.parent)
        if path.name in records:
            if records.is_foreign(path.name):
                move_aside(path)
            path.unlink(missing_ok=True)
            records.drop(path.name)
            with contextlib.suppress(OSError):
                path.parent.rmdir()  # if it is empty

    def remove_tree(self, folder: Path) -> None:
        """Delete a folder in which only docdepth writes."""
        shutil.rmtree(folder, ignore_errors=True)
        for known in [f for f in self._records if f == folder or folder in f.parents]:
            self._records.pop(known).path.unlink(missing_ok=True)

    def invalidate(self, path: Path) -> None:
        """Have a file made again."""
        self.records(path.parent).invalidate(path.name)
