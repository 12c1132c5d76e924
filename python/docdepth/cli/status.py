"""The verb that tells the state of a run."""

from __future__ import annotations

import json
from typing import Annotated

import typer
from rich.table import Table

from docdepth.cli.options import Json, RunPath, app, out


@app.command()
def status(
    run: RunPath,
    verify: Annotated[
        bool, typer.Option("--verify", help="Compare the content of every file with its checksum.")
    ] = False,
    as_json: Json = False,
) -> None:
    """Tell which results of a run are done, out of date, damaged or missing, and why."""
    from docdepth.io.lock import holder
    from docdepth.io.run_folder import RunFolder
    from docdepth.pipeline.run import changes_since_start, states

    folder = RunFolder.open(run)
    found, busy = states(folder, verify=verify), holder(folder.notes / "lock")
    if as_json:
        stages = [state.as_dict() for state in found]
        out.print(json.dumps({"in_use_by": busy, "stages": stages}, indent=1), soft_wrap=True)
        return
    table = Table("stage", "state", "frames", "seconds", "MB", "why", box=None)
    for state in found:
        frames = f"{state.frames}/{state.all_frames}"
        size = f"{state.size / 1e6:.1f}"
        table.add_row(state.name, state.state, frames, f"{state.seconds:.1f}", size, state.why)
    out.print(table, markup=False)
    if busy:
        out.print(f"in use by {busy}", soft_wrap=True, markup=False)
    for change in changes_since_start(folder):
        out.print(change, soft_wrap=True, markup=False)
    if any(state.state != "done" for state in found):
        out.print(f"bring it up to date: docdepth run {run}", soft_wrap=True, markup=False)
