"""What is printed, and where: consoles, warnings, and how much of it is wanted."""

from __future__ import annotations

import ast
import codecs
import io
import json
import logging
import re
import shlex
import sys
from dataclasses import dataclass
from typing import Any

import typer
from rich.console import Console
from rich.text import Text
from typer.core import TyperGroup

from docdepth.errors import NOTE

_ORDER = (
    *("demo", "inspect", "run", "status", "view", "map", "video"),
    *("evaluate", "tune", "convert", "calibrate", "render"),
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


_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]")
"""Characters that steer a terminal, which names of files and texts of recordings may hold."""


class _Console(Console):
    def render_str(self, text: str, **options: Any) -> Text:
        r"""Any text that is printed: control characters are told as ``\x1b``."""
        return super().render_str(_CONTROL.sub(lambda c: f"\\x{ord(c[0]):02x}", text), **options)

    def on_broken_pipe(self) -> None:
        """End without a word: whoever read the output has gone (``docdepth ... | head``)."""
        self.quiet = True
        sys.stdout = io.StringIO()  # else the interpreter complains when it flushes at its end
        raise SystemExit(_SIGPIPE)


out = _Console(highlight=False)
err = _Console(stderr=True, highlight=False)


def say(*lines: str, to: Console = out) -> None:
    """Print lines as they are, never broken at the width of a terminal."""
    for line in lines:
        to.print(line, soft_wrap=True, markup=False)


def show_json(value: Any) -> None:
    """Print a value as JSON."""
    say(json.dumps(value, indent=1))


@dataclass
class _Volume:
    quiet: bool = False
    verbose: bool = False


volume = _Volume()
"""What ``--quiet`` and ``--verbose`` ask for."""


class _Lines(logging.Handler):
    """Log records as lines of their own, never broken at the width of a terminal.

    A recording is opened several times by one command; each of its warnings and notes is printed
    once.
    """

    def __init__(self) -> None:
        super().__init__()
        self.printed: set[str] = set()

    def emit(self, record: logging.LogRecord) -> None:
        message = as_commands(record.getMessage())
        if record.levelno >= NOTE:
            if message in self.printed:
                return
            self.printed.add(message)
            word, style = ("note", "cyan") if record.levelno == NOTE else ("warning", "yellow")
            err.print(f"{word}:", style=style, end=" ")
        say(message, to=err)


_LINES = _Lines()


def set_volume(quiet: bool, verbose: bool) -> None:
    """Say how much is printed from now on."""
    volume.quiet, volume.verbose = quiet, verbose
    _LINES.printed.clear()
    root = logging.getLogger()
    if _LINES not in root.handlers:
        root.addHandler(_LINES)
    root.setLevel(logging.WARNING if quiet else logging.INFO if verbose else NOTE)


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
    unprintable = error.object[error.start : error.end]
    escaped = unprintable.encode("ascii", "backslashreplace").decode()
    return re.sub(r"\\udc([89a-f][0-9a-f])", r"\\x\1", escaped), error.end


_VERBS = {
    "run": "run",
    "inspect_recording": "inspect",
    "calibrate": "calibrate",
    "evaluate_held_out": "evaluate held-out",
    "available": "doctor",
}
"""Verbs of functions."""

_OPTIONS = {"output": "-o", "model": "--lens", "boxes": "--box"}
"""Options with other names than their arguments in Python."""


def as_commands(text: str) -> str:
    """A text whose Python in backticks is said by options and commands.

    `` `on_error='skip'` `` becomes ``--on-error skip``, and `` `docdepth.run(..., 'run',
    keep='frames')` `` becomes ``docdepth run run --keep frames``.
    """
    return re.sub(r"`([^`]+)`", lambda found: _command(found[1]), text)


def _command(code: str) -> str:
    """A call, or arguments of one, as a command or options."""
    is_call = code.startswith("docdepth.")
    try:
        call = ast.parse(code if is_call else f"_({code})", mode="eval").body
    except SyntaxError:
        return code
    if not isinstance(call, ast.Call):
        return code
    options = []
    for keyword in call.keywords:
        name, value = _option(keyword.arg or ""), keyword.value
        is_flag = isinstance(value, ast.Constant) and value.value is True
        options += [name] if is_flag else [name, _value(value)]
    if not is_call:
        return " ".join([*(_option(ast.unparse(name)) for name in call.args), *options])
    verb = _VERBS.get(ast.unparse(call.func).rpartition(".")[2])
    if verb is None:
        return code
    places = [_value(place) for place in call.args if ast.unparse(place) != "..."]
    if verb == "run" and len(places) == 2:
        places.insert(1, _OPTIONS["output"])
    return " ".join(["docdepth", verb, *places, *options])


def _option(argument: str) -> str:
    return _OPTIONS.get(argument, f"--{argument.replace('_', '-')}")


def _value(value: ast.expr) -> str:
    """A value as a shell takes it; a name stands for what the user knows."""
    if isinstance(value, ast.Constant):
        return shlex.quote(str(value.value))
    return ast.unparse(value).upper()
