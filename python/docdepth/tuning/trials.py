"""Parameter sets of a search: a grid, or a YAML file of named sets."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from docdepth._parameter_text import read_yaml
from docdepth._yaml_text import explain_yaml
from docdepth.config import Parameters, parameters, replaced
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
    settings: dict[str, Any]
    given: str = field(default="", compare=False)


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


def parse_axes(assignments: Sequence[str]) -> dict[str, list[Any]]:
    """Turn ``["dynamics.tolerance=0.1,0.2"]`` into the axes of a :func:`grid`.

    Raises
    ------
    ConfigError
        An assignment has no equals sign or no value, or its values are no YAML.
    """
    axes: dict[str, list[Any]] = {}
    for assignment in assignments:
        name, equals, text = assignment.partition("=")
        if not equals:
            raise ConfigError(f"--vary {assignment!r}: write stage.name=value,value")
        try:
            values = read_yaml(f"[{text}]")
        except (yaml.YAMLError, ValueError, RecursionError):
            values = None
        if not values:
            raise ConfigError(
                f"--vary {assignment!r}: the values {text!r} cannot be read; write numbers, words "
                "or lists such as [50, 3] with commas between them"
            )
        known = axes.setdefault(name.strip(), [])
        known += [value for k, value in enumerate(values) if value not in known + values[:k]]
    return axes


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


def parameters_of(base: Parameters, trial: Trial) -> Parameters:
    """Parameters of a trial: those of the run, or of a preset, with the settings of the trial.

    Raises
    ------
    ConfigError
        A name is unknown, or a value is out of range.
    """
    settings = dict(trial.settings)
    preset = settings.pop("preset", None)
    try:
        if preset is not None:
            output = {f"output.{name}": value for name, value in base.output.model_dump().items()}
            return parameters(preset, output | settings)
        return replaced(base, settings)
    except ConfigError as error:
        raise refused(trial, str(error)) from None


def check_stages(trial: Trial, stages: Sequence[str], what: str) -> None:
    """Refuse parameters that cannot change what the judge looks at.

    Parameters
    ----------
    trial : Trial
    stages : sequence of str
        Whose parameters can.
    what : str
        The judge looks at: ``labels`` or ``depth``.

    Raises
    ------
    ConfigError
    """
    for name in trial.settings:
        stage = name.partition(".")[0]
        if stage == "output":
            raise refused(
                trial,
                f"{name} changes the files that are written, not the depth in them; leave it out",
            )
        if name != "preset" and stage not in stages:
            raise refused(
                trial,
                f"{name} does not change {what}; judge by true depth (--depth DIR) or by sweeps "
                "that are left out (--held-out N)",
            )


def refused(trial: Trial, why: str) -> ConfigError:
    """The error for a trial, which says where it was given."""
    return ConfigError(f"{trial.given or f'trial {trial.name!r}'}: {why}")


def _is_set(settings: Any) -> bool:
    """Whether this is a set of parameters by name; empty is as the run."""
    return settings is None or (
        isinstance(settings, dict) and all(isinstance(name, str) for name in settings)
    )
