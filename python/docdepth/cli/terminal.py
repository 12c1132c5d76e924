"""What is printed, and where: consoles, warnings, and how much of it is wanted."""

from __future__ import annotations

import codecs
import inspect
import io
import logging
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import wraps
from typing import Annotated, Any, TypeVar, get_type_hints

import typer
from rich.console import Console
from typer.core import TyperGroup

from docdepth.cli.remedies import as_commands

_ORDER = (
    *("demo", "inspect", "check", "run", "status", "report", "view", "map", "video"),
    *("evaluate", "tune", "convert", "calibrate", "odometry", "classify", "render"),
)


class _Verbs(TyperGroup):
    """Lists the verbs in the order in which a reader needs them."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Names of the verbs; those without a place come last."""
        names = super().list_commands(ctx)
        return sorted(names, key=lambda name: (*_ORDER, name).index(name))


app = typer.Typer(
    cls=_Verbs,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Dense, metric depth maps for camera images from LiDAR recordings (DOC-Depth).",
)

_SIGPIPE = 141  # what a shell reports of a program that wrote into a closed pipe


class _Console(Console):
    def on_broken_pipe(self) -> None:
        """End without a word: whoever read the output has gone (``docdepth ... | head``)."""
        self.quiet = True
        sys.stdout = io.StringIO()  # else the interpreter complains when it flushes at its end
        raise SystemExit(_SIGPIPE)


out = _Console(highlight=False)
err = _Console(stderr=True, highlight=False)


@dataclass
class _Volume:
    quiet: bool = False
    verbose: bool = False


volume = _Volume()
"""What ``--quiet`` and ``--verbose`` ask for."""


class _Lines(logging.Handler):
    """Log records as lines of their own, never broken at the width of a terminal.

    A recording is opened several times by one command; each of its warnings is printed once.
    """

    def __init__(self) -> None:
        super().__init__()
        self.printed: set[str] = set()

    def emit(self, record: logging.LogRecord) -> None:
        message = as_commands(record.getMessage())
        if record.levelno >= logging.WARNING:
            if message in self.printed:
                return
            self.printed.add(message)
            err.print("warning:", style="yellow", end=" ")
        err.print(message, soft_wrap=True, markup=False)


_LINES = _Lines()


def set_volume(quiet: bool, verbose: bool) -> None:
    """Say how much is printed from now on."""
    volume.quiet, volume.verbose = quiet, verbose
    _LINES.printed.clear()
    root = logging.getLogger()
    if _LINES not in root.handlers:
        root.addHandler(_LINES)
    root.setLevel(logging.INFO if verbose else logging.WARNING)


def print_any_path() -> None:
    """Let every file name be printed, whatever its bytes and the terminal's encoding."""
    codecs.register_error("docdepth", _printable)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="docdepth")


def _printable(error: UnicodeError) -> tuple[str, int]:
    r"""Bytes of a path that are no text as ``\xff``, other characters as ``\u20ac``."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    escaped = (
        f"\\x{ord(c) - 0xDC00:02x}" if "\udc80" <= c <= "\udcff" else _escaped(c)
        for c in error.object[error.start : error.end]
    )
    return "".join(escaped), error.end


def _escaped(character: str) -> str:
    return character.encode("ascii", "backslashreplace").decode()


def _unwrapped(function: Callable[..., Any]) -> str:
    """The help of a verb with each paragraph in one line; indented lines are examples and stay."""
    paragraphs = inspect.cleandoc(function.__doc__ or "").split("\n\n")
    return "\n\n".join(p if p.startswith(" ") else " ".join(p.split("\n")) for p in paragraphs)


_Verb = TypeVar("_Verb", bound=Callable[..., Any])
Quiet = Annotated[
    bool,
    typer.Option("--quiet", "-q", help="Print only the result asked for, warnings and errors."),
]
Verbose = Annotated[
    bool, typer.Option("--verbose", "-v", help="Print each step, and the traceback of a bug.")
]


def verb(group: typer.Typer, name: str | None = None) -> Callable[[_Verb], _Verb]:
    """Register a verb that takes ``--quiet`` and ``--verbose`` as well."""

    def register(function: _Verb) -> _Verb:
        @wraps(function)
        def call(*args: Any, quiet: bool = False, verbose: bool = False, **options: Any) -> Any:
            set_volume(quiet or volume.quiet, verbose or volume.verbose)
            return function(*args, **options)

        hints = {
            **get_type_hints(function, include_extras=True), "quiet": Quiet, "verbose": Verbose
        }  # fmt: skip
        every = dict(inspect.signature(function).parameters)
        for added in ("quiet", "verbose"):
            every[added] = inspect.Parameter(added, inspect.Parameter.KEYWORD_ONLY, default=False)
        resolved = [p.replace(annotation=hints[name]) for name, p in every.items()]
        call.__signature__ = inspect.Signature(resolved)  # type: ignore[attr-defined]
        call.__annotations__ = hints
        call.__doc__ = _unwrapped(function)
        group.command(name)(call)
        return function

    return register
