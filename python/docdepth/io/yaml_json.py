"""Trees of plain values out of text that others may have written or damaged: YAML and JSON."""

from __future__ import annotations

import json
from typing import Any

import yaml

from docdepth._text import UniqueLoader, explain_yaml

_MOST_BITS = 1000  # of a whole number; Python does not even print one of 4300 digits
_MOST_VALUES = 10_000_000
"""Of a tree in which YAML's aliases stand for what they repeat: nine lines can be a milliard."""


def parse_yaml(text: str) -> Any:
    """The tree of a YAML text, without objects of Python.

    Raises
    ------
    ValueError
        It is no YAML, a name stands twice, it is too deep, or its aliases repeat too much.
    """
    try:
        tree = yaml.load(text, UniqueLoader)
        if _count(tree, {}) > _MOST_VALUES:
            raise ValueError(f"its aliases repeat more than {_MOST_VALUES} values")
        return tree
    except yaml.YAMLError as error:
        raise ValueError(explain_yaml(error)) from None
    except RecursionError:
        raise ValueError("it is too deep") from None
    except (LookupError, TypeError, AttributeError, ArithmeticError):
        raise ValueError("a tag (!!) does not fit its value") from None


def parse_json(text: str | bytes) -> Any:
    """The tree of a JSON text.

    Raises
    ------
    ValueError
        It is no JSON, or too deep.
    """
    try:
        return json.loads(text)
    except RecursionError:
        raise ValueError("it is too deep") from None


def _count(tree: Any, known: dict[int, int]) -> int:
    """Values of a tree, those of an alias as often as it stands."""
    if isinstance(tree, int) and tree.bit_length() > _MOST_BITS:
        raise ValueError("a whole number has more than 300 digits")
    if not isinstance(tree, (dict, list)):
        return 1
    if id(tree) not in known:
        known[id(tree)] = _MOST_VALUES  # what holds itself has no end
        values = tree.values() if isinstance(tree, dict) else tree
        known[id(tree)] = 1 + sum(_count(value, known) for value in values)
    return known[id(tree)]
