"""KITTI's recordings: what is left out, sizes of images, several LiDARs, real drives."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from formats import WRITERS
from kitti_drives import S_RECT, date, numbers, write_velodyne
from made_up import DRIVE, SIZE

from docdepth.datasets import open_dataset, usable_points
from docdepth.errors import CalibrationError, DatasetError
from docdepth.io.poses import read_poses


@pytest.fixture
def raw(tmp_path: Path) -> Path:
    return WRITERS["kitti_raw"][1](tmp_path).path


@pytest.fixture
def sequence(tmp_path: Path) -> Path:
    return WRITERS["kitti_odometry"][1](tmp_path).path


def test_raw_point_times_run_clockwise_from_behind() -> None:
    from docdepth.datasets.kitti_lidar import azimuth_relative_time

    # Behind to the left it starts; then left, forward at the stamp, right, and behind again.
    points = np.array([[-1, 1e-6, 0], [0, 1, 0], [1, 0, 0], [0, -1, 0], [-1, -1e-6, 0]], "f4")
    relative_time = azimuth_relative_time(points)
    assert relative_time.dtype == np.float32
    np.testing.assert_allclose(relative_time, [-0.5, -0.25, 0, 0.25, 0.5], atol=1e-6)


@pytest.mark.parametrize("every", [2, 4])
def test_a_sweep_lasts_as_long_as_before_where_others_are_left_out(raw: Path, every: int) -> None:
    def seconds() -> np.ndarray:
        recording = open_dataset(raw, image_size=SIZE)
        relative_time = recording.sweep(0).relative_time
        assert relative_time is not None
        return relative_time * np.median(np.diff(recording.times)) * 1e-9

    before, stamps = seconds(), raw / "velodyne_points" / "timestamps.txt"
    sweeps = sorted((raw / "velodyne_points" / "data").iterdir())
    stamps.write_text("".join(stamps.read_text().splitlines(keepends=True)[::every]))
    for k, file in enumerate(sweeps):
        file.unlink() if k % every else file.rename(file.with_name(f"{k // every:010d}.bin"))
    np.testing.assert_allclose(seconds(), before, atol=2e-3)


def test_a_missing_sweep_keeps_the_others_at_their_times(raw: Path) -> None:
    (raw / "velodyne_points" / "data" / "0000000001.bin").unlink()
    np.testing.assert_array_equal(open_dataset(raw).times, DRIVE.times[[0, 2, 3, 4]])


def test_a_blank_line_stands_for_a_lost_sweep_or_for_nothing(raw: Path) -> None:
    """As kitti2bag's users have them (kitti2bag#4)."""
    file = raw / "velodyne_points" / "timestamps.txt"
    lines = file.read_text().splitlines()
    file.write_text("\n\n".join(lines) + "\n\n\n")
    np.testing.assert_array_equal(open_dataset(raw, image_size=SIZE).times, DRIVE.times)
    sweep = sorted((raw / "velodyne_points" / "data").iterdir())[1]
    sweep.unlink()
    lines[1] = ""
    file.write_text("\n".join(lines) + "\n")
    kept = np.delete(DRIVE.times, 1)
    np.testing.assert_array_equal(open_dataset(raw, image_size=SIZE).times, kept)


def test_times_of_points_of_a_sequence(sequence: Path) -> None:
    """Raw sweeps need a file; of compensated ones it tells when moving objects were measured."""
    file = sequence / "point_times" / "000001.bin"
    content = file.read_bytes()
    file.write_bytes(content[4:])
    with pytest.raises(DatasetError, match=r"000001\.bin \(frame 1\).*401 points"):
        open_dataset(sequence).sweep(1)
    file.unlink()
    with pytest.raises(DatasetError, match=r"000001\.bin \(frame 1\) is missing"):
        open_dataset(sequence).sweep(1)
    (sequence / "docdepth.yaml").write_text("motion_compensated: true\nsensor: hdl64\n")
    dataset = open_dataset(sequence)
    assert dataset.sweep(0).motion_compensated
    np.testing.assert_array_equal(dataset.sweep(0).relative_time, DRIVE.rows(0)["share"])
    assert dataset.sweep(1).relative_time is None
    (sequence / "docdepth.yaml").write_text("motion_compensate: false\n")
    with pytest.raises(DatasetError, match="motion_compensate is unknown"):
        open_dataset(sequence)


def test_image_sizes_of_a_sequence(sequence: Path, caplog: pytest.LogCaptureFixture) -> None:
    with pytest.raises(CalibrationError, match=r"64 x 48 .*1000 x 300"):
        open_dataset(sequence, image_size=(1000, 300))
    for image in (sequence / "image_2").glob("*.png"):
        image.unlink()
    camera = open_dataset(sequence, image_size=(65, 47)).cameras["image_2"].camera
    assert (camera.width, camera.height) == (65, 47)
    assert not caplog.records
    camera = open_dataset(sequence).cameras["image_2"].camera
    assert (camera.width, camera.height) == (63, 48)  # twice the principal point
    assert "guessed" in caplog.text
    (sequence / "image_2" / "size.txt").write_text("70 50")
    camera = open_dataset(sequence).cameras["image_2"].camera
    assert (camera.width, camera.height) == (70, 50)


def test_image_size_that_does_not_fit(raw: Path) -> None:
    file = raw.parent / "calib_cam_to_cam.txt"
    with pytest.raises(CalibrationError, match="64 x 48 but the image size asked for is 640"):
        open_dataset(raw, image_size=(640, 480))
    for image in (raw / "image_02" / "data").iterdir():
        image.unlink()
    file.write_text(file.read_text().replace(S_RECT, ""))
    with pytest.raises(CalibrationError, match="by `image_size`"):
        open_dataset(raw)
    with pytest.raises(CalibrationError, match=r"principal point .* outside the 20 x 20"):
        open_dataset(raw, image_size=(20, 20))
    stream = open_dataset(raw, image_size=SIZE).cameras["image_02"]
    assert stream.camera.width == SIZE[0]
    np.testing.assert_array_equal(stream.times, DRIVE.image_times)


@pytest.mark.parametrize(
    ("number", "stamped_ms", "triggered_ms"),
    [("02", 10.5, 4), ("00", 16.7, 4), ("02", 16.7, 16.7), ("02", 0, 0), ("02", 37, 37)],
)
def test_one_trigger_exposes_the_cameras_of_kitti(
    raw: Path, number: str, stamped_ms: float, triggered_ms: float
) -> None:
    """Stamps of KITTI's own are late, by what the kind of camera tells; others hold."""
    file = raw.parent / "calib_cam_to_cam.txt"
    file.write_text(file.read_text().replace("_02:", f"_{number}:"))
    images = (raw / "image_02").rename(raw / f"image_{number}")
    times = DRIVE.times + round(1e6 * stamped_ms)
    for image in (images / "data").iterdir():
        image.unlink()
    (images / "timestamps.txt").write_text("".join(map(date, times)))
    stream = open_dataset(raw, image_size=SIZE).cameras[images.name]
    np.testing.assert_array_equal(stream.times, DRIVE.times + round(1e6 * triggered_ms))


def test_usable_points() -> None:
    points = np.array([[5, 0, 0], [np.nan, 0, 0], [np.inf, 1, 1], [0, 0, 0], [3e38, 0, 0]])
    assert usable_points(points.astype("f4")).tolist() == [True, False, False, False, False]


def test_two_lidars_of_a_sequence(sequence: Path) -> None:
    """Points of the first come first, the others' in its frame; times are of all of them."""
    write_velodyne(sequence / "velodyne_2", 6)
    T = np.eye(4)[:3] @ DRIVE.T_camera_lidar
    with (sequence / "calib.txt").open("a") as calibration:
        calibration.write(f"Tr_2: {numbers(T)}\n")
    (sequence / "docdepth.yaml").write_text("motion_compensated: true\n")
    times = sequence / "point_times" / "000002.bin"
    times.write_bytes(2 * times.read_bytes())
    (sequence / "point_times" / "000001.bin").unlink()
    dataset = open_dataset(sequence)
    folders = [sequence / name for name in ("velodyne", "velodyne_2", "point_times")]
    assert dataset.sweep_files(2) == [folder / "000002.bin" for folder in folders]
    assert dataset.sweep_files(1) == [folder / "000001.bin" for folder in folders[:2]]
    sweep, own = dataset.sweep(2), DRIVE.points(2)
    np.testing.assert_array_equal(sweep.points[: len(own)], own)
    place = dataset.lidars["velodyne_2"].T_lidar_sensor
    moved = own.astype("f8") @ place[:3, :3].T + place[:3, 3]
    np.testing.assert_allclose(sweep.points[len(own) :], moved, atol=1e-6)
    np.testing.assert_array_equal(sweep.sensor_rig.index, np.repeat([0, 1], len(own)))
    np.testing.assert_array_equal(sweep.relative_time, np.tile(DRIVE.rows(2)["share"], 2))


def test_a_lidar_of_another_name_is_asked_for(tmp_path: Path) -> None:
    scene = WRITERS["nuScenes"][1](tmp_path).path
    for table in tmp_path.rglob("sensor.json"):
        named = table.read_text().replace(': "LIDAR_TOP"', ': "LIDAR_FRONT"')
        table.write_text(named)
    with pytest.raises(DatasetError, match=r"no LIDAR_TOP, but LIDAR_FRONT, CAM_FRONT; say lidar"):
        open_dataset(scene)
    (tmp_path / "docdepth.yaml").write_text("lidar: LIDAR_FRONT\n")
    dataset = open_dataset(scene)
    assert list(dataset.lidars) == ["LIDAR_FRONT"]
    np.testing.assert_allclose(dataset.poses, DRIVE.poses, atol=1e-6)


def test_folders_without_a_recording(raw: Path, tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="not there"):
        open_dataset(tmp_path / "nowhere")
    (tmp_path / "empty").mkdir()
    with pytest.raises(DatasetError, match=r"that docdepth reads \(kitti_raw, .*say by `dataset`"):
        open_dataset(tmp_path / "empty")
    with pytest.raises(DatasetError, match="unknown dataset 'lyft'; there are kitti_raw"):
        open_dataset(raw, "lyft")
    with pytest.raises(DatasetError, match=r"no recording of semantic_kitti .a sequence"):
        open_dataset(raw, "semantic-kitti")


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
