"""Makes runs again with many parameter sets and scores each."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from multiprocessing import get_context
from pathlib import Path

from docdepth._core import __version__
from docdepth.concurrency import Progress, map_unordered, null_progress
from docdepth.config import Parameters
from docdepth.errors import ConfigError, RunError
from docdepth.io.atomic import write_atomically
from docdepth.io.recorded_folder import STATE_DIR
from docdepth.io.run_folder import RunFolder, stage_key
from docdepth.io.untrusted import read_text
from docdepth.pipeline.cameras import add_cameras, run_cameras
from docdepth.pipeline.classify import run_classify
from docdepth.pipeline.odometry import run_odometry
from docdepth.pipeline.plan import require
from docdepth.pipeline.render import run_render
from docdepth.pipeline.run_inputs import known_poses, open_recording, recording_of
from docdepth.tuning.results import Outcome, write_csv
from docdepth.tuning.trials import LABELS, Objective, Trial

_TRIALS = ".docdepth-trials"
"""Folder of the trials' run folders, which are deleted: nothing of the user's may lie there."""

_NOT_SHARED = ("run.yaml", "lock", "odometry", "map")
"""Odometry's checkpoints belong to its parameters; run.yaml is written anew."""


def tune(
    runs: Sequence[Path],
    objectives: Sequence[Objective],
    trials: Sequence[Trial],
    out: Path,
    jobs: int = 1,
    threads: int = 0,
    progress: Progress = null_progress,
) -> list[Outcome]:
    """Make runs again with each parameter set, and score each.

    A trial is a run folder of its own in ``out``, which shares the files of its run and makes again
    what its parameters change, as ``docdepth run`` does. It is deleted once it is scored; its score
    stays, so the same call continues a search that was interrupted.

    Parameters
    ----------
    runs : sequence of Path
        Run folders; they are only read.
    objectives : sequence of Objective
        Of each run; all of one kind.
    out : Path
        Folder of the results: ``tune.csv``, and a JSON file for each run and trial.

    Returns
    -------
    list of Outcome
        Run by run, in the order of ``trials``.
    """
    names = [trial.name for trial in trials]
    for name in names:
        if names.count(name) > 1 or not name.strip(".") or set(name) & set("/\\\0"):
            raise ConfigError(f"{name!r} cannot name a trial: names must be unique folder names")
    tasks = []
    for k, (run, objective) in enumerate(zip(runs, objectives, strict=True), 1):
        if out.resolve().is_relative_to(run.resolve()):
            raise ConfigError(f"{out} lies in the run {run}, which stays as it is")
        source = RunFolder.open(run)
        own, state = source.parameters, _state(source)
        chosen = [_checked(source, objective, trial) for trial in trials]
        objective.check(source)
        shared = any(
            "render" in objective.stages and not _differing(own, p, *LABELS) for p in chosen
        )
        require(source, "classify" if shared else "odometry")
        folder = out / f"{k}_{run.resolve().name}"
        for trial, p in zip(trials, chosen, strict=True):
            tasks.append(_Task(run, objective, folder, trial, p, state, threads))
    _run_tasks([task for task in tasks if task.outcome() is None], jobs, len(tasks), progress)
    outcomes = [found for task in tasks if (found := task.outcome()) is not None]
    write_csv(outcomes, objectives[0].by, out / "tune.csv")
    return outcomes


def _checked(source: RunFolder, objective: Objective, trial: Trial) -> Parameters:
    """The parameters of a trial, if it can be made of this run and can change its score."""
    chosen, own, inputs = (
        trial.parameters(source.parameters),
        source.parameters,
        source.manifest.inputs,
    )
    for name in trial.settings:
        stage = name.partition(".")[0]
        if stage == "output":
            raise trial.refused(f"{name} changes the files that are written, not the depth in them")
        if name != "preset" and stage not in objective.stages:
            raise trial.refused(f"{name} does not change labels; score by depth or left-out sweeps")
    if inputs is None and _differing(own, chosen, "odometry"):
        raise trial.refused(f"{source.path} was not made of a recording; its odometry is given")
    if inputs is not None and inputs.labels and _differing(own, chosen, "ground", "dynamics"):
        raise trial.refused(f"the classes of {source.path} are given, not found")
    return chosen


def _differing(own: Parameters, chosen: Parameters, *stages: str) -> bool:
    return any(getattr(own, stage) != getattr(chosen, stage) for stage in stages)


def _state(run: RunFolder) -> dict[str, object]:
    """The keys of the stages that trials may share."""
    return {stage: run.stage(stage).key for stage in ("odometry", "classify")}


@dataclass(frozen=True)
class _Task:
    """One trial and everything that a worker process needs to make it."""

    run: Path
    objective: Objective
    out: Path
    trial: Trial
    parameters: Parameters
    state: dict[str, object]
    threads: int

    @cached_property
    def key(self) -> str:
        """Hash of all that the score depends on."""
        values = self.parameters.model_dump(mode="json")
        used = {stage: values[stage] for stage in (*self.objective.stages, "output")}
        compared = [str(self.objective), self.objective.truth_files()]
        return stage_key([__version__, self.state, compared], used)

    def outcome(self) -> Outcome | None:
        """The stored score, if it is of the same run, parameters, objective and version."""
        try:
            found = json.loads(read_text(self._file))
            if found["key"] != self.key:
                return None
            return Outcome(self.run.name, self.trial.name, self.trial.settings, found["metrics"])
        except (FileNotFoundError, ValueError, TypeError, KeyError):
            return None  # not there, or damaged

    @property
    def _file(self) -> Path:
        return self.out / f"{self.trial.name}.json"

    def __call__(self) -> None:
        """Make the trial, score it, write the score and delete the trial."""
        source, path = RunFolder.open(self.run), self.out / _TRIALS / self.trial.name
        trial = RunFolder(path)
        if trial.manifest.trial != self.key:
            trial = self._begin(path, source)
        self._make(trial, source)
        metrics = self.objective.measure(path, self.threads)
        if _state(RunFolder.open(self.run)) != self.state:
            raise RunError(
                f"another command has changed {self.run} meanwhile; run the same command again"
            )
        content = json.dumps({"key": self.key, "metrics": metrics}, indent=1).encode()
        write_atomically(self._file, content)
        shutil.rmtree(path)
        with contextlib.suppress(OSError):
            path.parent.rmdir()  # unless it holds another trial

    def _begin(self, path: Path, source: RunFolder) -> RunFolder:
        """A copy of the run with the trial's parameters, which shares the files of its results.

        The run is only read: a stage never writes into a result but puts another in its place.
        """
        shutil.rmtree(path, ignore_errors=True)
        root, state = source.path.resolve(), source.state_dir.resolve()

        def not_shared(folder: str, names: list[str]) -> list[str]:
            return [n for n in names if Path(folder) in (root, state) and n in _NOT_SHARED]

        shutil.copytree(root, path, copy_function=_linked, ignore=not_shared)
        trial = RunFolder(path)
        changes = {"trial": self.key, "parameters": self.parameters}
        trial.manifest = source.manifest.model_copy(update=changes, deep=True)
        settings, preset = self.trial.settings, "preset" in self.trial.settings
        for name, camera in trial.cameras.items():
            # The trial wins over them; a preset replaces everything but the kind of files.
            kept = {
                key: value
                for key, value in camera.settings.items()
                if key not in settings and not (preset and key.startswith("render."))
            }
            trial.cameras[name] = camera.model_copy(update={"settings": kept})
        trial.save()  # last: without it, the trial is begun anew
        return trial

    def _make(self, trial: RunFolder, source: RunFolder) -> None:
        """Make all that the objective compares and that the parameters change."""
        if _differing(source.parameters, self.parameters, "odometry"):
            recording = open_recording(trial.inputs, trial.manifest.derived)
            poses = known_poses(trial.inputs, recording)
            run_odometry(trial, recording, poses, threads=self.threads)
        run_classify(trial, self.threads)
        if self.objective.by == "depth":
            recording = recording_of(trial)
            if not trial.cameras:
                add_cameras(trial, list(recording.cameras.values()))
            name = trial.camera_in(trial.depth_folder(self.objective.camera))
            cameras = run_cameras(trial, recording, [name])
            run_render(trial, [camera.stream for camera in cameras], self.threads)


def _run_tasks(tasks: list[_Task], jobs: int, total: int, progress: Progress) -> None:
    before = total - len(tasks)
    progress("trials", before, total)
    if jobs <= 1 or len(tasks) <= 1:
        for k, task in enumerate(tasks, 1):
            task()
            progress("trials", before + k, total)
        return
    # Spawned, not forked: a fork of a process with running threads can deadlock.
    with ProcessPoolExecutor(min(jobs, len(tasks)), get_context("spawn")) as pool:
        ended = map_unordered(pool, _Task.__call__, tasks, jobs)
        for k, _ in enumerate(ended, 1):
            progress("trials", before + k, total)


def _linked(source: str, copy: str) -> None:
    """Give a result another name; copy what docdepth adds to, and to another disk."""
    if STATE_DIR not in Path(source).parts:
        with contextlib.suppress(OSError):
            os.link(source, copy)
            return
    shutil.copy2(source, copy)
