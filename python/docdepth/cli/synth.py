"""Verbs that make synthetic drives."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from docdepth.cli.names import SCENE_NAMES, SENSOR_NAMES, one_of
from docdepth.cli.options import PresetName, Threads
from docdepth.cli.progress import progress_bars
from docdepth.cli.summary import show_summary
from docdepth.cli.terminal import app, out, verb, volume

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
            progress=progress,
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
        labels = evaluate_labels(folder, sequence, progress)
        depth = evaluate_depth(folder, sequence, progress=progress)
    for table in (labels.table(), depth.table()):
        rows = tuple(row for row in table.rows if row[0] in _ROWS_OF_THE_DEMO)
        out.print(f"\n{replace(table, rows=rows)}", soft_wrap=True, markup=False)
    if not volume.quiet:
        lines = (
            f"\nmore figures: docdepth evaluate labels {folder} --labels {sequence}",
            f"              docdepth evaluate depth {folder} --depth {sequence}",
        )
        out.print("\n".join(lines), soft_wrap=True, markup=False)
