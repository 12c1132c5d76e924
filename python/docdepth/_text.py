"""YAML as people write it, and parameters as text: what users write, what tables say."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any, Literal, NamedTuple, get_args, get_origin

import yaml
from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from docdepth.errors import ConfigError


class UniqueLoader(yaml.SafeLoader):
    """YAML in which every name stands once in its table."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        names: set[str] = set()
        for key in (key for key, _ in node.value if isinstance(key, yaml.ScalarNode)):
            if key.value in names:
                what = f"{key.value!r} stands twice; keep one of the two"
                raise yaml.MarkedYAMLError(problem=what, problem_mark=key.start_mark)
            names.add(key.value)
        return super().construct_mapping(node, deep)


def explain_yaml(error: yaml.YAMLError) -> str:
    """What is wrong with a YAML text, in a line: where, what, and what to do."""
    where = getattr(error, "problem_mark", None)
    if not isinstance(error, yaml.MarkedYAMLError) or where is None:
        return " ".join(str(error).split())
    what, begun = str(error.problem), error.context_mark or where
    if "\\t" in what:
        what = "a tab stands where a space has to; indent by spaces"
    elif "mapping values" in what:
        what = "': ' where no value can be; indent the line as those around it, or quote a text"
    elif "<block" in what:
        what = "the line is indented otherwise than those around it"
    elif "parsing a flow" in str(error.context):
        where, what = begun, "a bracket is not closed, or a comma is missing in it"
    elif "quoted scalar" in str(error.context):
        where, what = begun, "a quote is not closed"
    elif "twice" not in what:
        what += "; write NAME: VALUE, indented by spaces as the lines around it"
    return f"line {where.line + 1}: {what}"


MOST_KEY_FRAMES = 400
"""Key frames of one spacing that may vote on a sweep: as many fill 2 GB at the default size of
their pixels."""

_SHOWN = 60  # characters of a value in a message

# A description reads "meaning, symbol [unit]"; symbol and unit may be left out.
_SYMBOL = re.compile(
    r", ((?:l|s|w|alpha|delta|tau|k_nn|r_seed|[dR]_[a-z]+|sigma_[a-z]+|d_theta = d_phi)"
    r"(?:(?:, | and )(?:[dR]_[a-z]+|sigma_[a-z]+))*)$"
)
_UNIT = re.compile(r"\s*\[([^]]*)\]$")


class Described(NamedTuple):
    """A parameter in words."""

    description: str
    # unit, symbol: empty for none; the symbol is the paper's
    unit: str
    symbol: str
    range: str  # ``"0.001 to 10"``, or the words of a choice with commas


def described(field: FieldInfo) -> Described:
    """Meaning, unit, symbol and range of a parameter."""
    text, unit, symbol = field.description or "", "", ""
    if found := _UNIT.search(text):
        text, unit = text[: found.start()], found[1]
    if found := _SYMBOL.search(text):
        text, symbol = text[: found.start()], found[1]
    return Described(text, "" if unit == "-" else unit, symbol, _range(field))


def explain(error: ValidationError, stages: Mapping[str, type[BaseModel]]) -> str:
    """All that is wrong with a tree of parameters, in plain sentences."""
    sentences: dict[tuple[int | str, ...], str] = {}
    for problem in error.errors():  # of the items of one tuple, the first says it for all
        sentences.setdefault(problem["loc"][:2], _sentence(problem, stages))
    return "; ".join(sentences.values())


class _Settings(UniqueLoader):
    """In which ``010`` and ``1:20`` are not octal and minutes, either."""


def _integer(loader: yaml.SafeLoader, node: yaml.ScalarNode) -> Any:
    try:
        return int(node.value)
    except ValueError:
        return node.value


def _real(loader: yaml.SafeLoader, node: yaml.ScalarNode) -> Any:
    return node.value if ":" in node.value else loader.construct_yaml_float(node)


_Settings.add_constructor("tag:yaml.org,2002:int", _integer)
_Settings.add_constructor("tag:yaml.org,2002:float", _real)


def read_yaml(text: str) -> Any:
    """Parameters from YAML.

    Raises
    ------
    yaml.YAMLError, ValueError
        The text is no YAML, or a name stands twice.
    """
    try:
        return yaml.load(text, _Settings)
    except RecursionError:
        raise yaml.YAMLError("it is too deep") from None
    except (LookupError, TypeError, AttributeError, ArithmeticError):
        raise yaml.YAMLError("a tag (!!) does not fit its value") from None


def parse_settings(assignments: list[str]) -> dict[str, object]:
    """``["dynamics.tolerance=0.3"]`` as a dict; values are read as YAML."""
    settings: dict[str, object] = {}
    for assignment in assignments:
        name, equals, value = assignment.partition("=")
        if not equals:
            raise ConfigError(f"--set {assignment!r}: write stage.name=value")
        try:
            settings[name.strip()] = read_yaml(value)
        except (yaml.YAMLError, ValueError):
            raise ConfigError(
                f"--set {assignment!r}: the value {value!r} cannot be read; write a number, a "
                "word or a list such as [50, 3]"
            ) from None
    return settings


def as_setting(value: Any) -> str:
    """A value as :func:`parse_settings` takes it."""
    if isinstance(value, tuple | list):
        return ",".join(map(as_setting, value)) or "none"
    if isinstance(value, float) and float(f"{value:g}") == value:
        return f"{value:g}"
    return str(value)


def check_key_frames(kind: str, spacing: float, radius: float) -> None:
    """Refuse key frames that never vote, or too many of them."""
    names = f"dynamics.{kind}_radius", f"dynamics.{kind}_spacing"
    if radius < spacing:
        raise ValueError(
            f"{names[0]} = {radius:g} m must not be below {names[1]} = {spacing:g} m; no key frame "
            "would vote"
        )
    if 2 * radius / spacing > MOST_KEY_FRAMES:
        raise ValueError(
            f"{names[0]} = {radius:g} m holds {2 * radius / spacing:.0f} key frames at "
            f"{names[1]} = {spacing:g} m; {MOST_KEY_FRAMES} are the most"
        )


def _sentence(problem: ErrorDetails, stages: Mapping[str, type[BaseModel]]) -> str:
    place = [str(part) for part in problem["loc"]]
    name, value = ".".join(place[:2]), shown(problem["input"])
    own = problem.get("ctx", {}).get("error") if problem["type"] == "value_error" else None
    stage = stages.get(place[0]) if place else None
    field = stage.model_fields.get(place[1]) if stage and len(place) > 1 else None
    if own is not None:
        return f"{name} = {value}: {own}" if field else str(own)
    if field:
        return f"{name} = {value}: it must be {_wanted(field)}"
    if stage and len(place) > 1:
        return f"unknown parameter {name!r}; that stage knows {', '.join(stage.model_fields)}"
    if stage:
        return f"{name} = {value}: write a table of parameters, name: value"
    if place and problem["type"] == "extra_forbidden":
        return f"unknown stage {name!r}; there are {', '.join(stages)}"
    if place:
        return f"{name} = {value}: it must be 'default' or 'paper'"
    return f"parameters are a table of {', '.join(stages)}, not {value}"


def _wanted(field: FieldInfo) -> str:
    """``"a number from 0.001 to 10 m"``"""
    about = described(field)
    several = get_origin(field.annotation) is tuple
    if _words(field.annotation):
        return f"{'one or several of' if several else 'one of'} {about.range}"
    number = "a whole number" if field.annotation is int else "a number"
    number = "two numbers" if several else number
    how = ", written [50, 3]" if several else ""
    return f"{number} from {about.range} {about.unit}".rstrip() + how


def _range(field: FieldInfo) -> str:
    if words := _words(field.annotation):
        return ", ".join(words)
    bounds = field.metadata or _metadata(field.annotation)
    low, high = (
        next(getattr(bound, key) for bound in bounds if hasattr(bound, key)) for key in ("ge", "le")
    )
    return f"{low:g} to {high:g}"


def _metadata(annotation: Any) -> list[Any]:
    """Bounds of the items of a tuple."""
    inner = [item for part in get_args(annotation) for item in getattr(part, "__metadata__", ())]
    return [bound for item in inner for bound in getattr(item, "metadata", [item])]


def _words(annotation: Any) -> tuple[str, ...]:
    if get_origin(annotation) is Literal:
        return get_args(annotation)
    return next((words for inner in get_args(annotation) if (words := _words(inner))), ())


def shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= _SHOWN else text[: _SHOWN - 3] + "..."
