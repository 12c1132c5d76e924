"""The command line: each verb is a stage of the paper, or a question about its result."""

from __future__ import annotations

import ctypes
import logging
import sys
from typing import Annotated

import typer
from rich.logging import RichHandler

from docdepth.cli import check, stages, truth
from docdepth.cli.options import app, err, out
from docdepth.errors import DocDepthError

__all__ = ["app", "check", "main", "stages", "truth"]


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


def keep_memory() -> None:
    """Have glibc keep what arrays leave behind, in one place for all threads.

    Every sweep needs the same megabytes. The system clears them page by page when they were given
    back in between, which takes a tenth of the time of ``classify``.
    """
    if sys.platform != "linux" or not hasattr(ctypes.CDLL(None), "mallopt"):
        return
    trim_threshold, top_pad, mmap_threshold, arena_max = -1, -2, -3, -8
    for parameter, value in (
        (trim_threshold, 1 << 30),
        (top_pad, 1 << 26),
        (mmap_threshold, 1 << 25),
        (arena_max, 1),
    ):
        ctypes.CDLL(None).mallopt(parameter, value)


def main() -> None:
    """Entry point: one clear sentence and exit code 2 for a user's mistake."""
    keep_memory()
    try:
        app()
    except DocDepthError as error:
        err.print("error:", style="red", end=" ")
        err.print(str(error), soft_wrap=True, markup=False)
        sys.exit(2)
