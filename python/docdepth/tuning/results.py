"""Results of a parameter search as a table, CSV and plots."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from docdepth.errors import MissingExtraError
from docdepth.evaluation.label_counts import NOTE
from docdepth.evaluation.tables import Table, number
from docdepth.io.atomic import write_atomically

_NAMES = {
    "sa": "static accuracy SA",
    "da": "dynamic accuracy DA",
    "precision": "precision",
    "iou": "IoU",
}
METRICS = ("sa", "da", "f1", "precision", "iou")


@dataclass(frozen=True)
class Outcome:
    """Result of one trial.

    Attributes
    ----------
    name : str
    settings : dict
        Parameter values of the trial by dotted name.
    metrics : dict
        Metrics, from :meth:`docdepth.evaluation.LabelResult.as_dict`.
    seconds : dict
        Seconds of each step of the classification, summed over all sweeps.
    """

    name: str
    settings: dict[str, Any]
    metrics: dict[str, Any]
    seconds: dict[str, float]

    @property
    def ground_seconds(self) -> float:
        """Seconds per sweep to grow the ground and to label the points (summed over threads)."""
        return self._per_sweep(lambda step: step.startswith("ground"))

    @property
    def vote_seconds(self) -> float:
        """Seconds per sweep to build key frames and to vote (summed over threads)."""
        return self._per_sweep(lambda step: step in ("key frames", "vote"))

    def metric(self, name: str) -> float:
        """A metric by name; NaN where it is undefined."""
        value = self.metrics.get(name)
        return math.nan if value is None else float(value)

    def _per_sweep(self, counts: Callable[[str], bool]) -> float:
        total = sum(seconds for step, seconds in self.seconds.items() if counts(step))
        return total / max(int(self.metrics["sweeps"]), 1)


def table(outcomes: Sequence[Outcome]) -> Table:
    """One row per trial: metrics, and milliseconds per sweep."""
    header = ("trial", "SA %", "DA %", "F1", "precision", "IoU", "ground ms", "voting ms")
    rows = []
    for outcome in outcomes:
        cells = [number(outcome.metric(name), 2 if name in ("sa", "da") else 4) for name in METRICS]
        times = [f"{1e3 * s:.1f}" for s in (outcome.ground_seconds, outcome.vote_seconds)]
        rows.append((outcome.name, *cells, *times))
    first = outcomes[0].metrics if outcomes else {}
    title = f"{first.get('protocol')}; poses: {first.get('poses')}; {first.get('sweeps')} sweeps"
    return Table(title, header, tuple(rows), NOTE)


def as_csv(outcomes: Sequence[Outcome]) -> str:
    """The table with all digits and one column per parameter that any trial sets."""
    names = list(dict.fromkeys(name for outcome in outcomes for name in outcome.settings))
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(["trial", *names, *METRICS, "ground_seconds", "vote_seconds"])
    for outcome in outcomes:
        settings = [outcome.settings.get(name, "") for name in names]
        metrics = [outcome.metric(name) for name in METRICS]
        times = [outcome.ground_seconds, outcome.vote_seconds]
        writer.writerow([outcome.name, *settings, *metrics, *times])
    return stream.getvalue()


def plot(outcomes: Sequence[Outcome], path: Path) -> None:
    """Plot the metrics of all trials, and IoU over the seconds of voting.

    Where exactly one numeric parameter varies, it is the x axis of the metrics; otherwise precision
    is plotted over dynamic accuracy.

    Parameters
    ----------
    outcomes : sequence of Outcome
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
    figure = Figure(figsize=(12, 4.5), layout="constrained")
    left, right = figure.subplots(1, 2)
    axis = _varying_parameter(outcomes)
    if axis is not None:
        values = [outcome.settings[axis] for outcome in outcomes]
        for name, scale in (("sa", 0.01), ("da", 0.01), ("precision", 1.0), ("iou", 1.0)):
            heights = [scale * outcome.metric(name) for outcome in outcomes]
            left.plot(values, heights, "o-", label=_NAMES[name])
        left.set(xlabel=axis, ylabel="metric, 0..1")
        left.legend()
    else:
        for outcome in outcomes:
            position = outcome.metric("da"), outcome.metric("precision")
            left.plot(*position, "o")
            left.annotate(outcome.name, position, textcoords="offset points", xytext=(4, 4), size=8)
        left.set(xlabel="dynamic accuracy DA [%]", ylabel="precision")
    for outcome in outcomes:
        position = 1e3 * outcome.vote_seconds, outcome.metric("iou")
        right.plot(*position, "o")
        right.annotate(outcome.name, position, textcoords="offset points", xytext=(4, 4), size=8)
    right.set(xlabel="key frames and voting [ms per sweep]", ylabel="IoU of the dynamic class")
    for axes in (left, right):
        axes.grid(alpha=0.3)
    stream = io.BytesIO()
    figure.savefig(stream, format=path.suffix[1:] or "png", dpi=120)
    write_atomically(path, lambda out: out.write(stream.getvalue()))


def _varying_parameter(outcomes: Sequence[Outcome]) -> str | None:
    """The only parameter whose values differ between trials, if they are numbers."""
    names = {name for outcome in outcomes for name in outcome.settings}
    varying = [name for name in names if len({repr(o.settings.get(name)) for o in outcomes}) > 1]
    if len(varying) != 1:
        return None
    values = [outcome.settings.get(varying[0]) for outcome in outcomes]
    numbers = all(isinstance(v, int | float) and not isinstance(v, bool) for v in values)
    return varying[0] if numbers else None
