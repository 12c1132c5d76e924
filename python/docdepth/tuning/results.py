"""Results of a parameter search as a table, CSV and plots."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth.errors import MissingExtraError
from docdepth.evaluation.tables import Table, number
from docdepth.io.atomic import write_atomically

_LABEL = (0.05, 0.06)  # size of a label, as shares of what an axis spans


@dataclass(frozen=True)
class Outcome:
    """Result of one trial.

    Attributes
    ----------
    name : str
    settings : dict
        Parameter values of the trial by dotted name.
    metrics : dict
        All that the judge has measured, ready for JSON.
    seconds : dict
        Seconds per sweep of each step of the classification, summed over threads.
    """

    name: str
    settings: dict[str, Any]
    metrics: dict[str, Any]
    seconds: dict[str, float]

    def metric(self, name: str) -> float:
        """A metric by dotted name (``all.mae``); NaN where it is undefined."""
        value: Any = self.metrics
        for part in name.split("."):
            value = value.get(part) if isinstance(value, dict) else None
        return math.nan if value is None else float(value)

    def time(self, of_step: Callable[[str], bool]) -> float:
        """Seconds per sweep of some steps; NaN if none of them was needed."""
        found = [seconds for step, seconds in self.seconds.items() if of_step(step)]
        return sum(found) if found else math.nan


@dataclass(frozen=True)
class Column:
    """A figure of each trial.

    Attributes
    ----------
    name : str
        In the CSV file.
    header : str
        In the table.
    label : str
        In plots.
    digits : int
        After the point, in the table.
    value : callable
        The figure of an outcome.
    scale : float
        What it is multiplied by in table and plots.
    """

    name: str
    header: str
    label: str
    digits: int
    value: Callable[[Outcome], float]
    scale: float = 1.0

    def scaled(self, outcome: Outcome) -> float:
        """The figure as table and plots show it."""
        return self.scale * self.value(outcome)


@dataclass(frozen=True)
class View:
    """How the results of a judge are shown.

    Attributes
    ----------
    title : callable
        Of the table, from the metrics of a trial.
    note : str
        Below the table.
    columns : tuple of Column
    lines : tuple of str
        Columns that are plotted over a parameter that varies alone.
    unit : str
        Of these.
    plots : tuple of (str, str)
        Columns on the x and y axis: of the left plot where several parameters vary, and of the
        right one.
    """

    title: Callable[[dict[str, Any]], str]
    note: str
    columns: tuple[Column, ...]
    lines: tuple[str, ...]
    unit: str
    plots: tuple[tuple[str, str], tuple[str, str]]

    def column(self, name: str) -> Column:
        """A column by its name."""
        return next(column for column in self.columns if column.name == name)


def means(of_runs: Sequence[Sequence[Outcome]]) -> list[Outcome]:
    """Outcomes of the same trials on several runs as one: each figure is the mean over the runs.

    A figure that some runs do not have is the mean over the others. Every run counts alike.

    Parameters
    ----------
    of_runs : sequence of sequence of Outcome
        Of each run, in the same order.
    """
    return [
        Outcome(
            same[0].name,
            same[0].settings,
            _mean([one.metrics for one in same]),
            _mean([one.seconds for one in same]),
        )
        for same in zip(*of_runs, strict=True)
    ]


def _mean(values: Sequence[Any]) -> Any:
    """The mean of numbers, of dictionaries entry by entry; of other values the first."""
    if all(isinstance(value, dict) for value in values):
        names = dict.fromkeys(name for value in values for name in value)
        return {n: _mean([value[n] for value in values if n in value]) for n in names}
    numbers = [v for v in values if isinstance(v, int | float) and not math.isnan(v)]
    return math.fsum(numbers) / len(numbers) if numbers else values[0]


def table(outcomes: Sequence[Outcome], view: View) -> Table:
    """One row per trial."""
    header = ("trial", *(column.header for column in view.columns))
    rows = [
        (outcome.name, *(number(c.scaled(outcome), c.digits) for c in view.columns))
        for outcome in outcomes
    ]
    title = view.title(outcomes[0].metrics) if outcomes else ""
    return Table(title, header, tuple(rows), view.note)


def as_csv(outcomes: Sequence[Outcome], view: View) -> str:
    """The table with all digits and one column per parameter that any trial sets."""
    names = list(dict.fromkeys(name for outcome in outcomes for name in outcome.settings))
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(["trial", *names, *(column.name for column in view.columns)])
    for outcome in outcomes:
        settings = [outcome.settings.get(name, "") for name in names]
        writer.writerow([outcome.name, *settings, *(c.value(outcome) for c in view.columns)])
    return stream.getvalue()


def plot(outcomes: Sequence[Outcome], view: View, path: Path) -> None:
    """Plot the figures of all trials.

    Where exactly one numeric parameter varies, it is the x axis of the left plot.

    Parameters
    ----------
    outcomes : sequence of Outcome
    view : View
        Of the judge.
    path : Path
        Output file: PNG, PDF or SVG.

    Raises
    ------
    MissingExtraError
        matplotlib is not installed.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError:
        raise MissingExtraError(
            'plots are drawn by matplotlib: pip install "docdepth[viz]"'
        ) from None
    # Names stand in a legend of one line each: they are long where several parameters vary.
    figure = Figure(figsize=(14, max(4.5, 0.2 * len(outcomes))), layout="constrained")
    left, right = figure.subplots(1, 2)
    axis = _varying_parameter(outcomes)
    if axis is not None:
        drawn = sorted(outcomes, key=lambda outcome: outcome.settings[axis])
        for column in map(view.column, view.lines):
            # Shares and percentages share an axis.
            heights = [column.value(o) / (100 if "%" in column.label else 1) for o in drawn]
            label = column.label.partition(" [")[0]
            left.plot([o.settings[axis] for o in drawn], heights, "o-", label=label)
        left.set(xlabel=axis, ylabel=view.unit)
        left.legend()
    else:
        _scatter(left, outcomes, *map(view.column, view.plots[0]))
    _scatter(right, outcomes, *map(view.column, view.plots[1]))
    figure.legend(*right.get_legend_handles_labels(), loc="outside right upper", fontsize=8)
    for axes in (left, right):
        axes.grid(alpha=0.3)
    stream = io.BytesIO()
    figure.savefig(stream, format=path.suffix[1:] or "png", dpi=120)
    write_atomically(path, lambda out: out.write(stream.getvalue()))


def _scatter(axes: Any, outcomes: Sequence[Outcome], x: Column, y: Column) -> None:
    """A point with its number for each trial."""
    places = np.array([(x.scaled(outcome), y.scaled(outcome)) for outcome in outcomes])
    for k, (outcome, place) in enumerate(zip(outcomes, places, strict=True), 1):
        axes.plot(*place, "o", label=f"{k}: {outcome.name}")
    for group in beside_each_other(places):
        text = ", ".join(str(k + 1) for k in group)
        axes.annotate(text, places[group[0]], textcoords="offset points", xytext=(4, 4), size=8)
    axes.set(xlabel=x.label, ylabel=y.label)


def beside_each_other(places: NDArray[np.float64]) -> list[list[int]]:
    """Groups of points so close in a plot that their labels would run over each other.

    Parameters
    ----------
    places : ndarray of float64, shape (N, 2)

    Returns
    -------
    list of list of int
        Rows of each group, in order of their first one.
    """
    known = places[np.isfinite(places).all(axis=1)]
    span = np.ptp(known, axis=0) if len(known) else np.zeros(2)
    groups: list[list[int]] = []
    for k, place in enumerate(places):
        near = (g for g in groups if (abs(place - places[g[0]]) <= np.multiply(_LABEL, span)).all())
        if (group := next(near, None)) is None:
            groups.append([k])
        else:
            group.append(k)
    return groups


def _varying_parameter(outcomes: Sequence[Outcome]) -> str | None:
    """The only parameter whose values differ between trials, if they are numbers."""
    names = {name for outcome in outcomes for name in outcome.settings}
    varying = [name for name in names if len({repr(o.settings.get(name)) for o in outcomes}) > 1]
    if len(varying) != 1:
        return None
    values = [outcome.settings.get(varying[0]) for outcome in outcomes]
    numbers = all(isinstance(v, int | float) and not isinstance(v, bool) for v in values)
    return varying[0] if numbers else None
