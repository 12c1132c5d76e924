"""Parameters and inputs from a file: one that a user wrote, or the run.yaml of a run."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import yaml

from docdepth._text import explain_yaml, read_yaml
from docdepth.config import STAGES, Preset, departures, parameters
from docdepth.errors import ConfigError
from docdepth.io.inputs import RunInputs
from docdepth.io.manifest import RunManifest
from docdepth.io.untrusted import read_text


class RunConfigFile(NamedTuple):
    """What a file gives, all of it defaults that options replace."""

    inputs: RunInputs | None  # those of a run.yaml
    preset: Preset
    # parameters by dotted name; of a run.yaml, which lists all, those that differ from the preset
    settings: dict[str, object]


def read_config(path: Path) -> RunConfigFile:
    """Read a file of parameters (``odometry: {max_range: 80}``) or a run.yaml."""
    try:
        tree = read_yaml(read_text(path))
    except (OSError, ValueError, yaml.YAMLError) as error:
        of_yaml = explain_yaml(error) if isinstance(error, yaml.YAMLError) else str(error)
        why = error.strerror if isinstance(error, OSError) else of_yaml
        raise ConfigError(f"--config {path} cannot be read as YAML: {why}") from None
    if not isinstance(tree, dict):
        raise ConfigError(
            f"--config {path} holds no parameters; write them by stage, for example "
            "odometry: {max_range: 80}, or name the run.yaml of a run"
        )
    is_run = "inputs" in tree or "parameters" in tree
    values = tree.get("parameters") if is_run else tree
    if is_run and tree.keys() - RunManifest.model_fields.keys():
        values = None
    try:
        inputs = RunInputs(**tree["inputs"]) if is_run and tree.get("inputs") else None
    except (ConfigError, TypeError):
        values = None
    if not isinstance(values, dict):
        raise ConfigError(
            f"--config {path} is a damaged run.yaml: inputs or parameters is missing or is "
            "something else; name another file"
        )
    preset = values.get("preset", "default")
    try:
        settings = _by_name(values)
        differ = departures(parameters(preset, settings))  # all are checked
        return RunConfigFile(inputs, preset, differ if is_run else settings)
    except ConfigError as error:
        raise ConfigError(f"--config {path}: {error}") from None


def _by_name(values: dict[Any, Any]) -> dict[str, object]:
    """Parameters by dotted name, from stages or from dotted names."""
    found: dict[str, object] = {}
    for name, value in values.items():
        if name not in STAGES:
            found[str(name)] = value
        elif isinstance(value, dict):
            found |= {f"{name}.{key}": of_key for key, of_key in value.items()}
        elif value is not None:  # a stage without an entry
            raise ConfigError(f"{name} is {value!r}; write {name}: {{NAME: VALUE}}")
    found.pop("preset", None)
    return found
