"""What the command line understands: names, completion, configuration files, JSON, silence."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from command_line import cli
from docdepth.cli.config_file import read_config
from docdepth.cli.synth import SCENE_NAMES
from docdepth.config import Parameters, parameters
from docdepth.io.run_folder import RunFolder


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["synth", "out", "--scene", "town"], "'town' is unknown; there are"),
        (["synth", "out", "--sensor", "VLP16"], "did you mean VLP-16?"),
        (["run", "d", "-o", "r", "--layers", "class,tiem"], "did you mean time?"),
    ],
)
def test_an_unknown_name_is_answered_with_the_known_ones(docdepth, words, message):
    ended = docdepth(*words)
    assert ended.code == 2
    assert message in ended.err
    assert len(ended.err.splitlines()) == 1


def test_names_are_understood_with_dash_or_underline_and_any_capitals(drive, tmp_path):
    result = cli(
        "run", drive, "-o", tmp_path / "run",
        "--dataset", "KITTI-odometry", "--format", "NPY,exr-half",
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    folder = RunFolder.open(tmp_path / "run")
    assert folder.inputs.dataset == "kitti_odometry"
    assert folder.parameters.output.format == ("npy", "exr-half")


def test_completion_knows_options_and_values():
    def complete(line: str) -> list[str]:
        surroundings = {
            **os.environ,
            "_DOCDEPTH_COMPLETE": "complete_bash",
            "COMP_WORDS": line,
            "COMP_CWORD": str(len(line.split(" ")) - 1),
        }
        code = "import sys; sys.argv = ['docdepth']; from docdepth.cli import main; main()"
        command = [sys.executable, "-c", code]
        return subprocess.run(
            command, env=surroundings, capture_output=True, text=True
        ).stdout.split()

    assert complete("docdepth synth --scene ") == list(SCENE_NAMES)
    assert "--image-size" in complete("docdepth run --im")


def test_the_help_of_run_fits_one_screen_and_all_of_it_is_at_hand(docdepth, monkeypatch):
    monkeypatch.setenv("COLUMNS", "100")
    some, every = docdepth("run", "--help").out, docdepth("run", "--help-all").out
    names = [set(re.findall(r"│ (--[\w-]+)", text)) for text in (some, every)]
    shared = {"--quiet", "--verbose", "--help", "--help-all"}
    assert len(some.splitlines()) <= 40
    assert len(names[0] - shared) == 10
    assert names[0] < names[1] > {"--poses-as-given", "--scheduler", "--mask", "--config"}


def test_parameters_are_listed(docdepth):
    rows = json.loads(docdepth("parameters", "--json").out)
    names = {f"{s}.{n}" for s, g in Parameters() if s != "preset" for n, _ in g}
    assert {row["name"] for row in rows} == names
    text = docdepth("parameters", "dynamics").out
    assert "dynamics.coarse_radius  80 m, paper 50; allowed:" in text
    assert "render.step" not in text


def test_quiet_says_nothing_and_verbose_more(docdepth, drive, tmp_path):
    ended = docdepth("run", drive, "-o", tmp_path / "run", "-q")
    assert ended == (0, "", "")
    assert docdepth("--quiet", "run", tmp_path / "run") == (0, "", "")
    table = docdepth("evaluate", "labels", tmp_path / "run", "--labels", drive, "-q")
    assert "SA" in table.out
    assert table.err == ""
    assert docdepth("run", drive, "-o", tmp_path / "run", "--set", "x.y=1", "-q").err != ""


def test_a_run_is_told_in_json(docdepth, drive, tmp_path):
    ended = docdepth("run", drive, "-o", tmp_path / "run", "--json")
    told = json.loads(ended.out)
    assert set(told["stages"]) >= {"odometry", "classify"}
    assert told["run"] == str(tmp_path / "run")
    assert 0.5 < told["cameras"]["image_2"]["density"] < 1
    assert "odometry" in ended.err  # progress


class TestConfig:
    def write(self, folder, tree):
        path = folder / "config.yaml"
        path.write_text(yaml.safe_dump(tree))
        return path

    def test_a_file_sets_parameters_and_options_win(self, drive, tmp_path):
        config = self.write(
            tmp_path,
            {"preset": "paper", "dynamics": {"tolerance": 0.3, "window": 3}, "output.scale": 128},
        )
        result = cli(
            "run", drive, "-o", tmp_path / "run", "--config", config,
            "--set", "dynamics.window=7", "--scale", "200",
        )  # fmt: skip
        assert result.exit_code == 0, result.output
        wanted = {"dynamics.tolerance": 0.3, "dynamics.window": 7, "output.scale": 200.0}
        assert RunFolder.open(tmp_path / "run").parameters == parameters("paper", wanted)

    def test_the_file_of_a_run_repeats_it(self, drive, tmp_path):
        first, second = tmp_path / "first", tmp_path / "second"
        options = ["--set", "dynamics.tolerance=0.3", "--camera", "image_2", "--format", "npy"]
        assert cli("run", drive, "-o", first, *options).exit_code == 0
        result = cli("run", "--config", first / "run.yaml", "-o", second)
        assert result.exit_code == 0, result.output
        one, two = RunFolder.open(first), RunFolder.open(second)
        assert one.parameters == two.parameters
        assert one.inputs == two.inputs
        for path in sorted((first / "depth").glob("*.npy")):
            assert path.read_bytes() == (second / "depth" / path.name).read_bytes()

    def test_another_preset_replaces_that_of_a_run_but_not_what_was_set(self, finished, tmp_path):
        run = tmp_path / "run"
        shutil.copytree(finished[0], run)
        tree = yaml.safe_load((run / "run.yaml").read_text())
        tree["parameters"]["dynamics"]["tolerance"] = 0.3
        given = read_config(self.write(tmp_path, tree))
        assert given.settings == {"dynamics.tolerance": 0.3}
        assert given.inputs is not None

    def test_an_explicit_value_stays_with_another_preset(self, tmp_path):
        given = read_config(self.write(tmp_path, {"dynamics": {"coarse_radius": 80}}))
        assert parameters("paper", given.settings).dynamics.coarse_radius == 80


def in_new_process(script: str, variable: str, wanted: str | None) -> list[str]:
    """What a script prints where this environment variable is set, or is not."""
    environment = {name: value for name, value in os.environ.items() if name != variable}
    if wanted:
        environment[variable] = wanted
    command = [sys.executable, "-c", script]
    result = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    return result.stdout.split()


@pytest.mark.parametrize("wanted", [None, "2"])
def test_numpy_multiplies_in_the_calling_thread(wanted: str | None) -> None:
    """Unless the user has asked for threads."""
    script = (
        "import ctypes, sys, numpy\n"
        "from docdepth.cli import take_one_blas_thread\n"
        "taken = take_one_blas_thread()\n"
        "module = sys.modules.get('numpy._core._multiarray_umath')\n"
        "library = ctypes.CDLL(getattr(module, '__file__', None))\n"
        "name = 'scipy_openblas_get_num_threads64_'\n"
        "print(taken, getattr(library, name)() if hasattr(library, name) else 'other')\n"
    )
    taken, threads = in_new_process(script, "OPENBLAS_NUM_THREADS", wanted)
    if threads == "other":
        pytest.skip("numpy without its own OpenBLAS")
    assert taken == str(wanted is None)
    if wanted is None:
        assert threads == "1"


def test_a_run_without_a_place_is_named_after_its_recording(
    drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    named = tmp_path / f"{drive.name}_run"
    first = cli("run", drive, "--camera", "none", "--frames", "0:4")
    assert first.exit_code == 0, first.output
    assert [path.name for path in tmp_path.iterdir()] == [named.name]
    before = (named / "traj_odometry.ply").stat().st_mtime_ns
    for again in (("run", drive, "--camera", "none", "--frames", "0:4"), ("run", named)):
        assert cli(*again).exit_code == 0
        assert (named / "traj_odometry.ply").stat().st_mtime_ns == before
    nothing = cli("run")
    assert "no recording: docdepth run RECORDING" in str(nothing.exception)


def test_control_characters_in_names_do_not_reach_the_terminal(docdepth, tmp_path: Path) -> None:
    (tmp_path / "red\x1b[31m\x9b2J\r\u00e9").mkdir()
    ended = docdepth("run", tmp_path / "red\x1b[31m\x9b2J\r\u00e9", "-o", tmp_path / "run")
    assert ended.code == 2
    assert "red\\x1b[31m\\x9b2J\\x0d\u00e9 is no recording" in ended.err
