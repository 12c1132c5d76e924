"""The verb that checks inputs and runs nothing."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from docdepth.cli.options import (
    Formats,
    LayerNames,
    PresetName,
    Scale,
    Settings,
    changes,
    option,
    verb,
)
from docdepth.cli.status import show_findings
from docdepth.cli.terminal import say
from docdepth.config import parameters
from docdepth.io.inputs import RunInputs
from docdepth.pipeline.check import report_inputs


@verb(inputs=RunInputs, but=("on_error", "hash_inputs", "camera_fit"))
def check(
    recording: Annotated[
        Path,
        typer.Argument(
            metavar="RECORDING", help="A recording (its folder, or a bag), or the folder of a run."
        ),
    ],
    output: Annotated[
        Path | None,
        option("Run folder: is there room, may you write there?", "RUN", "-o --output"),
    ] = None,
    *,
    inputs: dict[str, object],
    preset: PresetName = "default",
    settings: Settings = None,
    format: Formats = None,
    scale: Scale = None,
    layers: LayerNames = None,
) -> None:
    """Check all inputs of a run, and tell all problems at once. Nothing is written.

    docdepth check 2011_09_26_drive_0005_sync --camera image_02
    """
    values = parameters(preset, changes(settings, format, scale, layers))  # type: ignore[arg-type]
    report = report_inputs(RunInputs(recording=recording, **inputs), values, output)
    show_findings(report.findings)
    if any(found.severity == "error" for found in report.findings):
        raise typer.Exit(2)
    say(f"ok: {report.summary}")
