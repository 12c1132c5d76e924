"""A whole run: every stage, from a recording to depth maps."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from docdepth.concurrency import null_progress
from docdepth.config import Parameters, Settings, replaced
from docdepth.datasets.base import Dataset
from docdepth.errors import (
    DamagedFileError,
    DatasetError,
    DocDepthError,
    OdometryError,
    RunError,
    log_findings,
    raise_findings,
)
from docdepth.io.inputs import RunInputs
from docdepth.io.manifest import Keep
from docdepth.io.run_folder import RunFolder
from docdepth.pipeline.camera_fit import cameras_to_fit, fit_cameras
from docdepth.pipeline.cameras import RunCamera, add_cameras, run_cameras
from docdepth.pipeline.check import check_inputs, check_opened, misfit_of_poses
from docdepth.pipeline.classify import open_labels, run_classify
from docdepth.pipeline.execution import (
    Execution,
    parameters_within_budget,
    store_memory_budget,
    within_memory,
)
from docdepth.pipeline.odometry import run_odometry
from docdepth.pipeline.plan import InputFiles, plan
from docdepth.pipeline.render import run_render
from docdepth.pipeline.run_inputs import check_place, known_poses, open_as_begun, open_inputs
from docdepth.pipeline.run_reader import Run
from docdepth.pipeline.stage import Stage
from docdepth.visualization.report import index_is_whole

log = logging.getLogger(__name__)

_MOST_REPAIRS = 100
"""Damaged files that one command makes again when it comes upon them. More are a broken disk."""


def run(
    inputs: RunInputs | Path | str,
    output: Path | str,
    parameters: Parameters | None = None,
    execution: Execution | None = None,
    **options: Any,
) -> Run:
    """Turn a recording into depth maps: odometry, ground, dynamics, rendering.

    The same call continues a run that was interrupted, and makes again what is missing, damaged or
    out of date.

    ``run("drive", "run", frames="0:40", jobs=4)`` is short for
    ``run(RunInputs(recording="drive", frames="0:40"), "run", execution=Execution(jobs=4))``.

    Parameters
    ----------
    inputs : RunInputs or Path
        A recording, and what is taken in place of its own data; or the path of the recording.
    output : Path
        Run folder; it is created, or continued if it holds the same run.
    parameters : Parameters, optional
        Of all stages, from :func:`docdepth.parameters`.
    execution : Execution, optional
        Threads, jobs, memory, renderer, progress and what stays. The result does not depend on it.
    **options
        Fields of :class:`RunInputs` and :class:`Execution` by name.

    Returns
    -------
    Run
        To be read, as of :func:`docdepth.open_run`; there is nothing to read after a dry run.

    Raises
    ------
    DocDepthError
        An input is missing or damaged, or the folder holds another run.
    """
    inputs, execution = models_of(inputs, execution, options)
    return Run(run_stages(inputs, Path(output), parameters or Parameters(), execution).path)


def run_stages(
    inputs: RunInputs, place: Path, values: Parameters, execution: Execution
) -> RunFolder:
    """:func:`run` with all that it may be given; of a dry run the folder is not written."""
    begun = RunFolder(place).manifest
    inputs = _as_begun(inputs, begun.inputs)
    with _all_problems(inputs, values, place):
        known, before = (None, inputs) if begun.inputs is None else (begun.derived, begun.inputs)
        opened = open_inputs(inputs, known, before.keep_ego)
        if execution.memory is not None:
            recording, cameras, jobs = opened.recording, opened.cameras, execution.jobs
            within = within_memory(execution.memory, recording, cameras, values, jobs)
    folder = RunFolder(place)  # another command may have begun the run meanwhile
    # A folder that holds one recording may be given.
    inputs = _as_begun(inputs.but(recording=opened.recording.path), folder.manifest.inputs)
    _follow_recording(folder, opened.recording)
    folder.start(inputs, values, execution.force, opened.derived)
    choose_frames_kept(folder, execution.keep)
    if execution.memory is not None:
        store_memory_budget(folder, within)
    add_cameras(folder, opened.cameras)
    if inputs.labels is not None:
        open_labels(folder)
    _make(folder, opened.recording, execution)
    return folder


def models_of(
    inputs: RunInputs | Path | str, execution: Execution | None, options: dict[str, object]
) -> tuple[RunInputs, Execution]:
    """Both models, with the fields that were named one by one."""
    of_inputs = {name: v for name, v in options.items() if name in RunInputs.model_fields}
    others = {name: v for name, v in options.items() if name not in of_inputs}
    if isinstance(inputs, RunInputs):
        inputs = inputs.but(**of_inputs) if of_inputs else inputs
    else:
        inputs = RunInputs(recording=inputs, **of_inputs)
    return inputs, _execution(execution, others)


def _execution(execution: Execution | None, options: dict[str, object]) -> Execution:
    """With the fields that were named one by one."""
    if unknown := options.keys() - Execution.model_fields:
        raise TypeError(f"unexpected keyword argument {min(unknown)!r}")
    if execution is not None and not options:
        return execution
    return Execution(**(vars(execution) if execution else {}) | options)


def _as_begun(inputs: RunInputs, begun: RunInputs | None) -> RunInputs:
    """Inputs with what a run keeps from when it began."""
    if begun is None:
        return inputs
    on_error = inputs.on_error or begun.on_error
    return inputs.but(on_error=on_error, hash_inputs=inputs.hash_inputs or begun.hash_inputs)


def continue_run(
    output: Path | str,
    changes: Settings | None = None,
    execution: Execution | None = None,
    **options: Any,
) -> RunFolder:
    """Make what is missing, damaged or out of date in a run, with the inputs that run.yaml names.

    Parameters
    ----------
    output : Path
        Run folder.
    changes : dict, optional
        Parameters by dotted name that the run has from now on; its own if absent.
    execution : Execution, optional
        As for :func:`run`.
    **options
        Fields of :class:`Execution` by name.
    """
    folder, execution = RunFolder.open(Path(output)), _execution(execution, options)
    if folder.manifest.inputs is None:
        raise RunError(f"{output} was not made of a recording; there is nothing to continue")
    check_place(folder)
    folder.manifest.parameters = replaced(folder.parameters, changes or {})
    choose_frames_kept(folder, execution.keep)
    with _all_problems(folder.inputs, folder.parameters, folder.path):
        opened = open_as_begun(folder.inputs, folder.manifest.derived)
    folder.manifest.derived = opened.derived
    _make(folder, opened.recording, execution)
    return folder


@contextmanager
def _all_problems(inputs: RunInputs, parameters: Parameters, output: Path) -> Iterator[None]:
    """If the inputs cannot be opened, tell all that is wrong with them."""
    try:
        yield
    except DocDepthError:
        raise_findings(check_inputs(inputs, parameters, output).findings)
        raise


def _follow_recording(folder: RunFolder, recording: Dataset) -> None:
    """If a run's recording lies elsewhere now, and is the same, note where."""
    inputs, place = folder.manifest.inputs, recording.path.resolve()
    if inputs is not None and inputs.recording != place:
        sweeps = folder.stage_inputs("odometry").get("sweeps")
        if sweeps == InputFiles(folder).sweeps(recording):
            folder.manifest.inputs = inputs.but(recording=place)


def _check(folder: RunFolder, recording: Dataset, cameras: Sequence[RunCamera], jobs: int) -> None:
    """Check all inputs of a run that has something to do; what is found is kept in run.yaml."""
    streams = [camera.stream for camera in cameras]
    values = parameters_within_budget(folder)
    checked = check_opened(folder.inputs, recording, streams, values, folder.path, jobs)
    raise_findings(checked.findings)
    folder.manifest.warnings = [str(found) for found in checked.findings]
    folder.manifest.estimate = checked.summary
    log_findings(log, checked.findings)


def _make(folder: RunFolder, recording: Dataset, execution: Execution) -> None:
    """Run each stage that has something to do, or check it alone."""
    workers, progress = execution.workers(), execution.progress or null_progress
    are_fitted = not cameras_to_fit(folder, recording)
    poses, cameras = known_poses(folder.inputs, recording), run_cameras(folder, recording)
    if execution.dry_run:
        _check(folder, recording, cameras, workers.jobs)
        if folder.inputs.poses:
            log_findings(log, misfit_of_poses(folder.inputs.poses, recording, folder.parameters))
        return
    stages = plan(folder, recording, poses, cameras)
    is_done = all([stage.state().state == "done" for stage in stages])
    if is_done and are_fitted and index_is_whole(folder):
        _finish(folder, stages)
        return
    if not is_done:
        _check(folder, recording, cameras, workers.jobs)

    def draw(cameras: Sequence[RunCamera], stages: Sequence[Stage]) -> None:
        streams, renders = [c.stream for c in cameras], {s.name: s for s in stages[2:]}
        run_render(folder, streams, workers.threads, progress, execution.renderer, workers, renders)

    with folder.lock("run"), workers:
        folder.manifest.frames_deleted = None  # they are needed
        for _ in range(_MOST_REPAIRS):
            stages = plan(folder, recording, poses, cameras)
            try:
                run_odometry(folder, recording, poses, progress, workers.threads, stages[0])
                run_classify(folder, workers.threads, progress, workers, stages[1])
                draw(cameras, stages)
                if fit_cameras(folder, recording, progress):
                    cameras = run_cameras(folder, recording)
                    stages = plan(folder, recording, poses, cameras)
                    draw(cameras, stages)
                _finish(folder, stages)
                return
            except (DatasetError, OdometryError):
                # A file that was whole when the run began is not any more.
                shorter = _without_newly_broken(folder)
                if shorter is None:
                    raise
                recording = shorter
                poses = known_poses(folder.inputs, recording)
                cameras = run_cameras(folder, recording)
            except DamagedFileError as error:
                # Size and time were those of its record. Now that it is known, it is made again.
                whole = folder.path.absolute()  # as workers name it
                if whole not in error.path.absolute().parents:
                    raise
                folder.invalidate(folder.path / error.path.absolute().relative_to(whole))
        raise RunError(
            f"more than {_MOST_REPAIRS} files of {folder.path} are damaged; check the disk"
        )


def _finish(folder: RunFolder, stages: Sequence[Stage]) -> None:
    """Save run.yaml of a run that is done, where the recording was moved or a command was killed,
    and delete the frames if only results are to stay, or what an interrupted command left of them.
    """
    killed = [stage.name for stage in stages if folder.stage(stage.name).state == "running"]
    if killed or not folder.is_saved:
        with folder.lock("run"):
            for name in killed:
                folder.set_stage(name, state="done")
            folder.save()
    folders = folder.frame_path(0).parent, folder.classes_path(0).parent
    if folder.manifest.keep != "results" or not any(folder.records(f).names() for f in folders):
        return
    with folder.lock("run"):
        keys = {name: folder.stage(name).key for name in ("odometry", "classify")}
        folder.manifest.frames_deleted = keys
        folder.save()  # before the first is gone: a run that is interrupted here misses none
        for where in folders:
            records = folder.records(where)
            for name in records.names():
                folder.remove(where / name)
            records.compact()


def _without_newly_broken(folder: RunFolder) -> Dataset | None:
    """The recording without frames that broke meanwhile; None if there are none, or if they stop
    the run."""
    before = folder.manifest.derived
    if before.skipped is None:
        return None
    opened = open_as_begun(folder.inputs, before.model_copy(update={"skipped": None}))
    now = opened.derived.skipped
    if now is None or now.sentences() == before.skipped.sentences():
        return None
    folder.manifest.derived = opened.derived
    folder.save()
    return opened.recording


def choose_frames_kept(run: RunFolder, keep: Keep | None) -> None:
    """Note what stays once all is done; as before if it is None."""
    run.manifest.keep = keep or run.manifest.keep
    if run.manifest.keep != "results":
        run.manifest.frames_deleted = None  # so its frames are missing
