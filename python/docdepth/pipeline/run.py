"""A whole run: every stage, from a recording to depth maps."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from docdepth.config import Parameters, replaced
from docdepth.datasets.base import Dataset
from docdepth.datasets.formats.docdepth_run import RunDataset
from docdepth.errors import (
    ConfigError,
    DamagedFileError,
    DatasetError,
    DocDepthError,
    OdometryError,
    RunError,
    log_findings,
    raise_findings,
)
from docdepth.io.manifest import SKIPPED, skipped_frames
from docdepth.io.run_folder import RunFolder
from docdepth.pipeline.check import check_inputs, check_opened
from docdepth.pipeline.classify import run_classify
from docdepth.pipeline.given_labels import open_labels, take_labels
from docdepth.pipeline.given_poses import poses_entry
from docdepth.pipeline.graph import outdated
from docdepth.pipeline.input_files import InputFiles
from docdepth.pipeline.kept_frames import choose_kept, delete_frames, keeps_only_results
from docdepth.pipeline.memory import keep_budget, parameters_within_budget, within_memory
from docdepth.pipeline.odometry import run_odometry
from docdepth.pipeline.render import run_render
from docdepth.pipeline.run_inputs import (
    known_poses,
    open_cameras,
    open_inputs,
    open_recording,
    open_upright,
    register,
    run_cameras,
)
from docdepth.pipeline.run_state import forget_cameras, require, states
from docdepth.pipeline.stage import Progress
from docdepth.pipeline.virtual_camera import check_name
from docdepth.pipeline.workers import Workers
from docdepth.render.backends import Renderer
from docdepth.visualization.report import index_is_whole

log = logging.getLogger(__name__)

_MOST_REPAIRS = 100
"""Damaged files that one command makes again when it comes upon them. More are a broken disk."""


def run(
    recording: Path | str,
    output: Path | str,
    parameters: Parameters | None = None,
    *,
    dataset: str | None = None,
    camera: str | Sequence[str] | None = None,
    poses: Path | str | None = None,
    camera_times: Path | str | None = None,
    calibration: Path | str | None = None,
    labels: Path | str | None = None,
    image_size: str | None = None,
    frames: str | None = None,
    on_error: str | None = None,
    keep: str | None = None,
    hash_inputs: bool = False,
    force: bool = False,
    dry_run: bool = False,
    threads: int = 0,
    jobs: int = 1,
    scheduler: str | None = None,
    memory: str | None = None,
    renderer: Renderer | None = None,
    progress: Progress | None = None,
) -> RunFolder:
    """Turn a recording into depth maps: odometry, ground, dynamics, rendering.

    The same call continues a run that was interrupted, and makes again what is missing, damaged or
    out of date.

    Parameters
    ----------
    recording : Path
        A recording: its folder, or its file.
    output : Path
        Run folder; it is created, or continued if it holds the same run.
    parameters : Parameters, optional
        Of all stages, from :func:`docdepth.parameters`.
    dataset : str, optional
        Format of the recording, as ``--dataset``: ``kitti_raw``, ``bag``, ``folder``; guessed if
        absent.
    camera : str or sequence of str, optional
        Cameras to render, ``all``, or ``none`` for poses and labels alone; the left colour camera
        if absent. Cameras that the run has already stay.
    poses : Path or str, optional
        File of LiDAR poses ``T_world_lidar`` (TUM, KITTI, PLY, NPY); ``CAMERA:FILE`` for those of
        a camera; ``dataset`` for the recording's own. Estimated if absent.
    camera_times : Path, optional
        Image times in seconds, one a line; those of the recording if absent.
    calibration : Path, optional
        ``calib.json`` of :mod:`docdepth.calibration`, or a text file of ``T_camera_lidar``, taken
        in place of the recording's own.
    labels : Path, optional
        Folder of labels of another method, ``NAME.label`` or ``NAME.npy`` for each sweep: nothing
        is classified then.
    image_size : str, optional
        ``WIDTHxHEIGHT`` in pixels, for recordings that do not tell it.
    frames : str, optional
        ``A:B``: sweeps A to B-1 only.
    on_error : {"stop", "skip"}, optional
        ``skip`` reads every sweep and image before the run begins and leaves broken ones out, as if
        they had not been recorded; status and report list them. As the run began if absent, else
        ``stop``.
    keep : {"frames", "results"}, optional
        What stays once all is done: the frames as well, which are made again if they were deleted,
        or all but them. They are four fifths of the bytes. As the run began if absent, else
        ``frames``.
    hash_inputs : bool
        Tell by their content whether inputs have changed, not by size and time.
    force : bool
        Continue a run that was started with other inputs or parameters. What they change is made
        again.
    dry_run : bool
        Check everything and make nothing; :func:`docdepth.pipeline.run_state.states` tells what
        would be made.
    threads : int
        Of all processes of this machine, 0 takes every core; of each worker of a cluster, 0 takes
        one. The result depends neither on it nor on who does the work.
    jobs, scheduler
        As for :class:`docdepth.pipeline.workers.Workers`. A script that asks for jobs needs the
        line ``if __name__ == "__main__":``.
    memory : str, optional
        ``4G``: the most that all processes together may take, by
        :func:`docdepth.pipeline.memory.within_memory`. As before if absent. The result is the same.
    renderer : Renderer, optional
        Draws the depth maps; the CPU if absent. All draw the same.
    progress : callable, optional
        ``progress(stage, done, total)``.

    Returns
    -------
    RunFolder

    Raises
    ------
    DocDepthError
        An input is missing or damaged, or the folder holds another run.
    """
    inputs: dict[str, Any] = {
        "dataset": _absolute(recording),
        "name": dataset,
        "camera": camera if camera is None or isinstance(camera, str) else list(camera),
        "poses": poses_entry(poses),
        "camera_times": _absolute(camera_times),
        "image_size": image_size,
        "frames": frames,
    }
    further = {"calibration": _absolute(calibration), "labels": _absolute(labels)}
    inputs |= {name: place for name, place in further.items() if place is not None}
    values, place = parameters or Parameters(), Path(output)
    begun = RunFolder(place).manifest.get("source")
    if on_error not in (None, "stop", "skip"):
        raise ConfigError(f"on_error is {on_error!r}; it must be stop or skip")
    if on_error == "skip" or (on_error is None and SKIPPED in (begun or {})):
        inputs[SKIPPED] = {}
    with _all_problems(inputs, values, place):
        opened, streams = open_upright(inputs, begun)
        if memory is not None:
            within = within_memory(memory, opened, streams, values, jobs)
    folder = RunFolder(place)  # another command may have begun the run meanwhile
    inputs["dataset"] = _absolute(opened.path)  # a folder that holds one recording may be given
    if hash_inputs or folder.manifest.get("source", {}).get("hash_inputs"):
        inputs["hash_inputs"] = True  # for good: a run compares as it began
    _follow_recording(folder, opened)
    folder.start(inputs, values, force)
    choose_kept(folder, keep)
    if memory is not None:
        keep_budget(folder, within)
    register(folder, streams)
    if labels is not None:
        open_labels(folder)
    _make(folder, opened, Workers(threads, jobs, scheduler), dry_run, renderer, progress)
    return folder


def continue_run(
    output: Path | str,
    *,
    keep: str | None = None,
    dry_run: bool = False,
    threads: int = 0,
    jobs: int = 1,
    scheduler: str | None = None,
    renderer: Renderer | None = None,
    progress: Progress | None = None,
) -> RunFolder:
    """Make what is missing, damaged or out of date in a run, with the inputs that run.yaml names.

    Parameters
    ----------
    output : Path
        Run folder.
    keep, dry_run, threads, jobs, scheduler, renderer, progress
        As for :func:`run`.

    Raises
    ------
    DocDepthError
        There is no run, or an input is missing or damaged.
    """
    folder = RunFolder.open(Path(output))
    source = folder.manifest["source"]
    if not source:
        raise RunError(f"{output} was not made of a recording; there is nothing to continue")
    _check_place(folder)
    choose_kept(folder, keep)
    with _all_problems(source, folder.parameters, folder.path):
        recording, _ = open_inputs(source)
    _make(folder, recording, Workers(threads, jobs, scheduler), dry_run, renderer, progress)
    return folder


def render_again(
    output: Path | str,
    changes: dict[str, Any] | None = None,
    camera: str | Sequence[str] | None = None,
    virtual: tuple[str, dict[str, Any]] | None = None,
    *,
    labels: Path | str | None = None,
    threads: int = 0,
    renderer: Renderer | None = None,
    progress: Progress | None = None,
) -> RunFolder:
    """Render with other parameters, of further cameras of the recording, or of a virtual camera.

    Parameters
    ----------
    output : Path
        Run folder with up to date classes.
    changes : dict, optional
        Parameters of the stages ``render`` and ``output`` by dotted name. They belong to the named
        cameras alone, or to the whole run if none is named.
    camera : str or sequence of str, optional
        Cameras of the recording to render; all cameras of the run if absent.
    virtual : (str, dict), optional
        Name and description of a virtual camera, from :func:`virtual_camera`.
    labels : Path, optional
        Folder of labels of another method, which replace the classes of the run.
    threads, renderer, progress
        As for :func:`run`.

    Raises
    ------
    RunError
        Classes are missing or out of date.
    ConfigError
        A parameter is refused, or a virtual camera has the name of another.
    """
    folder = RunFolder.open(Path(output))
    require(folder, "classify" if labels is None else "odometry")
    _check_place(folder)
    if labels is not None:
        folder.manifest["source"]["labels"] = _absolute(labels)
        open_labels(folder)
    source, changes = folder.manifest["source"], changes or {}
    recording = open_recording(source) if source else RunDataset(folder.path)
    named = _named_cameras(folder, recording, camera, virtual)
    new = [name for name in named if not folder.stage(f"render {name}")]
    if named:
        for name in named:
            folder.cameras[name]["settings"] |= changes
    else:
        values = replaced(folder.parameters, changes)
        folder.manifest["parameters"] = values.model_dump(mode="json")
    cameras = run_cameras(folder, recording, named or None)
    streams = [camera.stream for camera in cameras]
    try:
        if labels is not None:
            take_labels(folder, progress)
        run_render(folder, streams, threads, progress, renderer)
    except DocDepthError:
        forget_cameras(folder.path, new)
        raise
    return folder


def _named_cameras(
    folder: RunFolder,
    recording: Dataset,
    camera: str | Sequence[str] | None,
    virtual: tuple[str, dict[str, Any]] | None,
) -> list[str]:
    """Names of the cameras that were asked for, which the run knows from now on."""
    if virtual:
        name, description = virtual
        check_name(folder, name)
        folder.cameras[name] = {"folder": name, "virtual": description, "settings": {}}
        return [name]
    if camera is not None:
        streams = open_cameras(folder.manifest["source"], recording, camera)
        register(folder, streams)
        return [stream.name for stream in streams]
    if not folder.cameras:
        register(folder, list(recording.cameras.values()))
    return []


@contextmanager
def _all_problems(source: dict[str, Any], parameters: Parameters, output: Path) -> Iterator[None]:
    """If the inputs cannot be opened, tell all that is wrong with them."""
    try:
        yield
    except DocDepthError:
        raise_findings(check_inputs(source, parameters, output))
        raise


def _check_place(folder: RunFolder) -> None:
    """Refuse to go on without the recording."""
    place = folder.manifest["source"].get("dataset")
    if place and not Path(place).exists():
        raise RunError(
            f"{place}, the recording of {folder.path}, is not there; if it was moved, say where "
            f"it is now: docdepth run RECORDING -o {folder.path}"
        )


def _follow_recording(folder: RunFolder, recording: Dataset) -> None:
    """If a run's recording lies elsewhere now, and is the same, note where."""
    source, place = folder.manifest.get("source", {}), _absolute(recording.path)
    if source.get("dataset") not in (None, place):
        sweeps = folder.made_of("odometry").get("sweeps")
        if sweeps == InputFiles(folder).sweeps(recording):
            source["dataset"] = place


def _check(folder: RunFolder, recording: Dataset, jobs: int) -> None:
    """Check all inputs of a run that has something to do; what is found is kept in run.yaml."""
    source, cameras = folder.manifest["source"], run_cameras(folder, recording)
    streams = [camera.stream for camera in cameras]
    values = parameters_within_budget(folder)
    report = check_opened(source, recording, streams, values, folder.path, jobs)
    raise_findings(report.findings)
    folder.manifest["warnings"] = [str(found) for found in report.findings]
    folder.manifest["estimate"] = report.summary
    log_findings(log, report.findings)


def _make(
    folder: RunFolder,
    recording: Dataset,
    workers: Workers,
    dry_run: bool,
    renderer: Renderer | None,
    progress: Progress | None,
) -> None:
    """Run each stage that has something to do, or check it alone."""
    if dry_run:
        return _check(folder, recording, workers.jobs)
    left = outdated(states(folder))
    if not left and index_is_whole(folder):
        if folder.manifest != RunFolder(folder.path).manifest:  # the recording was moved, or --keep
            with folder.lock("run"):
                folder.save()
        _delete_frames(folder)
        return
    if left:
        _check(folder, recording, workers.jobs)
    poses = known_poses(folder.manifest["source"], recording)
    with folder.lock("run"), workers:
        for _ in range(_MOST_REPAIRS):
            try:
                run_odometry(folder, recording, poses, progress, workers.threads)
                run_classify(folder, workers.threads, progress, workers)
                streams = [camera.stream for camera in run_cameras(folder, recording)]
                run_render(folder, streams, workers.threads, progress, renderer, workers)
                _delete_frames(folder)
                return
            except (DatasetError, OdometryError):
                # A file that was whole when the run began is not any more.
                shorter = _without_newly_broken(folder)
                if shorter is None:
                    raise
                recording = shorter
                poses = known_poses(folder.manifest["source"], recording)
            except DamagedFileError as error:
                # Size and time were those of its record. Now that it is known, it is made again.
                whole = folder.path.absolute()  # as workers name it
                if whole not in error.path.absolute().parents:
                    raise
                folder.forget(folder.path / error.path.absolute().relative_to(whole))
        raise RunError(
            f"more than {_MOST_REPAIRS} files of {folder.path} are damaged; check the disk"
        )


def _delete_frames(folder: RunFolder) -> None:
    """Delete the frames of a run that is done, if only its results are to stay."""
    if keeps_only_results(folder) and folder.records(folder.frame_path(0).parent).names():
        with folder.lock("run"):
            delete_frames(folder)


def _without_newly_broken(folder: RunFolder) -> Dataset | None:
    """The recording without frames that broke meanwhile; None if there are none, or if they stop
    the run."""
    source = folder.manifest["source"]
    if SKIPPED not in source:
        return None
    before, source[SKIPPED] = source[SKIPPED], {}
    recording, _ = open_inputs(source)
    if skipped_frames(source[SKIPPED]) == skipped_frames(before):
        return None
    folder.save()
    return recording


def _absolute(path: Path | str | None) -> str | None:
    if not isinstance(path, str | os.PathLike | None):
        raise ConfigError(f"a {type(path).__name__} is not a path; give that of its folder or file")
    return None if path is None else str(Path(path).resolve())
