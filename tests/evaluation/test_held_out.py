"""Depth maps against held-out sweeps, on a small synthetic drive with known depth."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

from docdepth.cli import app
from docdepth.diagnostics.edge_fit import EdgeFit
from docdepth.errors import InputError, RunError
from docdepth.evaluation.held_out import evaluate_held_out
from docdepth.io.run_folder import RunFolder
from docdepth.pipeline.run_inputs import recorded_camera
from true_drive import write_true_drive

LENGTH = 7
LEFT_OUT = 3  # one of them


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    root = tmp_path_factory.mktemp("held_out")
    sequence = write_true_drive(root / "sequences" / "00", LENGTH)
    result = CliRunner().invoke(app, ["run", str(sequence), "-o", str(root / "run")])
    assert result.exit_code == 0, result.output
    return root / "run"


@pytest.fixture
def run(finished, tmp_path):
    shutil.copytree(finished, tmp_path / "run")
    return tmp_path / "run"


def change(run, index, **arrays):
    folder = RunFolder.open(run)
    frame, key = replace(folder.frame(index), **arrays), folder.key(folder.frame_path(index))
    folder.write_frame(index, frame, key)


def test_most_returns_agree_with_the_other_sweeps(finished):
    result = evaluate_held_out(finished, every=7)
    assert result.sweeps == 1
    assert result.all.density > 90
    assert result.all.too_near + result.all.too_far < 6
    assert result.static.pixels + result.dynamic.pixels == result.all.pixels
    assert sum(r.figures.pixels for r in result.by_range) == result.all.pixels


def test_a_held_out_sweep_is_not_drawn(finished, run):
    """Only the held-out sweep is scaled, so that every comparison must fail."""
    before = evaluate_held_out(finished, every=7).all
    points = RunFolder.open(run).points(LEFT_OUT)
    change(run, LEFT_OUT, points=points * np.float32(1.25))
    after = evaluate_held_out(run, every=7, max_range=100).all
    assert before.too_near < 5
    assert after.too_near > 95
    change(run, LEFT_OUT, points=points * np.float32(0.8))
    assert evaluate_held_out(run, every=7).all.too_far > 95


def test_errors_of_the_other_sweeps_are_found(finished, run):
    for index in {*range(7)} - {LEFT_OUT}:
        points = RunFolder.open(run).points(index)
        change(run, index, points=points * np.float32(1.1))
    before, after = (evaluate_held_out(r, every=7).static for r in (finished, run))
    assert before.too_far < 5
    assert after.too_far > 60  # points from sweeps ahead of the camera move less
    assert after.mae > 5 * before.mae


def test_every_sweep_between_the_first_and_the_last(finished):
    result = evaluate_held_out(finished, every=1, max_range=30)
    assert result.sweeps == 5
    assert result.by_range[-1].far == 30


def test_on_the_command_line(finished):
    result = CliRunner().invoke(
        app, ["evaluate", "held-out", str(finished), "--every", "7", "--json"]
    )
    assert result.exit_code == 0, result.output
    printed = json.loads(result.stdout)
    assert printed["sweeps"] == 1
    assert printed["all"]["edge_displacement"] is None
    assert printed["all"]["too_near"] == evaluate_held_out(finished, every=7).all.too_near


def test_what_a_wrong_camera_adds_is_said(finished, monkeypatch):
    """The check of this short drive cannot tell; here it says half a degree."""
    from docdepth.evaluation import camera_error as module

    class Check:
        agrees, verdict = False, "the calibration is off"
        change = np.array([0, np.radians(0.5), 0, 0, 0, 0, 0])
        fit = EdgeFit(change, np.eye(7), np.zeros(2), 1.0, np.zeros(1), np.zeros(2))

    assert module.camera_error(RunFolder.open(finished)) is None
    stream = recorded_camera(RunFolder.open(finished), "")
    edges = SimpleNamespace(enough=True, stream=stream, motions=[np.zeros(6)])
    monkeypatch.setattr(module, "edges_of_run", lambda *_: edges)
    monkeypatch.setattr(module, "compare", lambda _: Check)
    found = module.camera_error(RunFolder.open(finished))
    assert found.mae > 0.05
    assert 1 < found.wrong < 50
    arguments = ["evaluate", "held-out", str(finished), "--every", "7"]
    printed = CliRunner().invoke(app, [*arguments, "--json"])
    camera = json.loads(printed.stdout)["camera"]
    assert camera == pytest.approx({"mae": found.mae, "wrong": found.wrong})
    assert f"{found.wrong:.1f} % of the pixels" in CliRunner().invoke(app, arguments).output


def test_a_lost_map_is_no_reason_to_lose_the_errors(run):
    """Returns are compared without the maps; the camera alone needs them."""
    next(iter((run / "depth").glob("*.png"))).unlink()
    result = CliRunner().invoke(app, ["evaluate", "held-out", str(run), "--every", "7", "--json"])
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["camera"]["mae"] is None


def test_mistakes(finished, run):
    with pytest.raises(InputError, match="each 0-th"):
        evaluate_held_out(finished, every=0)
    RunFolder.open(run).classes_path(LEFT_OUT).unlink()
    with pytest.raises(RunError, match="is missing"):
        evaluate_held_out(run, every=7)
