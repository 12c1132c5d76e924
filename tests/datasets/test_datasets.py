"""Recordings are read as they are."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from kitti_drives import (
    R_RECT,
    R_VELO,
    T_VELO,
    P,
    numbers,
    some_poses,
    write_image,
    write_sweeps,
)  # fmt: skip

from docdepth.datasets import open_dataset, usable_points
from docdepth.errors import CalibrationError, DatasetError
from docdepth.geometry.se3 import inverse
from docdepth.io.poses import read_poses, write_kitti


def test_raw_point_times_run_clockwise_from_behind() -> None:
    from docdepth.datasets.kitti_lidar import azimuth_relative_time

    # Behind to the left it starts; then left, forward at the stamp, right, and behind again.
    points = np.array([[-1, 1e-6, 0], [0, 1, 0], [1, 0, 0], [0, -1, 0], [-1, -1e-6, 0]], "f4")
    relative_time = azimuth_relative_time(points)
    assert relative_time.dtype == np.float32
    np.testing.assert_allclose(relative_time, [-0.5, -0.25, 0, 0.25, 0.5], atol=1e-6)


def test_raw_camera_uses_the_whole_calibration(raw: Path) -> None:
    stream = open_dataset(raw).cameras["image_02"]
    assert (stream.camera.width, stream.camera.height) == (1242, 375)
    # KITTI's own recipe for a pixel: P_rect R_rect T x, in homogeneous coordinates.
    points = np.random.default_rng(1).uniform([5, -3, -2], [40, 3, 2], (30, 3))
    R4, T4 = np.eye(4), np.eye(4)
    R4[:3, :3], T4[:3, :3], T4[:3, 3] = R_RECT, R_VELO, T_VELO
    pixels = P @ R4 @ T4 @ np.c_[points, np.ones(30)].T
    ours = stream.camera.K @ (stream.T_camera_lidar @ np.c_[points, np.ones(30)].T)[:3]
    np.testing.assert_allclose(ours, pixels, rtol=1e-9)
    np.testing.assert_array_equal(stream.times, open_dataset(raw).times)
    assert stream.names == [f"{k:010d}" for k in range(4)]
    assert stream.images == []


def test_raw_images_bring_their_own_times(raw: Path) -> None:
    for k in range(3):
        write_image(raw / "image_02" / "data" / f"{k:010d}.png")
    stamps = [f"2011-09-26 13:02:25.{k}81199337\n" for k in range(3)]
    (raw / "image_02" / "timestamps.txt").write_text("".join(stamps))
    stream = open_dataset(raw).cameras["image_02"]
    assert [image.name for image in stream.images] == [f"{k:010d}.png" for k in range(3)]
    assert stream.times[1] - stream.times[0] == 10**8
    assert stream.times[0] - open_dataset(raw).times[0] == 3 * 10**7
    (raw / "image_02" / "timestamps.txt").unlink()
    with pytest.raises(DatasetError, match=r"image_02/timestamps\.txt is missing"):
        open_dataset(raw)


def test_a_missing_sweep_keeps_the_others_at_their_times(raw: Path) -> None:
    times = open_dataset(raw).times
    (raw / "velodyne_points" / "data" / "0000000001.bin").unlink()
    np.testing.assert_array_equal(open_dataset(raw).times, times[[0, 2, 3]])


@pytest.mark.parametrize("place", ["poses.txt", "../../poses/07.txt"])
def test_sequence_poses_become_the_lidars(sequence: Path, place: str) -> None:
    lidar = some_poses(4)
    Tr = np.eye(4)
    Tr[:3, :3], Tr[:3, 3] = R_VELO, T_VELO
    (sequence / place).parent.mkdir(exist_ok=True)
    write_kitti(sequence / place, Tr @ lidar @ inverse(Tr))
    np.testing.assert_allclose(open_dataset(sequence).poses, lidar, atol=1e-9)


def test_raw_sequence_with_point_times_and_a_camera_between_sweeps(sequence: Path) -> None:
    (sequence / "docdepth.yaml").write_text("motion_compensated: false\nsensor: hdl64\n")
    with pytest.raises(DatasetError, match=r"point_times/000000\.bin \(frame 0\) is missing"):
        open_dataset(sequence).sweep(0)
    (sequence / "point_times").mkdir()
    relative_time = np.linspace(-0.5, 0.5, 50, dtype="<f4")
    relative_time.tofile(sequence / "point_times" / "000000.bin")
    (sequence / "image_2" / "times.txt").write_text("0.05\n0.15\n")
    dataset = open_dataset(sequence)
    np.testing.assert_array_equal(dataset.sweep(0).relative_time, relative_time)
    assert not dataset.sweep(0).motion_compensated
    assert dataset.cameras["image_2"].times.tolist() == [50_000_000, 150_000_000]
    assert dataset.cameras["image_2"].names == ["000000", "000001"]
    (sequence / "docdepth.yaml").write_text("motion_compensate: false\n")
    with pytest.raises(DatasetError, match="motion_compensate is unknown"):
        open_dataset(sequence)
    (sequence / "docdepth.yaml").write_text("motion_compensated: true\n")
    np.testing.assert_array_equal(open_dataset(sequence).sweep(0).relative_time, relative_time)
    assert open_dataset(sequence).sweep(0).motion_compensated
    assert open_dataset(sequence).sweep(1).relative_time is None
    relative_time[1:].tofile(sequence / "point_times" / "000000.bin")
    with pytest.raises(DatasetError, match=r"000000\.bin \(frame 0\).*50 points"):
        dataset.sweep(0)


def test_image_sizes_of_a_sequence(sequence: Path, caplog: pytest.LogCaptureFixture) -> None:
    (sequence / "image_2" / "size.txt").unlink()
    camera = open_dataset(sequence, image_size=(1241, 376)).cameras["image_2"].camera
    assert (camera.width, camera.height) == (1241, 376)
    assert not caplog.records
    camera = open_dataset(sequence).cameras["image_2"].camera
    assert (camera.width, camera.height) == (1200, 360)
    assert "guessed" in caplog.text
    for k in range(4):
        write_image(sequence / "image_2" / f"{k:06d}.png", 1242, 375)
    caplog.clear()
    for stream in open_dataset(sequence).cameras.values():  # of which one alone has images
        assert (stream.camera.width, stream.camera.height) == (1242, 375)
    assert not caplog.records
    with pytest.raises(CalibrationError, match=r"1242 x 375 .*1000 x 300"):
        open_dataset(sequence, image_size=(1000, 300))


def test_usable_points() -> None:
    points = np.array([[5, 0, 0], [np.nan, 0, 0], [np.inf, 1, 1], [0, 0, 0], [3e38, 0, 0]])
    assert usable_points(points.astype("f4")).tolist() == [True, False, False, False, False]


# ---- the files of a sweep


def test_files_of_a_sweep_of_two_lidars_with_times(sequence: Path) -> None:
    write_sweeps(sequence / "velodyne_2", 4, 6)
    with (sequence / "calib.txt").open("a") as calibration:
        calibration.write(f"Tr_2: {numbers(np.eye(4)[:3])}\n")
    (sequence / "point_times").mkdir()
    np.zeros(104, "<f4").tofile(sequence / "point_times" / "000002.bin")
    folders = [sequence / name for name in ("velodyne", "velodyne_2", "point_times")]
    dataset = open_dataset(sequence)
    assert dataset.sweep_files(2) == [folder / "000002.bin" for folder in folders]
    assert dataset.sweep_files(1) == [folder / "000001.bin" for folder in folders[:2]]


def test_layouts_are_named_with_hyphens_too(sequence: Path) -> None:
    assert open_dataset(sequence, "kitti-odometry").name == "kitti_odometry"


def test_image_size_that_does_not_fit(raw: Path) -> None:
    file = raw.parent / "calib_cam_to_cam.txt"
    text = file.read_text()
    with pytest.raises(CalibrationError, match="1242 x 375 but the image size asked for is 640"):
        open_dataset(raw, image_size=(640, 480))
    file.write_text(text.replace("S_rect_02: 1.242000e+03 3.750000e+02\n", ""))
    with pytest.raises(CalibrationError, match="by `image_size`"):
        open_dataset(raw)
    with pytest.raises(CalibrationError, match=r"principal point .* outside the 400 x 300"):
        open_dataset(raw, image_size=(400, 300))
    assert open_dataset(raw, image_size=(1242, 375)).cameras["image_02"].camera.width == 1242


def test_folders_without_a_recording(raw: Path, tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="not there"):
        open_dataset(tmp_path / "nowhere")
    (tmp_path / "empty").mkdir()
    with pytest.raises(DatasetError, match=r"that docdepth reads \(kitti_raw, .*say by `dataset`"):
        open_dataset(tmp_path / "empty")
    with pytest.raises(DatasetError, match="unknown dataset 'lyft'; there are kitti_raw"):
        open_dataset(raw, "lyft")
    with pytest.raises(DatasetError, match=r"no recording of semantic_kitti .a sequence"):
        open_dataset(raw, "semantic_kitti")


# ---- the real drives


@pytest.mark.skipif("DOCDEPTH_KITTI_RAW" not in os.environ, reason="no KITTI drives")
@pytest.mark.parametrize(("drive", "images"), [("0005", 0), ("9001", 78)])
def test_real_drives(drive: str, images: int) -> None:
    root = Path(os.environ["DOCDEPTH_KITTI_RAW"])
    dataset = open_dataset(root / "2011_09_26" / f"2011_09_26_drive_{drive}_sync")
    stream = dataset.cameras["image_02"]
    assert len(stream.images) == images
    assert len(stream.times) == len(dataset)
    sweep = dataset.sweep(7)
    assert len(sweep.points) > 100_000
    # What lies ahead projects into the image, upright: the road below the horizon.
    points = sweep.points[sweep.points[:, 0] > 5].astype(np.float64)
    seen = (
        stream.camera.K
        @ (points @ stream.T_camera_lidar[:3, :3].T + stream.T_camera_lidar[:3, 3]).T
    )
    u, v = seen[:2] / seen[2]
    inside = (u >= 0) & (u < 1242) & (v >= 0) & (v < 375)
    assert inside.sum() > 10_000
    road = inside & (points[:, 2] < -1.5)
    assert (v[road] > 172).all()
    assert len(read_poses(dataset.path / "lidar_poses_tum.txt", len(dataset))) == len(dataset)
