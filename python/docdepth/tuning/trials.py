"""Parameter sets of a search: a grid, or a YAML file of named sets."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from docdepth.config import Parameters, parameters, parse_settings
from docdepth.errors import ConfigError

# Stages that the classification depends on.
_STAGES = ("ground", "dynamics")


@dataclass(frozen=True)
class Trial:
    """One parameter set.

    Attributes
    ----------
    name : str
        Names the result file and the row of the table.
    settings : dict
        Values by dotted name that replace those of the run, ``{"dynamics.window": 3}``. The key
        ``preset`` starts from that preset instead of the parameters of the run.
    """

    name: str
    settings: dict[str, Any]


def grid(axes: Mapping[str, Sequence[Any]]) -> list[Trial]:
    """All combinations of the given values.

    Parameters
    ----------
    axes : dict
        Values by dotted name, ``{"dynamics.tolerance": [0.1, 0.2], "dynamics.window": [3, 5]}``.
    """
    trials = []
    for values in itertools.product(*axes.values()):
        settings = dict(zip(axes, values, strict=True))
        name = ",".join(f"{key.partition('.')[2]}={value}" for key, value in settings.items())
        trials.append(Trial(name or "as the run", settings))
    return trials


def parse_axes(assignments: Sequence[str]) -> dict[str, list[Any]]:
    """Turn ``["dynamics.tolerance=0.1,0.2"]`` into the axes of a :func:`grid`."""
    axes = {}
    for name, value in parse_settings(list(assignments), "--vary").items():
        values = yaml.safe_load(f"[{value}]") if isinstance(value, str) else value
        axes[name] = values if isinstance(values, list) else [values]
    return axes


def read_trials(path: Path) -> list[Trial]:
    """Read trials from a YAML file of lines ``NAME: {stage.parameter: value}``.

    Raises
    ------
    ConfigError
        The file is missing or has another structure.
    """
    try:
        tree = yaml.safe_load(path.read_text())
    except (OSError, yaml.YAMLError) as error:
        raise ConfigError(f"{path} cannot be read: {error}") from None
    if not isinstance(tree, dict) or not all(
        isinstance(settings, dict) or settings is None for settings in tree.values()
    ):
        raise ConfigError(f"{path}: write one line per trial, NAME: {{stage.parameter: value}}")
    return [Trial(str(name), dict(settings or {})) for name, settings in tree.items()]


def parameters_of(base: Parameters, trial: Trial) -> Parameters:
    """Parameters of a trial: those of the run, or of a preset, with the settings of the trial.

    Raises
    ------
    ConfigError
        A name is unknown or does not belong to the classification, or a value is out of range.
    """
    settings = dict(trial.settings)
    preset = settings.pop("preset", None)
    for name in settings:
        if name.partition(".")[0] not in _STAGES:
            raise ConfigError(
                f"trial {trial.name!r}: {name!r} is not a parameter of the classification; "
                f"trials vary the stages {' and '.join(_STAGES)}"
            )
    if preset is not None:
        return parameters(preset, settings)
    # Old names of settings are resolved before they replace the values of the run.
    return parameters(base.preset, _by_name(base) | _by_name(parameters(settings=settings), True))


def _by_name(p: Parameters, set_only: bool = False) -> dict[str, Any]:
    """Parameter values by dotted name; with ``set_only`` only those that were given."""
    stages = p.model_dump(exclude_unset=set_only)
    return {
        f"{stage}.{name}": value
        for stage, values in stages.items()
        if isinstance(values, dict)
        for name, value in values.items()
    }
