"""Makes runs again with many parameter sets and scores each."""

from __future__ import annotations

import contextlib
import json
import shutil
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from docdepth._core import __version__
from docdepth.concurrency import Progress, null_progress
from docdepth.config import Parameters
from docdepth.errors import ConfigError, RunError
from docdepth.io.atomic import write_atomically
from docdepth.io.run_folder import RunFolder, stage_key
from docdepth.pipeline.plan import require
from docdepth.tuning.judge import Judge
from docdepth.tuning.results import Outcome, write_csv
from docdepth.tuning.trial_run import make_trial
from docdepth.tuning.trials import Trial

_TRIALS = ".docdepth-trials"
"""Folder of the trials' run folders, which are deleted: nothing of the user's may lie there."""


def tune(
    runs: Sequence[Path],
    judges: Sequence[Judge],
    trials: Sequence[Trial],
    out: Path,
    jobs: int = 1,
    threads: int = 0,
    progress: Progress | None = None,
) -> list[Outcome]:
    """Make runs again with each parameter set, and score each.

    A trial is a run folder of its own in ``out``, which shares the files of its run and makes again
    what its parameters change, as ``docdepth run`` does. It is deleted once it is scored; its score
    stays, so the same call continues a search that was interrupted.

    Parameters
    ----------
    runs : sequence of Path
        Run folders; they are only read.
    judges : sequence of Judge
        Of each run; all of one kind.
    trials : sequence of Trial
    out : Path
        Folder of the results: ``tune.csv``, and a JSON file for each run and trial.
    jobs : int
        Number of trials that run at the same time.
    threads : int
        Threads per trial; 0 uses all cores.
    progress : callable, optional
        Called with ``"trials"``, the trials done and their number.

    Returns
    -------
    list of Outcome
        Run by run, in the order of ``trials``.

    Raises
    ------
    ConfigError
        Two trials have the same name, a name cannot name a folder, a parameter is unknown or
        cannot matter to the judge, or ``out`` lies in a run.
    RunError
        What trials share with a run is missing or out of date.
    DatasetError
        The truth or the recording is not there.
    """
    names = [trial.name for trial in trials]
    for name in names:
        if names.count(name) > 1 or not name.strip(".") or set(name) & set("/\\\0"):
            raise ConfigError(f"{name!r} cannot name a trial: names must be unique folder names")
    tasks = []
    for k, (run, judge) in enumerate(zip(runs, judges, strict=True), 1):
        if out.resolve().is_relative_to(run.resolve()):
            raise ConfigError(f"{out} lies in the run {run}, which stays as it is")
        folder = out / f"{k}_{run.resolve().name}"
        source = RunFolder.open(run)
        chosen = [_checked(source, judge, trial) for trial in trials]
        judge.check(source)
        for stage in sorted({_shared(source.parameters, p, judge) for p in chosen}):
            require(source, stage)
        for trial, p in zip(trials, chosen, strict=True):
            tasks.append(_Task(run, judge, folder, trial, p, _state(source), threads))
    _run_tasks([task for task in tasks if task.outcome() is None], jobs, len(tasks), progress)
    outcomes = [found for task in tasks if (found := task.outcome()) is not None]
    write_csv(outcomes, judges[0].by, out / "tune.csv")
    return outcomes


def _checked(source: RunFolder, judge: Judge, trial: Trial) -> Parameters:
    """The parameters of a trial, if it can be made of this run and can change its score."""
    chosen, own = trial.parameters(source.parameters), source.parameters
    for name in trial.settings:
        stage = name.partition(".")[0]
        if stage == "output":
            raise trial.refused(f"{name} changes the files that are written, not the depth in them")
        if name != "preset" and stage not in judge.stages:
            raise trial.refused(f"{name} does not change labels; score by depth or left-out sweeps")
    if chosen.odometry != own.odometry and source.manifest.inputs is None:
        raise trial.refused(f"{source.path} was not made of a recording; its odometry is given")
    same = (chosen.ground, chosen.dynamics) == (own.ground, own.dynamics)
    inputs = source.manifest.inputs
    if inputs is not None and inputs.labels is not None and not same:
        raise trial.refused(f"the classes of {source.path} are given, not found")
    return chosen


def _shared(base: Parameters, chosen: Parameters, judge: Judge) -> str:
    """The last stage of the run that a trial may share: it comes before the first that differs."""
    if chosen.odometry != base.odometry or "render" not in judge.stages:
        return "odometry"
    same = (chosen.ground, chosen.dynamics) == (base.ground, base.dynamics)
    return "classify" if same else "odometry"


def _state(run: RunFolder) -> dict[str, Any]:
    """The keys of the stages that trials may share."""
    return {stage: run.stage(stage).key for stage in ("odometry", "classify")}


@dataclass(frozen=True)
class _Task:
    """One trial and everything that a worker process needs to make it."""

    run: Path
    judge: Judge
    out: Path
    trial: Trial
    parameters: Parameters
    state: dict[str, Any]
    threads: int

    @property
    def file(self) -> Path:
        return self.out / f"{self.trial.name}.json"

    @property
    def key(self) -> str:
        """Hash of all that the score depends on."""
        values = self.parameters.model_dump(mode="json")
        used = {stage: values[stage] for stage in (*self.judge.stages, "output")}
        judged = [str(self.judge), self.judge.truth_files()]
        return stage_key([__version__, self.state, judged], used)

    def outcome(self) -> Outcome | None:
        """The stored score, if it is of the same run, parameters, judge and version."""
        try:
            found = json.loads(self.file.read_text(encoding="utf-8"))
            if found["key"] != self.key:
                return None
            return Outcome(self.run.name, self.trial.name, self.trial.settings, found["metrics"])
        except (FileNotFoundError, ValueError, TypeError, KeyError):
            return None  # not there, or damaged

    def __call__(self) -> None:
        """Make the trial, score it, write the score and delete the trial."""
        path, key = self.out / _TRIALS / self.trial.name, self.key
        source, varied = RunFolder.open(self.run), set(self.trial.settings)
        make_trial(path, source, self.parameters, varied, key, self.judge, self.threads)
        metrics = self.judge.measure(path, self.threads)
        if _state(RunFolder.open(self.run)) != self.state:
            raise RunError(
                f"another command has changed {self.run} meanwhile; run the same command again"
            )
        content = json.dumps({"key": key, "metrics": metrics}, indent=1).encode()
        write_atomically(self.file, lambda stream: stream.write(content))
        shutil.rmtree(path)
        with contextlib.suppress(OSError):
            path.parent.rmdir()  # unless it holds another trial


def _run_tasks(tasks: list[_Task], jobs: int, total: int, progress: Progress | None) -> None:
    report, before = progress or null_progress, total - len(tasks)
    report("trials", before, total)
    if jobs <= 1 or len(tasks) <= 1:
        for k, task in enumerate(tasks, 1):
            task()
            report("trials", before + k, total)
        return
    # Spawned, not forked: a fork of a process with running threads can deadlock.
    with ProcessPoolExecutor(min(jobs, len(tasks)), get_context("spawn")) as pool:
        futures = [pool.submit(task) for task in tasks]
        try:
            for k, future in enumerate(as_completed(futures), 1):
                future.result()
                report("trials", before + k, total)
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
