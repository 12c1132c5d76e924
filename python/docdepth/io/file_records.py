"""Records of the files that docdepth wrote: what each was made of, and whether it is whole."""

from __future__ import annotations

import json
import os
import sys
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from typing import Any, Literal

from docdepth.errors import RunError
from docdepth.io.atomic import Written, checksum
from docdepth.io.untrusted import open_file, parse_json

FileState = Literal["whole", "damaged", "missing", "unknown"]
"""``unknown``: docdepth did not write the file, or its record is lost."""


@dataclass(slots=True)  # a long drive has many
class _Record:
    size: int
    time: int
    checksum: int
    key: str
    """As JSON: half the size of a dict."""
    state: FileState | None = None
    """What was found, so that nothing is read twice."""


def _line(name: str, record: _Record | None) -> str:
    """The line that tells of a file; None if it was deleted."""
    entry: dict[str, object] = {"name": name}
    if record is not None:
        known = {"size": record.size, "time": record.time, "checksum": record.checksum}
        entry |= {**known, "key": json.loads(record.key)}
    return json.dumps(entry) + "\n"


class FileRecords:
    """The records of one folder.

    A line is added before a file gets its final name. So every file of docdepth has a record, also
    after a power failure, and a file that differs from its record was damaged or replaced.

    Parameters
    ----------
    path : Path
        File of the records, a line for each file that is written or deleted.
    """

    def __init__(self, folder: Path, path: Path) -> None:
        self._folder, self.path, self._lock = folder, path, Lock()
        self._records: dict[str, _Record] = {}
        self._lines = self._bytes_read = self._inode = 0
        self._torn = False  # by a power failure
        self.read_on()

    def read_on(self) -> bool:
        """Read the lines that were added since; False if the file is another one by now."""
        try:
            with open_file(self.path) as stream:
                known = os.fstat(stream.fileno())
                if self._inode and (
                    self._inode != known.st_ino or self._bytes_read > known.st_size
                ):
                    return False
                stream.seek(self._bytes_read)
                added = stream.read()
        except OSError:
            return not self._inode
        self._inode = known.st_ino
        self._bytes_read += added.rfind(b"\n") + 1
        self._torn = bool(added) and not added.endswith(b"\n")
        for line in added.decode("utf-8", "surrogateescape").splitlines():
            self._lines += 1
            self._parse(line)
        return True

    def _parse(self, line: str) -> None:
        try:
            entry = parse_json(line)
            name = str(entry.pop("name"))
            if not is_file_name(name):
                return  # of another folder: not by docdepth
            if entry:
                self._records[name] = _checked(entry)
            else:
                self._records.pop(name, None)
        except (ValueError, TypeError, AttributeError, KeyError):
            pass  # cut off by a power failure: its file counts as not written

    def create(self) -> None:
        """Make an empty file of records if there is none."""
        self._append("")

    def __contains__(self, name: str) -> bool:
        return name in self._records

    def names(self) -> list[str]:
        """Files that have a record."""
        return list(self._records)

    def add(self, name: str, written: Written, key: dict[str, str]) -> None:
        """Note a file; called before it gets its name."""
        text = sys.intern(json.dumps(key))
        record = _Record(written.size, written.time, written.checksum, text)
        with self._lock:
            self._append(_line(name, record))
            self._records[name] = record

    def invalidate(self, name: str) -> None:
        """Note that a file of docdepth is to be made again."""
        self.add(name, Written(-1, -1, -1), {})

    def drop(self, name: str) -> None:
        """Note that a file has been deleted."""
        with self._lock:
            if self._records.pop(name, None) is not None:
                self._append(_line(name, None))

    def _append(self, line: str) -> None:
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            with self.path.open("ab") as stream:
                stream.write(("\n" * (self._torn and bool(line)) + line).encode())
        except OSError as error:
            raise RunError(
                f"cannot write {self.path}: {error.strerror}; make room or choose another folder "
                "and run the same command again; it continues where it stopped"
            ) from error
        self._torn &= not line
        self._lines += bool(line)

    def compact(self) -> None:
        """Write the records anew if most lines are outdated."""
        with self._lock:
            if self._lines <= 2 * len(self._records) + 100:
                return
            lines = [_line(name, record) for name, record in self._records.items()]
            part = self.path.with_name(self.path.name + ".part")
            part.write_text("".join(lines))
            os.replace(part, self.path)
            self._lines = len(lines)

    def recorded_key(self, name: str) -> dict[str, str]:
        """What a file was made of, a hash for each stage, whatever has become of the file."""
        found: dict[str, str] = json.loads(self._records[name].key) if name in self._records else {}
        return found

    def size(self, name: str) -> int:
        """Bytes of a file; 0 without a record."""
        return max(self._records[name].size, 0) if name in self._records else 0

    def is_foreign(self, name: str) -> bool:
        """Whether docdepth did not write a file, or somebody has changed it since."""
        record = self._records.get(name)
        return record is None or (record.size >= 0 and self.state(name) == "damaged")

    def state(self, name: str, verify: bool = False) -> FileState:
        """Compare a file with its record.

        Parameters
        ----------
        verify : bool
            Compare the content also where size and time are those of the record.
        """
        record = self._records.get(name)
        if record is None:
            return "unknown"
        if verify or record.state is None:
            path = self._folder / name
            try:
                known = os.stat(path)
                same = known.st_size == record.size
                if same and (verify or known.st_mtime_ns != record.time):
                    same = checksum(path) == record.checksum
                record.state = "whole" if same else "damaged"
            except FileNotFoundError:
                record.state = "missing"
            except OSError:
                record.state = "damaged"
        return record.state


_shared: dict[tuple[str, Path], FileRecords] = {}
_sharing = Lock()
_MOST_SHARED = 32  # folders


def shared_records(folder: Path, path: Path, writer: str) -> FileRecords:
    """Records that are only read: each chunk of a worker reads what was added since the last.

    ``writer`` names the process that writes them: another one may have begun a new file under an
    old name, inode included.
    """
    with _sharing:
        records = _shared.get((writer, path))
        if records is None or not records.read_on():
            if len(_shared) >= _MOST_SHARED:  # of other runs
                _shared.clear()
            records = _shared[writer, path] = FileRecords(folder, path)
        return records


def is_file_name(name: str) -> bool:
    """Whether a name leads to no other folder."""
    return name == os.path.basename(name) and name not in ("", ".", "..")


def _checked(entry: dict[str, Any]) -> _Record:
    """The record of a line; one whose entries are of other types is refused."""
    key, numbers = entry.pop("key"), entry.values()
    if not all(type(number) is int for number in numbers) or not isinstance(key, dict):
        raise TypeError
    if not all(isinstance(text, str) for text in key.values()):
        raise TypeError
    return _Record(**entry, key=sys.intern(json.dumps(key)))
