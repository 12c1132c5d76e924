"""Run folder files: written whole, read back the same, damaged ones named."""

import errno
import json
import os
from pathlib import Path

import numpy as np
import pytest

from docdepth.config import parameters
from docdepth.errors import CalibrationError, RunError
from docdepth.geometry.camera import Camera
from docdepth.geometry.lidar_frame import LidarFrame
from docdepth.geometry.se3 import poses_from, rotation_exp
from docdepth.geometry.trajectory import Trajectory
from docdepth.io.atomic import write_atomically, write_output
from docdepth.io.calibration import read_calibration, read_camera_calibration, write_calibration
from docdepth.io.frames import read_frame, read_trajectory, write_frame, write_trajectory
from docdepth.io.inputs import RunInputs
from docdepth.io.run_folder import RunFolder, stage_key


@pytest.mark.parametrize("name", ["sweep with a space", os.fsdecode(b"stra\xc3\x9fe \xff ")])
def test_frame_is_read_back_the_same(tmp_path, name):
    rng = np.random.default_rng(1)
    frame = LidarFrame(
        points=rng.normal(size=(100, 3)).astype(np.float32),
        index=np.arange(0, 200, 2, dtype=np.uint32),
        name=name,
        input_points=201,
        classid=rng.choice([0, 50, 100], 100).astype(np.uint16),
        votes_static=rng.integers(0, 60, 100, dtype=np.uint16),
        votes_dynamic=rng.integers(0, 60, 100, dtype=np.uint16),
        time_offset=rng.uniform(-0.05, 0.05, 100).astype(np.float32),
    )
    path = tmp_path / "frames" / "frame_000000.ply"
    write_frame(path, frame)
    back = read_frame(path)
    for column in ("points", "index", "classid", "votes_static", "votes_dynamic", "time_offset"):
        np.testing.assert_array_equal(getattr(back, column), getattr(frame, column))
    assert (back.name, back.input_points) == (name, 201)


def test_poses_that_were_read_are_written_as_they_were(tmp_path):
    rng = np.random.default_rng(5)
    turned = [rotation_exp(v) for v in rng.normal(size=(300, 3)) * [0.05, 0.05, 1.5]]
    # Quarter turns, where components are equal, and half turns, where w is 0.
    axes = np.array(list(np.ndindex(3, 3, 3))) - 1
    turned += [rotation_exp(v * np.pi / n) for v in axes for n in (1, 2)]
    given = poses_from(turned, rng.normal(size=(len(turned), 3)) * 1e3)
    times = np.arange(len(turned)) * 100_000_001
    write_trajectory(tmp_path / "one.ply", Trajectory(times, given), np.arange(len(times)))
    read, indices = read_trajectory(tmp_path / "one.ply")
    np.testing.assert_allclose(read.poses, given, rtol=0, atol=2e-14)
    write_trajectory(tmp_path / "two.ply", read, indices)
    np.testing.assert_array_equal(read_trajectory(tmp_path / "two.ply")[0].poses, read.poses)


def test_a_failed_write_leaves_the_old_file(tmp_path):
    path = tmp_path / "depth.png"
    path.write_bytes(b"whole")

    def full_disk(stream):
        stream.write(b"half")
        raise OSError(28, "No space left on device")

    with pytest.raises(RunError, match=r"depth\.png: No space left on device; make room"):
        write_atomically(path, full_disk)
    assert path.read_bytes() == b"whole"
    assert list(tmp_path.iterdir()) == [path]


def test_a_file_of_another_content_is_kept_though_it_is_as_long(tmp_path):
    path = tmp_path / "calib.json"
    path.write_bytes(b"mine")
    for _ in range(2):  # what docdepth wrote itself is no other content
        write_output(path, lambda stream: stream.write(b"ours"))
        assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == {
            "calib.json": b"ours",
            "calib.json.old": b"mine",
        }


def test_another_run_is_not_overwritten(tmp_path):
    source = RunInputs(recording=tmp_path / "a")
    RunFolder.create(tmp_path / "run", source, parameters()).save()
    RunFolder.create(tmp_path / "run", source, parameters())  # the same one goes on
    posed, other = source.but(poses="dataset"), parameters("default", {"dynamics.tolerance": 0.3})
    RunFolder.create(tmp_path / "posed", posed, parameters()).save()
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "cat.jpg").touch()
    for folder, inputs, values, match in (
        ("run", source.but(recording=tmp_path / "b"), parameters(), "recording is '.*/a', .*/b'"),
        ("run", posed, parameters(), "its poses is not given, not 'dataset'"),
        ("posed", source, parameters(), "its poses is 'dataset', and now it is not given"),
        ("run", source, other, r"its dynamics\.tolerance is 0\.2, not 0\.3"),
        ("photos", source, parameters(), "holds no run"),
    ):
        with pytest.raises(RunError, match=match):
            RunFolder.create(tmp_path / folder, inputs, values)


def test_a_run_that_another_command_starts_is_no_foreign_folder(tmp_path, monkeypatch):
    """Its first file is listed before it has a record, or the record comes in between."""
    path = tmp_path / "run"
    (path / ".docdepth/records").mkdir(parents=True)
    (path / ".run.yaml.part").touch()
    RunFolder.create(path, None, parameters())
    (path / ".run.yaml.part").rename(path / "run.yaml")
    with pytest.raises(RunError, match="holds no run"):
        RunFolder.create(path, None, parameters())
    listed = Path.iterdir

    def recorded_meanwhile(folder):
        files = list(listed(folder))
        (path / ".docdepth/records/run.jsonl").touch()
        return iter(files)

    monkeypatch.setattr(Path, "iterdir", recorded_meanwhile)
    RunFolder.create(path, None, parameters())


def test_calibration_round_trip_and_missing(tmp_path):
    run = RunFolder.create(tmp_path / "run", None, parameters())
    with pytest.raises(CalibrationError, match=r"calib\.json is missing"):
        run.calibration()
    camera = Camera(np.array([[721.5, 0, 609.6], [0, 721.5, 172.9], [0, 0, 1]]), 1242, 375)
    pose = poses_from([rotation_exp([0.01, 1.5, 0.3])], [[0.1, 0.2, 0.3]])[0]
    distortion = (-0.3, 0.1, 0, 0.01)
    write_calibration(run.calibration_folder("image_03"), camera, pose, distortion)
    with pytest.raises(CalibrationError, match=r"calib\.json is missing"):
        run.calibration()
    assert run.calibration("image_03")[2] == [-0.3, 0.1, 0, 0.01]
    write_calibration(run.calibration_folder(), camera, pose)
    back, T_camera_lidar, distortion = run.calibration()
    assert not any(distortion)
    np.testing.assert_array_equal(back.K, camera.K)
    np.testing.assert_array_equal(T_camera_lidar, pose)
    assert (back.width, back.height) == (1242, 375)


@pytest.mark.parametrize(
    "K", [[[50, 0, 31], [0, 51, 24], [0, 9, 1]], [[-5, 0, 31], [0, 5, 24], [0, 0, 1]]]
)
def test_a_camera_that_is_none_is_named_by_its_file(tmp_path, K):
    (tmp_path / "calib.json").write_text(json.dumps({"mtx": K, "size": [64, 48]}))
    (tmp_path / "calib_lidar_ref_cam.txt").write_text("1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n")
    for read in (
        lambda: read_calibration(tmp_path, ""),
        lambda: read_camera_calibration(tmp_path / "calib.json"),
    ):
        with pytest.raises(CalibrationError, match=r"calib.json.* K must be"):
            read()


def test_stage_key_depends_on_every_value():
    assert stage_key({"a": 1.0}, [2]) == stage_key({"a": 1.0}, [2])
    assert stage_key({"a": 1.0}, [2]) != stage_key({"a": 1.0}, [3])


def test_what_docdepth_wrote_is_replaced_and_what_others_changed_is_kept(tmp_path):
    file = tmp_path / "a.csv"
    write_output(file, b"first")
    try:
        os.getxattr(file, "user.docdepth")
    except (OSError, AttributeError):
        pytest.skip("files have no attributes here")
    write_output(file, b"second")
    assert [p.name for p in tmp_path.iterdir()] == ["a.csv"]
    file.write_bytes(b"mine")
    write_output(file, b"third")
    assert (tmp_path / "a.csv.old").read_bytes() == b"mine"
    assert file.read_bytes() == b"third"


def test_file_systems_that_cannot_sync(tmp_path, monkeypatch):
    def fsync(descriptor):
        raise OSError(errno.EINVAL, os.strerror(errno.EINVAL))

    monkeypatch.setattr(os, "fsync", fsync)
    write_atomically(tmp_path / "a", b"content")
    assert (tmp_path / "a").read_bytes() == b"content"
