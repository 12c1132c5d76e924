"""The verb that tries many parameter sets."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
import yaml

from docdepth import tuning
from docdepth._text import read_yaml
from docdepth.cli.options import OneCamera, Threads, option, verb
from docdepth.cli.progress import progress_bars
from docdepth.cli.terminal import say
from docdepth.errors import ConfigError, MissingExtraError
from docdepth.io.atomic import write_output


@verb()
def tune(
    runs: Annotated[
        list[Path], typer.Argument(metavar="RUN...", help="Run folders, one or several drives.")
    ],
    output: Annotated[
        Path, option("Folder for the results: table, CSV and plot.", "OUT", "-o --output")
    ],
    label_folders: Annotated[
        list[Path] | None,
        option(
            "Score by true labels, as evaluate labels does: parameters of odometry, ground and "
            "dynamics. One for each run, in the same order.",
            "DIR",
            "--labels",
        ),
    ] = None,
    depth_folders: Annotated[
        list[Path] | None,
        option(
            "Score by true depth maps, as evaluate depth does. One for each run.", "DIR", "--depth"
        ),
    ] = None,
    every: Annotated[
        int | None,
        option(
            "Compare with every N-th sweep, left out of the depth, as evaluate held-out "
            "does: needs no truth. Chosen with N = 10 if no other objective is.",
            "N",
            "--held-out",
            min=1,
        ),
    ] = None,
    camera: OneCamera = None,
    vary: Annotated[
        list[str] | None,
        option(
            "Values to try of a parameter of odometry, ground, dynamics or render; repeated, all "
            "are combined.",
            "STAGE.NAME=A,B,C",
        ),
    ] = None,
    trials: Annotated[
        Path | None,
        option("YAML of parameter sets, one a line: NAME: {stage.name: value}.", "FILE"),
    ] = None,
    jobs: Annotated[int, option("Parameter sets to try at a time.", "N", min=1, max=1024)] = 1,
    threads: Threads = 0,
) -> None:
    """Make runs again with many parameter sets, score each, write a table, CSV and a plot.

    Only what the parameters change is made again, in folders of its own: the runs stay as they are.
    The same command continues a search that was interrupted. The table and the plot show the means
    over several runs, tune.csv each run.

      docdepth tune RUN -o out --vary render.behind=5,15
      docdepth tune RUN1 RUN2 RUN3 -o out --vary render.behind=5,15
      docdepth tune RUN --labels DIR -o out --vary dynamics.tolerance=0.1,0.2
    """
    objectives = _objectives(len(runs), label_folders, depth_folders, every, camera)
    if bool(vary) == bool(trials):
        raise ConfigError("say what to vary: --vary STAGE.NAME=A,B or --trials FILE")
    sets = tuning.read_trials(trials) if trials else tuning.grid(parse_axes(vary or []), "--vary")
    with progress_bars() as progress:
        outcomes = tuning.tune(runs, objectives, sets, output, jobs, threads, progress)
    by = objectives[0].by
    table = tuning.table(outcomes, by)
    say(str(table))
    write_output(output / "tune.md", os.fsencode(table.markdown()))
    try:
        tuning.plot(outcomes, by, output / "tune.png")
    except MissingExtraError as error:
        say(f"no plot: {error}")


def parse_axes(assignments: Sequence[str]) -> dict[str, list[Any]]:
    """Turn ``["dynamics.tolerance=0.1,0.2"]`` into the axes of a grid."""
    axes: dict[str, list[Any]] = {}
    for assignment in assignments:
        name, equals, text = assignment.partition("=")
        if not equals:
            raise ConfigError(f"--vary {assignment!r}: write stage.name=value,value")
        try:
            values = read_yaml(f"[{text}]")
        except (yaml.YAMLError, ValueError, RecursionError):
            values = None
        if not values:
            raise ConfigError(
                f"--vary {assignment!r}: the values {text!r} cannot be read; write numbers, words "
                "or lists such as [50, 3] with commas between them"
            )
        known = axes.setdefault(name.strip(), [])
        known += [value for k, value in enumerate(values) if value not in known + values[:k]]
    return axes


def _objectives(
    count: int,
    labels: list[Path] | None,
    depth: list[Path] | None,
    every: int | None,
    camera: str | None,
) -> list[tuning.Objective]:
    """The objective that the options choose, for each run."""
    if sum(bool(option) for option in (labels, depth, every)) > 1:
        raise ConfigError("choose one objective: --labels DIR, --depth DIR or --held-out N")
    truths = labels or depth
    if truths and len(truths) != count:
        raise ConfigError(
            f"{count} runs and {len(truths)} folders of truth: name one for each run, in the same "
            "order"
        )
    if labels and camera is not None:
        raise ConfigError("labels are the same for every camera; leave --camera out")
    if truths:
        return [
            tuning.Objective("labels" if labels else "depth", folder, camera) for folder in truths
        ]
    return [tuning.Objective(camera=camera, every=every or 10)] * count
