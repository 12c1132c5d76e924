"""Remedies of the library as the command line says them."""

from __future__ import annotations

import ast
import re
import shlex

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
