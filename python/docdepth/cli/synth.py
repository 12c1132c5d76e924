"""Verbs that make synthetic drives and tune parameters."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from docdepth.cli.names import SCENE_NAMES, SENSOR_NAMES, one_of
from docdepth.cli.options import OneCamera, PresetName, Threads
from docdepth.cli.progress import progress_bars
from docdepth.cli.summary import show_summary
from docdepth.cli.terminal import app, out, verb, volume

if TYPE_CHECKING:
    from docdepth.tuning import Judge

LabelJudgeFolders = Annotated[
    list[Path] | None,
    typer.Option(
        "--labels",
        metavar="DIR",
        help="Judge by true labels, as evaluate labels does: parameters of odometry, ground and "
        "dynamics. One for each run, in the same order.",
    ),
]
DepthJudgeFolders = Annotated[
    list[Path] | None,
    typer.Option(
        "--depth",
        metavar="DIR",
        help="Judge by true depth maps, as evaluate depth does. One for each run.",
    ),
]
HeldOutSweeps = Annotated[
    int | None,
    typer.Option(
        "--held-out",
        min=1,
        metavar="N",
        help="Judge by every N-th sweep, left out of the depth that it judges, as evaluate "
        "held-out does: needs no truth. Chosen with N = 10 if no other judge is.",
    ),
]

_ROWS_OF_THE_DEMO = ("moving now", "temporarily static", "all", "interior", "moving objects")


@verb(app)
def synth(
    output: Annotated[
        Path, typer.Argument(metavar="OUT", help="New folder; the drive is OUT/sequences/00.")
    ],
    scene: Annotated[
        str, typer.Option(help=f"Street: {', '.join(SCENE_NAMES)}.", **one_of(SCENE_NAMES))
    ] = "city",
    sensor: Annotated[
        str, typer.Option(help=f"LiDAR: {', '.join(SENSOR_NAMES)}.", **one_of(SENSOR_NAMES))
    ] = "HDL-64",
    frames: Annotated[
        int, typer.Option(min=2, max=100000, metavar="N", help="Number of sweeps, ten a second.")
    ] = 60,
    seed: Annotated[
        int,
        typer.Option(min=0, metavar="N", help="Number that varies houses, bends and traffic."),
    ] = 0,
    skew: Annotated[
        bool, typer.Option(help="Write raw sweeps, without motion compensation.")
    ] = False,
    beam_width: Annotated[
        float,
        typer.Option(
            min=0, max=5, metavar="DEG", help="Width of a beam; real LiDARs have 0.1 to 0.35."
        ),
    ] = 0.0,
    bloom: Annotated[
        float,
        typer.Option(
            min=0, max=5, metavar="DEG", help="Ghost returns this far beside retro-reflectors."
        ),
    ] = 0.0,
    force: Annotated[
        bool, typer.Option("--force", help="Replace the synthetic drive that is in OUT.")
    ] = False,
) -> None:
    """Write a synthetic drive with exact labels, poses and depth (SemanticKITTI layout)."""
    from docdepth.synthetic import write_drive

    with progress_bars() as progress:
        write_drive(
            output, scene=scene, sensor=sensor, frames=frames, seed=seed, skew=skew,
            beam_width_deg=beam_width, blooming_deg=bloom, force=force,
            progress=lambda done, total: progress("synth", done, total),
        )  # fmt: skip
    if not volume.quiet:
        sequence = output / "sequences" / "00"
        out.print(f"{frames} sweeps in {sequence}", soft_wrap=True, markup=False)


@verb(app)
def demo(
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="DIR", help="Folder for drive and run.")
    ] = Path("demo"),
    frames: Annotated[
        int, typer.Option(min=3, max=100000, metavar="N", help="Number of sweeps, ten a second.")
    ] = 40,
    preset: PresetName = "default",
    threads: Threads = 0,
) -> None:
    """Make a synthetic drive and its depth maps, and print their errors."""
    from docdepth.cli.demo import demo as make
    from docdepth.evaluation.runs import evaluate_depth, evaluate_labels
    from docdepth.io.run_folder import RunFolder

    with progress_bars() as progress:
        sequence, folder = make(output, preset, frames, threads, progress)  # type: ignore[arg-type]
    show_summary(RunFolder(folder))
    with progress_bars() as progress:
        labels = evaluate_labels(folder, sequence, partial(progress, "labels"))
        depth = evaluate_depth(folder, sequence, progress=partial(progress, "depth"))
    for table in (labels.table(), depth.table()):
        rows = tuple(row for row in table.rows if row[0] in _ROWS_OF_THE_DEMO)
        out.print(f"\n{replace(table, rows=rows)}", soft_wrap=True, markup=False)
    if not volume.quiet:
        lines = (
            f"\nmore figures: docdepth evaluate labels {folder} --labels {sequence}",
            f"              docdepth evaluate depth {folder} --depth {sequence}",
        )
        out.print("\n".join(lines), soft_wrap=True, markup=False)


@verb(app)
def tune(
    runs: Annotated[
        list[Path], typer.Argument(metavar="RUN...", help="Run folders, one or several drives.")
    ],
    output: Annotated[
        Path,
        typer.Option(
            "-o", "--output", metavar="OUT", help="Folder for the results: table, CSV and plot."
        ),
    ],
    label_folders: LabelJudgeFolders = None,
    depth_folders: DepthJudgeFolders = None,
    every: HeldOutSweeps = None,
    camera: OneCamera = None,
    vary: Annotated[
        list[str] | None,
        typer.Option(
            metavar="STAGE.NAME=A,B,C",
            help="Values to try of a parameter of odometry, ground, dynamics or render; repeated, "
            "all are combined.",
        ),
    ] = None,
    trials: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="YAML of parameter sets, one a line: NAME: {stage.name: value}."
        ),
    ] = None,
    jobs: Annotated[
        int, typer.Option(min=1, max=1024, metavar="N", help="Parameter sets to try at a time.")
    ] = 1,
    threads: Threads = 0,
) -> None:
    """Make a run again with many parameter sets, judge each, write a table, CSV and a plot.

    Only what the parameters change is made again, in folders of its own: the run stays as it is.
    The same command continues a search that was interrupted. The table of several runs has the
    means over them; each run has a table of its own in a folder below OUT.

      docdepth tune RUN -o out --vary render.behind=5,15
      docdepth tune RUN1 RUN2 RUN3 -o out --vary render.behind=5,15
      docdepth tune RUN --labels DIR -o out --vary dynamics.tolerance=0.1,0.2
    """
    from docdepth import tuning
    from docdepth.errors import ConfigError, MissingExtraError

    judges = _judges(len(runs), label_folders, depth_folders, every, camera)
    if bool(vary) == bool(trials):
        raise ConfigError("say what to vary: --vary STAGE.NAME=A,B or --trials FILE")
    if trials:
        sets = tuning.read_trials(trials)
    else:
        sets = tuning.grid(tuning.parse_axes(vary or []), "--vary")
    with progress_bars() as progress:

        def told(done: int, total: int) -> None:
            progress("trials", done, total)

        if len(runs) == 1:
            view = judges[0].view
            outcomes = tuning.tune(runs[0], judges[0], sets, output, jobs, threads, told)
        else:
            view = tuning.mean_view(judges[0], len(runs))
            outcomes = tuning.tune_runs(runs, judges, sets, output, jobs, threads, told)
    out.print(str(tuning.table(outcomes, view)), soft_wrap=True, markup=False)
    try:
        tuning.plot(outcomes, view, output / "tune.png")
    except MissingExtraError as error:
        out.print(f"no plot: {error}", markup=False)


def _judges(
    count: int,
    labels: list[Path] | None,
    depth: list[Path] | None,
    every: int | None,
    camera: str | None,
) -> list[Judge]:
    """The judge that the options choose, for each run."""
    from docdepth.errors import ConfigError
    from docdepth.tuning import DepthJudge, HeldOutJudge, LabelJudge

    if sum(bool(option) for option in (labels, depth, every)) > 1:
        raise ConfigError("choose one judge: --labels DIR, --depth DIR or --held-out N")
    truths = labels or depth
    if truths and len(truths) != count:
        raise ConfigError(
            f"{count} runs and {len(truths)} folders of truth: name one for each run, in the same "
            "order"
        )
    if labels and camera is not None:
        raise ConfigError("labels are the same for every camera; leave --camera out")
    if labels:
        return [LabelJudge(folder) for folder in labels]
    if depth:
        return [DepthJudge(folder, camera) for folder in depth]
    return [HeldOutJudge(10 if every is None else every, camera)] * count
