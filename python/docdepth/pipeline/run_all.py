"""Every recording of a data set, one run each."""

from __future__ import annotations

import logging
import traceback
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from docdepth.concurrency import Progress, null_progress
from docdepth.datasets import find_recordings, open_dataset
from docdepth.errors import ConfigError, DatasetError, DocDepthError, RunError
from docdepth.pipeline.memory import bytes_of
from docdepth.pipeline.parallel import WorkerPool
from docdepth.pipeline.run import run
from docdepth.pipeline.virtual_camera import parse_size

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class RecordingResult:
    """How the run of a recording has ended.

    Attributes
    ----------
    recording, folder : Path
        The recording and its run folder.
    error : Exception, optional
        Why it failed; None if all is done.
    """

    recording: Path
    folder: Path
    error: Exception | None


def run_all(
    root: Path | str,
    output: Path | str,
    *,
    threads: int = 0,
    jobs: int = 1,
    scheduler: str | None = None,
    progress: Progress | None = None,
    **options: Any,
) -> list[RecordingResult]:
    """Turn every recording below a folder into depth maps, the longest first.

    Where there are as many recordings as workers, or more, each worker makes whole runs; else all
    workers share one run after the other. A recording that fails does not stop the others.

    Parameters
    ----------
    root : Path
        A folder with recordings below it.
    output : Path
        The run of ROOT/SOME/RECORDING is in OUTPUT/SOME/RECORDING.
    threads, jobs, scheduler, progress, **options
        As for :func:`docdepth.pipeline.run.run`. ``progress`` also gets the recordings that are
        done.

    Returns
    -------
    list of RecordingResult
        Of each recording, the longest first.

    Raises
    ------
    DatasetError
        There is no recording below the folder.
    """
    places = _longest_first(Path(root), Path(output), options)
    folders = [Path(output) / place.relative_to(Path(root)) for place in places]
    report = progress or null_progress
    ended: dict[int, RecordingResult] = {}
    report("recordings", 0, len(places))
    with WorkerPool(threads, jobs, scheduler) as workers:
        if not workers.inline and len(places) >= workers.count:
            alone = {**options, "threads": workers.threads_each(len(places))}
            if options.get("memory") is not None and scheduler is None:
                alone["memory"] = str(bytes_of(options["memory"]) // jobs)
            found = _whole_runs(workers, places, folders, alone)
        else:
            shared = {"threads": threads, "jobs": jobs, "scheduler": scheduler}
            one = partial(_run_one, options={**options, **shared, "progress": progress})
            found = enumerate(map(one, zip(places, folders, strict=True)))
        for number, error in found:
            ended[number] = RecordingResult(places[number], folders[number], error)
            report("recordings", len(ended), len(places))
    return [ended[number] for number in range(len(places))]


def _longest_first(root: Path, output: Path, options: dict[str, Any]) -> list[Path]:
    """The recordings below a folder, without runs that are made there."""
    made = output.resolve()
    found = [
        place
        for place in find_recordings(root, options.get("dataset"))
        if made not in (place.resolve(), *place.resolve().parents)
    ]
    if not found:
        raise DatasetError(f"there is no recording below {root}; name another folder")
    if root in found:
        raise ConfigError(
            f"{root} is a recording itself", f"run it alone: `docdepth.run({str(root)!r}, RUN)`"
        )
    lengths = {place: _length(place, options) for place in found}
    return sorted(found, key=lambda place: -lengths[place])


def _length(place: Path, options: dict[str, Any]) -> int:
    """Sweeps of a recording; 0 if it does not open, which its run explains."""
    size = parse_size(options.get("image_size"))
    try:
        return len(open_dataset(place, options.get("dataset"), size, options.get("frames")))
    except DocDepthError:
        return 0


def _whole_runs(
    workers: WorkerPool, places: list[Path], folders: list[Path], options: dict[str, Any]
) -> Iterator[tuple[int, Exception | None]]:
    """Number and error of each run, as they end."""
    left = set(range(len(places)))
    pairs = [(p.absolute(), f.absolute()) for p, f in zip(places, folders, strict=True)]
    try:
        for number, error in workers.map(partial(_run_one, options=options), pairs):
            left.remove(number)
            yield number, error
    except RunError as error:  # a worker has died
        yield from ((number, error) for number in left)


def _run_one(place: tuple[Path, Path], options: dict[str, Any]) -> Exception | None:
    """Run a recording into a folder; what stopped it."""
    recording, folder = place
    try:
        run(recording, folder, **options)
    except (DocDepthError, OSError, MemoryError) as error:
        log.warning("%s failed: %s", recording, error)
        return error
    except Exception:  # a mistake of docdepth's own stops no other recording either
        return RuntimeError(traceback.format_exc())
    return None
