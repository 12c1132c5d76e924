"""The state of a run: its verb, and the table that ends each verb that makes results."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Any

from rich.table import Table

from docdepth._text import as_setting
from docdepth.cli.options import Json, RunPath, option, verb
from docdepth.cli.terminal import as_commands, err, out, say, show_json, volume
from docdepth.errors import Finding
from docdepth.io.atomic import holder
from docdepth.io.run_folder import RunFolder
from docdepth.pipeline.plan import states

_LEAST_SHARE = 0.1
"""Of the seconds of a stage: smaller steps are not shown."""


@verb()
def status(
    run: RunPath,
    verify: Annotated[
        bool, option("Compare the content of every file with its checksum.", flags="--verify")
    ] = False,
    as_json: Json = False,
) -> None:
    """Tell which results of a run are done, out of date, damaged or missing, and why."""
    show_states(RunFolder.open(run), as_json, verify)


def show_states(folder: RunFolder, as_json: bool, verify: bool = False) -> None:
    """Print the state of each stage."""
    left_out = folder.manifest.derived.skipped
    skipped = [] if left_out is None else left_out.sentences()
    found, busy = states(folder, verify=verify), holder(folder.state_dir / "lock")
    estimate = folder.manifest.estimate
    if as_json:
        stages = [state.as_dict() for state in found]
        return show_json(
            {"in_use_by": busy, "stages": stages, "skipped": skipped, "estimate": estimate}
        )
    table = Table("stage", "state", "frames", "seconds", "MB", "why", box=None)
    for state in found:
        frames, size = f"{state.frames}/{state.all_frames}", f"{state.size / 1e6:.1f}"
        why = as_commands(state.why)
        table.add_row(state.name, state.state, frames, f"{state.seconds:.1f}", size, why)
    out.print(table)
    lines = [f"in use by {busy}"] if busy else []
    lines += [f"left out: {text}" for text in skipped]
    lines += changes_since_start(folder)
    if left := [state.name for state in found if state.state != "done"]:
        lines += [estimate] * bool(estimate)
        lines.append(f"docdepth run {folder.path} makes: {', '.join(left)}")
    return say(*lines)


def show_summary(folder: RunFolder, as_json: bool = False) -> None:
    """Print seconds per stage, density, images left out, and what is not up to date."""
    summary = _summary_of(folder)
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
        if (density := camera["density"]) is not None:
            lines.append(f"density of {name}: {100 * density:.1f} % of the pixels have depth")
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
    return say(*lines)


def _summary_of(folder: RunFolder) -> dict[str, Any]:
    """State and seconds of each stage, cameras and peak memory, ready for JSON."""
    stages = folder.manifest.stages
    rendered = {name: folder.stage(f"render {name}") for name in folder.cameras}
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
            for state in states(folder)
        },
        "cameras": {
            name: {"density": stage.density, "left_out": stage.left_out}
            for name, stage in rendered.items()
        },
        "peak_memory_mb": max((entry.peak_memory_mb for entry in stages.values()), default=0),
    }


def changes_since_start(folder: RunFolder) -> list[str]:
    """A sentence that tells which parameters were changed, with the command that goes back."""
    if folder.manifest.parameters_at_start is None:
        return []
    at_start = folder.manifest.parameters_at_start.model_dump(mode="json")
    now = folder.parameters.model_dump(mode="json")
    changed = [
        (f"{stage}.{key}", now[stage][key], value)
        for stage, values in at_start.items()
        if isinstance(values, dict)
        for key, value in values.items()
        if now[stage][key] != value
    ]
    if not changed:
        return []
    what = ", ".join(
        f"{key} is {as_setting(new)}, was {as_setting(old)}" for key, new, old in changed
    )
    back = " ".join(f"--set {key}={as_setting(old)}" for key, _, old in changed)
    return [f"{what}; back: docdepth run {folder.path} {back}"]


def show(result: Any, as_json: bool) -> None:
    """Print metrics: their table with its legend, or all of them as JSON."""
    return show_json(result.as_dict()) if as_json else say(str(result.table()))


def show_findings(findings: Iterable[Finding]) -> None:
    """Print findings, a line each."""
    for found in findings:
        colour = {"error": "red", "warning": "yellow"}.get(found.severity, "cyan")
        err.print(f"{found.severity}:", style=colour, end=" ")
        say(as_commands(str(found)), to=err)
