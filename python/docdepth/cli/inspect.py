"""The verb that tells what a recording holds, and what is wrong with it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from docdepth.cli.options import (
    CalibrationFile,
    DatasetName,
    Frames,
    Json,
    PosesFile,
)
from docdepth.cli.summary import show_json
from docdepth.cli.terminal import app, err, out, verb

if TYPE_CHECKING:
    from docdepth.inspection.inspection import Inspection


@verb(app)
def inspect(
    recording: Annotated[
        Path, typer.Argument(metavar="RECORDING", help="A recording: its folder, or a bag.")
    ],
    output: Annotated[
        Path,
        typer.Option("-o", "--output", metavar="PAGE", help="Page to write, with pictures."),
    ] = Path("inspect.html"),
    dataset: DatasetName = None,
    frames: Frames = None,
    poses: PosesFile = None,
    calibration: CalibrationFile = None,
    as_json: Json = False,
) -> None:
    """Tell what a recording holds, and which frames, poses and times look wrong.

    A few sweeps are opened and registered. The page shows sweeps over each other by their poses,
    and points on images: look at it before a long run.

      docdepth inspect drive.mcap -o drive.html
    """
    from docdepth.inspection.inspect import inspect_recording
    from docdepth.inspection.pictures import pictures_of
    from docdepth.pipeline.given_poses import poses_entry
    from docdepth.pipeline.run_inputs import known_poses, open_recording
    from docdepth.pipeline.stage import recorded_warnings
    from docdepth.visualization.inspection_page import write_inspection
    from docdepth.visualization.page import check_page

    check_page(output)
    source: dict[str, Any] = {
        "dataset": str(recording),
        "name": dataset,
        "poses": poses_entry(poses),
        "calibration": None if calibration is None else str(calibration),
        "frames": frames,
    }
    with recorded_warnings() as logged:  # these are printed when they are found
        drive = open_recording(source)
        given = known_poses(source, drive)
        result = inspect_recording(drive, given, opening=list(logged))
        pictures = list(pictures_of(drive, result))
    findings: list[tuple[str, str]] = [(p.severity, p.text) for p in result.problems]
    findings += [("note", text) for text in result.notes]
    write_inspection(output, result.figures, findings, pictures)
    if as_json:
        show_json({**result.figures, "findings": [
            {"severity": severity, "text": text} for severity, text in findings
        ]})  # fmt: skip
    else:
        _show(result, [finding for finding in findings if finding[1] not in logged])
        out.print(f"pictures: {output}", soft_wrap=True, markup=False)
    if any(severity == "error" for severity, _ in findings):
        raise typer.Exit(2)


def _show(result: Inspection, findings: list[tuple[str, str]]) -> None:
    from docdepth.visualization.inspection_text import inspection_lines

    for line in inspection_lines(result.figures):
        out.print(line, soft_wrap=True, markup=False, highlight=False)
    for severity, text in findings:
        colour = {"error": "red", "warning": "yellow"}.get(severity, "cyan")
        err.print(f"{severity}:", style=colour, end=" ")
        err.print(text, soft_wrap=True, markup=False)
