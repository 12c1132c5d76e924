"""Both ends of the range of each parameter can be held and finished."""

from __future__ import annotations

import re
import time
from pathlib import Path

import pytest

from command_line import cli
from docdepth.parameter_table import parameter_table

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
    name: str, end: float, drive: Path, tmp_path: Path
) -> None:
    settings = {name: f"{end:g}"} | _BESIDE.get((name, end), {})
    if name in ("render.static_size", "render.dynamic_size"):
        settings = {name: f"[{end:g}, {end:g}]", "render.primitive": "splats"}
    options = [part for key, value in settings.items() for part in ("--set", f"{key}={value}")]
    began = time.perf_counter()
    result = cli("run", drive, "-o", tmp_path / "run", *options)
    # Ranges that leave next to no points of this drive are refused, which is as good.
    if not re.search(r"leave \d % of the points", str(result.exception)):
        assert result.exit_code == 0, result.output + str(result.exception)
    assert time.perf_counter() - began < SECONDS
