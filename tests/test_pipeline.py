"""A whole run on a small synthetic drive: files, resume, bad input."""

from __future__ import annotations

import shutil

import cv2
import numpy as np
import pytest
import yaml
from typer.testing import CliRunner

from docdepth import pipeline
from docdepth.cli import app
from docdepth.errors import DatasetError, DocDepthError
from docdepth.io.ply import read_frame
from docdepth.io.run_folder import RunFolder

pytest.importorskip("embreex")

FRAMES = 5


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    from docdepth.synthetic import write_drive

    root = tmp_path_factory.mktemp("drive")
    write_drive(root, scene="city", sensor="VLP-16", frames=FRAMES, seed=1)
    return root / "sequences" / "00"


@pytest.fixture(scope="module")
def finished(drive, tmp_path_factory):
    run = tmp_path_factory.mktemp("finished") / "run"
    result = cli("run", drive, "-o", run)
    assert result.exit_code == 0, result.output
    return run, result.output


def cli(*arguments):
    """Run the command line as main() does."""
    result = CliRunner().invoke(app, [str(a) for a in arguments])
    if isinstance(result.exception, DocDepthError):
        result.exit_code = 2
    elif result.exception and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


def test_outputs_of_a_run(drive, finished):
    run, output = finished
    names = [p.stem for p in sorted((drive / "image_2").glob("*.png"))]
    inside = [p.stem for p in sorted((run / "depth").glob("*.png"))]
    left_out = RunFolder(run).stage("render")["left_out"]
    assert sorted(inside + left_out) == names
    assert inside
    for name in inside:
        depth = cv2.imread(str(run / "depth" / f"{name}.png"), cv2.IMREAD_UNCHANGED)
        assert depth.dtype == np.uint16
        assert depth.shape == (375, 1242)
        assert (depth > 0).mean() > 0.2
        assert (run / "report" / f"{name}.jpg").is_file()
    for sweep in sorted((drive / "velodyne").glob("*.bin")):
        rows = sweep.stat().st_size // 16
        labels = np.fromfile(run / "labels" / f"{sweep.stem}.label", np.uint32)
        assert len(labels) == rows
        assert set(np.unique(labels)) <= {9, 251}
    for name in ("traj_odometry.ply", "traj_camera.ply", "calib.json", "calib_lidar_ref_cam.txt"):
        assert (run / name).is_file()
    assert not list(run.rglob("*.part"))
    if left_out:
        assert f"{len(left_out)} images outside" in output


def test_interrupted_run_goes_on_and_ends_the_same(drive, finished, tmp_path, monkeypatch):
    run = tmp_path / "run"
    written = []

    def stop_after(function, count):
        def wrapped(*arguments):
            written.append(arguments[0])
            if len(written) == count:
                raise KeyboardInterrupt
            return function(*arguments)

        return wrapped

    for name, count in (("_write_classified", 3), ("_write_image", 2)):
        written.clear()
        with monkeypatch.context() as patch:
            patch.setattr(pipeline, name, stop_after(getattr(pipeline, name), count))
            assert cli("run", drive, "-o", run).exit_code != 0
    before = {p: p.stat().st_mtime_ns for p in (run / "labels").iterdir()}
    assert cli("run", drive, "-o", run).exit_code == 0
    assert {p: p.stat().st_mtime_ns for p in (run / "labels").iterdir()} == before
    for folder in ("frames", "labels", "depth"):
        for path in sorted((finished[0] / folder).iterdir()):
            assert path.read_bytes() == (run / folder / path.name).read_bytes(), path.name


def test_one_stage_again_with_another_parameter(finished, tmp_path):
    run = tmp_path / "run"
    shutil.copytree(finished[0], run)
    before = {p.name: p.read_bytes() for p in (run / "depth").iterdir()}
    assert cli("render", run, "--set", "render.ahead=1").exit_code == 0
    after = {p.name: p.read_bytes() for p in (run / "depth").iterdir()}
    assert before.keys() == after.keys()
    assert RunFolder(run).parameters.render.ahead == 1
    result = cli("render", run, "--set", "dynamics.tolerance=1")
    assert result.exit_code == 2
    assert "this stage knows render only" in str(result.exception)


def test_truncated_sweep_keeps_what_was_computed(drive, tmp_path):
    broken = tmp_path / "drive"
    shutil.copytree(drive, broken)
    sweep = broken / "velodyne" / "000003.bin"
    whole = sweep.read_bytes()
    sweep.write_bytes(whole[:-5])
    result = cli("run", broken, "-o", tmp_path / "run")
    assert result.exit_code == 2
    assert "000003.bin" in str(result.exception)
    sweep.write_bytes(whole)
    assert cli("run", broken, "-o", tmp_path / "run").exit_code == 0


def test_unusable_points_are_kept_apart(drive, tmp_path):
    broken = tmp_path / "drive"
    shutil.copytree(drive, broken)
    path = broken / "velodyne" / "000002.bin"
    points = np.fromfile(path, np.float32).reshape(-1, 4)
    points[:50, 0] = np.nan
    points[50:90, 1] = np.inf
    points[90:120, :3] = 0
    points.tofile(path)
    run = tmp_path / "run"
    result = cli("run", broken, "-o", run)
    assert result.exit_code == 0, result.output
    frame = read_frame(run / "frames" / "frame_000002.ply")
    np.testing.assert_array_equal(frame.index, np.arange(120, len(points)))
    assert np.isfinite(frame.points).all()
    assert len(np.fromfile(run / "labels" / "000002.label", np.uint32)) == len(points)


def test_a_sweep_without_usable_points_is_named(drive, tmp_path):
    broken = tmp_path / "drive"
    shutil.copytree(drive, broken)
    np.zeros((1000, 4), np.float32).tofile(broken / "velodyne" / "000002.bin")
    result = cli("run", broken, "-o", tmp_path / "run")
    assert result.exit_code == 2
    assert "000002" in str(result.exception)


def test_folder_with_another_run(drive, finished):
    result = cli("run", drive, "-o", finished[0], "--set", "dynamics.tolerance=0.3")
    assert result.exit_code == 2
    assert "another run" in str(result.exception)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--preset", "best"], "unknown preset"),
        (["--set", "dynamics.tau=1"], "unknown parameter"),
        (["--dataset", "kiti"], "kiti"),
        (["--camera", "image_9"], "image_9"),
        (["--image-size", "100x100"], "asked for is 100 x 100"),
        (["--image-size", "100"], "WIDTHxHEIGHT"),
    ],
)
def test_mistakes_on_the_command_line(drive, tmp_path, arguments, message):
    result = cli("run", drive, "-o", tmp_path / "run", *arguments)
    assert result.exit_code == 2
    assert message in str(result.exception)


def test_no_image_inside_the_sweeps(drive, finished, tmp_path):
    run = tmp_path / "run"
    shutil.copytree(finished[0], run)
    times = tmp_path / "times.txt"
    times.write_text("1000\n2000\n")
    folder = RunFolder(run)
    folder.manifest["source"]["camera_times"] = str(times)
    (run / "run.yaml").write_text(yaml.safe_dump(folder.manifest))
    result = cli("render", run)
    assert result.exit_code == 2
    assert isinstance(result.exception, DatasetError)
