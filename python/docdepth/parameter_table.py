"""Every public parameter in words, for the documentation and the command line."""

from __future__ import annotations

from typing import TypedDict

from docdepth._text import described
from docdepth.config import STAGES, Parameters, parameters


class PublicParameter(TypedDict):
    """A public parameter: its value in either preset, and what :class:`.Described` says of it."""

    name: str
    default: object
    paper: object
    description: str
    unit: str
    symbol: str
    range: str


def parameter_table() -> list[PublicParameter]:
    """Every public parameter, for tables.

    Returns
    -------
    list of PublicParameter
        ``name`` (dotted), ``default`` and ``paper`` (its value in either preset), ``range`` and
        ``unit`` (text), ``symbol`` (the paper's, or empty) and ``description``.
    """
    default, paper = Parameters(), parameters("paper")
    return [
        PublicParameter(
            name=f"{stage}.{key}",
            default=getattr(getattr(default, stage), key),
            paper=getattr(getattr(paper, stage), key),
            description=about.description,
            unit=about.unit,
            symbol=about.symbol,
            range=about.range,
        )
        for stage, model in STAGES.items()
        for key, field in model.model_fields.items()
        for about in [described(field)]
    ]
