"""Options whose values are names: checked, listed in the help, and known to completion."""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Iterable
from typing import Any, get_args

import typer

from docdepth.config import DepthFormat, Layer, Preset
from docdepth.datasets import format_names
from docdepth.evaluation.depth import Mode
from docdepth.synthetic import SCENES, sensors

DATASETS = format_names()
RENDERERS = ("cpu", "egl", "egl:N", "osmesa")
PRESETS: tuple[str, ...] = get_args(Preset)
FORMATS: tuple[str, ...] = get_args(DepthFormat)
LAYERS: tuple[str, ...] = get_args(Layer)
MODES: tuple[str, ...] = get_args(Mode)
ON_ERROR = ("stop", "skip")
COLORINGS = ("class", "votes", "instance")
SCENE_NAMES = tuple(SCENES)
SENSOR_NAMES = tuple(sensors())


def one_of(names: Iterable[str]) -> dict[str, Any]:
    """Arguments of ``typer.Option`` for one of these names."""
    known = tuple(names)
    return {
        "metavar": "NAME",
        "parser": _named(lambda text: _name(text, known)),
        "autocompletion": lambda incomplete: [n for n in known if n.startswith(incomplete)],
    }


def some_of(names: Iterable[str]) -> dict[str, Any]:
    """Arguments of ``typer.Option`` for one or several of these names, with commas."""
    known = tuple(names)

    def complete(incomplete: str) -> list[str]:
        before, comma, last = incomplete.rpartition(",")
        taken = before.split(",")
        return [before + comma + n for n in known if n.startswith(last) and n not in taken]

    def parse(text: str) -> str:
        return ",".join(_name(part, known) for part in text.split(","))

    return {
        "metavar": "NAME[,NAME...]",
        "parser": _named(parse),
        "autocompletion": complete,
    }


def _named(parse: Callable[[str], str]) -> Callable[[str], str]:
    parse.__name__ = "name"  # typer asks for it
    return parse


def _name(text: str, known: tuple[str, ...]) -> str:
    """The name that is meant; capitals do not matter, nor whether it has ``-`` or ``_``."""
    if re.fullmatch(r"egl:[0-9]{1,4}", text) and "egl:N" in known:
        return text
    plain = {_folded(name): name for name in known if name != "egl:N"}
    if _folded(text) in plain:
        return plain[_folded(text)]
    near = difflib.get_close_matches(_folded(text), plain, n=1)
    meant = f"; did you mean {plain[near[0]]}?" if near else ""
    raise typer.BadParameter(f"{text!r} is unknown; there are {', '.join(known)}{meant}")


def _folded(text: str) -> str:
    return text.strip().lower().replace("-", "_")
