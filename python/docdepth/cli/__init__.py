"""The command line: each verb is a stage of the paper, or a question about its result."""

from __future__ import annotations

import logging
import sys
from typing import Annotated

import typer
from rich.logging import RichHandler

from docdepth.cli import stages, truth
from docdepth.cli.shared import app, err, out
from docdepth.errors import DocDepthError

__all__ = ["app", "main", "stages", "truth"]


@app.callback(invoke_without_command=True)
def options(
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Log what is done.")] = False,
) -> None:
    """Set up what every verb shares."""
    logging.basicConfig(
        level=logging.INFO if verbose else logging.WARNING,
        format="%(message)s",
        handlers=[RichHandler(console=err, show_time=False, show_path=False)],
    )
    if version:
        from docdepth import __version__

        out.print(__version__)
        raise typer.Exit


def main() -> None:
    """Entry point: one clear sentence and exit code 2 for a user's mistake."""
    try:
        app()
    except DocDepthError as error:
        err.print("error:", style="red", end=" ")
        err.print(str(error), soft_wrap=True, markup=False)
        sys.exit(2)
