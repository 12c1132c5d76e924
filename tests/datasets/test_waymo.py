"""Waymo's range images, poses of pixels, shutters and stamps, by the format's definition."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import waymo_files as files
from conformance import check
from made_up import DISTORTION, DRIVE, K
from waymo_files import SEGMENT, T_VEHICLE_LIDAR, T_VEHICLE_REAR, T_VEHICLE_TOP

from docdepth.datasets import open_dataset, usable_points
from docdepth.errors import DatasetError
from docdepth.geometry.se3 import inverse, poses_from, rotation_exp

pytest.importorskip("pyarrow")

HEIGHT, WIDTH = 8, 600


def random_images(seed: int, height: int = HEIGHT) -> list[np.ndarray]:
    rng = np.random.default_rng(seed)
    images = rng.uniform(2, 60, (DRIVE.count, height, WIDTH, 4)).astype(np.float32)
    images[..., 0][rng.random(images.shape[:3]) < 0.2] = 0
    return list(images)


def write(root: Path, moving: np.ndarray | None = None, clockwise: bool = True) -> Path:
    """TOP and REAR; ``moving`` are poses of the vehicle, which it changes within a sweep."""
    poses = files.vehicle_poses() if moving is None else moving
    files.write_lidar(root, {5: random_images(5, 4), 1: random_images(1)})
    files.write_calibration(root, {5: T_VEHICLE_REAR, 1: T_VEHICLE_TOP})
    files.write_poses(root, poses)
    files.write_images(root, poses, shutter=0.02)
    pixels = [column_poses(T, clockwise) for T in poses]
    files.write_pixel_poses(root, [np.stack([files.pixel_poses(T, 1, 1)[0, 0] for T in sweep])
                                   [None].repeat(HEIGHT, axis=0) for sweep in pixels])  # fmt: skip
    return root / SEGMENT


def column_poses(T: np.ndarray, clockwise: bool = True) -> np.ndarray:
    """Poses of the vehicle at each column: 8 m/s ahead and 0.4 rad/s, the frame's in the middle."""
    seconds = 0.1 * ((np.arange(WIDTH) + 0.5) / WIDTH - 0.5) * (1 if clockwise else -1)
    turns = rotation_exp(np.outer(seconds, [0, 0, 0.4]))
    return T @ poses_from(list(turns), np.outer(seconds, [8.0, 0, 0]))


def by_hand(k: int, number: int, poses: np.ndarray, clockwise: bool = True) -> list[np.ndarray]:
    """Returns of a LiDAR in the LiDAR frame, pixel by pixel."""
    image = random_images(number, 8 if number == 1 else 4)[k]
    T = {1: T_VEHICLE_TOP, 5: T_VEHICLE_REAR}[number]
    columns = column_poses(poses[k], clockwise)
    points = []
    for row in range(image.shape[0]):
        for column in range(WIDTH):
            r = float(image[row, column, 0])
            if r <= 0:
                continue
            up = files.INCLINATIONS[7 - row] if number == 1 else 0.5 - 2.0 * (row + 0.5) / 4
            about = np.pi - 2 * np.pi * (column + 0.5) / WIDTH - np.arctan2(T[1, 0], T[0, 0])
            p = [r * np.cos(up) * np.cos(about), r * np.cos(up) * np.sin(about), r * np.sin(up)]
            p = T @ [*p, 1]
            if number == 1:
                p = inverse(poses[k]) @ columns[column] @ p
            points.append((inverse(T_VEHICLE_LIDAR) @ p)[:3])
    return points


def test_points_are_where_the_definition_puts_them(tmp_path):
    dataset = open_dataset(write(tmp_path))
    check(dataset, "waymo")
    assert list(dataset.lidars) == ["TOP", "REAR"]
    sweep = dataset.sweep(2)
    assert sweep.motion_compensated
    kept = usable_points(sweep.points)
    expected = [p for number in (1, 5) for p in by_hand(2, number, files.vehicle_poses())]
    np.testing.assert_allclose(sweep.points[kept], expected, atol=2e-5)
    top = random_images(1)[2]
    np.testing.assert_array_equal(sweep.intensity[: top[..., 0].size], top[..., 1].ravel())
    late = sweep.relative_time[: top[..., 0].size].reshape(HEIGHT, WIDTH)
    np.testing.assert_allclose(late[3], (np.arange(WIDTH) + 0.5) / WIDTH - 0.5, atol=1e-5)
    np.testing.assert_array_equal(late, late[:1].repeat(HEIGHT, axis=0))
    np.testing.assert_array_equal(dataset.times, files.microseconds(DRIVE.times))
    np.testing.assert_allclose(dataset.poses, DRIVE.poses, atol=1e-9)


@pytest.mark.parametrize("clockwise", [True, False])
def test_the_vehicle_tells_which_column_came_first(tmp_path, clockwise):
    ahead = np.repeat(np.eye(4)[None], DRIVE.count, axis=0)
    ahead[:, 0, 3] = 0.8 * np.arange(DRIVE.count)
    dataset = open_dataset(write(tmp_path, ahead, clockwise))
    sweep = dataset.sweep(1)
    late = sweep.relative_time[: HEIGHT * WIDTH].reshape(HEIGHT, WIDTH)[0]
    assert (np.diff(late) > 0).all() if clockwise else (np.diff(late) < 0).all()
    kept = usable_points(sweep.points)
    expected = [p for number in (1, 5) for p in by_hand(1, number, ahead, clockwise)]
    np.testing.assert_allclose(sweep.points[kept], expected, atol=2e-5)


def test_without_poses_of_pixels_sweeps_are_raw(tmp_path):
    path = write(tmp_path)
    (tmp_path / "lidar_pose" / f"{SEGMENT}.parquet").unlink()
    sweep = open_dataset(path).sweep(0)
    assert not sweep.motion_compensated
    assert sweep.relative_time is not None


def test_cameras(tmp_path):
    """The middle of the exposure, K of pixels with their centres at integers, optical axes."""
    (stream,) = open_dataset(write(tmp_path)).cameras.values()
    assert stream.name == "FRONT"
    np.testing.assert_allclose(stream.times, DRIVE.image_times, rtol=0, atol=2000)
    np.testing.assert_array_equal(stream.camera.K, K)
    np.testing.assert_array_equal(stream.distortion, DISTORTION)
    np.testing.assert_allclose(stream.T_camera_lidar, DRIVE.T_camera_lidar, atol=1e-9)


def test_without_images_cameras_fire_with_the_sweeps(tmp_path):
    path = write(tmp_path)
    (tmp_path / "camera_image" / f"{SEGMENT}.parquet").unlink()
    dataset = open_dataset(path)
    starts = np.array(files.frame_names()) * 1000
    half = int(np.median(np.diff(starts))) // 2
    np.testing.assert_array_equal(dataset.times, starts + half)
    np.testing.assert_array_equal(dataset.cameras["FRONT"].times, dataset.times)
    check(dataset, "waymo")


def test_images_of_another_pose_do_not_tell_the_time(tmp_path, caplog):
    path = write(tmp_path)
    other = files.vehicle_poses()
    other[:, 0, 3] += 1
    files.write_images(tmp_path, other)
    dataset = open_dataset(path)
    assert "no image of FRONT has the pose of its frame" in caplog.text
    starts = np.array(files.frame_names()) * 1000
    np.testing.assert_allclose(dataset.times - starts, 5e7, rtol=0, atol=2e5)


def test_a_pixel_without_a_pose_is_no_return(tmp_path):
    path = write(tmp_path)
    pixels = [files.pixel_poses(T, HEIGHT, WIDTH) for T in files.vehicle_poses()]
    pixels[2][5:] = 0
    files.write_pixel_poses(tmp_path, pixels)
    kept = usable_points(open_dataset(path).sweep(2).points[: HEIGHT * WIDTH])
    seen = random_images(1)[2][..., 0] > 0
    seen[5:] = False
    np.testing.assert_array_equal(kept, seen.ravel())


def test_segments_are_listed(tmp_path):
    write(tmp_path)
    assert open_dataset(tmp_path).name == "waymo"
    file = tmp_path / "lidar" / f"{SEGMENT}.parquet"
    (tmp_path / "lidar" / "other.parquet").write_bytes(file.read_bytes())
    with pytest.raises(DatasetError, match=r"2 segments of Waymo; name one of .*other"):
        open_dataset(tmp_path)
    with pytest.raises(DatasetError, match=r"2 segments of Waymo, but no nothing"):
        open_dataset(tmp_path / "nothing")


def test_damaged_components(tmp_path):
    path = write(tmp_path)
    files.write_calibration(tmp_path, {1: np.diag([2.0, 2, 2, 1]), 5: T_VEHICLE_REAR})
    with pytest.raises(DatasetError, match=r"lidar_calibration.*TOP is no rotation"):
        open_dataset(path)
    files.write_calibration(tmp_path, {5: T_VEHICLE_REAR})
    with pytest.raises(DatasetError, match=r"lidar_calibration.*TOP: the file has no such row"):
        open_dataset(path)
    files.write_calibration(tmp_path, {1: T_VEHICLE_TOP, 5: T_VEHICLE_REAR})
    files.write_poses(tmp_path, np.full((DRIVE.count, 4, 4), np.nan))
    with pytest.raises(DatasetError, match=r"vehicle_pose.*\(frame 0\) has no transform"):
        open_dataset(path)
