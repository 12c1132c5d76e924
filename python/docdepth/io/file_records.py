"""Records of the files that docdepth wrote: what each was made of, and whether it is whole."""

from __future__ import annotations

import json
import os
import sys
import zlib
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from typing import Any, Literal

from docdepth.errors import RunError
from docdepth.io.atomic import Written
from docdepth.io.yaml_json import parse_json

FileState = Literal["whole", "damaged", "missing", "unknown"]
"""``unknown``: docdepth did not write the file, or its record is lost."""

_CHUNK = 1 << 22  # bytes that are read at once for a checksum


@dataclass(slots=True)  # a long drive has many
class _Record:
    size: int
    time: int
    checksum: int
    key: tuple[str, ...]
    """Names and values in turn: half the size of a dict."""
    state: FileState | None = None
    """What was found, so that nothing is read twice."""


def _flat(key: dict[str, str]) -> tuple[str, ...]:
    return tuple(sys.intern(str(part)) for item in key.items() for part in item)


def _entry(record: _Record) -> dict[str, object]:
    """A record as its line tells it."""
    known = {"size": record.size, "time": record.time, "checksum": record.checksum}
    return {**known, "key": _dict(record.key)}


def _dict(flat: tuple[str, ...]) -> dict[str, str]:
    return dict(zip(flat[::2], flat[1::2], strict=True))


class FileRecords:
    """The records of one folder.

    A line is added before a file gets its final name. So every file of docdepth has a record, also
    after a power failure, and a file that differs from its record was damaged or replaced.

    Parameters
    ----------
    folder : Path
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
            with self.path.open("rb") as stream:
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
        self._append_text("")

    def __contains__(self, name: str) -> bool:
        return name in self._records

    def names(self) -> list[str]:
        """Files that have a record."""
        return list(self._records)

    def add(self, name: str, written: Written, key: dict[str, str]) -> None:
        """Note a file; called before it gets its name."""
        record = _Record(written.size, written.time, written.checksum, _flat(key))
        with self._lock:
            self._append(name, _entry(record))
            self._records[name] = record

    def invalidate(self, name: str) -> None:
        """Note that a file of docdepth is to be made again."""
        self.add(name, Written(-1, -1, -1), {})

    def drop(self, name: str) -> None:
        """Note that a file has been deleted."""
        with self._lock:
            if self._records.pop(name, None) is not None:
                self._append(name, {})

    def _append(self, name: str, entry: dict[str, object]) -> None:
        self._append_text("\n" * self._torn + json.dumps({"name": name, **entry}) + "\n")
        self._torn = False
        self._lines += 1

    def _append_text(self, text: str) -> None:
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            with self.path.open("ab") as stream:
                stream.write(text.encode())
        except OSError as error:
            raise RunError(
                f"cannot write {self.path}: {error.strerror}; make room or choose another folder "
                "and run the same command again; it continues where it stopped"
            ) from error

    def compact(self) -> None:
        """Write the records anew if most lines are outdated."""
        with self._lock:
            if self._lines <= 2 * len(self._records) + 100:
                return
            records = self._records.items()
            lines = [json.dumps({"name": name, **_entry(r)}) + "\n" for name, r in records]
            part = self.path.with_name(self.path.name + ".part")
            part.write_text("".join(lines))
            os.replace(part, self.path)
            self._lines = len(lines)

    def key(self, name: str) -> dict[str, str]:
        """What a file was made of: a hash for each stage; empty if the file is not whole."""
        return _dict(self._records[name].key) if self.state(name) == "whole" else {}

    def recorded_key(self, name: str) -> dict[str, str]:
        """What the record of a file says, whatever has become of the file."""
        return _dict(self._records[name].key) if name in self._records else {}

    def size(self, name: str) -> int:
        """Bytes of a file; 0 without a record."""
        return max(self._records[name].size, 0) if name in self._records else 0

    def state(self, name: str, verify: bool = False) -> FileState:
        """Compare a file with its record.

        Parameters
        ----------
        name : str
        verify : bool
            Compare the content also where size and time are those of the record.
        """
        record = self._records.get(name)
        if record is None:
            return "unknown"
        if verify or record.state is None:
            record.state = self._compare(name, record, verify)
        return record.state

    def _compare(self, name: str, record: _Record, verify: bool) -> FileState:
        path = self._folder / name
        try:
            known = os.stat(path)
            if known.st_size != record.size:
                return "damaged"
            if known.st_mtime_ns == record.time and not verify:
                return "whole"
            return "whole" if _checksum(path) == record.checksum else "damaged"
        except FileNotFoundError:
            return "missing"
        except OSError:
            return "damaged"


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
    return _Record(**entry, key=_flat(key))


def same_content(path: Path, written: Written) -> bool:
    """Whether a file is not there, or has the content of one that was written."""
    try:
        same_size = path.stat().st_size == written.size
        return same_size and _checksum(path) == written.checksum
    except FileNotFoundError:
        return True
    except OSError:
        return False


def _checksum(path: Path) -> int:
    checksum = 0
    with path.open("rb") as stream:
        while data := stream.read(_CHUNK):
            checksum = zlib.crc32(data, checksum)
    return checksum
