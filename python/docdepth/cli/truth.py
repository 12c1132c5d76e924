"""Verbs that make synthetic drives and tune parameters."""

from __future__ import annotations

from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from docdepth.cli.names import SCENE_NAMES, SENSOR_NAMES, one_of
from docdepth.cli.options import OneCamera, PresetName, RunPath, Threads
from docdepth.cli.progress import progress_bars
from docdepth.cli.summary import show_summary
from docdepth.cli.terminal import app, out, verb, volume

if TYPE_CHECKING:
    from docdepth.tuning import Judge

LabelJudgeFolder = Annotated[
    Path | None,
    typer.Option(
        "--labels",
        metavar="DIR",
        help="Judge by true labels, as evaluate labels does: parameters of odometry, ground and "
        "dynamics.",
    ),
]
DepthJudgeFolder = Annotated[
    Path | None,
    typer.Option(
        "--depth", metavar="DIR", help="Judge by true depth maps, as evaluate depth does."
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
            blooming_deg=bloom, force=force,
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
    from docdepth.cli.evaluate import depth, labels
    from docdepth.io.run_folder import RunFolder

    with progress_bars() as progress:
        sequence, folder = make(output, preset, frames, threads, progress)  # type: ignore[arg-type]
    show_summary(RunFolder(folder))
    labels(folder, sequence)
    depth(folder, sequence)
    if not volume.quiet:
        out.print(f"look at the pictures in {folder / 'report'}", soft_wrap=True, markup=False)


@verb(app)
def tune(
    run: RunPath,
    output: Annotated[
        Path,
        typer.Option(
            "-o", "--output", metavar="OUT", help="Folder for the results: table, CSV and plot."
        ),
    ],
    label_folder: LabelJudgeFolder = None,
    depth_folder: DepthJudgeFolder = None,
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
    The same command continues a search that was interrupted.

      docdepth tune RUN -o out --vary render.behind=5,15
      docdepth tune RUN --labels DIR -o out --vary dynamics.tolerance=0.1,0.2
    """
    from docdepth import tuning
    from docdepth.errors import ConfigError, MissingExtraError

    judge = _judge(label_folder, depth_folder, every, camera)
    if bool(vary) == bool(trials):
        raise ConfigError("say what to vary: --vary STAGE.NAME=A,B or --trials FILE")
    if trials:
        sets = tuning.read_trials(trials)
    else:
        sets = tuning.grid(tuning.parse_axes(vary or []), "--vary")
    with progress_bars() as progress:
        outcomes = tuning.tune(
            run, judge, sets, output, jobs, threads,
            lambda done, total: progress("trials", done, total),
        )  # fmt: skip
    out.print(str(tuning.table(outcomes, judge.view)), soft_wrap=True, markup=False)
    try:
        tuning.plot(outcomes, judge.view, output / "tune.png")
    except MissingExtraError as error:
        out.print(f"no plot: {error}", markup=False)


def _judge(labels: Path | None, depth: Path | None, every: int | None, camera: str | None) -> Judge:
    """The one judge that the options choose."""
    from docdepth.errors import ConfigError
    from docdepth.tuning import DepthJudge, HeldOutJudge, LabelJudge

    if sum(option is not None for option in (labels, depth, every)) > 1:
        raise ConfigError("choose one judge: --labels DIR, --depth DIR or --held-out N")
    if labels is not None:
        if camera is not None:
            raise ConfigError("labels are the same for every camera; leave --camera out")
        return LabelJudge(labels)
    if depth is not None:
        return DepthJudge(depth, camera)
    return HeldOutJudge(10 if every is None else every, camera)


@app.command("sweep", hidden=True, deprecated=True)
@wraps(tune)
def sweep(*args: Any, **options: Any) -> None:
    tune(*args, **options)
