"""YAML as people write it: every name once, and mistakes told in a line."""

from __future__ import annotations

from typing import Any

import yaml


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
        what = "a tab stands before the name; indent by spaces"
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
