"""Runs the trials of a parameter search: in parallel processes, resumable."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

from docdepth import __version__
from docdepth.config import Parameters
from docdepth.errors import ConfigError
from docdepth.evaluation.runs import evaluate_labels
from docdepth.io.atomic import write_atomically
from docdepth.io.run_folder import RunFolder, stage_key
from docdepth.tuning.results import Outcome, as_csv, table
from docdepth.tuning.trial_folder import TrialFolder
from docdepth.tuning.trials import Trial, parameters_of


def tune(
    run: Path,
    labels: Path,
    trials: Sequence[Trial],
    out: Path,
    jobs: int = 1,
    threads: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> list[Outcome]:
    """Classify a run with each parameter set and compare with the truth.

    Parameters
    ----------
    run : Path
        Run folder with deskewed sweeps; it is only read.
    labels : Path
        SemanticKITTI labels, as for :func:`docdepth.evaluation.runs.evaluate_labels`.
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
        Two trials have the same name, a name cannot name a folder, or a parameter is unknown or
        does not belong to the classification.
    """
    source = RunFolder.open(run)
    tasks = []
    for trial in trials:
        chosen = parameters_of(source.parameters, trial)
        odometry = source.stage("odometry").get("key")
        key = stage_key(__version__, odometry, chosen.model_dump(), str(labels.resolve()))
        tasks.append(_Task(run, labels, out, trial, chosen, key, threads))
    names = [trial.name for trial in trials]
    for name in names:
        if names.count(name) > 1 or not name.strip(".") or set(name) & set("/\\\0"):
            raise ConfigError(f"{name!r} cannot name a trial: names must be unique folder names")
    remaining = [task for task in tasks if task.outcome() is None]
    _run_tasks(remaining, jobs, len(tasks), progress)
    outcomes = [found for found in (task.outcome() for task in tasks) if found is not None]
    text = table(outcomes).markdown().encode()
    write_atomically(out / "tune.md", lambda stream: stream.write(text))
    rows = as_csv(outcomes).encode()
    write_atomically(out / "tune.csv", lambda stream: stream.write(rows))
    return outcomes


@dataclass(frozen=True)
class _Task:
    """One trial and everything that a worker process needs to run it."""

    run: Path
    labels: Path
    out: Path
    trial: Trial
    parameters: Parameters
    key: str
    threads: int

    @property
    def file(self) -> Path:
        return self.out / f"{self.trial.name}.json"

    def outcome(self) -> Outcome | None:
        """The stored result, if the same run, parameters and version made it."""
        try:
            found = json.loads(self.file.read_text())
        except (FileNotFoundError, json.JSONDecodeError):
            return None
        if found.get("key") != self.key:
            return None
        return Outcome(self.trial.name, self.trial.settings, found["metrics"], found["seconds"])

    def __call__(self) -> None:
        """Classify, evaluate, write the result and delete the classes."""
        from docdepth.pipeline import run_classify

        folder = TrialFolder(self.out / f".{self.trial.name}", self.run, self.parameters, self.key)
        run_classify(folder, self.threads)
        metrics = evaluate_labels(folder, self.labels).as_dict()
        seconds = folder.stage("classify").get("seconds", {})
        content = json.dumps({"key": self.key, "metrics": metrics, "seconds": seconds}, indent=1)
        write_atomically(self.file, lambda stream: stream.write(content.encode()))
        shutil.rmtree(folder.path, ignore_errors=True)


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
