"""Results of a parameter search as a table, CSV and a plot."""

from __future__ import annotations

import csv
import io
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from docdepth.config import Settings
from docdepth.errors import MissingExtraError
from docdepth.evaluation.tables import Table, number
from docdepth.io.atomic import write_output

_ERRORS = {
    "density": ("all.density", "density %", 1),
    "mae": ("all.mae", "MAE m", 3),
    "rmse": ("all.rmse", "RMSE m", 3),
    "too_near": ("all.too_near", "too near %", 2),
    "too_far": ("all.too_far", "too far %", 2),
}
COLUMNS = {
    "labels": {
        "sa": ("sa", "SA %", 2),
        "da": ("da", "DA %", 2),
        "f1": ("f1", "F1", 4),
        "precision": ("precision", "precision", 4),
        "iou": ("iou", "IoU", 4),
    },
    "depth": {"pixels": ("all.pixels", "pixels", 0), **_ERRORS},
    "held-out": {"returns": ("all.pixels", "returns", 0), **_ERRORS},
}
"""Metric, heading and digits of each column, by objective."""

_PLOTTED = {"labels": ("iou", "precision"), "depth": ("mae", "density")}


@dataclass(frozen=True)
class Outcome:
    """Score of one trial on one run, or its mean over several."""

    run: str  # name of the run folder
    name: str  # of the trial
    settings: Settings  # parameter values of the trial by dotted name
    # all that was measured, as ``docdepth evaluate --json`` prints it
    metrics: Mapping[str, object]

    def metric(self, name: str) -> float:
        """A metric by dotted name (``all.mae``); NaN where it is undefined."""
        return metric_of(self.metrics, name)


def metric_of(metrics: Mapping[str, object], name: str) -> float:
    """A metric by dotted name (``all.mae``); NaN where it is undefined."""
    value: Any = metrics
    for part in name.split("."):
        value = value.get(part) if isinstance(value, dict) else None
    return math.nan if value is None else float(value)


def means(outcomes: Sequence[Outcome]) -> list[Outcome]:
    """One outcome for each trial: every figure is the mean over the runs that have it."""
    of_trial: dict[str, list[Outcome]] = {}
    for outcome in outcomes:
        of_trial.setdefault(outcome.name, []).append(outcome)
    return [
        Outcome("mean", name, same[0].settings, _mean([one.metrics for one in same]))
        for name, same in of_trial.items()
    ]


def _mean(values: Sequence[Any]) -> Any:
    """The mean of numbers, of dictionaries entry by entry; of other values the first."""
    if all(isinstance(value, dict) for value in values):
        names = dict.fromkeys(name for value in values for name in value)
        return {n: _mean([value[n] for value in values if n in value]) for n in names}
    numbers = [v for v in values if isinstance(v, int | float) and not math.isnan(v)]
    return math.fsum(numbers) / len(numbers) if numbers else values[0]


def table(outcomes: Sequence[Outcome], by: str) -> Table:
    """One row per trial: means, where several runs were tried."""
    columns, runs = list(COLUMNS[by].values()), len({outcome.run for outcome in outcomes})
    rows = [
        (mean.name, *(number(mean.metric(metric), digits) for metric, _, digits in columns))
        for mean in means(outcomes)
    ]
    title = f"{by}, mean of {runs} runs" if runs > 1 else f"{by} of {outcomes[0].run}"
    return Table(title, ("trial", *(heading for _, heading, _ in columns)), tuple(rows))


def write_csv(outcomes: Sequence[Outcome], by: str, path: Path) -> None:
    """One row for each run and trial, with all digits and a column for each parameter."""
    names = list(dict.fromkeys(name for outcome in outcomes for name in outcome.settings))
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(["run", "trial", *names, *COLUMNS[by]])
    for outcome in outcomes:
        settings = [outcome.settings.get(name, "") for name in names]
        figures = [outcome.metric(metric) for metric, _, _ in COLUMNS[by].values()]
        writer.writerow([outcome.run, outcome.name, *settings, *figures])
    write_output(path, os.fsencode(stream.getvalue()))


def plot(outcomes: Sequence[Outcome], by: str, path: Path) -> None:
    """Plot two metrics of all trials: over a single parameter that varies, else over each other."""
    try:
        from matplotlib.figure import Figure
    except ImportError:
        raise MissingExtraError(
            'plots are drawn by matplotlib: pip install "docdepth[viz]"'
        ) from None
    (first, label, _), (second, other, _) = (
        COLUMNS[by][name] for name in _PLOTTED.get(by, _PLOTTED["depth"])
    )
    drawn, axis = means(outcomes), _varying_parameter(outcomes)
    if axis is not None:
        drawn.sort(key=lambda outcome: cast(float, outcome.settings[axis]))
    ones, others = ([outcome.metric(name) for outcome in drawn] for name in (first, second))
    figure = Figure(figsize=(8, max(4.5, 0.2 * len(drawn))), layout="constrained")
    left = figure.subplots()
    if axis is not None:
        values = [cast(float, outcome.settings[axis]) for outcome in drawn]
        left.plot(values, ones, "o-", label=label)
        right = left.twinx()
        right.plot(values, others, "s--", color="tab:orange", label=other)
        right.set_ylabel(other)
        left.set(xlabel=axis, ylabel=label)
    else:
        for k, place in enumerate(zip(others, ones, strict=True), 1):
            left.plot(*place, "o", label=f"{k}: {drawn[k - 1].name}")
            left.annotate(str(k), place, textcoords="offset points", xytext=(4, 4), size=8)
        left.set(xlabel=other, ylabel=label)
    figure.legend(loc="outside right upper", fontsize=8)
    stream = io.BytesIO()
    figure.savefig(stream, format=path.suffix[1:], dpi=120)
    write_output(path, stream.getvalue())


def _varying_parameter(outcomes: Sequence[Outcome]) -> str | None:
    """The only parameter whose values differ between trials, if they are numbers."""
    names = {name for outcome in outcomes for name in outcome.settings}
    varying = [name for name in names if len({repr(o.settings.get(name)) for o in outcomes}) > 1]
    values = [outcome.settings.get(name) for name in varying for outcome in outcomes]
    numbers = all(isinstance(v, int | float) and not isinstance(v, bool) for v in values)
    return varying[0] if len(varying) == 1 and numbers else None
