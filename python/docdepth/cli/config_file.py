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

_INPUTS = ("dataset", "name", "camera", "poses", "camera_times", "image_size", "frames",
           "calibration", "labels")  # fmt: skip
_STAGES = tuple(name for name in Parameters.model_fields if name != "preset")


@dataclass(frozen=True)
class Given:
    """What a file gives, all of it defaults that options replace.

    Attributes
    ----------
    source : dict
        Entries of ``source`` in run.yaml: dataset, camera, poses and more; empty in a file of
        parameters.
    preset : str
    settings : dict
        Parameters by dotted name; of a run.yaml, which lists all, those that differ from the
        preset.
    """

    source: dict[str, Any] = field(default_factory=dict)
    preset: Preset = "default"
    settings: dict[str, Any] = field(default_factory=dict)

    def inputs(
        self,
        recording: Path | None,
        dataset: str | None,
        camera: str | list[str] | None,
        poses: str | None,
        camera_times: Path | None,
        image_size: str | None,
        frames: str | None,
        calibration: Path | None = None,
        labels: Path | None = None,
    ) -> dict[str, Any]:
        """Arguments of :func:`docdepth.run`: those of the options, else of the file.

        Raises
        ------
        ConfigError
            Neither names a recording.
        """
        place = recording or self.source.get("dataset")
        if place is None:
            raise ConfigError(
                "no recording: docdepth run RECORDING -o RUN, or --config RUN/run.yaml"
            )
        return {
            "recording": place,
            "dataset": dataset or (None if recording else self.source.get("name")),
            "camera": camera or self.source.get("camera"),
            "poses": poses or self.source.get("poses"),
            "camera_times": camera_times or self.source.get("camera_times"),
            "image_size": image_size or self.source.get("image_size"),
            "frames": frames or self.source.get("frames"),
            "calibration": calibration or self.source.get("calibration"),
            "labels": labels or self.source.get("labels"),
        }


def read_config(path: Path) -> Given:
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
    is_run = "source" in tree or "parameters" in tree
    source = tree.get("source") if is_run else {}
    values = tree.get("parameters") if is_run else tree
    if not isinstance(values, dict) or not isinstance(source, dict) or not _is_source(source):
        raise ConfigError(
            f"--config {path} is a damaged run.yaml: source or parameters is missing or is "
            "something else; name another file"
        )
    preset = values.get("preset", "default")
    try:
        settings = _by_name(values)
        differ = departures(parameters(preset, settings))  # all are checked
        return Given(source, preset, differ if is_run else settings)
    except ConfigError as error:
        raise ConfigError(f"--config {path}: {error}") from None


def _is_source(source: dict[str, Any]) -> bool:
    """Whether the inputs are names or lists of names."""
    values = [source.get(key) for key in _INPUTS]
    every = [v for value in values for v in (value if isinstance(value, list) else [value])]
    return all(value is None or isinstance(value, str) for value in every)


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
