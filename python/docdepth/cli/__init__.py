"""The command line: each verb is a stage of the paper, or a question about its result."""

from __future__ import annotations

import ctypes
import os
import sys
import threading
import time
from functools import cache
from typing import Annotated

import typer

from docdepth._core import __version__
from docdepth.cli import (  # noqa: F401
    calibrate,
    convert,
    doctor,
    evaluate,
    inspect,
    look,
    stages,
    status,
    synth,
    tune,
)
from docdepth.cli.failures import STOPPED, print_error
from docdepth.cli.options import Quiet, Verbose
from docdepth.cli.terminal import app, out, print_any_path, set_volume


@app.callback(invoke_without_command=True)
def options(
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Set up what every verb shares."""
    set_volume(quiet, verbose)
    if version:
        out.print(__version__)
        raise typer.Exit


_GIVEN_BACK_EVERY = 10.0
"""Some twenty sweeps by an HDL-64 take as much processor time [s]."""


@cache
def keep_memory() -> None:
    """Have glibc keep what arrays leave behind, in one place for all threads.

    Every sweep needs the same megabytes. The system clears them page by page when they were given
    back in between, which takes a tenth of the time of ``classify``. But small things that stay lie
    between, so the heap of a long drive grows though nothing more is in use. So what is free goes
    back after all, once in a while: memory is that of so much work, however long the drive. The
    clock is processor time, since on a busy machine hardly a sweep is done in a second. Arrays
    above 8 MB go back at once: voxel maps grow by doubling, and each would leave a hole.
    """
    library = ctypes.CDLL(None)
    if sys.platform != "linux" or not hasattr(library, "mallopt"):
        return
    trim_threshold, top_pad, mmap_threshold, arena_max = -1, -2, -3, -8
    for parameter, value in (
        (trim_threshold, 1 << 30),
        (top_pad, 1 << 26),
        (mmap_threshold, 1 << 23),
        (arena_max, 1),
    ):
        library.mallopt(parameter, value)

    def give_back() -> None:
        due = _GIVEN_BACK_EVERY
        while True:
            time.sleep(1.0)
            if time.process_time() >= due:
                library.malloc_trim(0)
                due = time.process_time() + _GIVEN_BACK_EVERY

    threading.Thread(target=give_back, name="give back memory", daemon=True).start()


def take_one_blas_thread() -> bool:
    """Have numpy's OpenBLAS multiply in the calling thread; tell whether it does.

    A product with a 3 x 3 matrix is over before other threads have started, and these then wait for
    the next by turning round: a tenth of the processor time of a run. Where numpy has another
    library, or OPENBLAS_NUM_THREADS is set, nothing changes.
    """
    if "OPENBLAS_NUM_THREADS" in os.environ:
        return False
    modules = (sys.modules.get(f"numpy.{name}._multiarray_umath") for name in ("_core", "core"))
    for module in modules:
        library = ctypes.CDLL(getattr(module, "__file__", None))
        for name in _SET_BLAS_THREADS:
            if hasattr(library, name):
                getattr(library, name)(1)
                return True
    return False


_SET_BLAS_THREADS = (
    "scipy_openblas_set_num_threads64_",  # of numpy's wheels since 1.26
    "openblas_set_num_threads64_",
    "openblas_set_num_threads",
)


def _from_home(word: str) -> str:
    """A word with its ``~/`` written out, which shells leave in quotes and behind ``--output=``.

    Else a folder named ~ would be made, and ``rm -r ~`` removes the home instead of it.
    """
    option, mark, value = word.rpartition("=") if word.startswith("--") else ("", "", word)
    return option + mark + (os.path.expanduser(value) if value.startswith("~/") else value)


def main() -> None:
    """Entry point: every end without a result is a sentence and an exit code, never a traceback."""
    try:
        keep_memory()
        take_one_blas_thread()
        print_any_path()
        code = app(args=[_from_home(word) for word in sys.argv[1:]], standalone_mode=False)
        if code == STOPPED:  # typer has taken the KeyboardInterrupt
            raise KeyboardInterrupt
    except (Exception, KeyboardInterrupt) as error:
        code = print_error(error)
    sys.exit(code)
