"""The verb that tells the state of a run."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from docdepth.cli.options import Json, RunPath
from docdepth.cli.remedies import as_commands
from docdepth.cli.summary import show_json
from docdepth.cli.terminal import app, out, verb

if TYPE_CHECKING:
    from docdepth.io.run_folder import RunFolder


@verb(app)
def status(
    run: RunPath,
    verify: Annotated[
        bool, typer.Option("--verify", help="Compare the content of every file with its checksum.")
    ] = False,
    as_json: Json = False,
) -> None:
    """Tell which results of a run are done, out of date, damaged or missing, and why."""
    from docdepth.io.run_folder import RunFolder

    show_states(RunFolder.open(run), as_json, verify)


def show_states(folder: RunFolder, as_json: bool, verify: bool = False) -> None:
    """Print the state of each stage."""
    from docdepth.cli.changes import changes_since_start
    from docdepth.io.lock import holder
    from docdepth.pipeline.plan import states

    left_out = folder.manifest.derived.skipped
    skipped = [] if left_out is None else left_out.sentences()
    found, busy = states(folder, verify=verify), holder(folder.notes / "lock")
    if as_json:
        return show_json(
            {
                "in_use_by": busy,
                "stages": [state.as_dict() for state in found],
                "skipped": skipped,
                "estimate": folder.manifest.estimate,
            }
        )
    table = Table("stage", "state", "frames", "seconds", "MB", "why", box=None)
    for state in found:
        frames = f"{state.frames}/{state.all_frames}"
        size = f"{state.size / 1e6:.1f}"
        why = as_commands(state.why)
        table.add_row(state.name, state.state, frames, f"{state.seconds:.1f}", size, why)
    out.print(table)
    lines = [f"in use by {busy}"] if busy else []
    lines += [f"left out: {text}" for text in skipped]
    lines += changes_since_start(folder)
    if left := [state.name for state in found if state.state != "done"]:
        lines += [folder.manifest.estimate] * bool(folder.manifest.estimate)
        lines.append(f"docdepth run {folder.path} makes: {', '.join(left)}")
    for line in lines:
        out.print(line, soft_wrap=True, markup=False)
    return None
