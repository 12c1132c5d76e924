"""Parameter sets of a sweep: combinations, or a file of named ones."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from docdepth.config import Parameters, parameters, parse_settings
from docdepth.errors import ConfigError

_STAGES = ("ground", "dynamics")


@dataclass(frozen=True)
class Trial:
    """One parameter set.

    Attributes
    ----------
    name : str
        A folder name; the row of the table.
    settings : dict
        Values by dotted name over those of the run, ``{"dynamics.window": 3}``. The name
        ``preset`` starts from a preset instead of the run.
    """

    name: str
    settings: dict[str, Any]


def grid(axes: Mapping[str, Sequence[Any]]) -> list[Trial]:
    """All combinations of some values of some parameters.

    Parameters
    ----------
    axes : dict
        ``{"dynamics.tolerance": [0.1, 0.2], "dynamics.window": [3, 5]}``.
    """
    trials = []
    for values in itertools.product(*axes.values()):
        settings = dict(zip(axes, values, strict=True))
        name = ",".join(f"{key.partition('.')[2]}={value}" for key, value in settings.items())
        trials.append(Trial(name or "as the run", settings))
    return trials


def parse_axes(assignments: Sequence[str]) -> dict[str, list[Any]]:
    """``["dynamics.tolerance=0.1,0.2"]`` as axes of a :func:`grid`."""
    axes = {}
    for name, value in parse_settings(list(assignments)).items():
        values = yaml.safe_load(f"[{value}]") if isinstance(value, str) else value
        axes[name] = values if isinstance(values, list) else [values]
    return axes


def read_trials(path: Path) -> list[Trial]:
    """Trials of a YAML file, ``NAME: {stage.parameter: value}``.

    Raises
    ------
    ConfigError
        The file is missing or of another shape.
    """
    try:
        tree = yaml.safe_load(path.read_text())
    except (OSError, yaml.YAMLError) as error:
        raise ConfigError(f"{path} cannot be read: {error}") from None
    if not isinstance(tree, dict) or not all(
        isinstance(settings, dict) or settings is None for settings in tree.values()
    ):
        raise ConfigError(f"{path}: write NAME: {{stage.parameter: value}}, a line a trial")
    return [Trial(str(name), dict(settings or {})) for name, settings in tree.items()]


def parameters_of(base: Parameters, trial: Trial) -> Parameters:
    """Parameters of a trial: those of the run, or of a preset, with its settings."""
    settings = dict(trial.settings)
    for name in settings:
        if name != "preset" and name.partition(".")[0] not in _STAGES:
            raise ConfigError(
                f"trial {trial.name!r}: {name!r} is no parameter of the classification; "
                f"a sweep varies {', '.join(_STAGES)}"
            )
    preset = settings.pop("preset", None)
    if preset is None:
        preset = base.preset
        of_run = base.model_dump()
        settings = {
            f"{stage}.{name}": value
            for stage, values in of_run.items()
            if isinstance(values, dict)
            for name, value in values.items()
        } | settings
    return parameters(preset, settings)
