"""Verbs that tell about docdepth itself: its parameters, and what this installation can do."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from docdepth.cli.names import one_of
from docdepth.cli.options import Json
from docdepth.cli.summary import show_json
from docdepth.cli.terminal import app, out, verb
from docdepth.config import Parameters

STAGES = tuple(name for name in Parameters.model_fields if name != "preset")


@verb(app)
def parameters(
    stage: Annotated[
        str | None,
        typer.Argument(
            help=f"Stage: {', '.join(STAGES)}; all if absent.",
            show_default=False,
            **one_of(STAGES) | {"metavar": "STAGE"},
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """List the parameters that --set takes: values, ranges, and what each is for."""
    from docdepth.parameter_table import parameter_table

    rows = [r for r in parameter_table() if stage in (None, r["name"].partition(".")[0])]
    if as_json:
        return show_json(rows)
    for row in rows:
        unit = f" {row['unit']}" if row["unit"] else ""
        paper = "" if row["paper"] == row["default"] else f", paper {_shown(row['paper'])}"
        symbol = f" ({row['symbol']} in the paper)" if row["symbol"] else ""
        values = f"{_shown(row['default'])}{unit}{paper}"
        allowed = f"allowed: {row['range']}" + (unit if row["unit"] else "")
        out.print(f"[bold]{row['name']}[/bold]  {values}; {allowed}", soft_wrap=True)
        out.print(f"    {row['description']}{symbol}", soft_wrap=True, markup=False)


def _shown(value: Any) -> str:
    """A value as ``--set`` takes it."""
    if isinstance(value, tuple | list):
        texts = [_shown(v) for v in value]
        return ",".join(texts) if texts else "none"
    return f"{value:g}" if isinstance(value, float) else str(value)


@verb(app)
def doctor(as_json: Json = False) -> None:
    """List what this installation can do, and what it lacks.

    Each package is imported and each renderer tried.
    """
    from docdepth.cli.doctor import doctor as examine

    rows = examine()
    if as_json:
        return show_json([{"name": n, "finding": f, "ok": well} for n, f, well in rows])
    for name, finding, well in rows:
        out.print(f"{'ok' if well else '--'}  {name:<24} {finding}", soft_wrap=True, markup=False)
