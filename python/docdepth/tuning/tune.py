"""Runs the trials of a parameter search: in parallel processes, resumable."""

from __future__ import annotations

import contextlib
import json
import shutil
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from docdepth._core import __version__
from docdepth.config import Parameters
from docdepth.errors import ConfigError, DamagedFileError, RunError
from docdepth.io.atomic import write_atomically
from docdepth.io.run_folder import RunFolder, stage_key
from docdepth.pipeline.run_state import require
from docdepth.tuning.judges import Judge
from docdepth.tuning.results import Outcome, View, as_csv, means, table
from docdepth.tuning.trial_run import make_trial
from docdepth.tuning.trials import Trial, check_stages, parameters_of, refused

_TRIALS = ".docdepth-trials"
"""Folder of the trials' run folders. A trial is deleted once it is judged, so nothing of the user's
may lie there."""


def tune(
    run: Path,
    judge: Judge,
    trials: Sequence[Trial],
    out: Path,
    jobs: int = 1,
    threads: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> list[Outcome]:
    """Make a run again with each parameter set, and judge each.

    A trial makes the stages that its parameters change, and what follows from them as far as the
    judge looks at it. All else it shares with the run.

    Parameters
    ----------
    run : Path
        Run folder; it is only read.
    judge : LabelJudge, DepthJudge or HeldOutJudge
    trials : sequence of Trial
    out : Path
        Folder of the results: one JSON file per trial, ``tune.csv`` and ``tune.md``.
    jobs : int
        Number of trials that run at the same time. Their seconds are comparable only with 1.
    threads : int
        Threads per trial; 0 uses all cores.
    progress : callable, optional
        Called with the number of finished trials and the number of all trials.

    Returns
    -------
    list of Outcome
        In the order of ``trials``.

    Raises
    ------
    ConfigError
        Two trials have the same name, a name cannot name a folder, a parameter is unknown or
        cannot matter to the judge, or ``out`` lies in the run.
    RunError
        What trials share with the run is missing or out of date.
    DatasetError
        The truth or the recording is not there.
    """
    source = RunFolder.open(run)
    if out.resolve().is_relative_to(run.resolve()):
        raise ConfigError(f"{out} lies in the run {run}, which stays as it is; choose another -o")
    chosen = [_checked(source, judge, trial) for trial in trials]
    names = [trial.name for trial in trials]
    for name in names:
        if names.count(name) > 1 or not name.strip(".") or set(name) & set("/\\\0"):
            raise ConfigError(f"{name!r} cannot name a trial: names must be unique folder names")
    judge.check(source)
    # What all trials share must be up to date; the rest is made again in each.
    for stage in sorted({_shared(source.parameters, p, judge) for p in chosen}):
        require(source, stage)
    state = _state(source)
    made_of = [__version__, state["odometry"], source.made_of("odometry"), judge.made_of(source)]
    tasks = []
    for trial, p in zip(trials, chosen, strict=True):
        values = {stage: p.model_dump()[stage] for stage in (*judge.stages, "output")}
        key = stage_key(made_of, values)
        tasks.append(_Task(run, judge, out, trial, p, key, state, threads))
    remaining = [task for task in tasks if task.outcome() is None]
    _run_tasks(remaining, jobs, len(tasks), progress)
    with contextlib.suppress(OSError):
        (out / _TRIALS).rmdir()  # unless it holds an interrupted trial of another search
    outcomes = [found for found in (task.outcome() for task in tasks) if found is not None]
    _write(outcomes, judge.view, out)
    return outcomes


def tune_runs(
    runs: Sequence[Path],
    judges: Sequence[Judge],
    trials: Sequence[Trial],
    out: Path,
    jobs: int = 1,
    threads: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> list[Outcome]:
    """Try the same parameter sets on several runs, and average what is measured.

    Parameters
    ----------
    runs : sequence of Path
        Run folders of several drives.
    judges : sequence of Judge
        Of each run; all of one kind.
    trials, jobs, threads, progress
        As for :func:`tune`.
    out : Path
        Folder of the means, ``tune.csv`` and ``tune.md``. Each run has a folder in it, as
        :func:`tune` writes it, named by its number and its name.

    Returns
    -------
    list of Outcome
        Means over the runs, in the order of ``trials``; every run counts alike.

    Raises
    ------
    ConfigError, RunError, DatasetError
        As :func:`tune`. What other runs were found to be stays.
    """
    total = len(runs) * len(trials)
    found = []
    for k, (run, judge) in enumerate(zip(runs, judges, strict=True)):
        told = _told_after(k * len(trials), total, progress)
        folder = out / f"{k + 1}_{run.resolve().name}"
        found.append(tune(run, judge, trials, folder, jobs, threads, told))
    outcomes = means(found)
    _write(outcomes, mean_view(judges[0], len(runs)), out)
    return outcomes


def mean_view(judge: Judge, runs: int) -> View:
    """How means over several runs are shown."""
    return replace(judge.view, title=lambda _: f"Means over {runs} runs")


def _told_after(
    done: int, total: int, progress: Callable[[int, int], None] | None
) -> Callable[[int, int], None]:
    return lambda some, _: progress(done + some, total) if progress else None


def _write(outcomes: Sequence[Outcome], view: View, out: Path) -> None:
    text = table(outcomes, view).markdown().encode()
    write_atomically(out / "tune.md", lambda stream: stream.write(text))
    rows = as_csv(outcomes, view).encode()
    write_atomically(out / "tune.csv", lambda stream: stream.write(rows))


def _checked(source: RunFolder, judge: Judge, trial: Trial) -> Parameters:
    """The parameters of a trial, if it can be made of this run."""
    chosen = parameters_of(source.parameters, trial)
    check_stages(trial, judge.stages, judge.what)
    if chosen.odometry != source.parameters.odometry and not source.manifest["source"].get(
        "dataset"
    ):
        raise refused(trial, f"{source.path} was not made of a recording; its odometry is given")
    own = source.parameters
    if source.manifest["source"].get("labels") and (chosen.ground, chosen.dynamics) != (
        own.ground,
        own.dynamics,
    ):
        raise refused(trial, f"the classes of {source.path} are given (--labels), not found")
    return chosen


def _shared(base: Parameters, chosen: Parameters, judge: Judge) -> str:
    """The last stage of the run that a trial may share: it comes before the first that differs."""
    if chosen.odometry != base.odometry or "render" not in judge.stages:
        return "odometry"
    same = (chosen.ground, chosen.dynamics) == (base.ground, base.dynamics)
    return "classify" if same else "odometry"


def _state(run: RunFolder) -> dict[str, Any]:
    """The keys of the stages that trials may share."""
    return {stage: run.stage(stage).get("key") for stage in ("odometry", "classify")}


@dataclass(frozen=True)
class _Task:
    """One trial and everything that a worker process needs to run it."""

    run: Path
    judge: Judge
    out: Path
    trial: Trial
    parameters: Parameters
    key: str
    state: dict[str, Any]
    threads: int

    @property
    def file(self) -> Path:
        return self.out / f"{self.trial.name}.json"

    def outcome(self) -> Outcome | None:
        """The stored result, if the same run, parameters, judge and version made it."""
        try:
            found = json.loads(self.file.read_text(encoding="utf-8"))
            if found["key"] != self.key:
                return None
            metrics, seconds = dict(found["metrics"]), dict(found["seconds"])
        except (FileNotFoundError, ValueError, TypeError, KeyError):
            return None  # not there, or damaged
        return Outcome(self.trial.name, self.trial.settings, metrics, seconds)

    def __call__(self) -> None:
        """Make the trial, judge it, write the result and delete the trial."""
        path, source = self.out / _TRIALS / self.trial.name, RunFolder.open(self.run)
        varied = set(self.trial.settings)
        try:
            folder = make_trial(
                path, source, self.parameters, varied, self.key, self.judge, self.threads
            )
            metrics = self.judge.measure(folder.path, self.threads)
        except DamagedFileError as error:
            self._check_run()
            file = error.path.resolve()  # a file of the run, where it is a link
            shutil.rmtree(path, ignore_errors=True)
            raise RunError(
                DamagedFileError(file, error.what).text,
                f"`docdepth.run(..., {str(self.run)!r})` makes it again",
            ) from None
        except RunError:
            self._check_run()
            raise
        self._check_run()
        classify = folder.stage("classify")
        frames = classify.get("frames") or 1
        seconds = {step: s / frames for step, s in classify.get("seconds", {}).items()}
        content = json.dumps({"key": self.key, "metrics": metrics, "seconds": seconds}, indent=1)
        write_atomically(self.file, lambda stream: stream.write(content.encode()))
        shutil.rmtree(path, ignore_errors=True)

    def _check_run(self) -> None:
        """Refuse what was made of a run that another command changed meanwhile."""
        if _state(RunFolder.open(self.run)) != self.state:
            raise RunError(
                f"another command has changed {self.run} meanwhile; run the same command again"
            )


def _run_tasks(
    tasks: list[_Task], jobs: int, total: int, progress: Callable[[int, int], None] | None
) -> None:
    def report(remaining: int) -> None:
        if progress:
            progress(total - remaining, total)

    report(len(tasks))
    if jobs <= 1 or len(tasks) <= 1:
        for k, task in enumerate(tasks):
            task()
            report(len(tasks) - k - 1)
        return
    # Spawned, not forked: a fork of a process with running threads can deadlock.
    with ProcessPoolExecutor(min(jobs, len(tasks)), mp_context=get_context("spawn")) as pool:
        futures = [pool.submit(task) for task in tasks]
        try:
            for k, future in enumerate(as_completed(futures)):
                future.result()
                report(len(tasks) - k - 1)
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
