"""Runs at the ends of the ranges of parameters finish, or are refused with a reason."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from command_line import cli
from docdepth.errors import DocDepthError
from docdepth.io.run_folder import RunFolder
from docdepth.parameter_table import parameter_table
from docdepth.pipeline.plan import states

_LISTS = ("render.static_size", "render.dynamic_size")


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
def test_a_run_at_the_ends_of_ranges(seed: int, drive: Path, tmp_path: Path) -> None:
    """Two random parameters, each at a random end of its range."""
    random = np.random.default_rng(seed)
    ranges = {
        p["name"]: p["range"].split(" to ") for p in parameter_table() if " to " in p["range"]
    }
    settings = {
        str(name): random.choice(ranges[name]) for name in random.choice(sorted(ranges), 2, False)
    }
    options = []
    for name, end in settings.items():
        options += ["--set", f"{name}=[{end},{end}]" if name in _LISTS else f"{name}={end}"]
    result = cli("run", drive, "-o", tmp_path / "run", *options)
    if result.exit_code:
        assert isinstance(result.exception, DocDepthError)
        return
    made = RunFolder.open(tmp_path / "run")
    assert {state.state for state in states(made)} == {"done"}
    for name, end in settings.items():
        stage, parameter = name.split(".")
        held = getattr(getattr(made.parameters, stage), parameter)
        np.testing.assert_allclose(held, float(end), rtol=1e-5)
