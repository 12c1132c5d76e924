"""The recording for rerun: what it is told is what the run holds."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from command_line import cli
from docdepth.datasets import open_dataset
from docdepth.errors import MissingExtraError, RunError
from docdepth.io.depth import read_depth
from docdepth.io.run_folder import RunFolder
from docdepth.io.tracks import read_tracks
from docdepth.visualization.drive_scene import instance_colors
from docdepth.visualization.pictures import colorize
from docdepth.visualization.rerun_recording import _layout, write_rerun


def test_no_pane_stays_empty_where_a_recording_has_no_images(rerun, finished, drive) -> None:
    run = RunFolder.open(finished[0])
    stream = open_dataset(drive).cameras["image_2"]
    panes = []
    for shown in (stream, None, replace(stream, images=[])):
        root = _layout(rerun, run, shown).root_container.contents[1]
        panes.append([view.name for view in root.contents])
    assert panes == [["image", "depth"], ["depth"], ["depth"]]


@pytest.fixture
def rerun():
    return pytest.importorskip("rerun", reason="rerun is not installed")


def array(batch) -> np.ndarray:
    """The numbers of a component."""
    values = batch.as_arrow_array()
    while hasattr(values, "flatten") and values.type.num_fields:
        values = values.flatten()
    return np.asarray(values)


def test_the_recording_holds_sweeps_tracks_and_depth(
    rerun, finished, drive, tmp_path: Path, monkeypatch
) -> None:
    told: dict[str, list] = {}
    log = rerun.RecordingStream.log

    def spy(self, entity, what, *more, **options):
        told.setdefault(entity, []).append(what)
        log(self, entity, what, *more, **options)

    monkeypatch.setattr(rerun.RecordingStream, "log", spy)
    run = RunFolder.open(finished[0])
    stream = open_dataset(drive).cameras["image_2"]
    path = tmp_path / "run.rrd"
    path.write_text("of somebody")
    write_rerun(run, path, color="instance", stream=stream)
    assert (tmp_path / "run.rrd.old").read_text() == "of somebody"
    trajectory = run.trajectory()
    origin = trajectory.poses[0, :3, 3]
    assert len(told["world/lidar/points"]) == len(trajectory)
    record, _ = run.classified_frame(2)
    points = told["world/lidar/points"][2]
    np.testing.assert_array_equal(array(points.positions).reshape(-1, 3), record.points)
    packed = array(points.colors)
    red = np.rint(255 * instance_colors(record.instance)[:, 0])
    np.testing.assert_array_equal(packed >> 24, red)
    place = array(told["world/lidar"][2].translation).reshape(3)
    np.testing.assert_allclose(place, trajectory.poses[2, :3, 3] - origin, atol=1e-5)
    time = int(trajectory.times[2])
    there = [track for track in read_tracks(run.path / "tracks.csv") if track.covers(time)]
    boxes = told["world/tracks"][2]
    centers, halves = (array(b).reshape(-1, 3) for b in (boxes.centers, boxes.half_sizes))
    turns = array(boxes.quaternions).reshape(-1, 4)
    for track, center, half, turn in zip(there, centers, halves, turns, strict=True):
        T = track.pose_at(time)
        middle = T[:3, :3] @ (0, 0, track.size[2] / 2) + T[:3, 3] - origin
        np.testing.assert_allclose(center, middle, atol=1e-4)
        np.testing.assert_allclose(half, track.size / 2, atol=1e-6)
        x, y, z, w = turn  # the first column of the rotation
        forward = (1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w))
        np.testing.assert_allclose(forward, T[:3, 0], atol=1e-5)
    maps = sorted((run.path / "depth").glob("*.png"))
    assert len(told["world/camera/depth"]) == len(told["world/camera/image"]) == len(maps)
    shown = told["world/camera/depth"][0]
    depth = array(shown.buffer).view(np.uint16) / array(shown.meter)[0]
    np.testing.assert_allclose(depth, np.nan_to_num(read_depth(maps[0])).ravel(), atol=0.002)
    # The picture of depth has the colours of all others.
    assert len(told["depth"]) == len(maps)
    picture = cv2.imdecode(array(told["depth"][0].blob).view(np.uint8), cv2.IMREAD_COLOR)
    assert np.abs(picture.astype(int) - colorize(read_depth(maps[0]))).mean() < 12
    verified = [sys.executable, "-m", "rerun", "rrd", "verify", str(path)]
    assert subprocess.run(verified, capture_output=True, timeout=60).returncode == 0
    assert not list(tmp_path.glob(".*"))


def test_what_rerun_cannot_show_or_write_is_said(finished, tmp_path: Path, monkeypatch) -> None:
    result = cli("view", finished[0], "--rerun", tmp_path / "a.rrd", "--frame", "1")
    assert result.exit_code == 2
    assert "every sweep" in str(result.exception)
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(MissingExtraError, match=r"docdepth\[rerun\]"):
        write_rerun(RunFolder.open(finished[0]), tmp_path / "a.rrd")


def test_a_place_that_cannot_be_written_is_named(rerun, finished, tmp_path: Path) -> None:
    with pytest.raises(RunError, match=r"nowhere/a.rrd cannot be written"):
        write_rerun(RunFolder.open(finished[0]), tmp_path / "nowhere" / "a.rrd")
