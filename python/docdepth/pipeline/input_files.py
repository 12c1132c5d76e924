"""The identity of the files that a run reads: names, sizes, times, and on request the content."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable
from pathlib import Path

from docdepth.datasets.base import CameraStream, Dataset
from docdepth.datasets.files import ImageSource, file_of
from docdepth.errors import DatasetError
from docdepth.io.run_folder import RunFolder, stage_key

_Known = dict[str, list[int | str]]
_NOTES = "inputs.json"
"""By name size and time of each file, and perhaps its hash and the time of its state."""


class InputFiles:
    """What is known of the files of a recording.

    Parameters
    ----------
    run : RunFolder
        Its inputs say whether contents are hashed (``hash_inputs``). The hash of a file that nobody
        has written since, by the time that the system notes of it, is that of an earlier command.
    """

    def __init__(self, run: RunFolder) -> None:
        self._run = run
        self._hashed = run.manifest.inputs is not None and run.manifest.inputs.hash_inputs
        self._before = {what: _known(entry) for what, entry in run.read_notes(_NOTES).items()}
        self._now: dict[str, _Known] = {}

    def sweeps(self, recording: Dataset) -> str:
        """Hash of the identity of all files that sweeps are read from."""
        files = (file for index in range(len(recording)) for file in recording.sweep_files(index))
        return self._identify("sweeps", files, recording.path)

    def images(self, stream: CameraStream) -> list[str]:
        """The identity of each image of a camera; empty strings where there are none."""
        if not stream.images:
            return [""] * len(stream.names)
        name = f"images of {stream.name}"
        self._identify(name, stream.images, stream.images[0].parent)
        return [stage_key(self._identity(known)) for known in self._now[name].values()]

    def labels(self, files: Iterable[Path], folder: Path) -> str:
        """Hash of the identity of files of given labels."""
        return self._identify("labels", files, folder)

    def changed(self, what: str) -> list[str]:
        """Names of ``sweeps`` or ``labels`` that differ from those that were saved."""
        if what not in self._now:
            return []
        before, now = self._before.get(what, {}), self._now[what]
        return sorted(
            name
            for name in before.keys() | now.keys()
            if name not in before
            or name not in now
            or self._identity(before[name]) != self._identity(now[name])
        )

    def save(self) -> None:
        """Write what is known now."""
        before = self._run.read_notes(_NOTES)
        now = {**before, **self._now}
        if now != before:
            self._run.write_notes(_NOTES, now)

    def _identify(self, what: str, files: Iterable[ImageSource], root: Path) -> str:
        before: _Known = self._before.get(what, {})
        now: _Known = {}
        hashes: dict[Path, str] = {}  # a bag holds many sweeps and images
        for one in files:
            name, file = os.path.relpath(one, root), file_of(one)
            if name in now:
                continue
            try:
                known = file.stat()
                entry: list[int | str] = [known.st_size, known.st_mtime_ns]
                if self._hashed:
                    # Anybody can set the time of a change, but not that of a change of the file's
                    # state.
                    noted = before.get(name, [])
                    same = len(noted) > 3 and noted[3] == known.st_ctime_ns and noted[:2] == entry
                    if not same and file not in hashes:
                        hashes[file] = _hash(file)
                    entry += [noted[2] if same else hashes[file], known.st_ctime_ns]
            except OSError as error:
                raise DatasetError(
                    f"{file} cannot be read: {error.strerror}; put it back"
                ) from None
            now[name] = entry
        self._now[what] = now
        return stage_key([[name, self._identity(entry)] for name, entry in now.items()])

    def _identity(self, entry: list[int | str]) -> list[int | str]:
        """Size and time, or size and hash."""
        return [entry[0], entry[2]] if self._hashed and len(entry) > 2 else entry[:2]


def _known(files: object) -> _Known:
    """What was noted of files; nothing where someone has changed it."""
    entries = files.items() if isinstance(files, dict) else ()
    return {name: entry for name, entry in entries if isinstance(entry, list)}


def _hash(file: Path) -> str:
    found = hashlib.sha256()
    with file.open("rb") as stream:
        while data := stream.read(1 << 22):
            found.update(data)
    return found.hexdigest()
