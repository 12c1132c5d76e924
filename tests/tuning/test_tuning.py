"""Parameter search: a trial is what a plain run gives, resumable, and the run stays unchanged."""

from __future__ import annotations

import csv
import hashlib
import json
import math
import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from command_line import cli
from docdepth.config import parameters
from docdepth.dynamics import voting
from docdepth.errors import CalibrationError, ConfigError, DatasetError, RunError
from docdepth.evaluation.held_out import evaluate_held_out
from docdepth.evaluation.runs import evaluate_depth, evaluate_labels
from docdepth.io.run_folder import RunFolder
from docdepth.pipeline.run import run as run_all
from docdepth.tuning import (
    DepthJudge,
    HeldOutJudge,
    LabelJudge,
    Outcome,
    Trial,
    grid,
    means,
    plot,
    trial_run,
    tune,
    tune_runs,
)
from docdepth.tuning.results import beside_each_other

pytest.importorskip("embreex")

FRAMES = 5
BASE = Trial("as the run", {})
NARROW = Trial("narrow", {"dynamics.window": 1, "dynamics.fine_spacing": 0.5})
LETTER = Trial("letter", {"preset": "paper", "ground.voxel_size": 0.1})
BEHIND = Trial("behind", {"render.behind": 0.0})
ALL = Trial("all", {"odometry.voxel_size": 1.5, "dynamics.tolerance": 0.4, "render.behind": 0.0})
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


def made(monkeypatch) -> list[str]:
    """The stages that trials make, apart from those that find nothing to do."""
    told: list[str] = []

    def watched(name):
        original = getattr(trial_run, name)

        def stage(trial, *rest, **named):
            before = json.dumps(trial.manifest["stages"])
            original(trial, *rest, **named)
            if json.dumps(trial.manifest["stages"]) != before:
                told.append(name.removeprefix("run_"))

        monkeypatch.setattr(trial_run, name, stage)

    for name in ("run_odometry", "run_classify", "run_render"):
        watched(name)
    return told


def test_a_trial_is_judged_like_a_plain_run_with_its_parameters(run, drive, tmp_path) -> None:
    before = contents(run)
    plain = run_all(drive, tmp_path / "plain", parameters(settings=ALL.settings)).path
    of_labels = Trial("all", {name: ALL.settings[name] for name in PATHS})
    expected = [
        (LabelJudge(drive), of_labels, evaluate_labels(plain, drive)),
        (DepthJudge(drive), ALL, evaluate_depth(plain, drive)),
        (HeldOutJudge(2), ALL, evaluate_held_out(plain, 2)),
    ]
    for judge, trial, result in expected:
        base, found = tune(run, judge, [BASE, trial], tmp_path / judge.view.unit[:5])
        assert found.metrics == json.loads(json.dumps(result.as_dict()))
        assert found.metrics != base.metrics
        shutil.rmtree(tmp_path / judge.view.unit[:5])
    assert contents(run) == before


def test_labels_of_a_run_and_of_a_preset(run, drive, tmp_path) -> None:
    judge, out = LabelJudge(drive), tmp_path / "out"
    outcomes = tune(run, judge, [BASE, NARROW, LETTER], out, threads=1)
    assert outcomes[0].metrics == evaluate_labels(run, drive).as_dict()
    letter = parameters("paper", {"ground.voxel_size": 0.1})
    plain = run_all(drive, tmp_path / "plain", letter).path
    assert outcomes[2].metrics == evaluate_labels(plain, drive).as_dict()
    assert outcomes[0].metrics["static_kept"] != outcomes[1].metrics["static_kept"]
    with (out / "tune.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert [row["trial"] for row in rows] == ["as the run", "narrow", "letter"]
    assert rows[1]["dynamics.window"] == "1"
    assert float(rows[1]["sa"]) == pytest.approx(outcomes[1].metrics["sa"])
    assert float(rows[1]["vote_seconds"]) > 0
    assert "| narrow |" in (out / "tune.md").read_text()
    assert sorted(file.suffix for file in out.iterdir()) == sorted([".json"] * 3 + [".csv", ".md"])


@pytest.mark.parametrize(
    ("judge", "settings", "stages"),
    [
        ("labels", {}, []),
        ("labels", {"dynamics.tolerance": 0.4}, ["classify"]),
        ("labels", {"odometry.voxel_size": 1.5}, ["odometry", "classify"]),
        ("held-out", {"render.behind": 0.0}, []),
        ("held-out", {"dynamics.tolerance": 0.4, "render.behind": 0.0}, ["classify"]),
        ("depth", {}, []),
        ("depth", {"render.behind": 0.0}, ["render"]),
        ("depth", {"dynamics.tolerance": 0.4}, ["classify", "render"]),
        ("depth", {"odometry.voxel_size": 1.5}, ["odometry", "classify", "render"]),
    ],
)
def test_only_what_its_parameters_change_is_made_again(
    run, drive, tmp_path, monkeypatch, judge, settings, stages
) -> None:
    judges = {"labels": LabelJudge(drive), "depth": DepthJudge(drive), "held-out": HeldOutJudge()}
    told = made(monkeypatch)
    tune(run, judges[judge], [Trial("a", settings)], tmp_path)
    assert told == stages


def test_an_interrupted_search_resumes(run, drive, tmp_path, monkeypatch) -> None:
    judge, out, write = LabelJudge(drive), tmp_path / "out", voting.vote
    whole = tune(run, judge, [BASE, NARROW], tmp_path / "whole", threads=1)
    votes = iter(range(3))

    def fail(*arguments, **named):
        if next(votes, None) is None:
            raise KeyboardInterrupt
        return write(*arguments, **named)

    monkeypatch.setattr(voting, "vote", fail)
    with pytest.raises(KeyboardInterrupt):
        tune(run, judge, [BASE, NARROW], out, threads=1)
    voted: list[int] = []
    monkeypatch.setattr(
        voting, "vote", lambda *a, **named: (voted.append(1), write(*a, **named))[1]
    )
    told = made(monkeypatch)
    again = tune(run, judge, [BASE, NARROW], out, threads=1)
    assert told == ["classify"]
    # The last of the three may still have been on its way to the disk.
    assert FRAMES - 3 <= len(voted) <= FRAMES - 2
    assert [o.metrics for o in again] == [o.metrics for o in whole]
    assert not (out / ".docdepth-trials").exists()
    # Another value under the same name is another trial.
    tune(run, judge, [Trial("narrow", {"dynamics.window": 3})], out, threads=1)
    assert told == ["classify"] * 2


@pytest.mark.parametrize("text", ["", "{", "[]", "3", '{"key": 1}', "\0"])
def test_a_damaged_result_is_made_again(run, tmp_path, text) -> None:
    judge = HeldOutJudge()
    whole = tune(run, judge, [BEHIND], tmp_path)
    (tmp_path / "behind.json").write_text(text)
    assert tune(run, judge, [BEHIND], tmp_path) == whole
    found = json.loads((tmp_path / "behind.json").read_text())
    del found["seconds"]
    (tmp_path / "behind.json").write_text(json.dumps(found))
    assert tune(run, judge, [BEHIND], tmp_path) == whole


def test_a_result_belongs_to_its_judge(run, drive, tmp_path) -> None:
    truth = Path(shutil.copytree(drive / "labels", tmp_path / "truth"))
    (first,) = tune(run, LabelJudge(truth), [BASE], tmp_path)
    sweep = truth / "000002.label"
    sweep.write_bytes(bytes(len(sweep.read_bytes())))
    (second,) = tune(run, LabelJudge(truth), [BASE], tmp_path)
    assert first.metrics["static"] > second.metrics["static"]
    (third,) = tune(run, HeldOutJudge(1), [BASE], tmp_path)
    assert third.metrics["sweeps"] == FRAMES - 2
    (fourth,) = tune(run, HeldOutJudge(2), [BASE], tmp_path)
    assert fourth.metrics["sweeps"] == 2


@pytest.mark.slow
def test_parallel_processes_give_the_same_results(run, drive, tmp_path) -> None:
    judge, trials, told = LabelJudge(drive), [BASE, NARROW, LETTER], []
    alone = tune(run, judge, trials, tmp_path / "alone", threads=1)
    beside = tune(
        run, judge, trials, tmp_path / "beside", 2, 1, lambda done, total: told.append(done)
    )
    assert [o.metrics for o in alone] == [o.metrics for o in beside]
    assert told == [0, 1, 2, 3]


def test_results_that_trials_share_must_be_up_to_date(own, drive, tmp_path) -> None:
    out = tmp_path / "out"
    (own / "labels" / "000002.label").unlink()
    with pytest.raises(RunError, match=r"classify of .* is incomplete"):
        tune(own, HeldOutJudge(), [BEHIND], out)
    # Trials that classify again do not share it.
    tune(own, LabelJudge(drive), [NARROW], out)
    (own / "frames" / "frame_000002.ply").unlink()
    with pytest.raises(RunError, match=r"odometry of .* is incomplete"):
        tune(own, LabelJudge(drive), [NARROW], out)


def test_a_run_that_changes_meanwhile_is_told(own, drive, tmp_path, monkeypatch) -> None:
    original = trial_run.run_classify

    def classify(trial, *rest):
        original(trial, *rest)
        cli("classify", own, "--set", "dynamics.tolerance=0.3")

    monkeypatch.setattr(trial_run, "run_classify", classify)
    with pytest.raises(RunError, match=r"has changed .* meanwhile; run the same command again"):
        tune(own, LabelJudge(drive), [BASE], tmp_path / "out")
    assert not list((tmp_path / "out").glob("*.json"))


def test_a_damaged_file_of_the_run_is_named(own, tmp_path) -> None:
    frame = own / "frames" / "frame_000002.ply"
    time, size = frame.stat().st_mtime_ns, frame.stat().st_size
    frame.write_bytes(b"x" * size)
    os.utime(frame, ns=(time, time))
    with pytest.raises(RunError, match=f"^{frame} is damaged .*; docdepth run {own} makes"):
        tune(own, HeldOutJudge(), [BEHIND], tmp_path / "out")
    assert not list((tmp_path / "out" / ".docdepth-trials").iterdir())


def test_trials_win_over_the_own_settings_of_a_camera(own, drive, tmp_path) -> None:
    def depth(trial: Trial, name: str):
        return tune(own, DepthJudge(drive), [trial], tmp_path / name)[0].metrics["all"]

    before, behind = depth(BASE, "a"), depth(BEHIND, "b")
    cli("render", own, "--camera", "image_2", "--set", "render.behind=0")
    assert RunFolder.open(own).cameras["image_2"]["settings"] == {"render.behind": 0}
    assert depth(BASE, "c") == behind != before
    assert depth(Trial("15", {"render.behind": 15.0}), "d") == before
    assert depth(Trial("default", {"preset": "default"}), "e") == before


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"dynamics.windows": 3}, "^trial 'a': .*windows"),
        ({"window": 3}, "^trial 'a': .*write stage.name"),
        ({"dynamics.window": 4}, "^trial 'a': .*odd"),
        ({"render.step": 1.0}, r"render.step does not change labels; .*--depth DIR.*--held-out N"),
        ({"output.scale": 100}, "output.scale changes the files"),
        ({"preset": "best"}, "^trial 'a': unknown preset"),
    ],
)
def test_impossible_parameters_are_refused(run, drive, tmp_path, settings, message) -> None:
    with pytest.raises(ConfigError, match=message):
        tune(run, LabelJudge(drive), [BASE, Trial("a", settings)], tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("names", [["a/b"], [".."], ["a", "a"]])
def test_impossible_names_are_refused(run, drive, tmp_path, names) -> None:
    with pytest.raises(ConfigError, match=r"cannot name a trial.*unique"):
        tune(run, LabelJudge(drive), [Trial(name, {}) for name in names], tmp_path / "out")


def test_impossible_searches_are_refused_before_anything_is_made(run, drive, tmp_path, own) -> None:
    out, labels = tmp_path / "out", LabelJudge(drive)
    with pytest.raises(ConfigError, match="lies in the run"):
        tune(run, labels, [BASE], run / "tuned")
    for judge in (LabelJudge(tmp_path / "no"), DepthJudge(tmp_path / "no")):
        with pytest.raises(DatasetError, match="no is not there"):
            tune(run, judge, [BASE], out)
    for several in (HeldOutJudge(camera="image_9"), DepthJudge(drive, "image_9")):
        with pytest.raises(RunError, match="image_9"):
            tune(run, several, [BASE], out)
    (own / "calib.json").unlink()
    with pytest.raises(CalibrationError, match=f"docdepth render {own}"):
        tune(own, HeldOutJudge(), [BASE], out)
    folder = RunFolder.open(own)
    folder.manifest["source"] = {}
    folder.save()
    with pytest.raises(ConfigError, match="its odometry is given"):
        tune(own, labels, [Trial("a", {"odometry.voxel_size": 1.5})], out)
    assert not out.exists()


def test_means_count_every_run_alike() -> None:
    first = Outcome("a", {"x": 1}, {"all": {"mae": 1.0, "density": 0.5}, "k": 3}, {"vote": 2.0})
    other = Outcome("a", {"x": 1}, {"all": {"mae": 2.0, "density": None}, "k": 4}, {})
    third = Outcome("a", {"x": 1}, {"all": {"mae": 6.0, "density": math.nan}, "k": 5}, {})
    (mean,) = means([[first], [other], [third]])
    assert mean.metrics == {"all": {"mae": 3.0, "density": 0.5}, "k": 4.0}
    assert mean.seconds == {"vote": 2.0}
    assert (mean.name, mean.settings) == ("a", {"x": 1})


def test_several_runs(run, own, drive, tmp_path) -> None:
    out, trials, told = tmp_path / "out", [BASE, NARROW], []
    judges = [LabelJudge(drive), LabelJudge(drive)]
    found = tune_runs(
        [run, own], judges, trials, out, progress=lambda done, total: told.append((done, total))
    )
    assert told[0] == (0, 4)
    assert told[-1] == (4, 4)
    singles = [tune(run, judges[0], trials, out / "1_run")]
    singles.append(tune(own, judges[1], trials, out / "2_own"))
    for name in ("iou", "precision"):
        expected = [np.mean([o.metric(name) for o in same]) for same in zip(*singles, strict=True)]
        np.testing.assert_allclose([o.metric(name) for o in found], expected)
    assert "Means over 2 runs" in (out / "tune.md").read_text()
    assert (out / "tune.csv").read_text().count("\n") == 3


def test_each_run_has_a_truth(run, own, drive, tmp_path) -> None:
    varied = ("-o", tmp_path / "out", "--vary", "dynamics.tolerance=0.2")
    ended = cli("tune", run, own, "--labels", drive, *varied)
    assert ended.exit_code == 2
    assert "2 runs and 1 folders of truth" in str(ended.exception)
    ended = cli("tune", run, own, "--labels", drive, "--labels", drive, *varied)
    assert ended.exit_code == 0, ended.output
    assert "Means over 2 runs" in ended.output


def test_a_users_files_beside_the_results_stay(run, tmp_path) -> None:
    kept = tmp_path / ".behind" / "file"
    kept.parent.mkdir()
    kept.write_text("mine")
    tune(run, HeldOutJudge(), [BEHIND], tmp_path)
    assert kept.read_text() == "mine"


def test_labels_of_points_that_lie_together_are_one() -> None:
    places = np.array([[0, 0], [10, 1], [0.4, 0.05], [np.nan, 0], [0.4, 0.1], [10, 1]])
    assert beside_each_other(places) == [[0, 2], [1, 5], [3], [4]]
    assert beside_each_other(np.zeros((3, 2))) == [[0, 1, 2]]
    assert beside_each_other(np.full((2, 2), np.nan)) == [[0], [1]]


@pytest.mark.parametrize("judge", [LabelJudge(Path()), DepthJudge(Path()), HeldOutJudge()])
def test_plots_are_drawn(tmp_path, judge) -> None:
    pytest.importorskip("matplotlib")
    errors = {"mae": 0.1, "rmse": 0.3, "density": 90.0, "too_near": 1.0, "too_far": None}
    metrics = {"sa": 99.0, "da": 90.0, "precision": 0.8, "iou": None, "sweeps": 5, "all": errors}
    trials = grid({"dynamics.window": [1, 3]})
    for some in (trials, [BASE, NARROW, LETTER]):
        outcomes = [Outcome(t.name, t.settings, metrics, {"vote": 1.0}) for t in some]
        plot(outcomes, judge.view, tmp_path / "tune.png")
        assert (tmp_path / "tune.png").read_bytes()[:4] == b"\x89PNG"
        (tmp_path / "tune.png").unlink()
