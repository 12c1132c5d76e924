"""Poses that do not cover a drive, and what files of long drives may get wrong."""

from __future__ import annotations

import gzip
import pickle
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from conformance import check
from formats import WRITERS
from kitti_drives import R_RECT, numbers
from long_drives import (
    COLUMNS_APART,
    R_RECT_01,
    SEQUENCE,
    T_IMU_CAMERA0,
    date,
    kitti_360_poses,
    rectified,
)
from made_up import DRIVE, K

from docdepth.datasets import open_dataset, usable_points
from docdepth.datasets.pandaset import T_camera_lidar, read_table
from docdepth.datasets.pose_tables import poses_at, poses_of_angles, read_pose_table
from docdepth.errors import CalibrationError, DatasetError, DocDepthError
from docdepth.geometry.se3 import inverse
from docdepth.geometry.trajectory import Trajectory


@pytest.fixture
def kitti_360(tmp_path: Path) -> Path:
    """ROOT of KITTI-360."""
    return WRITERS["KITTI-360"][1](tmp_path).path.parent.parent


# ---- tables of poses


def write(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


def test_rows_of_a_pose_table(tmp_path: Path) -> None:
    text = "GPSTime,x,y\n1326030975726043,1.5,-2\n1326030975726044,nan,0\n1326030975726050, 3,4\n"
    stamps, rows = read_pose_table(write(tmp_path / "poses.csv", text), (2,), "copy it")
    assert stamps.tolist() == [1326030975726043, 1326030975726050]
    np.testing.assert_array_equal(rows, [[1.5, -2], [3, 4]])


def test_rows_that_come_twice_or_late_are_sorted(tmp_path: Path) -> None:
    stamps, rows = read_pose_table(write(tmp_path / "a", "5 1\n3 2\n5 9\n"), (1,), "copy it")
    assert (stamps.tolist(), rows.ravel().tolist()) == ([3, 5], [2, 1])


@pytest.mark.parametrize("line", ["7 1 2 3", "7.5 1 2", "x 1 2", "7 1 y", "NaN 1 2"])
def test_a_line_of_something_else_is_named(tmp_path: Path, line: str) -> None:
    file = write(tmp_path / "poses.csv", f"6 1 2\n{line}\n")
    with pytest.raises(DatasetError, match=r"poses\.csv, line 2: .* 2 more numbers; copy it"):
        read_pose_table(file, (2,), "copy it")


def test_a_table_without_poses(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=r"poses\.csv holds no poses"):
        read_pose_table(write(tmp_path / "poses.csv", "t,x\n1,nan\n"), (1,), "copy it")


def test_angles_turn_about_x_then_y_then_z() -> None:
    angles = np.array([[0.3, -0.2, 2.0]])
    (pose,) = poses_of_angles(np.array([[1.0, 2, 3]]), angles)
    (roll, pitch, yaw), p = angles[0], np.array([0.4, -0.7, 0.9])
    p = np.array([p[0], np.cos(roll) * p[1] - np.sin(roll) * p[2],
                  np.sin(roll) * p[1] + np.cos(roll) * p[2]])  # fmt: skip
    p = np.array([np.cos(pitch) * p[0] + np.sin(pitch) * p[2], p[1],
                  -np.sin(pitch) * p[0] + np.cos(pitch) * p[2]])  # fmt: skip
    p = np.array([np.cos(yaw) * p[0] - np.sin(yaw) * p[1],
                  np.sin(yaw) * p[0] + np.cos(yaw) * p[1], p[2]])  # fmt: skip
    np.testing.assert_allclose(pose[:3, :3] @ [0.4, -0.7, 0.9], p, atol=1e-15)
    np.testing.assert_array_equal(pose[:3, 3], [1, 2, 3])


def _line(*seconds: float, speed: float) -> tuple[np.ndarray, np.ndarray]:
    stamps = np.round(np.array(seconds) * 1e9).astype(np.int64)
    poses = np.repeat(np.eye(4)[None], len(stamps), axis=0)
    poses[:, 0, 3] = speed * np.array(seconds)
    return stamps, poses


def test_poses_at_times_of_sweeps() -> None:
    times = np.array([0, 100_000_000, 150_000_000, 200_000_000, 300_000_000])
    found = poses_at(*_line(0.1, 0.2, speed=10), times, Path("poses.csv"))
    np.testing.assert_allclose(found[:, 0, 3], [np.nan, 1, 1.5, 2, np.nan])


@pytest.mark.parametrize(("speed", "known"), [(0.2, True), (9.0, False)])
def test_a_gap_is_bridged_where_the_vehicle_hardly_moved(speed: float, known: bool) -> None:
    times = np.array([0, 10**9, 2 * 10**9])
    found = poses_at(*_line(0, 2, 2.1, speed=speed), times, Path("poses.csv"))
    assert np.isfinite(found).all(axis=(1, 2)).tolist() == [True, known, True]


def test_poses_of_another_recording_are_refused() -> None:
    with pytest.raises(DatasetError, match=r"poses\.csv has poses from .* recording\?"):
        poses_at(*_line(0, 1, speed=1), np.array([5 * 10**9]), Path("poses.csv"))


# ---- KITTI-360


def test_kitti_360_is_found_from_its_root(kitti_360: Path) -> None:
    assert open_dataset(kitti_360).path == kitti_360 / "data_3d_raw" / SEQUENCE
    (kitti_360 / "data_3d_raw").rename(kitti_360 / "sweeps")
    assert open_dataset(kitti_360 / "sweeps" / SEQUENCE).name == "kitti_360"


def test_kitti_360_from_within_its_folder(kitti_360: Path, monkeypatch) -> None:
    monkeypatch.chdir(kitti_360 / "data_3d_raw")
    there = open_dataset(SEQUENCE)
    assert there.name == "kitti_360"
    assert there.poses is not None
    assert len(there.cameras["image_00"].images) == DRIVE.images_count


def test_times_of_kitti_360s_points_are_those_of_kittis(kitti_360: Path) -> None:
    sweep = open_dataset(kitti_360).sweep(1)
    assert sweep.relative_time is not None
    assert not sweep.motion_compensated
    ahead, left = np.array([[5.0, 0, 0]]), np.array([[0.0, 5, 0]])
    for point, late in ((ahead, 0.0), (left, -0.25)):  # it turns clockwise, ahead at its stamp
        with (kitti_360 / "data_3d_raw" / SEQUENCE / "velodyne_points/data/0000000001.bin").open(
            "wb"
        ) as file:
            np.column_stack([point, [[0]]]).astype("<f4").tofile(file)
        np.testing.assert_allclose(open_dataset(kitti_360).sweep(1).relative_time, [late])


def test_a_frame_without_a_pose_is_interpolated(kitti_360: Path) -> None:
    kitti_360_poses(kitti_360 / "data_poses" / SEQUENCE, [0, 1, 3, 4])
    poses = open_dataset(kitti_360).poses
    assert poses is not None
    others = [0, 1, 3, 4]
    np.testing.assert_allclose(poses[others], DRIVE.poses[others], atol=1e-9)
    between = Trajectory(DRIVE.times[others], DRIVE.poses[others]).interpolate(DRIVE.times[2:3])
    np.testing.assert_allclose(poses[2], between[0], atol=1e-9)
    np.testing.assert_allclose(poses[2], DRIVE.poses[2], atol=2e-3)


def test_frames_before_the_first_pose_have_none(kitti_360: Path, caplog) -> None:
    kitti_360_poses(kitti_360 / "data_poses" / SEQUENCE, [1, 2, 4])
    assert open_dataset(kitti_360).poses is None
    assert "1 of 5 sweeps have no pose" in caplog.text
    assert "--frames 1:5 has poses" in caplog.text
    assert open_dataset(kitti_360, frames="0:3").poses is None
    part = open_dataset(kitti_360, frames="1:5").poses
    assert part is not None
    np.testing.assert_allclose(part[[0, 1, 3]], DRIVE.poses[[1, 2, 4]], atol=1e-9)


def test_poses_of_the_camera_are_those_of_the_imu(kitti_360: Path) -> None:
    folder = kitti_360 / "data_poses" / SEQUENCE
    poses = open_dataset(kitti_360).poses
    (folder / "poses.txt").unlink()
    np.testing.assert_allclose(open_dataset(kitti_360).poses, poses, atol=1e-9)
    (folder / "cam0_to_world.txt").unlink()
    assert open_dataset(kitti_360).poses is None


def test_poses_of_another_sequence(kitti_360: Path) -> None:
    file = kitti_360 / "data_poses" / SEQUENCE / "poses.txt"
    file.write_text(f"77 {numbers(np.eye(4)[:3])}\n")
    with pytest.raises(DatasetError, match=r"poses\.txt has no pose of a sweep"):
        open_dataset(kitti_360)


def test_the_right_camera_of_kitti_360(kitti_360: Path) -> None:
    file = kitti_360 / "calibration" / "perspective.txt"
    P = np.hstack([K, [[-20.0], [0], [0]]])
    file.write_text(
        file.read_text()
        + f"S_rect_01: 64 48\nR_rect_01: {numbers(R_RECT_01)}\nP_rect_01: {numbers(P)}\n"
    )
    cameras = open_dataset(kitti_360).cameras
    assert list(cameras) == ["image_00", "image_01"]
    from_left = inverse(cameras["image_00"].T_camera_lidar)
    shift = np.eye(4)
    shift[:3, 3] = -0.6, -0.01, 0.02
    expected = rectified(R_RECT_01) @ shift @ inverse(rectified(R_RECT))
    np.testing.assert_allclose(cameras["image_01"].T_camera_lidar @ from_left, expected, atol=1e-9)
    assert cameras["image_01"].images == []
    np.testing.assert_array_equal(cameras["image_01"].times, DRIVE.times)


MEI = """%YAML:1.0
---
model_type: MEI
camera_name: image_02
image_width: 140
image_height: 120
mirror_parameters:
   xi: 2.2134
distortion_parameters:
   k1: 1.6798e-02
   k2: 1.6548e+00
   p1: 4.2223e-03
   p2: -8.2462e-03
projection_parameters:
   gamma1: 133.63
   gamma2: 132.9
   u0: 71.3
   v0: 60.25
"""


def write_fisheye(root: Path) -> np.ndarray:
    """Camera 02, which looks ahead here, and images whose colours tell their pixels."""
    (root / "calibration" / "image_02.yaml").write_text(MEI)
    T_camera = T_IMU_CAMERA0 @ inverse(rectified(R_RECT))  # as the rectified camera 00
    file = root / "calibration" / "calib_cam_to_pose.txt"
    lines = [line for line in file.read_text().splitlines() if not line.startswith("image_02")]
    file.write_text("\n".join([*lines, f"image_02: {numbers(T_camera[:3])}"]) + "\n")
    v, u = np.mgrid[:120, :140]
    image = np.stack([u, v, u + v - 2], axis=-1).clip(0, 255).astype(np.uint8)
    folder = root / "data_2d_raw" / SEQUENCE / "image_02"
    (folder / "data_rgb").mkdir(parents=True)
    for k in range(2):
        cv2.imwrite(str(folder / "data_rgb" / f"{k:010d}.png"), image)
    (folder / "timestamps.txt").write_text("".join(date(t) for t in DRIVE.image_times[:2]))
    return image


def test_fisheyes_of_kitti_360_are_rectified(kitti_360: Path) -> None:
    image = write_fisheye(kitti_360)
    dataset = open_dataset(kitti_360)
    check(dataset, "kitti_360")
    assert list(dataset.cameras) == ["image_00", "fisheye_02"]
    stream = dataset.cameras["fisheye_02"]
    left = dataset.cameras["image_00"].T_camera_lidar
    np.testing.assert_allclose(stream.T_camera_lidar, left, atol=1e-9)
    found, K = stream.rectified_image(1), stream.camera.K
    assert found is not None
    assert np.degrees(2 * np.arctan(70 / K[0, 0])) > 115
    for x, y in [(0.0, 0.0), (1.4, 0.3), (-1.1, -1.3), (0.2, 1.2), (-1.5, 0.7)]:
        norm = np.sqrt(x * x + y * y + 1)  # the data set's own arithmetic, point by point
        mx, my = x / norm / (1 / norm + 2.2134), y / norm / (1 / norm + 2.2134)
        r2 = mx**2 + my**2
        radial = 1 + 1.6798e-2 * r2 + 1.6548 * r2**2
        p1, p2 = 4.2223e-3, -8.2462e-3
        px = 133.63 * (mx * radial + 2 * p1 * mx * my + p2 * (r2 + 2 * mx**2)) + 71.3
        py = 132.9 * (my * radial + p1 * (r2 + 2 * my**2) + 2 * p2 * mx * my) + 60.25
        u, v = K[0, 0] * x + K[0, 2], K[1, 1] * y + K[1, 2]
        seen = cv2.remap(found, np.float32([[u]]), np.float32([[v]]), cv2.INTER_LINEAR)[0, 0]
        np.testing.assert_allclose(seen[:2], [px, py], atol=1.3)
    assert not np.array_equal(found, image)


def test_an_image_of_a_fisheye_of_another_size(kitti_360: Path) -> None:
    write_fisheye(kitti_360)
    stream = open_dataset(kitti_360).cameras["fisheye_02"]
    cv2.imwrite(str(stream.images[1].file), np.zeros((30, 20, 3), np.uint8))
    with pytest.raises(DatasetError, match=r"0000000001\.png is 20x30 pixels, its calibration"):
        stream.rectified_image(1)


@pytest.mark.parametrize(
    "text",
    [MEI.replace("xi", "pi"), MEI.replace("140", "w"), MEI.replace("71.3", "x"), "nothing", ""]
    + ["%YAML:1.0\n{{[", "%YAML:1.0\n- 1\n"],
)
def test_a_broken_calibration_of_a_fisheye(kitti_360: Path, text: str) -> None:
    write_fisheye(kitti_360)
    (kitti_360 / "calibration" / "image_02.yaml").write_text(text)
    with pytest.raises(CalibrationError, match=r"image_02\.yaml (has no number|is no YAML)"):
        open_dataset(kitti_360)


@pytest.mark.parametrize(
    ("name", "text", "error"),
    [
        ("calib_cam_to_velo.txt", "1 2 3", "calib_cam_to_velo.txt must be 16 numbers"),
        ("calib_cam_to_velo.txt", "a b c", "calib_cam_to_velo.txt must be 16 numbers"),
        ("calib_cam_to_velo.txt", None, "calib_cam_to_velo.txt is missing; unpack"),
        ("calib_cam_to_pose.txt", "image_01: 1 2", "has no line 'image_00:'"),
        ("perspective.txt", "P_rect_02: 1", "perspective.txt has no camera"),
        ("perspective.txt", None, "perspective.txt is missing; unpack"),
    ],
)
def test_a_broken_calibration_of_kitti_360(
    kitti_360: Path, name: str, text: str | None, error: str
) -> None:
    file = kitti_360 / "calibration" / name
    file.unlink()
    if text is not None:
        file.write_text(text)
    with pytest.raises(CalibrationError, match=error):
        open_dataset(kitti_360 / "data_3d_raw" / SEQUENCE)


def test_a_copy_among_sweeps_of_kitti_360_is_named(kitti_360: Path) -> None:
    data = kitti_360 / "data_3d_raw" / SEQUENCE / "velodyne_points" / "data"
    (data / "0000000004.bin").rename(data / "0000000003 (1).bin")
    with pytest.raises(DatasetError, match=r"0000000003 \(1\).bin: the name is no number"):
        open_dataset(kitti_360)


def test_a_sweep_of_kitti_360_without_a_stamp(kitti_360: Path) -> None:
    file = kitti_360 / "data_3d_raw" / SEQUENCE / "velodyne_points" / "timestamps.txt"
    file.write_text("".join(file.read_text().splitlines(keepends=True)[:3]))
    with pytest.raises(DocDepthError, match=r"timestamps\.txt has 3 stamps for 5 files"):
        open_dataset(kitti_360)


# ---- folders of sweeps that are named by their stamps

STAMPED = ["MulRan", "NCLT", "HeLiPR, Ouster", "Boreas"]


@pytest.mark.parametrize("what", STAMPED)
def test_a_name_that_is_no_stamp(tmp_path: Path, what: str) -> None:
    dataset = open_dataset(WRITERS[what][1](tmp_path).path)
    (file,) = dataset.sweep_files(1)
    file.rename(file.with_name("sweep.bin"))
    with pytest.raises(DatasetError, match=r"sweep\.bin: the name is no number; names of sweeps"):
        open_dataset(dataset.path)


@pytest.mark.parametrize("what", STAMPED)
def test_a_sweep_that_has_gone_is_named(tmp_path: Path, what: str) -> None:
    dataset = open_dataset(WRITERS[what][1](tmp_path).path)
    (file,) = dataset.sweep_files(1)
    file.unlink()
    with pytest.raises(DatasetError, match=rf"{file.name} \(frame 1\) is missing; copy"):
        dataset.sweep(1)


@pytest.mark.parametrize("what", STAMPED)
def test_without_poses(tmp_path: Path, what: str) -> None:
    path = WRITERS[what][1](tmp_path).path
    names = ("global_pose.csv", "groundtruth_*.csv", "global_*_gt.txt", "lidar_poses.csv")
    (table,) = (file for name in names for file in tmp_path.rglob(name))
    table.unlink()
    assert open_dataset(path).poses is None


@pytest.mark.parametrize("what", STAMPED)
def test_poses_of_another_day(tmp_path: Path, what: str) -> None:
    path = WRITERS[what][1](tmp_path).path
    names = ("global_pose.csv", "groundtruth_*.csv", "global_*_gt.txt", "lidar_poses.csv")
    (table,) = (file for name in names for file in tmp_path.rglob(name))
    table.write_text(table.read_text().replace("17000", "17100"))
    with pytest.raises(DatasetError, match=rf"{table.name} has poses from .* recording\?"):
        open_dataset(path)


def test_times_of_mulrans_columns(tmp_path: Path) -> None:
    dataset = open_dataset(WRITERS["MulRan"][1](tmp_path).path)
    sweep = dataset.sweep(1)
    usable = usable_points(sweep.points)
    columns = COLUMNS_APART * np.arange(usable.sum())
    assert sweep.relative_time is not None
    expected = columns * 97656 / DRIVE.period  # ns of a column
    np.testing.assert_allclose(sweep.relative_time[usable], expected, atol=1e-6)
    assert not sweep.motion_compensated


def test_a_sweep_of_mulran_that_lacks_rows_has_no_times(tmp_path: Path, caplog) -> None:
    dataset = open_dataset(WRITERS["MulRan"][1](tmp_path).path)
    (file,) = dataset.sweep_files(1)
    file.write_bytes(file.read_bytes()[:-16])
    sweep = open_dataset(dataset.path).sweep(1)
    assert sweep.relative_time is None
    assert sweep.ring is None
    assert f"{file}, and 0 more of 5 sweeps: not 64 x 1024 rows" in caplog.text
    np.testing.assert_array_equal(
        sweep.points[usable_points(sweep.points)], DRIVE.points(1)[DRIVE.usable(1)]
    )


def test_rays_of_nclt_begin_at_the_lidar(tmp_path: Path) -> None:
    """A hit where the LiDAR sits is at the origin; one a metre below it is a metre down."""
    dataset = open_dataset(WRITERS["NCLT"][1](tmp_path).path)
    (file,) = dataset.sweep_files(0)
    body = np.array([[0.0, -0.005, -0.955], [2, -0.005, -0.955], [0, 3, -0.955], [0, 0, 0.045]])
    rows = np.zeros(4, "<u2, <u2, <u2, u1, u1")
    for k in range(3):
        rows[f"f{k}"] = np.round((body[:, k] + 100) / 0.005)
    rows.tofile(file)
    expected = [[0, 0, 0], [2, 0, 0], [0, -3, 0], [0, 0, -1]]
    np.testing.assert_allclose(dataset.sweep(0).points, expected, atol=0.0071)
    assert dataset.sweep(0).motion_compensated


@pytest.mark.parametrize("name", ["Ouster", "Avia"])
def test_times_of_heliprs_points_count_from_the_stamp(tmp_path: Path, name: str) -> None:
    dataset = open_dataset(WRITERS[f"HeLiPR, {name}"][1](tmp_path).path)
    sweep = dataset.sweep(1)
    usable = DRIVE.usable(1)
    assert sweep.relative_time is not None
    expected = DRIVE.rows(1)["share"][usable] + 0.5
    np.testing.assert_allclose(sweep.relative_time[usable], expected, atol=1e-6)


def test_early_sessions_of_aeva_have_shorter_rows(tmp_path: Path) -> None:
    path = WRITERS["HeLiPR, Aeva"][1](tmp_path).path
    for file in path.glob("*.bin"):
        rows = np.fromfile(file, np.dtype("V29"))
        early = 1_690_000_000_000_000_000 + int(file.stem) - DRIVE.times[0]
        short = np.frombuffer(rows.tobytes(), np.uint8).reshape(-1, 29)[:, :25]
        (path / f"{early}.bin").write_bytes(np.ascontiguousarray(short).tobytes())
        file.unlink()
    for table in (path.parent.parent / "LiDAR_GT").iterdir():
        table.unlink()
    sweep = open_dataset(path).sweep(2)
    np.testing.assert_array_equal(sweep.points, DRIVE.points(2))
    np.testing.assert_array_equal(sweep.intensity, DRIVE.rows(2)["intensity"])


def test_a_sequence_of_helipr_names_its_lidars(tmp_path: Path) -> None:
    path = WRITERS["HeLiPR, Ouster"][1](tmp_path).path
    assert open_dataset(tmp_path).path == path
    WRITERS["HeLiPR, Avia"][1](tmp_path / "more")
    (tmp_path / "more" / "KAIST05" / "LiDAR" / "Avia").rename(path.parent / "Avia")
    with pytest.raises(DatasetError, match=r"holds 2 recordings; name one of .*Avia, .*Ouster"):
        open_dataset(tmp_path / "KAIST05")


def test_a_camera_of_boreas_without_images_fires_with_the_sweeps(tmp_path: Path) -> None:
    path = WRITERS["Boreas"][1](tmp_path).path
    for image in (path / "camera").iterdir():
        image.unlink()
    stream = open_dataset(path, image_size=(64, 48)).cameras["camera"]
    assert stream.names == open_dataset(path, image_size=(64, 48)).lidars["lidar"].names
    assert (stream.camera.width, stream.camera.height) == (64, 48)
    assert open_dataset(path).cameras["camera"].camera.width == 2448


@pytest.mark.parametrize(
    ("name", "text", "error"),
    [
        ("P_camera.txt", "1 2 3", "must be a matrix of 3 x 4"),
        ("P_camera.txt", "a b", "is no matrix of numbers"),
        ("T_camera_lidar.txt", "1 0 0 0", "must be 16 numbers"),
        ("T_camera_lidar.txt", None, "is missing; download calib"),
    ],
)
def test_a_broken_calibration_of_boreas(
    tmp_path: Path, name: str, text: str | None, error: str
) -> None:
    path = WRITERS["Boreas"][1](tmp_path).path
    file = path / "calib" / name
    file.unlink()
    if text is not None:
        file.write_text(text)
    with pytest.raises(CalibrationError, match=f"{name} {error}"):
        open_dataset(path)


@pytest.mark.parametrize("what", ["MulRan", "NCLT", "HeLiPR, Ouster"])
def test_a_camera_of_the_users(tmp_path: Path, what: str) -> None:
    path = WRITERS[what][1](tmp_path).path
    assert open_dataset(path).cameras == {}
    camera = {
        "K": K.ravel().tolist(),
        "T_camera_lidar": DRIVE.T_camera_lidar.tolist(),
        "times": "sweeps",
    }
    (path / "docdepth.yaml").write_text(yaml.safe_dump({"cameras": {"front": camera}}))
    (stream,) = open_dataset(path, image_size=(64, 48)).cameras.values()
    np.testing.assert_array_equal(stream.camera.K, K)
    np.testing.assert_allclose(stream.times, DRIVE.times, atol=1000)
    with pytest.raises(CalibrationError, match=r"docdepth\.yaml, front has neither images"):
        open_dataset(path)


# ---- PandaSet


@pytest.fixture
def pandaset(tmp_path: Path) -> Path:
    return WRITERS["PandaSet"][1](tmp_path).path


@pytest.mark.parametrize(
    ("name", "looks", "to_its_right"),
    [
        ("front_camera", [1, 0, 0], [0, -1, 0]),
        ("back_camera", [-1, 0, 0], [0, 1, 0]),
        ("left_camera", [0, 1, 0], [1, 0, 0]),
        ("right_camera", [0, -1, 0], [-1, 0, 0]),
        ("front_left_camera", [0.7, 0.7, 0], [0.7, -0.7, 0]),
        ("front_right_camera", [0.7, -0.7, 0], [-0.7, -0.7, 0]),
    ],
)
def test_cameras_of_pandaset_look_where_they_are_called(name, looks, to_its_right) -> None:
    T = T_camera_lidar(name)
    assert T[2, :3] @ looks > 0.94
    assert T[0, :3] @ to_its_right > 0.94
    centre = inverse(T)[:3, 3]
    assert np.linalg.norm(centre) < 1.1
    assert -0.4 < centre[2] < 0, "below the LiDAR on the roof"
    assert centre @ looks > 0, "on the side to which it looks"


def test_points_of_pandasets_front_lidar_are_left_out(pandaset: Path) -> None:
    sweep = open_dataset(pandaset).sweep(3)
    assert len(sweep.points) == DRIVE.usable(3).sum()
    assert sweep.motion_compensated
    assert sweep.relative_time is not None
    shares = DRIVE.rows(3)["share"][DRIVE.usable(3)]
    np.testing.assert_allclose(sweep.relative_time, shares, atol=1e-5)  # 0.2 µs in doubles


def test_pandas_reads_the_table_that_the_test_writes(pandaset: Path) -> None:
    pandas = pytest.importorskip("pandas")
    table = pandas.read_pickle(pandaset / "lidar" / "03.pkl.gz")
    assert list(table.columns) == ["x", "y", "z", "i", "t", "d"]
    assert table.index.name == "index"
    own = read_table(pandaset / "lidar" / "03.pkl.gz", "")
    for name in table.columns:
        np.testing.assert_array_equal(own[name], table[name])


def test_a_pickle_that_would_run_a_program(pandaset: Path, tmp_path: Path) -> None:
    class Program:
        def __reduce__(self):
            return Path.touch, (tmp_path / "ran",)

    (pandaset / "lidar" / "01.pkl.gz").write_bytes(gzip.compress(pickle.dumps(Program())))
    with pytest.raises(DatasetError, match=r"01\.pkl\.gz \(frame 1\) .*it asks for .*no table"):
        open_dataset(pandaset).sweep(1)
    assert not (tmp_path / "ran").exists()


@pytest.mark.parametrize("content", [b"", b"nothing", gzip.compress(pickle.dumps([1, 2]))])
def test_a_sweep_of_pandaset_that_is_no_table(pandaset: Path, content: bytes) -> None:
    (pandaset / "lidar" / "01.pkl.gz").write_bytes(content)
    with pytest.raises(DatasetError, match=r"01\.pkl\.gz \(frame 1\) .*table of pandas"):
        open_dataset(pandaset).sweep(1)


@pytest.mark.parametrize(
    ("name", "content", "error"),
    [
        ("poses.json", "[]", "poses.json has 0 entries for 5 sweeps"),
        ("poses.json", "[1, 2, 3, 4, 5]", "poses.json, entry 0 is no pose"),
        ("timestamps.json", "[1, 2, 3, 3, 4]", "timestamps.json: the time of frame 3"),
        ("timestamps.json", '[1, 2, 3, 3.5, "x"]', "timestamps.json must be seconds"),
        ("intrinsics.json", "{}", "intrinsics.json has no fx"),
    ],
)
def test_a_broken_table_of_pandaset(pandaset: Path, name: str, content: str, error: str) -> None:
    (pandaset / "camera" / "front_camera" / name).write_text(content)
    with pytest.raises(DocDepthError, match=error):
        open_dataset(pandaset)
