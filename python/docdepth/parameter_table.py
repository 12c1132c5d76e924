"""Every public parameter in words, for the documentation and the command line."""

from __future__ import annotations

from typing import Any

from docdepth._parameter_text import described
from docdepth.config import STAGES, Parameters, parameters


def parameter_table() -> list[dict[str, Any]]:
    """Every public parameter, for tables.

    Returns
    -------
    list of dict
        ``name`` (dotted), ``default`` and ``paper`` (its value in either preset), ``range`` and
        ``unit`` (text), ``symbol`` (the paper's, or empty) and ``description``.
    """
    default, paper = Parameters(), parameters("paper")
    return [
        {
            "name": f"{stage}.{key}",
            "default": getattr(getattr(default, stage), key),
            "paper": getattr(getattr(paper, stage), key),
            **described(field)._asdict(),
        }
        for stage, model in STAGES.items()
        for key, field in model.model_fields.items()
    ]
