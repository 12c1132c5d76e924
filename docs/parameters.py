"""Print the page of parameters out of config.py (docs/parameters.md)."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from typing import Any

from pydantic import BaseModel

from docdepth.config import Parameters
from docdepth.parameter_table import parameter_table

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

COLUMNS = ("name", "meaning", "default", "paper", "unit", "range", "symbol")


def page() -> str:
    """The whole page as Markdown."""
    parts = [HEAD]
    for stage in Parameters.model_fields:
        group = getattr(Parameters(), stage)
        if isinstance(group, BaseModel):
            parts.append("\n".join(_table(stage, group)) + "\n")
    return "\n".join(parts)


def _table(stage: str, group: BaseModel) -> Iterator[str]:
    yield f"## {stage}\n"
    yield _documentation(type(group)) + "\n"
    yield _row(COLUMNS)
    yield _row(["---"] * len(COLUMNS))
    for about in parameter_table():
        if about["name"].startswith(f"{stage}."):
            default, paper = _shown(about["default"]), _shown(about["paper"])
            words = re.sub(r"[a-z][\w-]*(?=,|$)", r"`\g<0>`", about["range"])
            yield _row(
                (
                    f"`{about['name']}`",
                    about["description"],
                    default,
                    "" if paper == default else paper,
                    about["unit"],
                    words,
                    about["symbol"],
                )
            )


def _documentation(group: type[BaseModel]) -> str:
    """The docstring of a stage as Markdown, without the underlined title of its notes."""
    text = inspect.cleandoc(group.__doc__ or "")
    return re.sub(r"^Notes\n-+\n", "", text, flags=re.MULTILINE).replace("``", "`")


def _shown(value: Any) -> str:
    if isinstance(value, tuple):
        return ", ".join(_shown(item) for item in value) or "none"
    return f"{value:g}" if isinstance(value, float) else str(value)


def _row(cells: Any) -> str:
    return "| " + " | ".join(str(cell).replace("|", "\\|") for cell in cells) + " |"


if __name__ == "__main__":
    print(page(), end="")
