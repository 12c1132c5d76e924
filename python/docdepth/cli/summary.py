"""What a run has taken and given, as a table or as JSON."""

from __future__ import annotations

import json
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from rich.table import Table

from docdepth.cli.remedies import as_commands
from docdepth.cli.terminal import err, out, volume

if TYPE_CHECKING:
    from docdepth.errors import Finding
    from docdepth.io.run_folder import RunFolder


def show(result: Any, as_json: bool) -> None:
    """Print metrics: their table with its legend, or all of them as JSON."""
    if as_json:
        return show_json(result.as_dict())
    out.print(str(result.table()), soft_wrap=True, markup=False)


def show_findings(findings: Iterable[Finding]) -> None:
    """Print findings, a line each."""
    for found in findings:
        colour = {"error": "red", "warning": "yellow"}.get(found.severity, "cyan")
        err.print(f"{found.severity}:", style=colour, end=" ")
        err.print(as_commands(str(found)), soft_wrap=True, markup=False)


def show_json(value: Any) -> None:
    out.print(json.dumps(value, indent=1), soft_wrap=True, markup=False)


def summary_of(folder: RunFolder) -> dict[str, Any]:
    """State and seconds of each stage, cameras and peak memory, ready for JSON."""
    from docdepth.pipeline.plan import states

    stages = folder.manifest.stages
    found = states(folder)
    return {
        "run": str(folder.path),
        "stages": {
            state.name: {
                "state": state.state,
                "why": state.why,
                "frames": state.all_frames,
                "made": folder.stage(state.name).total_frames,
                "seconds": state.seconds,
                "seconds_by_step": folder.stage(state.name).seconds,
                "warnings": folder.stage(state.name).warnings,
            }
            for state in found
        },
        "cameras": {
            name: {
                "density": folder.stage(f"render {name}").density,
                "left_out": folder.stage(f"render {name}").left_out,
            }
            for name in folder.cameras
        },
        "peak_memory_mb": max((entry.peak_memory_mb for entry in stages.values()), default=0),
    }


_LEAST_SHARE = 0.1
"""Of the seconds of a stage: smaller steps are not shown."""


def show_summary(folder: RunFolder, as_json: bool = False) -> None:
    """Print seconds per stage, density, images left out, and what is not up to date."""
    from docdepth.cli.changes import changes_since_start

    summary = summary_of(folder)
    if as_json:
        return show_json(summary)
    if volume.quiet:
        return None
    table = Table("stage", "frames", "seconds", "ms/frame", "seconds of larger steps", box=None)
    for name, state in summary["stages"].items():
        steps = sorted(state["seconds_by_step"].items(), key=lambda step: -step[1])
        least = max(0.05, _LEAST_SHARE * sum(seconds for _, seconds in steps))
        parts = ", ".join(f"{step} {seconds:.1f}" for step, seconds in steps if seconds >= least)
        each = f"{1000 * state['seconds'] / state['made']:.0f}" if state["made"] else ""
        table.add_row(name, str(state["frames"]), f"{state['seconds']:.1f}", each, parts)
    out.print(table)
    lines = []
    for name, camera in summary["cameras"].items():
        if camera["density"] is not None:
            lines.append(
                f"density of {name}: {100 * camera['density']:.1f} % of the pixels have depth"
            )
        if left := camera["left_out"]:
            images = "image" if len(left) == 1 else "images"
            lines.append(f"{len(left)} {images} outside the sweeps left out: {', '.join(left)}")
    lines.append(f"peak memory {summary['peak_memory_mb']} MB; results in {folder.path}")
    lines += changes_since_start(folder)
    if left := [name for name, state in summary["stages"].items() if state["state"] != "done"]:
        remedy = f"docdepth run {folder.path}"
        lines.append(f"not up to date: {', '.join(left)}; bring it up to date: {remedy}")
    elif (page := folder.path / "report" / "index.html").is_file():
        lines.append(f"look at it: open {page} in a browser")
    for line in lines:
        out.print(line, soft_wrap=True, markup=False)
