"""``docdepth convert``: poses and labels for other tools, read back by what reads them."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from command_line import cli
from docdepth.datasets import open_dataset
from docdepth.errors import DocDepthError
from docdepth.evaluation.runs import evaluate_depth
from docdepth.geometry.se3 import inverse
from docdepth.io.depth import maps_in, read_depth
from docdepth.io.labels import read_classes
from docdepth.io.pcd import read_pcd, write_pcd
from docdepth.io.poses import read_poses, read_timed_poses, write_kitti
from docdepth.io.run_folder import RunFolder
from motion import straight
from small_drive import SWEEPS, write_small_drive

POSES = straight(SWEEPS, 0.5).poses


@pytest.fixture(scope="module")
def root(tmp_path_factory) -> Path:
    """A drive with KITTI's poses and SemanticKITTI's labels, and a run of it."""
    folder = tmp_path_factory.mktemp("convert")
    drive = write_small_drive(folder / "drive")
    T = open_dataset(drive).cameras["image_2"].T_camera_lidar
    far = POSES.copy()
    far[:, :2, 3] += (4e5, 5e6)  # as coordinates of a country
    write_kitti(drive / "poses.txt", T @ far @ inverse(T))
    (drive / "labels").mkdir()
    for k in range(SWEEPS):
        count = (drive / "velodyne" / f"{k:06d}.bin").stat().st_size // 16
        kinds = np.array([252, 40, 50], "<u4")[np.arange(count) % 3]
        (drive / "labels" / f"{k:06d}.label").write_bytes((kinds | 7 << 16).tobytes())
    assert cli("run", drive, "-o", folder / "run", "--poses", "dataset").exit_code == 0
    return folder


def convert(*arguments: object) -> None:
    ended = cli("convert", *arguments)
    assert ended.exit_code == 0, ended.exception


def test_poses_of_a_run(root, tmp_path):
    run = RunFolder.open(root / "run").trajectory()
    for to in ("tum", "kitti", "ply", "npy"):
        file = tmp_path / f"poses.{to}"
        convert(root / "run", file, "--to", to)
        times, poses = read_timed_poses(file)
        np.testing.assert_allclose(poses, run.poses, atol=1e-6 if to == "kitti" else 1e-8)
        if to in ("tum", "ply"):
            np.testing.assert_array_equal(times, run.times)
        else:
            assert times is None
    assert (read_poses(tmp_path / "poses.npy") == run.poses).all()


def test_poses_of_a_recording_and_of_a_camera(root, tmp_path):
    drive = open_dataset(root / "drive")
    convert(root / "drive", tmp_path / "lidar.npy", "--to", "npy")
    np.testing.assert_array_equal(read_poses(tmp_path / "lidar.npy"), drive.poses)
    for source in ("drive", "run"):
        file = tmp_path / f"{source}.txt"
        convert(root / source, file, "--to", "kitti", "--camera", "image_2")
        np.testing.assert_allclose(
            read_poses(file), read_poses(root / "drive" / "poses.txt"), atol=1e-5
        )
    # Back again: the camera's poses are the LiDAR's once the camera is named.
    check = cli("run", root / "drive", "--dry-run", "--poses", f"image_2:{tmp_path / 'run.txt'}")
    assert check.exit_code == 0


def test_a_file_of_poses(root, tmp_path):
    convert(root / "run", tmp_path / "a.ply", "--to", "ply")
    convert(tmp_path / "a.ply", tmp_path / "b.txt", "--to", "tum")
    convert(tmp_path / "b.txt", tmp_path / "c.txt", "--to", "kitti")
    np.testing.assert_allclose(
        read_poses(tmp_path / "c.txt"), RunFolder.open(root / "run").trajectory().poses, atol=1e-5
    )


def test_labels_of_a_run_keep_classes_and_instances(root, tmp_path):
    run = RunFolder.open(root / "run")
    convert(root / "run", tmp_path / "label", "--to", "label")
    convert(root / "run", tmp_path / "classid", "--to", "classid")
    instances = 0
    for k in range(SWEEPS):
        frame = run.frame(k)
        name, ours = f"{k:06d}.label", root / "run" / "labels"
        assert (tmp_path / "label" / name).read_bytes() == (ours / name).read_bytes()
        rows, _ = read_classes(tmp_path / "classid" / f"{k:06d}.npy", frame.input_points, k)
        np.testing.assert_array_equal(rows[frame.index], frame.classid)
        instances += np.count_nonzero(frame.instance)
    assert instances, "the box is a track"


def test_labels_of_a_recording(root, tmp_path):
    convert(root / "drive", tmp_path / "classid", "--to", "classid")
    convert(root / "drive", tmp_path / "label", "--to", "label")
    points = open_dataset(root / "drive").sweep(1).points
    given = np.array([100, 0, 50])[np.arange(len(points)) % 3]
    near = np.linalg.norm(points, axis=1) < 0.5
    np.testing.assert_array_equal(
        np.load(tmp_path / "classid" / "000001.npy"), np.where(near, 50, given)
    )
    labels = np.fromfile(tmp_path / "label" / "000001.label", "<u4")
    expected = np.where(near, 1, np.where(given == 100, 251, 9) | 7 << 16)
    np.testing.assert_array_equal(labels, expected)


def test_pcd_opens_as_dynamic_map_benchmark(root, tmp_path):
    """Points and poses from the first pose on: 5000 km away, a float32 holds half metres."""
    for source in ("run", "drive"):
        convert(root / source, tmp_path / source, "--to", "pcd")
        found = open_dataset(tmp_path / source, "dynamic_map")
        assert found.poses is not None
        np.testing.assert_allclose(found.poses, inverse(POSES[0]) @ POSES, atol=1e-6)
        for k in range(SWEEPS):
            sweep = found.sweep(k)
            frame = RunFolder.open(root / "run").frame(k)
            np.testing.assert_allclose(sweep.points, frame.points, atol=1e-4)
            moves = frame.classid >= 100 if source == "run" else frame.index % 3 == 0
            np.testing.assert_array_equal(found.labels(k) == 251, moves)


def test_pcd_round_trip(tmp_path):
    points = np.random.default_rng(0).normal(size=(5, 3)).astype(np.float32)
    viewpoint = np.array([1.5, -2, 0.123456789, 1, 0, 0, 0])
    write_pcd(tmp_path / "a.pcd", points, np.arange(5, dtype=np.float32), viewpoint)
    rows, header = read_pcd(tmp_path / "a.pcd")
    np.testing.assert_array_equal(np.stack([rows[a] for a in "xyz"], 1), points)
    np.testing.assert_array_equal(rows["intensity"], np.arange(5))
    np.testing.assert_array_equal(header.viewpoint, viewpoint)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("kitti.txt", "out", "--to", "tum"), "kitti.txt has no times, which tum needs"),
        (("kitti.txt", "out", "--to", "label"), "is a file; labels are those of a run"),
        (("kitti.txt", "out", "--to", "npy", "--camera", "image_2"), "does not tell where image_2"),
        (("plain", "out", "--to", "tum"), "plain has no poses of its own; estimate them by"),
        (("plain", "out", "--to", "label"), "plain has no labels of its own"),
        (("plain", "out", "--to", "pcd"), "plain has no poses of its own, which PCD files keep"),
        (("drive", "kitti.txt", "--to", "tum"), "kitti.txt is there; name another"),
        (("drive", "plain", "--to", "label"), "plain is there; name another"),
        (("drive", "out", "--to", "kitti", "--camera", "front"), "no camera 'front'; it has image"),
        (("drive", "out", "--to", "label", "--camera", "image_2"), "`camera` is for poses"),
        (("none", "out", "--to", "tum"), "none is not there"),
        (("unclassified", "out", "--to", "classid"), "classify of .* is missing"),
    ],
)
def test_what_cannot_be_converted(root, tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "drive").symlink_to(root / "drive")
    write_kitti(tmp_path / "kitti.txt", POSES)
    if "plain" in arguments:
        write_small_drive(tmp_path / "plain")
    if "unclassified" in arguments:
        from docdepth.config import Parameters
        from docdepth.pipeline import run_odometry

        run = RunFolder.create(tmp_path / "unclassified", None, Parameters())
        run_odometry(run, open_dataset(root / "drive"), POSES)
    ended = cli("convert", *arguments)
    assert ended.exit_code == 2
    assert isinstance(ended.exception, DocDepthError)
    assert not (tmp_path / "out").exists()
    with pytest.raises(DocDepthError, match=message):
        raise ended.exception


def test_an_unknown_format_is_refused(root, tmp_path):
    ended = cli("convert", root / "run", tmp_path / "out", "--to", "g2o")
    assert ended.exit_code == 2


def test_depth_of_a_run_in_the_layout_of_kittis_release(root, tmp_path):
    """Read back by OpenCV, and by docdepth as a drive of KITTI's depth completion."""
    run, release = RunFolder.open(root / "run"), tmp_path / "release"
    ended = cli("convert", root / "run", release, "--to", "proj_depth")
    assert ended.exit_code == 0, ended.output
    camera = release / "drive" / "proj_depth" / "groundtruth" / "image_2"
    maps = maps_in(root / "run" / "depth")
    assert [file.stem for file in sorted(camera.iterdir())] == sorted(maps)
    assert f"{len(maps)} depth maps" in ended.output
    for name, path in maps.items():
        steps = cv2.imread(str(camera / f"{name}.png"), cv2.IMREAD_UNCHANGED)
        assert steps.dtype == np.uint16
        np.testing.assert_array_equal(steps / 256.0, np.nan_to_num(read_depth(path)))
    assert evaluate_depth(run.path, release / "drive").all.mae == 0
    again = cli("convert", root / "run", release, "--to", "proj_depth")
    assert "is there" in str(again.exception)
    options = ("--to", "proj_depth", "--camera", "image_2")
    ended = cli("convert", root / "run", tmp_path / "other", *options)
    assert "holds the depth of every camera" in str(ended.exception)
