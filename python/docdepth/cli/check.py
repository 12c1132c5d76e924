"""The verb that checks inputs and runs nothing."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from docdepth.cli.options import (
    CalibrationFile,
    CameraNames,
    CameraTimes,
    DatasetName,
    Formats,
    Frames,
    GivenLabels,
    ImageSize,
    LayerNames,
    PosesFile,
    PresetName,
    Scale,
    Settings,
    changes_of,
    listed,
    output_of,
)
from docdepth.cli.summary import show_findings
from docdepth.cli.terminal import app, out, verb


@verb(app)
def check(
    recording: Annotated[
        Path,
        typer.Argument(
            metavar="RECORDING", help="A recording (its folder, or a bag), or the folder of a run."
        ),
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            "-o", "--output", metavar="RUN", help="Run folder: is there room, may you write there?"
        ),
    ] = None,
    dataset: DatasetName = None,
    camera: CameraNames = None,
    frames: Frames = None,
    poses: PosesFile = None,
    camera_times: CameraTimes = None,
    calibration: CalibrationFile = None,
    labels: GivenLabels = None,
    image_size: ImageSize = None,
    preset: PresetName = "default",
    settings: Settings = None,
    format: Formats = None,
    scale: Scale = None,
    layers: LayerNames = None,
) -> None:
    """Check all inputs of a run, and tell all problems at once. Nothing is written.

    docdepth check 2011_09_26_drive_0005_sync --camera image_02
    """
    from docdepth.config import parameters
    from docdepth.pipeline.check import report_inputs
    from docdepth.pipeline.given_poses import poses_entry

    changes = changes_of(settings) | output_of(format, scale, layers)
    source = {
        "dataset": str(recording),
        "name": dataset,
        "camera": listed(camera),
        "poses": poses_entry(poses),
        "camera_times": None if camera_times is None else str(camera_times),
        "calibration": None if calibration is None else str(calibration),
        "labels": None if labels is None else str(labels),
        "image_size": image_size,
        "frames": frames,
    }
    report = report_inputs(source, parameters(preset, changes), output)  # type: ignore[arg-type]
    show_findings(report.findings)
    if any(found.severity == "error" for found in report.findings):
        raise typer.Exit(2)
    out.print(f"ok: {report.summary}", soft_wrap=True, markup=False)
