"""Parameters and inputs from a file: one that a user wrote, or the run.yaml of a run."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from docdepth._parameter_text import read_yaml
from docdepth._yaml_text import explain_yaml
from docdepth.config import Parameters, Preset, departures, parameters
from docdepth.errors import ConfigError
from docdepth.io.inputs import RunInputs
from docdepth.io.manifest import RunManifest

_STAGES = tuple(name for name in Parameters.model_fields if name != "preset")


@dataclass(frozen=True)
class RunConfigFile:
    """What a file gives, all of it defaults that options replace.

    Attributes
    ----------
    run_inputs : RunInputs, optional
        Those of a run.yaml.
    preset : str
    settings : dict
        Parameters by dotted name; of a run.yaml, which lists all, those that differ from the
        preset.
    """

    run_inputs: RunInputs | None = None
    preset: Preset = "default"
    settings: dict[str, Any] = field(default_factory=dict)

    def inputs(self, recording: Path | None, options: dict[str, Any]) -> dict[str, Any]:
        """Fields of :class:`RunInputs`: those of the options, else of the file.

        Raises
        ------
        ConfigError
            Neither names a recording.
        """
        of_file = {} if self.run_inputs is None else self.run_inputs.model_dump(exclude_none=True)
        if recording is not None:
            of_file |= {"recording": recording, "dataset": None}
        if "recording" not in of_file:
            raise ConfigError(
                "no recording: docdepth run RECORDING -o RUN, or --config RUN/run.yaml"
            )
        return of_file | options


def read_config(path: Path) -> RunConfigFile:
    """Read a file of parameters (``odometry: {max_range: 80}``) or a run.yaml.

    Raises
    ------
    ConfigError
        The file cannot be read, has another structure, or a value is refused.
    """
    try:
        tree = read_yaml(path.read_text(encoding="utf-8"))
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


def _by_name(values: dict[Any, Any]) -> dict[str, Any]:
    """Parameters by dotted name, from stages or from dotted names."""
    found: dict[str, Any] = {}
    for name, value in values.items():
        if name == "preset":
            continue
        if name in _STAGES and value is None:  # a stage without an entry
            continue
        if name in _STAGES and not isinstance(value, dict):
            raise ConfigError(f"{name} is {value!r}; write {name}: {{NAME: VALUE}}")
        found |= {f"{name}.{k}": v for k, v in value.items()} if name in _STAGES else {name: value}
    return {str(name): value for name, value in found.items()}
