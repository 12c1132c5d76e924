"""The verb that tells what a recording holds, and what is wrong with it."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from docdepth.cli.options import Json, option, verb
from docdepth.cli.status import show_findings
from docdepth.cli.terminal import as_commands, say, show_json
from docdepth.diagnostics.recording_pictures import pictures_of
from docdepth.diagnostics.recording_report import inspect_recording
from docdepth.errors import Finding
from docdepth.io.inputs import RunInputs
from docdepth.pipeline.run_inputs import known_poses, open_recording
from docdepth.pipeline.stage import recorded_warnings
from docdepth.visualization.inspection import inspection_lines, write_inspection
from docdepth.visualization.page import check_page


@verb(
    inputs=RunInputs,
    but=("camera", "camera_times", "labels", "image_size", "on_error", "hash_inputs"),
)
def inspect(
    recording: Annotated[
        Path, typer.Argument(metavar="RECORDING", help="A recording: its folder, or a bag.")
    ],
    output: Annotated[Path, option("Page to write, with pictures.", "PAGE", "-o --output")] = Path(
        "inspect.html"
    ),
    *,
    inputs: dict[str, object],
    as_json: Json = False,
) -> None:
    """Tell what a recording holds, and which frames, poses and times look wrong.

    A few sweeps are opened and registered. The page shows sweeps over each other by their poses,
    and points on images: look at it before a long run.

      docdepth inspect drive.mcap -o drive.html
    """
    check_page(output)
    chosen = RunInputs(recording=recording, **inputs)
    with recorded_warnings() as logged:  # readers' notices are printed at once
        drive = open_recording(chosen)
        given = known_poses(chosen, drive)
    notices = [Finding("notice", "", text) for text in logged]
    result = inspect_recording(drive, given, notices)
    pictures = list(pictures_of(drive, result))
    said = [(found.severity, as_commands(str(found))) for found in result.findings]
    write_inspection(output, result.figures, said, pictures)
    if as_json:
        show_json({**result.figures, "findings": [asdict(found) for found in result.findings]})
    else:
        say(*inspection_lines(result.figures))
        show_findings(found for found in result.findings if found not in notices)
        say(f"pictures: {output}")
    if any(found.severity == "error" for found in result.findings):
        raise typer.Exit(2)
