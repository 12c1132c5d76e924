"""Parameter sets of a search, a grid or a YAML file of named sets, and what scores them."""

from __future__ import annotations

import itertools
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, cast

import yaml

from docdepth._text import explain_yaml, read_yaml
from docdepth.config import Parameters, Preset, Settings, parameters, replaced
from docdepth.errors import ConfigError, DatasetError
from docdepth.evaluation.held_out import evaluate_held_out
from docdepth.evaluation.runs import evaluate_depth, evaluate_labels
from docdepth.io.run_folder import RunFolder
from docdepth.io.untrusted import read_text


@dataclass(frozen=True)
class Trial:
    """One parameter set."""

    name: str  # names the result file and the row of the table
    # values by dotted name that replace those of the run, ``{"dynamics.window": 3}``. The key
    # ``preset`` starts from that preset instead of the parameters of the run
    settings: Settings
    # where it was given, for messages; its name if empty
    given: str = field(default="", compare=False)

    def refused(self, why: str) -> ConfigError:
        """The error for this trial, which says where it was given."""
        return ConfigError(f"{self.given or f'trial {self.name!r}'}: {why}")

    def parameters(self, base: Parameters) -> Parameters:
        """Parameters of the run, or of a preset, with the settings of the trial."""
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
    """Read trials from a YAML file of lines ``NAME: {stage.parameter: value}``."""
    try:
        tree = read_yaml(read_text(path))
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


LABELS = ("odometry", "ground", "dynamics")
_TRUTH = {"labels": "labels", "depth": "depth_2"}
"""Folder of the truth in a recording."""


@dataclass(frozen=True)
class Objective:
    """What trials are scored by.

    Parameters
    ----------
    by : {"held-out", "labels", "depth"}
        ``held-out`` compares depth with sweeps that were left out and needs no truth.
    truth : Path, optional
        True labels or depth maps, as for ``docdepth evaluate``.
    camera : str, optional
        Needed for depth where the run has several.
    every : int
        ``held-out`` leaves out every n-th sweep, one at a time.
    """

    by: Literal["held-out", "labels", "depth"] = "held-out"
    truth: Path | None = None
    camera: str | None = None
    every: int = 10

    @property
    def stages(self) -> tuple[str, ...]:
        """Stages whose parameters can change the score."""
        return LABELS if self.by == "labels" else (*LABELS, "render")

    def check(self, run: RunFolder) -> None:
        """Refuse a truth that is not there, and a run without this camera."""
        self.truth_files()
        if self.by != "labels":
            run.calibration(run.depth_folder(self.camera))

    def measure(self, trial: Path, threads: int = 0) -> dict[str, object]:
        """All metrics of a run folder by name."""
        if self.truth is None:
            options = {"camera": self.camera, "threads": threads}
            return evaluate_held_out(trial, self.every, **options).as_dict()  # type: ignore[arg-type]
        if self.by == "labels":
            return evaluate_labels(trial, self.truth).as_dict()
        return evaluate_depth(trial, self.truth, camera=self.camera).as_dict()

    def truth_files(self) -> list[list[Any]]:
        """Name, size and time of the files of the truth."""
        if self.truth is None:
            return []
        if not self.truth.is_dir():
            exists = self.truth.exists()
            raise DatasetError(f"{self.truth} is {'not a folder' if exists else 'not there'}")
        inside = self.truth / _TRUTH[self.by]
        with os.scandir(inside if inside.is_dir() else self.truth) as files:
            known = [(file.path, file.stat()) for file in files if file.is_file()]
        return sorted([os.path.abspath(path), s.st_size, s.st_mtime_ns] for path, s in known)
