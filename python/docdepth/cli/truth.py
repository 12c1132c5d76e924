"""Verbs that make synthetic drives, evaluate runs and tune parameters."""

from __future__ import annotations

from functools import wraps
from pathlib import Path
from typing import Annotated, Any

import typer

from docdepth.cli.options import Json, RunPath, Threads, app, out, progress_bars, show, show_summary

evaluate = typer.Typer(no_args_is_help=True, help="Measure the accuracy of a run.")
app.add_typer(evaluate, name="evaluate")


@app.command()
def synth(
    output: Annotated[Path, typer.Argument(metavar="OUT", help="Folder of the drive.")],
    scene: Annotated[
        str, typer.Option(help="city, crossing, highway, hills or residential.")
    ] = "city",
    sensor: Annotated[str, typer.Option(help="HDL-64, OS1-128, XT-32, VLP-16 or Avia.")] = "HDL-64",
    frames: Annotated[int, typer.Option(min=2, help="Number of sweeps.")] = 60,
    seed: Annotated[int, typer.Option(min=0, help="Random seed of the scene.")] = 0,
    skew: Annotated[
        bool, typer.Option(help="Write raw sweeps, without motion compensation.")
    ] = False,
    bloom: Annotated[
        float, typer.Option(min=0, help="Blooming around retro-reflectors, degrees.")
    ] = 0.0,
) -> None:
    """Write a synthetic drive with exact labels, poses and depth (SemanticKITTI layout)."""
    from docdepth.synthetic import write_drive

    with progress_bars() as progress:
        write_drive(
            output, scene=scene, sensor=sensor, frames=frames, seed=seed, skew=skew,
            blooming_deg=bloom,
            progress=lambda done, total: progress("synth", done, total),
        )  # fmt: skip
    out.print(f"{frames} sweeps in {output}", soft_wrap=True, markup=False)


@app.command()
def demo(
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder.")] = Path("demo"),
    frames: Annotated[int, typer.Option(min=3, help="Number of sweeps.")] = 40,
    preset: Annotated[
        str, typer.Option(help="default (most accurate) or paper (the paper's method).")
    ] = "default",
    threads: Threads = 0,
) -> None:
    """Make a synthetic drive and its depth maps, and print their errors."""
    from docdepth.cli.demo import demo as make
    from docdepth.io.run_folder import RunFolder

    with progress_bars() as progress:
        sequence, folder = make(output, preset, frames, threads, progress)  # type: ignore[arg-type]
    show_summary(RunFolder(folder))
    labels(folder, sequence)
    depth(folder, sequence)
    out.print(f"look at the pictures in {folder / 'report'}", soft_wrap=True, markup=False)


@app.command()
def tune(
    run: RunPath,
    truth: Annotated[Path, typer.Option("--labels", help="Folder of SemanticKITTI labels.")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="OUT", help="Results.")],
    vary: Annotated[
        list[str] | None,
        typer.Option(metavar="STAGE.NAME=A,B,C", help="Values; several options are combined."),
    ] = None,
    trials: Annotated[
        Path | None, typer.Option(help="YAML, one trial a line: NAME: {stage.name: value}.")
    ] = None,
    jobs: Annotated[int, typer.Option(min=1, help="Trials at a time.")] = 1,
    threads: Threads = 0,
) -> None:
    """Classify a run with many parameter sets and write a table, CSV and a plot.

    The same command continues a search that was interrupted.

      docdepth tune RUN --labels DRIVE -o out --vary dynamics.tolerance=0.1,0.2,0.4
    """
    from docdepth import tuning
    from docdepth.errors import ConfigError, MissingExtraError

    if bool(vary) == bool(trials):
        raise ConfigError("say what to vary: --vary STAGE.NAME=A,B or --trials FILE")
    sets = tuning.read_trials(trials) if trials else tuning.grid(tuning.parse_axes(vary or []))
    with progress_bars() as progress:
        outcomes = tuning.tune(
            run, truth, sets, output, jobs, threads,
            lambda done, total: progress("trials", done, total),
        )  # fmt: skip
    out.print(str(tuning.table(outcomes)), soft_wrap=True, markup=False)
    try:
        tuning.plot(outcomes, output / "tune.png")
    except MissingExtraError as error:
        out.print(f"no plot: {error}", markup=False)


@app.command("sweep", hidden=True, deprecated=True)
@wraps(tune)
def sweep(*args: Any, **options: Any) -> None:
    tune(*args, **options)


@app.command()
def doctor() -> None:
    """List what this installation can do, and what it lacks."""
    from docdepth.cli.doctor import doctor as examine

    for name, finding, well in examine():
        out.print(f"{'ok' if well else '--'}  {name:<24} {finding}", soft_wrap=True, markup=False)


@evaluate.command()
def labels(
    run: RunPath,
    truth: Annotated[Path, typer.Option("--labels", help="Folder of SemanticKITTI labels.")],
    as_json: Json = False,
) -> None:
    """Static and dynamic accuracy (SA, DA), F1, precision and IoU per point."""
    from docdepth.evaluation.runs import evaluate_labels

    show(evaluate_labels(run, truth), as_json)


@evaluate.command()
def depth(
    run: RunPath,
    truth: Annotated[Path, typer.Option("--depth", help="Folder of true depth maps.")],
    mode: Annotated[str, typer.Option(help="valid, or kitti (empty pixels are filled).")] = "valid",
    max_range: Annotated[
        float, typer.Option(help="Ignore pixels beyond this depth, metres.")
    ] = 80.0,
    camera: Annotated[
        str | None, typer.Option(help="Camera; needed where there are several.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Error (MAE, RMSE), density, and pixels more than 5 % too near or too far."""
    from docdepth.evaluation.runs import evaluate_depth

    show(evaluate_depth(run, truth, mode, max_range, camera), as_json)  # type: ignore[arg-type]


@evaluate.command()
def held_out(
    run: RunPath,
    every: Annotated[int, typer.Option(min=1, help="Leave out every N-th sweep.")] = 10,
    max_range: Annotated[
        float, typer.Option(help="Ignore returns beyond this depth, metres.")
    ] = 80.0,
    camera: Annotated[
        str | None, typer.Option(help="Camera; needed where there are several.")
    ] = None,
    threads: Threads = 0,
    as_json: Json = False,
) -> None:
    """Compare depth with sweeps that were left out: needs no ground truth.

    A sweep is left out, its view is rendered from the others, and each of its returns is compared
    with the map. Pixels between returns are not judged.
    """
    from docdepth.evaluation.held_out import evaluate_held_out

    with progress_bars() as progress:
        result = evaluate_held_out(
            run, every, max_range, camera, threads,
            lambda done, total: progress("held out", done, total),
        )  # fmt: skip
    show(result, as_json)
