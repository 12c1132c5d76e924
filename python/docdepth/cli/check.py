"""The verb that checks inputs and runs nothing."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from docdepth.cli.options import (
    CameraNames,
    Formats,
    LayerNames,
    Scale,
    Settings,
    app,
    err,
    listed,
    out,
    output_of,
)


@app.command()
def check(
    dataset: Annotated[
        Path, typer.Argument(help="Folder of a recording (KITTI raw, KITTI odometry) or of a run.")
    ],
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="RUN", help="Run folder that will be written."),
    ] = None,
    layout: Annotated[
        str | None,
        typer.Option(
            "--dataset",
            metavar="LAYOUT",
            help="kitti_raw, kitti_odometry, semantic_kitti or run; guessed if absent.",
        ),
    ] = None,
    camera: CameraNames = None,
    poses: Annotated[
        Path | None, typer.Option(help="LiDAR poses of your SLAM, TUM or KITTI format.")
    ] = None,
    camera_times: Annotated[
        Path | None, typer.Option(help="Image times in seconds, one a line.")
    ] = None,
    image_size: Annotated[
        str | None, typer.Option(metavar="WxH", help="Image size in pixels.")
    ] = None,
    frames: Annotated[
        str | None, typer.Option(metavar="A:B", help="Sweeps A to B - 1 alone.")
    ] = None,
    preset: Annotated[
        str, typer.Option(help="default (most accurate) or paper (the paper's method).")
    ] = "default",
    settings: Settings = None,
    format: Formats = None,
    scale: Scale = None,
    layers: LayerNames = None,
) -> None:
    """Check all inputs of a run, and tell all problems at once. Nothing is written.

    docdepth check 2011_09_26_drive_0005_sync --camera image_02
    """
    from docdepth.config import parameters, parse_settings
    from docdepth.pipeline.check import report_inputs

    changes = parse_settings(settings or []) | output_of(format, scale, layers)
    source = {
        "dataset": str(dataset),
        "name": layout,
        "camera": listed(camera),
        "poses": None if poses is None else str(poses),
        "camera_times": None if camera_times is None else str(camera_times),
        "image_size": image_size,
        "frames": frames,
    }
    report = report_inputs(source, parameters(preset, changes), output)  # type: ignore[arg-type]
    for problem in report.problems:
        colour = "red" if problem.severity == "error" else "yellow"
        err.print(f"{problem.severity}:", style=colour, end=" ")
        err.print(problem.text, soft_wrap=True, markup=False)
    if any(problem.severity == "error" for problem in report.problems):
        raise typer.Exit(2)
    out.print(f"ok: {report.summary}", soft_wrap=True, markup=False)
