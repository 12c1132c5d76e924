"""Parameter sets of a search, and the verb that takes them."""

from __future__ import annotations

from pathlib import Path

import pytest

from command_line import cli
from docdepth.config import parameters
from docdepth.errors import ConfigError
from docdepth.tuning import Trial, grid, parse_axes, read_trials
from docdepth.tuning.trials import parameters_of


def test_grids() -> None:
    axes = parse_axes(["dynamics.tolerance=0.1,0.2", "dynamics.window=5"])
    trials = grid(axes)
    assert [trial.name for trial in trials] == ["tolerance=0.1,window=5", "tolerance=0.2,window=5"]
    assert trials[1].settings == {"dynamics.tolerance": 0.2, "dynamics.window": 5}
    assert grid({}) == [Trial("as the run", {})]


def test_parameters_of_one_name_in_two_stages_are_told_apart() -> None:
    (trial,) = grid(parse_axes(["odometry.voxel_size=1", "ground.voxel_size=0.1"]))
    assert trial.name == "odometry.voxel_size=1,ground.voxel_size=0.1"


def test_values_may_be_lists_and_are_taken_once() -> None:
    assert parse_axes(["render.static_size=[50, 3],[40, 2]"]) == {
        "render.static_size": [[50, 3], [40, 2]]
    }
    assert parse_axes(["a.b=1,2", "a.b=2,3", "c.d=1,1"]) == {"a.b": [1, 2, 3], "c.d": [1]}


@pytest.mark.parametrize("text", ["a", "a.b=", "a.b=[", "a.b=1,,2", "a.b=}"])
def test_bad_values_speak_of_vary(text) -> None:
    with pytest.raises(ConfigError, match=r"^--vary '"):
        parse_axes([text])


def test_files(tmp_path) -> None:
    file = tmp_path / "trials.yaml"
    file.write_text("a: {dynamics.window: 3}\nb:\n")
    assert read_trials(file) == [Trial("a", {"dynamics.window": 3}), Trial("b", {})]
    for text in ("- 1\n", "", "{}", "a: 3\n", "a: {1: 2}\n"):
        file.write_text(text)
        with pytest.raises(ConfigError, match="NAME"):
            read_trials(file)
    file.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ConfigError, match="cannot be read"):
        read_trials(file)
    assert len(read_trials(Path(__file__).parents[2] / "benchmarks" / "ablation.yaml")) == 4


def test_settings_replace_those_of_the_run() -> None:
    base = parameters("paper", {"dynamics.window": 3, "render.step": 1.0, "output.scale": 100})
    assert parameters_of(base, Trial("a", {})) == base
    found = parameters_of(base, Trial("b", {"dynamics.tolerance": 0.5}))
    assert (found.dynamics.window, found.dynamics.tolerance, found.render.step) == (3, 0.5, 1.0)
    preset = parameters_of(base, Trial("d", {"preset": "default"}))
    assert preset == parameters(settings={"output.scale": 100})


def test_values_are_judged_beside_those_of_the_run() -> None:
    base = parameters(settings={"dynamics.fine_spacing": 0.5})
    found = parameters_of(base, Trial("a", {"dynamics.fine_radius": 1.0}))
    assert found.dynamics.fine_radius == 1.0  # below the default spacing of 2 m


def tuned(run: Path, *arguments: object):
    return cli("tune", run, *arguments)


def test_labels_on_the_command_line(finished, drive, tmp_path) -> None:
    out = tmp_path / "out"
    result = tuned(
        finished[0], "--labels", drive, "-o", out,
        "--vary", "dynamics.tolerance=0.1,0.2", "--vary", "dynamics.window=5",
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    assert "tolerance=0.1,window=5" in result.output
    assert "IoU" in result.output
    assert len((out / "tune.csv").read_text().splitlines()) == 3


def test_without_truth_sweeps_that_are_left_out_judge(finished, drive, tmp_path) -> None:
    out, vary = tmp_path / "out", ("--vary", "render.behind=0,15")
    result = tuned(finished[0], "-o", out, *vary)
    assert result.exit_code == 0, result.output
    assert "against 1 held-out sweeps" in result.output
    assert "too near %" in result.output
    assert "against 3 held-out" in tuned(finished[0], "--held-out", 1, "-o", out, *vary).output
    assert " images\n" in tuned(finished[0], "--depth", drive, "-o", out, *vary).output
    header = (out / "tune.csv").read_text().splitlines()[0]
    assert header == "trial,render.behind,pixels,density,mae,rmse,too_near,too_far"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--vary", "render.behind=-1"], "--vary: render.behind = -1: it must be a number from 0"),
        (["--vary", "render.behnd=1"], "--vary: unknown parameter 'render.behnd'"),
        (["--vary", "output.scale=1"], "--vary: output.scale changes the files"),
        (["--labels", "DRIVE", "--vary", "render.step=1"], "render.step does not change labels"),
        (["--labels", "DRIVE", "--held-out", "2"], "choose one judge"),
        (["--labels", "DRIVE", "--depth", "DRIVE"], "choose one judge"),
        (["--labels", "DRIVE", "--camera", "image_2"], "leave --camera out"),
        ([], "say what to vary"),
    ],
)
def test_what_cannot_be_tuned_is_a_sentence(finished, drive, tmp_path, words, message) -> None:
    words = [str(drive) if word == "DRIVE" else word for word in words]
    more = [] if "--vary" in words or not words else ["--vary", "dynamics.window=3"]
    result = tuned(finished[0], "-o", tmp_path / "out", *words, *more)
    assert result.exit_code == 2
    assert message in str(result.exception)


def test_trials_of_a_file_name_the_file(finished, tmp_path) -> None:
    file = tmp_path / "trials.yaml"
    file.write_text("good: {render.behind: 3}\nbad: {render.behind: -3}\n")
    result = tuned(finished[0], "-o", tmp_path / "out", "--trials", file)
    assert str(result.exception).startswith(f"{file}, trial 'bad': render.behind = -3")
