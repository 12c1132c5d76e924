"""The run folder of one trial: it shares the files of the run, and makes again what differs."""

from __future__ import annotations

import copy
import os
import shutil
from pathlib import Path

from docdepth.config import Parameters
from docdepth.datasets.formats.docdepth_run import RunDataset
from docdepth.io.run_folder import RunFolder
from docdepth.pipeline.classify import run_classify
from docdepth.pipeline.odometry import run_odometry
from docdepth.pipeline.render import run_render
from docdepth.pipeline.run_inputs import known_poses, open_recording, register, run_cameras
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
    if trial.manifest.get("trial") != key:
        trial = _begin(path, source, parameters, varied, key)
    inputs = trial.manifest["source"]
    if parameters.odometry != source.parameters.odometry:
        recording = open_recording(inputs)
        run_odometry(trial, recording, known_poses(inputs, recording), threads=threads)
    run_classify(trial, threads)
    if judge.by == "depth":
        recording = open_recording(inputs) if inputs.get("dataset") else RunDataset(path)
        if not trial.cameras:
            register(trial, list(recording.cameras.values()))
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
    notes = source.notes.resolve()

    def not_shared(folder: str, names: list[str]) -> list[str]:
        top = Path(folder) in (root, notes)
        return [name for name in names if top and name in _NOT_SHARED]

    shutil.copytree(root, path, copy_function=os.symlink, ignore=not_shared)
    records = source.notes / "records"
    trial = RunFolder(path)
    if records.is_dir():
        shutil.copytree(records, trial.notes / "records")
    trial.manifest = copy.deepcopy(source.manifest)
    trial.manifest |= {"trial": key, "parameters": parameters.model_dump(mode="json")}
    for camera in trial.cameras.values():
        own = camera.get("settings", {})
        # A preset replaces everything but the kind of files.
        preset = "preset" in varied
        camera["settings"] = {
            name: value
            for name, value in own.items()
            if name not in varied and not (preset and name.startswith("render."))
        }
    trial.save()  # last: without it, the trial is begun anew
    return trial
