"""Print the page of parameters out of config.py (docs/parameters.md)."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from typing import Any, Literal, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from docdepth.config import Parameters, parameters

HEAD = """\
# Parameters

Set any of them with `--set STAGE.NAME=VALUE`, or in Python with
`docdepth.parameters("default", {"STAGE.NAME": value})`. A tuple is written `[50, 3]`. `run.yaml`
keeps the values of a run. An unknown name or a value out of range is an error.

*Paper* is the value of `--preset paper` where it differs from the default. *Symbol* is the paper's.
Each stage lists where it departs from the paper's text.
What is not listed here is a constant in the code, named, with its unit and reason.

<!-- generated: python docs/parameters.py > docs/parameters.md -->
"""

COLUMNS = ("name", "default", "paper", "unit", "range", "meaning", "symbol")

# A description reads "meaning, symbol [unit]"; symbol and unit may be left out.
SYMBOL = re.compile(
    r", ((?:l|s|w|alpha|delta|tau|k_nn|r_seed|[dR]_[a-z]+|sigma_[a-z]+|d_theta = d_phi)"
    r"(?:(?:, | and )(?:[dR]_[a-z]+|sigma_[a-z]+))*)$"
)
UNIT = re.compile(r"\s*\[([^]]*)\]$")


def page() -> str:
    """The whole page as Markdown."""
    default, paper = Parameters(), parameters("paper")
    parts = [HEAD]
    for stage in Parameters.model_fields:
        group = getattr(default, stage)
        if isinstance(group, BaseModel):
            parts.append("\n".join(_table(stage, group, getattr(paper, stage))) + "\n")
    return "\n".join(parts)


def _table(stage: str, default: BaseModel, paper: BaseModel) -> Iterator[str]:
    yield f"## {stage}\n"
    yield _documentation(type(default)) + "\n"
    yield _row(COLUMNS)
    yield _row(["---"] * len(COLUMNS))
    for name, field in type(default).model_fields.items():
        here, there = getattr(default, name), getattr(paper, name)
        text, unit, symbol = _described(field)
        shown = "" if here == there else _shown(there)
        cells = (f"`{stage}.{name}`", _shown(here), shown, unit, _range(field), text, symbol)
        yield _row(cells)


def _documentation(group: type[BaseModel]) -> str:
    """The docstring of a stage as Markdown, without the underlined title of its notes."""
    text = inspect.cleandoc(group.__doc__ or "")
    return re.sub(r"^Notes\n-+\n", "", text, flags=re.MULTILINE).replace("``", "`")


def _described(field: FieldInfo) -> tuple[str, str, str]:
    """Meaning, unit and symbol out of a field's description."""
    text, unit, symbol = field.description or "", "", ""
    if found := UNIT.search(text):
        text, unit = text[: found.start()], found[1]
    if found := SYMBOL.search(text):
        text, symbol = text[: found.start()], found[1]
    return text, "" if unit == "-" else unit, symbol


def _range(field: FieldInfo) -> str:
    """Allowed values: the words of a choice, or the bounds of a number."""
    words = _words(field.annotation)
    if words:
        return ", ".join(f"`{word}`" for word in words)
    signs = {"gt": ">", "ge": "≥", "lt": "<", "le": "≤"}
    bounds = [
        f"{sign} {getattr(bound, key):g}"
        for bound in field.metadata
        for key, sign in signs.items()
        if hasattr(bound, key)
    ]
    return ", ".join(bounds)


def _words(annotation: Any) -> tuple[str, ...]:
    if get_origin(annotation) is Literal:
        return get_args(annotation)
    return next((words for inner in get_args(annotation) if (words := _words(inner))), ())


def _shown(value: Any) -> str:
    if isinstance(value, tuple):
        return ", ".join(_shown(item) for item in value) or "none"
    return f"{value:g}" if isinstance(value, float) else str(value)


def _row(cells: Any) -> str:
    return "| " + " | ".join(str(cell).replace("|", "\\|") for cell in cells) + " |"


if __name__ == "__main__":
    print(page(), end="")
