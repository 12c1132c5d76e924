"""The verb that checks inputs and runs nothing."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from docdepth.cli.options import (
    Formats,
    LayerNames,
    PresetName,
    Scale,
    Settings,
    changes_of,
    output_of,
    with_options,
)
from docdepth.cli.summary import show_findings
from docdepth.cli.terminal import app, out, verb
from docdepth.io.inputs import RunInputs


@verb(app)
@with_options(inputs=RunInputs, but=("on_error", "hash_inputs"))
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
    *,
    inputs: dict[str, Any],
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

    changes = changes_of(settings) | output_of(format, scale, layers)
    given = RunInputs(recording=recording, **inputs)
    report = report_inputs(given, parameters(preset, changes), output)  # type: ignore[arg-type]
    show_findings(report.findings)
    if any(found.severity == "error" for found in report.findings):
        raise typer.Exit(2)
    out.print(f"ok: {report.summary}", soft_wrap=True, markup=False)
