"""Parameter search: same metrics as a plain run, resumable, and the run stays unchanged."""

from __future__ import annotations

import csv
import hashlib
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from docdepth import pipeline
from docdepth.cli import app
from docdepth.config import Parameters, parameters
from docdepth.datasets.base import Sweep
from docdepth.dynamics import voting
from docdepth.dynamics.classifier import classify_drive
from docdepth.errors import ConfigError
from docdepth.evaluation import LabelEvaluation
from docdepth.geometry.sensor_rig import SensorRig
from docdepth.geometry.trajectory import Trajectory
from docdepth.io.frames import FrameRecord, write_trajectory
from docdepth.io.run_folder import RunFolder
from docdepth.tuning import Outcome, Trial, grid, parse_axes, plot, read_trials, tune
from docdepth.tuning.trials import parameters_of

pytest.importorskip("embreex")

FRAMES = 6
TRIALS = [
    Trial("as the run", {}),
    Trial("narrow", {"dynamics.window": 1, "dynamics.fine_spacing": 0.5}),
    Trial("letter", {"preset": "paper", "ground.voxel_size": 0.1}),
]


@pytest.fixture(scope="module")
def drive():
    from docdepth.synthetic import Drive, scene, sensor

    drive = Drive(scene("city", 0), sensor("VLP-16"), FRAMES)
    return drive, [drive.sweep(k) for k in range(FRAMES)]


@pytest.fixture(scope="module")
def run(drive, tmp_path_factory) -> Path:
    """A run folder with finished odometry, and a folder of labels."""
    path = tmp_path_factory.mktemp("tuning")
    labels = path / "labels"
    labels.mkdir()
    truth, sweeps = drive
    folder = RunFolder.create(path / "run", {"dataset": "made up", "poses": "exact"}, Parameters())
    write_trajectory(
        folder.trajectory_path, Trajectory(truth.times, truth.poses), np.arange(FRAMES)
    )
    for k, one in enumerate(sweeps):
        one.labels.tofile(labels / f"{k:06d}.label")
        rows = np.arange(len(one.points), dtype=np.uint32)
        seen = rig_beside_origin(one.points)
        record = FrameRecord(one.points, rows, f"{k:06d}", len(rows), sensor=seen.index)
        folder.write_frame(k, record, {"odometry": "x"})
    folder.write_sensors(seen, {"odometry": "x"})
    folder.set_stage("odometry", state="done", key="x")
    return folder.path


def rig_beside_origin(points) -> SensorRig:
    """The LiDAR is not at the origin, which changes votes."""
    return SensorRig.single((0.5, 0.2, 0.3), len(points))


def contents(path: Path) -> dict[str, str]:
    files = sorted(file for file in path.rglob("*") if file.is_file())
    return {str(file): hashlib.sha256(file.read_bytes()).hexdigest() for file in files}


def test_metrics_are_those_of_the_stages_in_memory(drive, run, tmp_path) -> None:
    before = contents(run)
    outcomes = tune(run, run.parent / "labels", TRIALS, tmp_path / "out", threads=1)
    assert contents(run) == before
    truth, sweeps = drive
    points = [one.points for one in sweeps]
    trajectory = Trajectory(truth.times, truth.poses)
    chosen = [
        parameters(),
        parameters("default", TRIALS[1].settings),
        parameters("paper", {"ground.voxel_size": 0.1}),
    ]
    for outcome, p in zip(outcomes, chosen, strict=True):
        of_run = [Sweep(one, "", 0, sensor_rig=rig_beside_origin(one)) for one in points]
        labels = classify_drive(of_run, trajectory, p)
        evaluation = LabelEvaluation()
        for one, label in zip(sweeps, labels, strict=True):
            evaluation.add(one.labels, label.classid >= 100, np.linalg.norm(one.points, axis=1))
        expected = evaluation.result().as_dict()
        for name in ("static_kept", "static_lost", "dynamic_found", "dynamic_missed", "by_range"):
            assert outcome.metrics[name] == expected[name], (outcome.name, name)
    assert outcomes[0].metrics["static_kept"] != outcomes[1].metrics["static_kept"]
    assert outcomes[0].vote_seconds > 0
    with (tmp_path / "out" / "tune.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert [row["trial"] for row in rows] == [trial.name for trial in TRIALS]
    assert rows[1]["dynamics.window"] == "1"
    assert float(rows[1]["sa"]) == pytest.approx(outcomes[1].metrics["sa"])
    assert "| narrow |" in (tmp_path / "out" / "tune.md").read_text()
    assert sorted(file.suffix for file in (tmp_path / "out").iterdir()) == sorted(
        [".json"] * 3 + [".csv", ".md"]
    )


def test_an_interrupted_search_resumes(run, tmp_path, monkeypatch) -> None:
    labels, out = run.parent / "labels", tmp_path / "out"
    whole = tune(run, labels, TRIALS[:2], tmp_path / "whole", threads=1)
    done = []
    original, write = pipeline.run_classify, voting.vote

    def stop_in_the_second(folder, *rest):
        done.append(folder.path.name)
        if len(done) == 2:
            votes = iter(range(3))

            def fail(*arguments, **named):
                if next(votes, None) is None:
                    raise KeyboardInterrupt
                return write(*arguments, **named)

            monkeypatch.setattr(voting, "vote", fail)
        original(folder, *rest)

    monkeypatch.setattr(pipeline, "run_classify", stop_in_the_second)
    with pytest.raises(KeyboardInterrupt):
        tune(run, labels, TRIALS[:2], out, threads=1)
    voted: list[int] = []
    monkeypatch.setattr(
        voting, "vote", lambda *a, **named: (voted.append(1), write(*a, **named))[1]
    )
    counted: list[int] = []
    monkeypatch.setattr(
        pipeline, "run_classify", lambda f, *r: (counted.append(1), original(f, *r))
    )
    again = tune(run, labels, TRIALS[:2], out, threads=1)
    assert len(counted) == 1
    # The last of the three may still have been on its way to the disk.
    assert FRAMES - 3 <= len(voted) <= FRAMES - 2
    assert [o.metrics for o in again] == [o.metrics for o in whole]
    # Another value under the same name is another trial.
    tune(run, labels, [Trial("narrow", {"dynamics.window": 3})], out, threads=1)
    assert len(counted) == 2


@pytest.mark.slow
def test_parallel_processes_give_the_same_results(run, tmp_path) -> None:
    labels, told = run.parent / "labels", []
    alone = tune(run, labels, TRIALS, tmp_path / "alone", threads=1)
    beside = tune(
        run, labels, TRIALS, tmp_path / "beside", 2, 1, lambda done, total: told.append(done)
    )
    assert [o.metrics for o in alone] == [o.metrics for o in beside]
    assert told == [0, 1, 2, 3]


def test_grids_and_files(tmp_path) -> None:
    axes = parse_axes(["dynamics.tolerance=0.1,0.2", "dynamics.window=5"])
    trials = grid(axes)
    assert [trial.name for trial in trials] == ["tolerance=0.1,window=5", "tolerance=0.2,window=5"]
    assert trials[1].settings == {"dynamics.tolerance": 0.2, "dynamics.window": 5}
    file = tmp_path / "trials.yaml"
    file.write_text("a: {dynamics.window: 3}\nb:\n")
    assert read_trials(file) == [Trial("a", {"dynamics.window": 3}), Trial("b", {})]
    file.write_text("- 1\n")
    with pytest.raises(ConfigError, match="NAME"):
        read_trials(file)


@pytest.mark.parametrize(
    ("trial", "message"),
    [
        (Trial("a", {"dynamics.windows": 3}), "windows"),
        (Trial("a", {"render.step": 1.0}), "not a parameter of the classification"),
        (Trial("a/b", {}), "cannot name"),
        (Trial("..", {}), "cannot name"),
    ],
)
def test_impossible_trials_are_refused(run, tmp_path, trial, message) -> None:
    with pytest.raises(ConfigError, match=message):
        tune(run, run.parent / "labels", [trial], tmp_path)


def test_two_trials_of_one_name_are_refused(run, tmp_path) -> None:
    with pytest.raises(ConfigError, match="unique"):
        tune(run, run.parent / "labels", [TRIALS[0], TRIALS[0]], tmp_path)


def test_settings_replace_those_of_the_run_by_old_names_too() -> None:
    base = parameters("paper", {"dynamics.window": 3, "render.step": 1.0})
    assert parameters_of(base, Trial("a", {})) == base
    found = parameters_of(base, Trial("b", {"dynamics.tolerance": 0.5}))
    assert (found.dynamics.window, found.dynamics.tolerance, found.render.step) == (3, 0.5, 1.0)
    old = parameters_of(base, Trial("c", {"dynamics.against": "surface"}))
    assert (old.dynamics.vote_model, old.dynamics.window) == ("surface", 3)
    assert parameters_of(base, Trial("d", {"preset": "default"})) == parameters()


def test_plots_are_drawn(tmp_path) -> None:
    pytest.importorskip("matplotlib")
    metrics = {"sa": 99.0, "da": 90.0, "precision": 0.8, "iou": None, "sweeps": 5}
    trials = grid({"dynamics.window": [1, 3]})
    for some in (trials, TRIALS):
        outcomes = [Outcome(t.name, t.settings, metrics, {"vote": 1.0}) for t in some]
        plot(outcomes, tmp_path / "tune.png")
        assert (tmp_path / "tune.png").read_bytes()[:4] == b"\x89PNG"
        (tmp_path / "tune.png").unlink()


def test_on_the_command_line(run: Path, tmp_path: Path) -> None:
    def cli(*arguments: object):
        given = [str(a) for a in ("tune", run, "--labels", run.parent / "labels", *arguments)]
        return CliRunner().invoke(app, ["-v", *given])

    out = tmp_path / "out"
    result = cli("-o", out, "--vary", "dynamics.tolerance=0.1,0.2", "--vary", "dynamics.window=5")
    assert result.exit_code == 0, result.output
    assert "tolerance=0.1,window=5" in result.output
    assert len((out / "tune.csv").read_text().splitlines()) == 3
    assert isinstance(cli("-o", out).exception, ConfigError)
    trials = Path(__file__).parents[2] / "benchmarks" / "ablation.yaml"
    assert len(read_trials(trials)) == 4
