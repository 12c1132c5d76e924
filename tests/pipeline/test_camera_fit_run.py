"""A run whose images ask for another camera."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import docdepth
from command_line import cli
from docdepth.datasets import open_dataset
from docdepth.diagnostics import calibration
from docdepth.diagnostics.calibration import RunEdges
from docdepth.diagnostics.depth_edges import edges_of_map
from docdepth.diagnostics.edge_fit import EdgeFit
from docdepth.errors import NOTE
from docdepth.evaluation import camera_error
from docdepth.geometry.se3 import rotation_exp
from docdepth.io.depth import read_depth
from docdepth.io.run_folder import RunFolder
from docdepth.pipeline import camera_fit
from docdepth.pipeline.camera_fit import CameraFit
from docdepth.pipeline.plan import states

CHANGE = np.array([0, np.radians(0.5), 0, 0, 0, 0, 6e-3])


def asks(gain: float) -> CameraFit:
    fit = EdgeFit(CHANGE, np.eye(7) * 1e-9, np.zeros(2), 1.6, np.zeros(12), np.zeros(2))
    return CameraFit(fit, 0.5, 0.05, gain)


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[CameraFit]:
    """What is found, one after the other; an empty list where nothing may be looked for."""
    found: list[CameraFit] = []
    monkeypatch.setattr(camera_fit, "_fit", lambda *_: found.pop(0))
    return found


def test_a_run_draws_with_what_the_images_ask_for(drive, tmp_path, asked, caplog) -> None:
    asked.append(asks(4))
    with caplog.at_level(NOTE, logger="docdepth"):
        docdepth.run(drive, tmp_path / "run", poses="dataset", camera_fit="apply")
    run = RunFolder.open(tmp_path / "run")
    (name,) = run.cameras
    given = open_dataset(drive).cameras[name]
    text = "fit when the camera turns 0.5 degrees to the left and images are taken 6.0 ms later"
    assert text in caplog.text
    assert text in (run.path / "report" / "index.html").read_text()
    stored = run.cameras[name].fit
    assert stored is not None
    assert stored.applied
    T = np.eye(4)
    T[:3, :3] = rotation_exp(CHANGE[:3])
    np.testing.assert_allclose(run.calibration()[1], T @ given.T_camera_lidar, atol=1e-9)
    assert {state.state for state in states(run)} == {"done"}
    # What was found holds: nothing is looked for, or drawn, again.
    maps = {file: file.stat().st_mtime_ns for file in (run.path / "depth").glob("*.png")}
    assert cli("run", run.path).exit_code == 0
    assert {file: file.stat().st_mtime_ns for file in maps} == maps


@pytest.mark.parametrize(("mode", "gain"), [("report", 4.0), ("apply", 1.0), ("off", 4.0)])
def test_or_as_it_was_given(drive, tmp_path: Path, asked, mode: str, gain: float) -> None:
    asked.append(asks(gain))
    ended = cli("run", drive, "-o", tmp_path / "run", "--poses", "dataset", "--camera-fit", mode)
    assert ended.exit_code == 0, ended.output
    assert len(asked) == (mode == "off")
    run = RunFolder.open(tmp_path / "run")
    (name,) = run.cameras
    given = open_dataset(drive).cameras[name]
    np.testing.assert_array_equal(run.calibration()[1], given.T_camera_lidar)
    stored = run.cameras[name].fit
    assert (stored is not None and bool(stored.verdict)) == (mode == "report")


def test_calibrate_writes_the_camera_that_images_ask_for(
    drive, finished, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("_FEWEST_IMAGES", "_FEWEST_EDGES"):
        monkeypatch.setattr(calibration, name, 3)
    for gain, wanted in ((1.0, {".jpg"}), (4.0, {".jpg", ".json", ".txt", ".yaml"})):
        monkeypatch.setattr(camera_error, "fit_camera", lambda *_, gain=gain: asks(gain))
        ended = cli("calibrate", finished[0], "-o", tmp_path / "fitted")
        assert ended.exit_code == 0, ended.output
        assert {file.suffix for file in (tmp_path / "fitted").iterdir()} == wanted
    file = tmp_path / "fitted" / "calib.json"
    assert f"docdepth run RECORDING --calibration {file}" in ended.output
    again = cli("run", drive, "-o", tmp_path / "run", "--calibration", file, "--frames", "0:3")
    assert again.exit_code == 0, again.output
    given, T = RunFolder.open(finished[0]).calibration()[1], np.eye(4)
    T[:3, :3] = rotation_exp(CHANGE[:3])
    used = RunFolder.open(tmp_path / "run").calibration()[1]
    np.testing.assert_allclose(used, T @ given, atol=1e-9)


def test_the_maps_that_were_drawn_are_looked_at(drive, tmp_path: Path, monkeypatch) -> None:
    """The fit gets the edges of the run's own maps, of images from places apart."""
    seen: list[tuple[RunEdges, float]] = []
    monkeypatch.setattr(camera_fit, "fit_camera", lambda *given: seen.append(given))
    docdepth.run(drive, tmp_path / "run", poses="dataset")
    ((found, path),) = seen
    assert 2 <= len(found.names) <= 5
    for name, edges in zip(found.names, found.edges, strict=True):
        depth = read_depth(tmp_path / "run" / "depth" / f"{name}.png")
        drawn = edges_of_map(depth, focal=found.stream.camera.K[1, 1])
        assert len(edges)
        assert {tuple(pixel) for pixel in edges.pixels} <= {tuple(pixel) for pixel in drawn.pixels}
    trajectory = RunFolder.open(tmp_path / "run").trajectory()
    times = found.stream.times[np.isin(found.stream.names, found.names)]
    assert path >= np.ptp(trajectory.arc_length_at(times)) > 0
