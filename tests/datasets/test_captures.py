"""Captures of packets: what the LiDAR measured comes back, at its times."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from captures import COLUMNS, ROWS, ouster_ranges, write_ouster
from conformance import check
from made_up import DRIVE

from docdepth.datasets import open_dataset, usable_points
from docdepth.errors import DatasetError

pytest.importorskip("ouster.sdk")


def test_points_of_an_ouster(tmp_path: Path) -> None:
    """Ranges from the centre of its lasers, rings and times of columns."""
    write_ouster(tmp_path / "drive.pcap")
    dataset = open_dataset(tmp_path / "drive.pcap")
    sweep, ranges = dataset.sweep(1), ouster_ranges(1).ravel()
    assert usable_points(sweep.points).tolist() == (ranges > 0).tolist()
    centre = sweep.sensor_rig.T_lidar_sensor[0, :3, 3]
    assert 0.03 < centre[2] < 0.05, "the lasers are above the origin of the sensor's frame"
    distance = np.linalg.norm(sweep.points - centre, axis=1)[ranges > 0]
    np.testing.assert_allclose(distance, ranges[ranges > 0] * 1e-3, atol=0.03)
    np.testing.assert_array_equal(sweep.ring, np.repeat(np.arange(ROWS), COLUMNS))
    np.testing.assert_array_equal(sweep.intensity, ranges % 200)
    column = np.tile(np.arange(COLUMNS), ROWS)
    share = column * (99_000_000 // COLUMNS) / DRIVE.period
    np.testing.assert_allclose(sweep.relative_time[ranges > 0], share[ranges > 0], atol=1e-6)


def test_columns_that_were_lost_have_no_points_and_the_rest_its_times(tmp_path: Path) -> None:
    write_ouster(tmp_path / "drive.pcap", missing=slice(100, 200))
    dataset = open_dataset(tmp_path / "drive.pcap")
    check(dataset, "ouster")
    sweep = dataset.sweep(2)
    column = np.tile(np.arange(COLUMNS), ROWS)
    lost = (column >= 96) & (column < 208)  # whole packets of 16 columns
    assert not usable_points(sweep.points)[(column >= 100) & (column < 200)].any()
    usable = usable_points(sweep.points) & ~lost
    share = column * (99_000_000 // COLUMNS) / DRIVE.period
    np.testing.assert_allclose(sweep.relative_time[usable], share[usable], atol=1e-6)


def test_stamps_are_on_the_clock_of_the_lidar_where_that_is_unix_time(tmp_path: Path) -> None:
    write_ouster(tmp_path / "drive.pcap", boot=False)
    times = open_dataset(tmp_path / "drive.pcap").times
    np.testing.assert_allclose(times, DRIVE.times - 40_000_000, atol=2000)


def test_metadata_that_is_missing_or_of_another_sensor(tmp_path: Path) -> None:
    write_ouster(tmp_path / "drive.pcap")
    (tmp_path / "drive.json").rename(tmp_path / "sensor.json")
    with pytest.raises(
        DatasetError, match=r"no metadata of its name.*files there: sensor.js"
    ):
        open_dataset(tmp_path / "drive.pcap", format="ouster")
    (tmp_path / "docdepth.yaml").write_text(yaml.safe_dump({"metadata": "sensor.json"}))
    assert len(open_dataset(tmp_path / "drive.pcap", format="ouster")) == DRIVE.count
    (tmp_path / "sensor.json").write_text("{}")
    with pytest.raises(DatasetError, match=r"drive.pcap with .*sensor.json is no capture"):
        open_dataset(tmp_path / "drive.pcap", format="ouster")


def test_an_empty_capture(recordings: Path) -> None:
    with pytest.raises(DatasetError, match=r"empty_pcap.pcap holds no frame that fits"):
        open_dataset(recordings / "ouster" / "empty_pcap.pcap")


def test_a_real_capture(recordings: Path) -> None:
    """Three revolutions of an OS1-128 that drives 0.25 m in each."""
    from docdepth.odometry.odometry import estimate_poses

    dataset = open_dataset(recordings / "ouster" / "OS-1-128_v2.3.0_1024x10_lb_n3.pcap")
    check(dataset, "ouster")
    assert len(dataset) == 3
    assert (usable_points(dataset.sweep(1).points)).sum() == 107357
    steps = np.diff(estimate_poses(dataset)[:, :3, 3], axis=0)
    np.testing.assert_allclose(np.linalg.norm(steps, axis=1), 0.25, atol=0.03)
