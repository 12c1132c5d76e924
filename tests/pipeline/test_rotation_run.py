"""Folders of clouds without times of points: a run finds whether sweeps are as measured."""

from __future__ import annotations

import logging
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import yaml

import docdepth
from command_line import cli
from docdepth.geometry.turn import Turn
from docdepth.io.inputs import DerivedInputs, RunInputs
from docdepth.io.run_folder import RunFolder
from docdepth.odometry import skew
from docdepth.odometry.skew import Sharpness, Skew, find_rotation
from docdepth.pipeline.run import continue_run
from docdepth.pipeline.run_inputs import open_inputs
from docdepth.synthetic import Drive, scene, sensor

MEASURED = Skew("measured", Turn(True), Sharpness(90, 0.05), Sharpness(100, 0.07))


@cache
def synthetic(skew: bool) -> list[np.ndarray]:
    """Sweeps of a drive, rows in the order of time."""
    drive = Drive(scene("city"), sensor("VLP-16"), 12, seed=7, skew=skew)
    sweeps = [drive.sweep(k) for k in range(12)]
    return [s.points[np.lexsort((s.ring, s.relative_time))] for s in sweeps]


def write_folder(folder: Path, count: int, skew: bool = True, **said: object) -> None:
    """A synthetic drive as NPY files of x, y and z."""
    (folder / "sweeps").mkdir(parents=True)
    for k, points in enumerate(synthetic(skew)[:count]):
        np.save(folder / "sweeps" / f"{k:06d}.npy", points)
    about = {"sweeps": "sweeps", "rate": 10, "columns": ["x", "y", "z"], **said}
    (folder / "docdepth.yaml").write_text(yaml.safe_dump(about))


def judged(monkeypatch: pytest.MonkeyPatch, state: str) -> None:
    """The sharpness as it would be."""
    found = Skew(state, MEASURED.turn, MEASURED.measured, MEASURED.compensated)
    monkeypatch.setattr(skew, "find_skew", lambda *_, **__: found)


def test_a_run_takes_times_by_rotation_and_keeps_to_them(tmp_path, monkeypatch, caplog) -> None:
    folder, run = tmp_path / "drive", tmp_path / "run"
    write_folder(folder, 3)
    judged(monkeypatch, "measured")
    with caplog.at_level(logging.WARNING):
        assert cli("run", folder, "-o", run, "--camera", "none").exit_code == 0
    assert "sweeps are as measured: with times by rotation (clockwise) points lie" in caplog.text
    assert RunFolder.open(run).manifest.derived.turn == MEASURED.turn
    times = RunFolder.open(run).frame(1).time_offset
    assert times is not None
    assert (times.min(), times.max()) == pytest.approx((-0.05, 0.05), abs=0.003)

    # What was found holds: nothing is judged, or made, again.
    judged(monkeypatch, "compensated")
    before = RunFolder.open(run).trajectory_path.stat().st_mtime_ns
    for again in (lambda: docdepth.run(folder, run, camera="none"), lambda: continue_run(run)):
        again()
        assert RunFolder.open(run).manifest.derived.turn == MEASURED.turn
        assert RunFolder.open(run).trajectory_path.stat().st_mtime_ns == before


@pytest.mark.parametrize(
    ("state", "said"),
    [
        ("compensated", "taken as motion compensated"),
        ("unknown", "it is not clear whether sweeps are as measured"),
    ],
)
def test_other_sweeps_stay_as_they_are(tmp_path, monkeypatch, caplog, state, said) -> None:
    write_folder(tmp_path / "drive", 3)
    judged(monkeypatch, state)
    with caplog.at_level(logging.WARNING):
        opened = open_inputs(RunInputs(recording=tmp_path / "drive", camera="none"))
    assert said in caplog.text
    assert opened.derived.turn is None
    assert opened.recording.sweep(0).relative_time is None


def test_what_docdepth_yaml_says_is_taken(tmp_path, monkeypatch) -> None:
    folder = tmp_path / "drive"
    write_folder(folder, 3, motion_compensated=True)
    judged(monkeypatch, "measured")
    inputs = RunInputs(recording=folder, camera="none")
    assert open_inputs(inputs).derived.turn is None
    assert open_inputs(inputs, DerivedInputs(turn=Turn(True))).derived.turn is None
    found = find_rotation(open_inputs(inputs).recording)[1]
    assert [one.code for one in found] == ["not-compensated"]


def test_the_stamp_that_a_user_says_is_that_of_the_times(tmp_path) -> None:
    folder = tmp_path / "drive"
    write_folder(folder, 12, stamp="end")
    opened = open_inputs(RunInputs(recording=folder, camera="none"))
    assert opened.derived.turn == Turn(True, None, 1.0)
    times = opened.recording.sweep(3).relative_time
    assert (times.min(), times.max()) == pytest.approx((-1, 0), abs=0.03)


@pytest.mark.slow
@pytest.mark.parametrize("skew", [True, False])
def test_inspect_tells_what_a_run_would_take(tmp_path, skew) -> None:
    write_folder(tmp_path / "drive", 12, skew)
    result = cli("inspect", tmp_path / "drive", "-o", tmp_path / "page.html")
    assert ("sweeps are as measured" in result.stderr + result.stdout) == skew
    assert ("taken as motion compensated" in result.stderr + result.stdout) != skew
