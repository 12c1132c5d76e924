"""The run folder of one trial: it shares the files of the run, and makes again what differs."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

from docdepth.config import Parameters
from docdepth.io.run_folder import RunFolder
from docdepth.pipeline.classify import run_classify
from docdepth.pipeline.odometry import run_odometry
from docdepth.pipeline.render import run_render
from docdepth.pipeline.run_cameras import add_cameras, run_cameras
from docdepth.pipeline.run_inputs import known_poses, open_recording, recording_of
from docdepth.tuning.judge import Judge

_NOT_SHARED = ("run.yaml", "lock", "records", "odometry", "map")
"""Odometry's checkpoints belong to its parameters; records and run.yaml are copied."""


def make_trial(
    path: Path,
    source: RunFolder,
    parameters: Parameters,
    varied: set[str],
    key: str,
    judge: Judge,
    threads: int,
) -> RunFolder:
    """Make all that the judge looks at.

    Files of the run that need not be made again are links to it. The run is only read: a stage
    never writes into a file but puts another in its place.

    Parameters
    ----------
    path : Path
        Folder of the trial; begun anew unless ``key`` made it.
    source : RunFolder
        The run.
    varied : set of str
        Dotted names of what the trial sets; they win over the own settings of a camera.
    key : str
        Hash of everything that the score depends on.
    """
    trial = RunFolder(path)
    if trial.manifest.trial != key:
        trial = _begin(path, source, parameters, varied, key)
    if parameters.odometry != source.parameters.odometry:
        recording = open_recording(trial.inputs, trial.manifest.derived)
        run_odometry(trial, recording, known_poses(trial.inputs, recording), threads=threads)
    run_classify(trial, threads)
    if judge.by == "depth":
        recording = recording_of(trial)
        if not trial.cameras:
            add_cameras(trial, list(recording.cameras.values()))
        name = trial.camera_in(trial.depth_folder(judge.camera))
        cameras = run_cameras(trial, recording, [name])
        run_render(trial, [camera.stream for camera in cameras], threads)
    return trial


def _begin(
    path: Path, source: RunFolder, parameters: Parameters, varied: set[str], key: str
) -> RunFolder:
    """A copy of a run with other parameters, whose results are links."""
    shutil.rmtree(path, ignore_errors=True)
    root = source.path.resolve()
    state = source.state_dir.resolve()

    def not_shared(folder: str, names: list[str]) -> list[str]:
        top = Path(folder) in (root, state)
        return [name for name in names if top and name in _NOT_SHARED]

    shutil.copytree(root, path, copy_function=os.symlink, ignore=not_shared)
    records = source.state_dir / "records"
    trial = RunFolder(path)
    if records.is_dir():
        shutil.copytree(records, trial.state_dir / "records")
    trial.manifest = source.manifest.model_copy(
        update={"trial": key, "parameters": parameters}, deep=True
    )
    for name, camera in trial.cameras.items():
        # A preset replaces everything but the kind of files.
        preset = "preset" in varied
        settings = {
            setting: value
            for setting, value in camera.settings.items()
            if setting not in varied and not (preset and setting.startswith("render."))
        }
        trial.cameras[name] = camera.model_copy(update={"settings": settings})
    trial.save()  # last: without it, the trial is begun anew
    return trial
