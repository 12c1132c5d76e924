"""Parameter search: a trial is what a plain run gives, resumable, and the run stays unchanged."""

from __future__ import annotations

import csv
import hashlib
import importlib
import json
import math
import shutil
from pathlib import Path

import pytest

from command_line import cli
from docdepth.cli.tune import parse_axes
from docdepth.config import parameters
from docdepth.errors import CalibrationError, ConfigError, DatasetError, RunError
from docdepth.evaluation.held_out import evaluate_held_out
from docdepth.evaluation.runs import evaluate_depth, evaluate_labels
from docdepth.pipeline.run import run as run_all
from docdepth.tuning import Objective, Outcome, Trial, grid, means, plot, read_trials, tune

pytest.importorskip("embreex")

BASE = Trial("as the run", {})
NARROW = Trial("narrow", {"dynamics.window": 1, "dynamics.fine_spacing": 0.5})
LETTER = Trial("letter", {"preset": "paper", "ground.voxel_size": 0.1})
BEHIND = Trial("behind", {"render.behind": 0.0})
ALL = Trial("all", {"odometry.voxel_size": 2.0, "dynamics.tolerance": 0.8, "render.behind": 0.0})
PATHS = ("odometry.voxel_size", "dynamics.tolerance")


@pytest.fixture(scope="module")
def run(finished: tuple[Path, str]) -> Path:
    """A finished run; no test writes into it."""
    return finished[0]


@pytest.fixture
def own(run: Path, tmp_path: Path) -> Path:
    """A copy of the run that a test may damage."""
    return Path(shutil.copytree(run, tmp_path / "own"))


def contents(path: Path) -> dict[str, str]:
    files = sorted(file for file in path.rglob("*") if file.is_file())
    return {str(file): hashlib.sha256(file.read_bytes()).hexdigest() for file in files}


@pytest.fixture
def made(monkeypatch) -> list[str]:
    """The stages that trials make, apart from those that find nothing to do."""
    told: list[str] = []
    module = importlib.import_module("docdepth.tuning.tune")

    def watched(name: str):
        original = getattr(module, name)

        def stage(trial, *rest, **named):
            before = (trial.path / "run.yaml").read_text()
            original(trial, *rest, **named)
            if (trial.path / "run.yaml").read_text() != before:
                told.append(name.removeprefix("run_"))

        return stage

    for name in ("run_odometry", "run_classify", "run_render"):
        monkeypatch.setattr(module, name, watched(name))
    return told


def test_grids_and_values() -> None:
    axes = parse_axes(["dynamics.tolerance=0.1,0.2", "dynamics.window=5"])
    trials = grid(axes)
    assert [trial.name for trial in trials] == ["tolerance=0.1,window=5", "tolerance=0.2,window=5"]
    assert trials[1].settings == {"dynamics.tolerance": 0.2, "dynamics.window": 5}
    assert grid({}) == [BASE]
    (trial,) = grid(parse_axes(["odometry.voxel_size=1", "ground.voxel_size=0.1"]))
    assert trial.name == "odometry.voxel_size=1,ground.voxel_size=0.1"
    lists = parse_axes(["render.static_size=[50, 3],[40, 2]", "a.b=1,2", "a.b=2,3", "c.d=1,1"])
    assert lists == {"render.static_size": [[50, 3], [40, 2]], "a.b": [1, 2, 3], "c.d": [1]}


@pytest.mark.parametrize("text", ["a", "a.b=", "a.b=[", "a.b=1,,2", "a.b=}"])
def test_bad_values_speak_of_vary(text) -> None:
    with pytest.raises(ConfigError, match="--vary"):
        parse_axes([text])


def test_files_of_trials(tmp_path) -> None:
    file = tmp_path / "trials.yaml"
    file.write_text("a: {dynamics.window: 3}\nb:\n")
    assert read_trials(file) == [Trial("a", {"dynamics.window": 3}), Trial("b", {})]
    for content in (b"- 1\n", b"", b"{}", b"a: 3\n", b"a: {1: 2}\n", b"\xff\xfe\x00"):
        file.write_bytes(content)
        with pytest.raises(ConfigError, match=r"trials\.yaml"):
            read_trials(file)
    assert len(read_trials(Path(__file__).parents[2] / "benchmarks" / "ablation.yaml")) == 4


def test_settings_replace_those_of_the_run() -> None:
    base = parameters("paper", {"dynamics.window": 3, "render.step": 1.0, "output.scale": 100})
    assert BASE.parameters(base) == base
    found = Trial("b", {"dynamics.tolerance": 0.5}).parameters(base)
    assert (found.dynamics.window, found.dynamics.tolerance, found.render.step) == (3, 0.5, 1.0)
    preset = Trial("d", {"preset": "default"}).parameters(base)
    assert preset == parameters(settings={"output.scale": 100})


def test_a_trial_is_scored_like_a_plain_run_with_its_parameters(run, drive, tmp_path) -> None:
    before = contents(run)
    plain = run_all(drive, tmp_path / "plain", parameters(settings=ALL.settings)).path
    of_labels = Trial("all", {name: ALL.settings[name] for name in PATHS})
    expected = [
        (Objective("labels", drive), of_labels, evaluate_labels(plain, drive)),
        (Objective("depth", drive), ALL, evaluate_depth(plain, drive)),
        (Objective(every=2), ALL, evaluate_held_out(plain, 2)),
    ]
    for objective, trial, result in expected:
        base, found = tune([run], [objective], [BASE, trial], tmp_path / objective.by)
        assert found.metrics == json.loads(json.dumps(result.as_dict()))
        assert found.metrics != base.metrics
    assert contents(run) == before


@pytest.mark.parametrize(
    ("objective", "settings", "stages"),
    [
        ("labels", {}, []),
        ("labels", {"odometry.voxel_size": 1.5}, ["odometry", "classify"]),
        ("held-out", {"render.behind": 0.0}, []),
        ("held-out", {"dynamics.tolerance": 0.4, "render.behind": 0.0}, ["classify"]),
        ("depth", {"render.behind": 0.0}, ["render"]),
        ("depth", {"dynamics.tolerance": 0.4}, ["classify", "render"]),
    ],
)
def test_only_what_its_parameters_change_is_made_again(
    run, drive, tmp_path, made, objective, settings, stages
) -> None:
    truth = None if objective == "held-out" else drive
    tune([run], [Objective(objective, truth)], [Trial("a", settings)], tmp_path)
    assert made == stages


def test_an_interrupted_search_resumes(run, drive, tmp_path, made, monkeypatch) -> None:
    objective, out, measure = Objective("labels", drive), tmp_path / "out", Objective.measure
    whole = tune([run], [objective], [BASE, NARROW], tmp_path / "whole")
    made.clear()

    def interrupted(objective, trial, threads=0):
        if trial.name == "narrow":
            raise KeyboardInterrupt
        return measure(objective, trial, threads)

    with monkeypatch.context() as patch:
        patch.setattr(Objective, "measure", interrupted)
        with pytest.raises(KeyboardInterrupt):
            tune([run], [objective], [BASE, NARROW], out)
    assert made == ["classify"]
    assert tune([run], [objective], [BASE, NARROW], out) == whole
    assert made == ["classify"], "the trial goes on where it stopped"
    assert not (out / "1_run" / ".docdepth-trials").exists()
    # Another value under the same name is another trial, and a damaged score is made again.
    tune([run], [objective], [Trial("narrow", {"dynamics.window": 3})], out)
    assert made == ["classify"] * 2
    (out / "1_run" / "narrow.json").write_text("{")
    assert tune([run], [objective], [BASE, NARROW], out) == whole


def test_a_score_belongs_to_its_truth(run, drive, tmp_path) -> None:
    truth = Path(shutil.copytree(drive / "labels", tmp_path / "truth"))
    (first,) = tune([run], [Objective("labels", truth)], [BASE], tmp_path)
    sweep = truth / "000002.label"
    sweep.write_bytes(bytes(len(sweep.read_bytes())))
    (second,) = tune([run], [Objective("labels", truth)], [BASE], tmp_path)
    assert first.metrics["static"] > second.metrics["static"]
    (third,) = tune([run], [Objective(every=1)], [BASE], tmp_path)
    assert third.metrics["sweeps"] == 3


def test_what_trials_share_must_be_up_to_date(own, drive, tmp_path) -> None:
    (own / "labels" / "000002.label").unlink()
    with pytest.raises(RunError, match=r"classify of .* is incomplete"):
        tune([own], [Objective()], [BEHIND], tmp_path / "out")
    # Trials that classify again do not share it.
    tune([own], [Objective("labels", drive)], [NARROW], tmp_path / "out")
    (own / "frames" / "frame_000002.ply").unlink()
    with pytest.raises(RunError, match=r"odometry of .* is incomplete"):
        tune([own], [Objective("labels", drive)], [NARROW], tmp_path / "out")


def test_trials_win_over_the_own_settings_of_a_camera(own, drive, tmp_path) -> None:
    def depth(trial: Trial, name: str):
        return tune([own], [Objective("depth", drive)], [trial], tmp_path / name)[0].metrics["all"]

    before, behind = depth(BASE, "a"), depth(BEHIND, "b")
    cli("render", own, "--camera", "image_2", "--set", "render.behind=0")
    assert depth(BASE, "c") == behind != before
    assert depth(Trial("15", {"render.behind": 15.0}), "d") == before
    assert depth(Trial("default", {"preset": "default"}), "e") == before


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"dynamics.windows": 3}, "trial 'a'.*windows"),
        ({"dynamics.window": 4}, "trial 'a'.*odd"),
        ({"render.step": 1.0}, "render.step does not change labels"),
        ({"output.scale": 100}, "output.scale"),
        ({"preset": "best"}, "trial 'a'.*preset"),
    ],
)
def test_impossible_parameters_are_refused(run, drive, tmp_path, settings, words) -> None:
    with pytest.raises(ConfigError, match=words):
        tune([run], [Objective("labels", drive)], [BASE, Trial("a", settings)], tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_impossible_searches_are_refused_before_anything_is_made(run, drive, tmp_path, own) -> None:
    out, labels = tmp_path / "out", Objective("labels", drive)
    for names in (["a/b"], [".."], ["a", "a"]):
        with pytest.raises(ConfigError, match="name"):
            tune([run], [labels], [Trial(name, {}) for name in names], out)
    with pytest.raises(ConfigError, match="lies in the run"):
        tune([run], [labels], [BASE], run / "tuned")
    with pytest.raises(DatasetError, match="not there"):
        tune([run], [Objective("depth", tmp_path / "no")], [BASE], out)
    with pytest.raises(RunError, match="image_9"):
        tune([run], [Objective(camera="image_9")], [BASE], out)
    (own / "calib.json").unlink()
    with pytest.raises(CalibrationError):
        tune([own], [Objective()], [BASE], out)
    assert not out.exists()


def test_means_count_every_run_alike() -> None:
    metrics = [
        {"all": {"mae": 1.0, "density": 0.5}, "k": 3},
        {"all": {"mae": 2.0, "density": None}, "k": 4},
        {"all": {"mae": 6.0, "density": math.nan}, "k": 5},
    ]
    (mean,) = means([Outcome(f"{k}", "a", {"x": 1}, m) for k, m in enumerate(metrics)])
    assert mean.metrics == {"all": {"mae": 3.0, "density": 0.5}, "k": 4.0}
    assert (mean.name, mean.settings) == ("a", {"x": 1})


@pytest.mark.slow
def test_several_runs_by_parallel_processes(run, own, drive, tmp_path) -> None:
    out, varied = tmp_path / "out", ("--vary", "dynamics.tolerance=0.1,0.2")
    one = cli("tune", run, own, "--labels", drive, "-o", out, *varied)
    assert one.exit_code == 2
    assert "2 runs and 1 folders" in str(one.exception)
    truths = ("--labels", drive, "--labels", drive)
    ended = cli("tune", run, own, *truths, "-o", out, *varied, "--jobs", "2", "--threads", "1")
    assert ended.exit_code == 0, ended.output
    assert "mean of 2 runs" in ended.output
    with (out / "tune.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert [row["run"] for row in rows] == ["run", "run", "own", "own"]
    assert [row["iou"] for row in rows[:2]] == [row["iou"] for row in rows[2:]]


def test_without_truth_left_out_sweeps_score(run, tmp_path) -> None:
    ended = cli("tune", run, "-o", tmp_path, "--vary", "render.behind=0,15")
    assert ended.exit_code == 0, ended.output
    assert "too near %" in ended.output
    lines = (tmp_path / "tune.csv").read_text().splitlines()
    assert lines[0] == "run,trial,render.behind,returns,density,mae,rmse,too_near,too_far"
    assert len(lines) == 3


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--vary", "render.behind=-1"], "--vary: render.behind = -1"),
        (["--labels", "d", "--held-out", "2"], "choose one objective"),
        (["--labels", "d", "--camera", "image_2"], "leave --camera out"),
        ([], "say what to vary"),
    ],
)
def test_what_cannot_be_tuned_is_a_sentence(run, tmp_path, words, message) -> None:
    ended = cli("tune", run, "-o", tmp_path / "out", *words)
    assert ended.exit_code == 2
    assert message in str(ended.exception)


@pytest.mark.parametrize("by", ["labels", "depth", "held-out"])
def test_plots_are_drawn(tmp_path, by) -> None:
    pytest.importorskip("matplotlib")
    errors = {"mae": 0.1, "density": 90.0, "too_far": None}
    metrics = {"precision": 0.8, "iou": None, "all": errors}
    for trials in (grid({"dynamics.window": [1, 3]}), [BASE, NARROW, LETTER]):
        outcomes = [Outcome("run", trial.name, trial.settings, metrics) for trial in trials]
        plot(outcomes, by, tmp_path / "tune.png")
        assert (tmp_path / "tune.png").read_bytes()[:4] == b"\x89PNG"
        (tmp_path / "tune.png").unlink()
