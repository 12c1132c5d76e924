"""Every recording of a data set, one run each."""

from __future__ import annotations

import logging
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from docdepth.concurrency import null_progress
from docdepth.config import Parameters
from docdepth.datasets import find_recordings, open_dataset
from docdepth.errors import ConfigError, DatasetError, DocDepthError, RunError
from docdepth.io.inputs import RunInputs
from docdepth.pipeline.cameras import parse_size
from docdepth.pipeline.execution import Execution, bytes_of
from docdepth.pipeline.parallel import WorkerPool
from docdepth.pipeline.run import models_of, run_stages

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
    inputs: RunInputs | Path | str,
    output: Path | str,
    parameters: Parameters | None = None,
    execution: Execution | None = None,
    **options: Any,
) -> list[RecordingResult]:
    """Turn every recording below a folder into depth maps, the longest first.

    Where there are as many recordings as workers, or more, each worker makes whole runs; else all
    workers share one run after the other. A recording that fails does not stop the others.

    Parameters
    ----------
    inputs : RunInputs or Path
        As for :func:`docdepth.pipeline.run.run`, with a folder of recordings as recording.
    output : Path
        The run of ROOT/SOME/RECORDING is in OUTPUT/SOME/RECORDING.
    parameters, execution, **options
        As for :func:`docdepth.pipeline.run.run`. ``progress`` also gets the recordings that are
        done.

    Returns
    -------
    list of RecordingResult
        Of each recording, the longest first.
    """
    inputs, execution = models_of(inputs, execution, options)
    root, output = inputs.recording, Path(output).resolve()
    places = _longest_first(inputs, output)
    folders = [output / place.relative_to(root) for place in places]
    pairs = list(zip(places, folders, strict=True))
    progress = execution.progress or null_progress
    ended: dict[int, RecordingResult] = {}
    progress("recordings", 0, len(places))
    with execution.workers() as workers:
        if not workers.inline and len(places) >= workers.count:
            alone = _for_one_worker(execution, workers.threads_each(len(places)))
            found = _whole_runs(workers, pairs, partial(_run_one, inputs, parameters, alone))
        else:
            found = enumerate(map(partial(_run_one, inputs, parameters, execution), pairs))
        for number, error in found:
            ended[number] = RecordingResult(places[number], folders[number], error)
            progress("recordings", len(ended), len(places))
    return [ended[number] for number in range(len(places))]


def _for_one_worker(execution: Execution, threads: int) -> Execution:
    """How a worker makes a whole run by itself."""
    memory = execution.memory
    if memory is not None and execution.scheduler is None:
        memory = str(bytes_of(memory) // execution.jobs)
    return execution.but(threads=threads, jobs=1, scheduler=None, memory=memory, progress=None)


def _longest_first(inputs: RunInputs, output: Path) -> list[Path]:
    """The recordings below a folder, without runs that are made there."""
    root = inputs.recording
    found = [
        place
        for place in find_recordings(root, inputs.dataset)
        if output not in (place.resolve(), *place.resolve().parents)
    ]
    if not found:
        raise DatasetError(f"there is no recording below {root}; name another folder")
    if root in found:
        raise ConfigError(
            f"{root} is a recording itself", f"run it alone: `docdepth.run({str(root)!r}, RUN)`"
        )
    lengths = {place: _length(place, inputs) for place in found}
    return sorted(found, key=lambda place: -lengths[place])


def _length(place: Path, inputs: RunInputs) -> int:
    """Sweeps of a recording; 0 if it does not open, which its run explains."""
    size = parse_size(inputs.image_size)
    try:
        return len(open_dataset(place, inputs.dataset, size, inputs.frames))
    except DocDepthError:
        return 0


def _whole_runs(
    workers: WorkerPool,
    pairs: list[tuple[Path, Path]],
    run_one: Callable[[tuple[Path, Path]], Exception | None],
) -> Iterator[tuple[int, Exception | None]]:
    """Number and error of each run, as they end."""
    left = set(range(len(pairs)))
    try:
        for number, error in workers.map(run_one, pairs):
            left.remove(number)
            yield number, error
    except RunError as error:  # a worker has died
        yield from ((number, error) for number in left)


def _run_one(
    inputs: RunInputs,
    parameters: Parameters | None,
    execution: Execution,
    pair: tuple[Path, Path],
) -> Exception | None:
    """Run a recording into a folder; what stopped it."""
    recording, folder = pair
    try:
        run_stages(inputs.but(recording=recording), folder, parameters or Parameters(), execution)
    except (DocDepthError, OSError, MemoryError) as error:
        log.warning("%s failed: %s", recording, error)
        return error
    except Exception:  # a mistake of docdepth's own stops no other recording either
        return RuntimeError(traceback.format_exc())
    return None
