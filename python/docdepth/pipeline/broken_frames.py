"""Broken sweeps and images: ``--on-error skip`` finds them before a run begins and leaves them out.

run.yaml names them (:class:`SkippedFrames`). A run that does not skip stops at the first of them.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from docdepth.datasets import CameraStream, Dataset, FrameRange
from docdepth.datasets.files import file_of
from docdepth.diagnostics.sweeps import check_sweep
from docdepth.errors import DatasetError, DocDepthError
from docdepth.io.inputs import SkippedFrames
from docdepth.io.run_folder import stage_key

log = logging.getLogger(__name__)

_MOST = 0.5  # of the sweeps of a recording; if more are broken, it is not the sweeps


def find_broken(
    recording: Dataset,
    cameras: Sequence[CameraStream],
    known: SkippedFrames | None = None,
) -> SkippedFrames:
    """Read every sweep and image once, and tell which are broken.

    Parameters
    ----------
    recording : Dataset
        The part of the recording that the run is of.
    cameras : sequence of CameraStream
        Whose images are wanted.
    known : SkippedFrames, optional
        What was found before; it holds as long as the files are the same.
    """
    numbers = recording.indices if isinstance(recording, FrameRange) else range(len(recording))
    checked = stage_key(list(_identities(recording, cameras)), list(numbers))
    if known is not None and known.checked == checked:
        return known
    log.info("every sweep and image is read, to find broken ones")
    sweeps: dict[int, str] = {}
    for k, number in enumerate(numbers):
        problem = _problem(partial(_check_sweep, recording, k))
        if problem:
            sweeps[number] = problem
    if len(sweeps) > _MOST * len(recording):
        raise DatasetError(
            f"{len(sweeps)} of {len(recording)} sweeps are broken, which is more than frames that "
            f"can be left out; the first: {next(iter(sweeps.values()))}"
        )
    images: dict[str, dict[str, str]] = {}
    for stream in cameras:
        for k, name in enumerate(stream.names if stream.images else []):
            problem = _problem(partial(stream.image, k))
            if problem:
                images.setdefault(stream.name, {})[name] = problem
    found = SkippedFrames(checked=checked, sweeps=sweeps, images=images)
    for text in found.sentences():
        log.warning("left out: %s", text)
    return found


def _check_sweep(recording: Dataset, index: int) -> None:
    """Raise what would stop a run at a sweep."""
    sweep = recording.sweep(index)
    files = recording.sweep_files(index)
    check_sweep(sweep, f"{files[0] if files else sweep.name} (frame {index})")


def _problem(read: Callable[[], object]) -> str:
    """What is wrong with what ``read`` reads; empty if nothing is."""
    try:
        read()
    except DocDepthError as error:
        return str(error)
    except OSError as error:
        return f"{error.filename or 'a file'} cannot be read ({error.strerror})"
    return ""


def _identities(recording: Dataset, cameras: Iterable[CameraStream]) -> Iterable[Any]:
    """Name, size and time of every file; None where there is none."""
    seen: set[Path] = set()
    sweeps = (file for k in range(len(recording)) for file in _files(recording, k))
    images = (file_of(image) for stream in cameras for image in stream.images)
    for file in (*sweeps, *images):
        if file not in seen:
            seen.add(file)
            try:
                status = file.stat()
                yield str(file), status.st_size, status.st_mtime_ns
            except OSError:
                yield str(file), None


def _files(recording: Dataset, index: int) -> list[Path]:
    try:
        return recording.sweep_files(index)
    except DocDepthError:
        return []
