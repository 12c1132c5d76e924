"""A folder that knows which of its files docdepth wrote, of what, and whether they are whole."""

from __future__ import annotations

import contextlib
import logging
import os
import shutil
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from threading import RLock
from typing import BinaryIO, NamedTuple
from uuid import uuid4

from docdepth.errors import RunError
from docdepth.io.atomic import WriteFile, Written, write_atomically
from docdepth.io.file_records import FileRecords, same_content, shared_records
from docdepth.io.lock import locked

log = logging.getLogger(__name__)

STATE_DIR = ".docdepth"
"""Folder of a run with what docdepth needs to continue it; nothing in it is a result."""


class StagedFile(NamedTuple):
    """A file that a worker has written, under a name that it does not keep.

    Attributes
    ----------
    part, path : str
        What it is called now, and what it is to be called; relative to the folder.
    written : Written
    key : dict
        What it is made of.
    """

    part: str
    path: str
    written: Written
    key: dict[str, str]


class RecordedFolder:
    """A folder whose files have records, in ``.docdepth/records``.

    Nothing that has no record is overwritten or deleted.

    A copy in another process (the folder is pickled) is that of a worker. It reads like the folder
    itself. What it writes waits in ``.docdepth/staging`` for :meth:`commit`, so that one process
    alone gives names and keeps records.

    Parameters
    ----------
    path : Path

    Attributes
    ----------
    staged : list of StagedFile, or None
        What the copy of a worker has written; None for the folder itself.
    """

    def __init__(self, path: Path) -> None:
        self.path = Path(path)
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

    @property
    def staging(self) -> Path:
        """Folder of files that workers have written and that have no name yet."""
        return self.state_dir / "staging"

    def commit(self, files: Iterable[StagedFile]) -> None:
        """Give files of a worker their names, and record them.

        Raises
        ------
        RunError
            A file cannot be moved or recorded.
        """
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
        """Keep other processes from working in the folder.

        Parameters
        ----------
        what : str
            What is done, for the message that others get.

        Raises
        ------
        RunError
            Another process works there.
        """
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
        """Records of the files in a folder of the run.

        Raises
        ------
        RunError
            The folder lies outside, as names out of damaged or hostile files may have it.
        """
        with self._writing:
            if folder not in self._records:
                self._refuse_outside(folder)
                file = self._records_file(folder)
                self._records[folder] = (
                    FileRecords(folder, file)
                    if self.staged is None
                    else shared_records(folder, file, self._writer)
                )
            return self._records[folder]

    def _refuse_outside(self, folder: Path) -> None:
        inside = self.path in (folder, *folder.parents)
        if not inside or ".." in folder.parts[len(self.path.parts) :]:
            raise RunError(f"{folder} lies outside of {self.path}; nothing is written there")

    def _records_file(self, folder: Path) -> Path:
        name = folder.relative_to(self.path).as_posix()
        return self.state_dir / "records" / f"{'run' if name == '.' else name}.jsonl"

    @property
    def state_dir(self) -> Path:
        """Folder with what docdepth needs to continue the run."""
        return self.path / STATE_DIR

    def key(self, path: Path) -> dict[str, str]:
        """What a file was made of, a hash for each stage; empty if the file is not whole."""
        return self.records(path.parent).key(path.name)

    def recorded_key(self, path: Path) -> dict[str, str]:
        """What the record of a file says, whatever has become of the file."""
        return self.records(path.parent).recorded_key(path.name)

    def write(
        self,
        path: Path,
        write: Callable[[BinaryIO], object],
        key: dict[str, str],
        *,
        sync: bool = True,
    ) -> None:
        """Write a file of the run and its record.

        A file that docdepth did not write and that has this name is kept as ``NAME.old``.

        Parameters
        ----------
        path : Path
        write : callable
            Writes the content.
        key : dict
            What the content is made of: a hash for each stage.
        sync : bool
            See :func:`docdepth.io.atomic.write_atomically`.

        Raises
        ------
        RunError
            The file cannot be written.
        """
        self._refuse_outside(path.parent)
        if self.staged is None:
            write_atomically(
                path, write, sync=sync, before_rename=lambda one: self._record(path, one, key)
            )
            return
        part, staged, inside = self.staging / uuid4().hex, self.staged, path.relative_to(self.path)

        def stage(written: Written) -> None:
            staged.append(StagedFile(str(part.relative_to(self.path)), str(inside), written, key))

        write_atomically(part, write, sync=sync, before_rename=stage)

    def _record(self, path: Path, written: Written, key: dict[str, str]) -> None:
        """Note a file that gets its name next."""
        records = self.records(path.parent)
        if not records.path.is_file():
            self._adopt(path.parent)
        if path.name not in records and not same_content(path, written):
            move_aside(path)
        records.add(path.name, written, key)

    def _adopt(self, folder: Path) -> None:
        """Take the files of a folder for docdepth's if it has written there and records are lost.

        They are made again, each under its name; none is deleted.
        """
        name = folder.relative_to(self.path).as_posix()
        with self._writing:
            records = self.records(folder)
            if records.path.is_file():
                return  # another thread was here before
            if self._has_written_into(name) and folder.is_dir():
                for file in folder.iterdir():
                    if file.is_file() and not file.name.startswith("."):
                        records.invalidate(file.name)
            records.create()
            self._note_written_into(name)

    def _has_written_into(self, name: str) -> bool:
        """Whether docdepth has written into a folder, as far as is known without records."""
        raise NotImplementedError

    def _note_written_into(self, name: str) -> None:
        """Remember that docdepth writes into a folder."""
        raise NotImplementedError

    def writer(self, key: dict[str, str]) -> WriteFile:
        """:meth:`write` for files that are made of ``key``."""
        return lambda path, write: self.write(path, write, key)

    def remove(self, path: Path) -> None:
        """Delete a file, if docdepth wrote it."""
        records = self.records(path.parent)
        if path.name in records:
            path.unlink(missing_ok=True)
            records.drop(path.name)
            with contextlib.suppress(OSError):
                path.parent.rmdir()  # if it is empty

    def remove_tree(self, folder: Path) -> None:
        """Delete a folder in which only docdepth writes."""
        shutil.rmtree(folder, ignore_errors=True)
        for known in [f for f in self._records if f == folder or folder in f.parents]:
            self._records.pop(known).path.unlink(missing_ok=True)

    def move_into_place(self, part: Path, path: Path, key: dict[str, str]) -> None:
        """Give a file that is whole its name, and record it."""
        self.write(path, lambda stream: stream.write(part.read_bytes()), key)
        part.unlink()

    def invalidate(self, path: Path) -> None:
        """Have a file made again."""
        self.records(path.parent).invalidate(path.name)


def move_aside(path: Path) -> None:
    """Give a file that docdepth did not write another name."""
    aside, number = path.with_name(f"{path.name}.old"), 1
    while aside.exists():
        number += 1
        aside = path.with_name(f"{path.name}.old{number}")
    with contextlib.suppress(FileNotFoundError):
        path.rename(aside)
        log.warning("%s was not written by docdepth and is %s now", path, aside.name)
