"""All findings, and errors with a code of their own: ``python tests/messages.py`` writes them down.

``messages.txt`` beside this file shows every text with its remedy, as Python and as the command
line say it. A change of words is then seen in one place. Values are ``{}``.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from docdepth.cli.terminal import as_commands

PACKAGE = Path(__file__).resolve().parents[1] / "python" / "docdepth"
GOLDEN = Path(__file__).with_name("messages.txt")

# Places of code, text and remedy among the arguments.
_PLACES = {"Finding": (0, 2, 3), "add": (0, 2, 3), "note": (0, 1, 2)}


class Message(NamedTuple):
    """Texts of a finding or error."""

    code: str
    text: str
    remedy: str


def messages() -> list[Message]:
    """Of the whole package, by code."""
    found = set()
    for path in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.FunctionDef):
                found |= set(_in_function(node))
    return sorted(found)


def _in_function(function: ast.FunctionDef) -> Iterator[Message]:
    nodes = list(ast.walk(function))
    names: list[tuple[int, str, ast.expr]] = [
        (node.lineno, node.targets[0].id, node.value)
        for node in nodes
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name)
    ]
    for call in nodes:
        if not isinstance(call, ast.Call):
            continue
        known = {name: value for line, name, value in sorted(names, key=lambda n: n[0])
                 if line < call.lineno}  # fmt: skip
        name = ast.unparse(call.func).rpartition(".")[2]
        code = next((k.value for k in call.keywords if k.arg == "code"), None)
        if name.endswith("Error") and isinstance(code, ast.Constant):
            arguments = [code, *call.args[:2]]
        elif name in _PLACES and len(call.args) > 1 and isinstance(call.args[0], ast.Constant):
            arguments = [call.args[k] for k in _PLACES[name] if k < len(call.args)]
        else:
            continue
        texts = [_text(argument, known) for argument in arguments]
        yield Message(*texts, *[""] * (3 - len(texts)))


def _text(node: ast.expr, known: dict[str, ast.expr]) -> str:
    if isinstance(node, ast.Constant):
        return str(node.value)
    if isinstance(node, ast.JoinedStr):
        return "".join(_text(part, {}) for part in node.values)
    if isinstance(node, ast.BinOp):
        return _text(node.left, known) + _text(node.right, known)
    if isinstance(node, ast.IfExp):
        return f"{_text(node.body, known)} | {_text(node.orelse, known)}"
    if isinstance(node, ast.Name) and node.id in known:
        return _text(known[node.id], {})
    return "{}"


def written() -> str:
    """What the golden file holds."""
    lines = []
    for code, text, remedy in messages():
        lines.append(f"{code}: {text}")
        lines += [f"    {said}" for said in dict.fromkeys((remedy, as_commands(remedy))) if said]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    GOLDEN.write_text(written(), encoding="utf-8")
