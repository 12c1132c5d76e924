"""Verbs that make synthetic drives."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from docdepth.cli.options import PresetName, Threads, one_of, option, verb
from docdepth.cli.progress import progress_bars
from docdepth.cli.status import show_summary
from docdepth.cli.terminal import say, volume
from docdepth.concurrency import Progress
from docdepth.config import parameters
from docdepth.errors import DatasetError
from docdepth.evaluation.runs import evaluate_depth, evaluate_labels
from docdepth.io.run_folder import RunFolder
from docdepth.pipeline.run import run
from docdepth.synthetic import SCENES, sensors, write_drive
from docdepth.synthetic.writer import described, sequence_folder, written_drive

SCENE_NAMES, SENSOR_NAMES = tuple(SCENES), tuple(sensors())
_ROWS_OF_THE_DEMO = ("moving now", "temporarily static", "all", "interior", "moving objects")


@verb()
def synth(
    output: Annotated[
        Path, typer.Argument(metavar="OUT", help="New folder; the drive is OUT/sequences/00.")
    ],
    scene: Annotated[
        str, option(f"Street: {', '.join(SCENE_NAMES)}.", **one_of(SCENE_NAMES))
    ] = "city",
    sensor: Annotated[
        str, option(f"LiDAR: {', '.join(SENSOR_NAMES)}.", **one_of(SENSOR_NAMES))
    ] = "HDL-64",
    frames: Annotated[
        int,
        option("Number of sweeps, ten a second; five of the Pandar40P.", "N", min=2, max=100000),
    ] = 60,
    seed: Annotated[int, option("Number that varies houses, bends and traffic.", "N", min=0)] = 0,
    skew: Annotated[bool, option("Write raw sweeps, without motion compensation.")] = False,
    beam_width: Annotated[
        float, option("Width of a beam; real LiDARs have 0.1 to 0.35.", "DEG", min=0, max=5)
    ] = 0.0,
    bloom: Annotated[
        float, option("Ghost returns this far beside retro-reflectors.", "DEG", min=0, max=5)
    ] = 0.0,
    force: Annotated[
        bool, option("Replace the synthetic drive that is in OUT.", flags="--force")
    ] = False,
) -> None:
    """Write a synthetic drive with exact labels, poses and depth (SemanticKITTI layout)."""
    with progress_bars() as progress:
        write_drive(
            output, scene=scene, sensor=sensor, frames=frames, seed=seed, skew=skew,
            beam_width_deg=beam_width, blooming_deg=bloom, force=force,
            progress=progress,
        )  # fmt: skip
    if not volume.quiet:
        say(f"{frames} sweeps in {sequence_folder(output)}")


@verb()
def demo(
    output: Annotated[Path, option("Folder for drive and run.", "DIR", "-o --output")] = Path(
        "demo"
    ),
    frames: Annotated[
        int,
        option("Number of sweeps, ten a second; five of the Pandar40P.", "N", min=3, max=100000),
    ] = 40,
    preset: PresetName = "default",
    threads: Threads = 0,
) -> None:
    """Make a synthetic drive and its depth maps, and print their errors."""
    values = parameters(preset)  # type: ignore[arg-type]
    sequence, folder = sequence_folder(output / "drive"), output / "run"
    with progress_bars() as progress:
        _write_drive_of_demo(output, frames, progress)
        run(sequence, folder, values, camera="image_2", threads=threads, progress=progress)
    show_summary(RunFolder(folder))
    with progress_bars() as progress:
        labels = evaluate_labels(folder, sequence, progress)
        depth = evaluate_depth(folder, sequence, progress=progress)
    for table in (labels.table(), depth.table()):
        rows = tuple(row for row in table.rows if row[0] in _ROWS_OF_THE_DEMO)
        say(f"\n{replace(table, rows=rows)}")
    if not volume.quiet:
        say(
            f"\nmore figures: docdepth evaluate labels {folder} --labels {sequence}",
            f"              docdepth evaluate depth {folder} --depth {sequence}",
        )


def _write_drive_of_demo(output: Path, frames: int, progress: Progress) -> None:
    """Write the drive, if it is not there; another one is refused."""
    drive = "city", 0, frames
    about = written_drive(sequence_folder(output / "drive"))
    if about is not None and (about["scene"], about["seed"], about["frames"]) != drive:
        raise DatasetError(
            f"{output} holds the demo of another drive ({described(about)}), not of {frames} "
            "frames; choose another folder with -o, or delete this one"
        )
    if not (sequence_folder(output / "drive") / "docdepth.yaml").is_file():
        write_drive(output / "drive", "city", "HDL-64", frames, seed=0, progress=progress)
