"""Parameter sets of a search: a grid, or a YAML file of named sets."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import yaml

from docdepth._parameter_text import read_yaml
from docdepth._yaml_text import explain_yaml
from docdepth.config import Parameters, Preset, Settings, parameters, replaced
from docdepth.errors import ConfigError


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
    given : str
        Where it was given, for messages; its name if empty.
    """

    name: str
    settings: Settings
    given: str = field(default="", compare=False)

    def refused(self, why: str) -> ConfigError:
        """The error for this trial, which says where it was given."""
        return ConfigError(f"{self.given or f'trial {self.name!r}'}: {why}")

    def parameters(self, base: Parameters) -> Parameters:
        """Parameters of the run, or of a preset, with the settings of the trial.

        Raises
        ------
        ConfigError
            A name is unknown, or a value is out of range.
        """
        settings = dict(self.settings)
        preset = settings.pop("preset", None)
        try:
            if preset is None:
                return replaced(base, settings)
            output = {f"output.{name}": value for name, value in base.output.model_dump().items()}
            return parameters(cast(Preset, preset), output | settings)
        except ConfigError as error:
            raise self.refused(str(error)) from None


def grid(axes: Mapping[str, Sequence[Any]], given: str = "") -> list[Trial]:
    """All combinations of the given values.

    Parameters
    ----------
    axes : dict
        Values by dotted name, ``{"dynamics.tolerance": [0.1, 0.2], "dynamics.window": [3, 5]}``.
    given : str
        Where they were given, for messages.
    """
    short = [name.partition(".")[2] for name in axes]
    shown = {name: s if short.count(s) == 1 else name for name, s in zip(axes, short, strict=True)}
    trials = []
    for values in itertools.product(*axes.values()):
        settings = dict(zip(axes, values, strict=True))
        name = ",".join(f"{shown[key]}={value}" for key, value in settings.items())
        trials.append(Trial(name or "as the run", settings, given))
    return trials


def read_trials(path: Path) -> list[Trial]:
    """Read trials from a YAML file of lines ``NAME: {stage.parameter: value}``.

    Raises
    ------
    ConfigError
        The file is missing or has another structure.
    """
    try:
        tree = read_yaml(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError, yaml.YAMLError) as error:
        why = explain_yaml(error) if isinstance(error, yaml.YAMLError) else error
        raise ConfigError(f"{path} cannot be read: {why}") from None
    if not isinstance(tree, dict) or not tree or not all(map(_is_set, tree.values())):
        raise ConfigError(f"{path}: write one line per trial, NAME: {{stage.parameter: value}}")
    return [
        Trial(str(name), dict(settings or {}), f"{path}, trial {str(name)!r}")
        for name, settings in tree.items()
    ]


def _is_set(settings: Any) -> bool:
    """Whether this is a set of parameters by name; empty is as the run."""
    return settings is None or (
        isinstance(settings, dict) and all(isinstance(name, str) for name in settings)
    )
