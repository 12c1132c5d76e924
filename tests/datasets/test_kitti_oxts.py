"""Poses of KITTI raw from ``oxts``, written by the formula of KITTI's devkit turned round."""

from __future__ import annotations

from math import asin, atan, atan2, degrees, exp, pi
from pathlib import Path

import numpy as np
import pytest
from conformance import check
from kitti_drives import date, numbers
from made_up import DRIVE
from writers import WRITERS

from docdepth.datasets import FrameRange, open_dataset
from docdepth.errors import CalibrationError, DatasetError
from docdepth.geometry.se3 import inverse, poses_from, rotation_exp

T_LIDAR_IMU = poses_from([rotation_exp([0.01, -0.005, 0.02])], [[-0.81, 0.32, -0.8]])[0]
LATITUDE, LONGITUDE = 49.015003823272, 8.4342971002335  # of drive 0005


def write_oxts(drive: Path, stamps: np.ndarray, T_world_imu: np.ndarray) -> None:
    """Packets of poses whose world is east, north, up from the first of them."""
    (drive.parent / "calib_imu_to_velo.txt").write_text(
        f"calib_time: 25-May-2012 16:47:16\nR: {numbers(T_LIDAR_IMU[:3, :3])}\n"
        f"T: {numbers(T_LIDAR_IMU[:3, 3])}\n"
    )
    data = drive / "oxts" / "data"
    data.mkdir(parents=True)
    (data.parent / "timestamps.txt").write_text("".join(map(date, stamps)))
    radius = 6378137
    scale = np.cos(LATITUDE * pi / 180)
    north0 = scale * radius * np.log(np.tan((90 + LATITUDE) * pi / 360))
    for k, T in enumerate(T_world_imu):
        (x, y, z), R = T[:3, 3], T[:3, :3]
        longitude = LONGITUDE + x / (scale * pi * radius / 180)
        latitude = atan(exp((north0 + y) / (scale * radius))) * 360 / pi - 90
        angles = atan2(R[2, 1], R[2, 2]), -asin(R[2, 0]), atan2(R[1, 0], R[0, 0])
        row = [latitude, longitude, 112.8 + z, *angles, *[0.1] * 19, 4, 10, 5, 5, 5]
        (data / f"{k:010d}.txt").write_text(" ".join(f"{number:.17g}" for number in row) + "\n")


@pytest.fixture
def raw(tmp_path: Path) -> Path:
    return WRITERS["kitti_raw"][1](tmp_path).path


def test_poses_at_the_sweeps(raw):
    """Packets at the stamps of the sweeps give their poses, relative to the first."""
    truth, stamps = DRIVE.poses, open_dataset(raw).times
    write_oxts(raw, stamps, truth)
    dataset = open_dataset(raw)
    check(dataset, "kitti_raw")
    np.testing.assert_allclose(dataset.poses, truth @ inverse(T_LIDAR_IMU), atol=2e-6)
    assert FrameRange(dataset, "1:3").poses is not None


def test_packets_have_their_own_times(raw):
    """At 8 m/s and a turn of 0.5 rad/s, packets come 13 ms after the sweeps, as in real drives."""
    stamps = open_dataset(raw).times

    def pose(times):
        seconds = (times - stamps[0]) * 1e-9
        turns = list(rotation_exp(np.outer(0.5 * seconds, [0, 0, 1])))
        places = 16 * np.stack([np.sin(0.5 * seconds), 1 - np.cos(0.5 * seconds)], axis=1)
        return poses_from(turns, np.column_stack([places, 0.1 * seconds]))

    late = stamps + 13_190_128
    write_oxts(raw, late, inverse(pose(late))[0] @ pose(late))
    expected = inverse(pose(late))[0] @ pose(stamps) @ inverse(T_LIDAR_IMU)
    found = open_dataset(raw).poses
    np.testing.assert_allclose(found[0], expected[0], atol=1e-5)  # before the first packet
    np.testing.assert_allclose(found[:, :3, :3], expected[:, :3, :3], atol=1e-6)
    np.testing.assert_allclose(found[:, :3, 3], expected[:, :3, 3], atol=6e-3)  # chord of the bend


def test_packets_that_end_early(raw, caplog):
    """Sweeps more than a sweep and a half behind the last packet have no pose."""
    stamps = open_dataset(raw).times
    write_oxts(raw, stamps[:2], DRIVE.poses[:2])
    dataset = open_dataset(raw)
    assert dataset.poses is None
    assert "2 of 5 sweeps have no pose" in caplog.text
    assert FrameRange(dataset, "0:3").poses is not None


def test_a_drive_without_the_place_of_the_imu(raw, caplog):
    write_oxts(raw, open_dataset(raw).times, DRIVE.poses)
    (raw.parent / "calib_imu_to_velo.txt").unlink()
    assert open_dataset(raw).poses is None
    assert "calib_imu_to_velo.txt is not there; unpack the 'calibration' archive" in caplog.text


def test_damaged_packets(raw):
    """They stop nobody who does not want the poses."""
    write_oxts(raw, open_dataset(raw).times, DRIVE.poses)
    file = raw / "oxts" / "data" / "0000000002.txt"
    for text in ("49.0 8.4", "49.0 8.4 x 0 0 0", "490 8.4 112 0 0 0"):
        file.write_text(text)
        dataset = open_dataset(raw)
        dataset.sweep(2)
        with pytest.raises(DatasetError, match=r"0000000002.txt \(frame 2\) does not begin with"):
            _ = dataset.poses
    (raw.parent / "calib_imu_to_velo.txt").write_text("R: 1 0 0\n")
    with pytest.raises(CalibrationError, match=r"calib_imu_to_velo.txt"):
        _ = open_dataset(raw).poses


def test_meters_are_those_of_the_earth():
    """A degree of latitude is 111.2 km on KITTI's sphere; Mercator stretches it by 1 / cos."""
    degree = degrees(1 / 6378137)
    from docdepth.datasets.formats.kitti_raw import _mercator

    east = degree / np.cos(np.radians(LATITUDE))
    places = np.array(
        [[LATITUDE, LONGITUDE, 100], [LATITUDE + degree, LONGITUDE, 101],
         [LATITUDE, LONGITUDE + east, 99]]
    )  # fmt: skip
    np.testing.assert_allclose(_mercator(places), [[0, 0, 0], [0, 1, 1], [1, 0, -1]], atol=1e-6)
