"""Both ends of the range of each parameter can be held and finished."""

from __future__ import annotations

import re
import shutil
import time
from pathlib import Path

import numpy as np
import pytest

from command_line import cli
from docdepth.io.run_folder import RunFolder
from docdepth.parameter_table import parameter_table
from docdepth.pipeline.run_state import states

SECONDS = 60
"""Five sweeps take two seconds with the defaults."""

# What a value needs beside it: ranges that contradict each other are refused.
_BESIDE = {
    ("odometry.min_range", 100.0): {"odometry.max_range": 1000},
    ("dynamics.fine_radius", 0.1): {"dynamics.fine_spacing": 0.1},
    ("dynamics.fine_radius", 1000.0): {"dynamics.fine_spacing": 5},
    ("dynamics.fine_spacing", 1000.0): {"dynamics.fine_radius": 1000},
    ("dynamics.coarse_radius", 0.1): {"dynamics.coarse_spacing": 0.1},
    ("dynamics.coarse_spacing", 0.1): {"dynamics.coarse_radius": 20},
    ("dynamics.coarse_spacing", 1000.0): {"dynamics.coarse_radius": 1000},
    ("render.max_depth", 2000.0): {"output.scale": 32},
    ("output.scale", 10000.0): {"render.max_depth": 6},
}


_VERBS = {"ground": "classify", "dynamics": "classify", "render": "render", "output": "render"}
"""What takes parameters of a stage for a run that is there."""


def _ends() -> list[tuple[str, float]]:
    return [
        (about["name"], float(end))
        for about in parameter_table()
        if " to " in about["range"]
        for end in about["range"].split(" to ")
    ]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "end"), _ends(), ids=lambda value: str(value))
def test_a_run_with_the_end_of_a_range_finishes(
    name: str, end: float, drive: Path, finished: tuple[Path, str], tmp_path: Path
) -> None:
    settings = {name: f"{end:g}"} | _BESIDE.get((name, end), {})
    if name in ("render.static_size", "render.dynamic_size"):
        settings = {name: f"[{end:g}, {end:g}]", "render.primitive": "splats"}
    options = [part for key, value in settings.items() for part in ("--set", f"{key}={value}")]
    began = time.perf_counter()
    verb = _VERBS.get(name.split(".")[0])
    if verb is None:
        result = cli("run", drive, "-o", tmp_path / "run", *options)
    else:  # the stages before do not know the parameter
        shutil.copytree(finished[0], tmp_path / "run")
        result = cli(verb, tmp_path / "run", *options)
        if verb == "classify" and result.exit_code == 0:
            result = cli("run", tmp_path / "run")
    # Ranges that leave next to no points of this drive are refused, which is as good.
    if not re.search(r"leave \d % of the points", str(result.exception)):
        assert result.exit_code == 0, result.output + str(result.exception)
        made, (stage, parameter) = RunFolder.open(tmp_path / "run"), name.split(".")
        assert {state.state for state in states(made)} == {"done"}
        held = getattr(getattr(made.parameters, stage), parameter)
        np.testing.assert_allclose(held, end, rtol=1e-5)
    assert time.perf_counter() - began < SECONDS
