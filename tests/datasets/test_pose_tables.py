"""Tables of poses that do not cover a drive."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from docdepth.datasets.pose_tables import poses_at, poses_of_angles, read_pose_table, rows_around
from docdepth.errors import DatasetError


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
    found = rf"poses\.csv, line 2: .* \({len(line.split())} values\).* 2 more numbers; copy it"
    with pytest.raises(DatasetError, match=found):
        read_pose_table(file, (2,), "copy it")


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


def test_rows_around_sweeps_give_the_same_poses() -> None:
    rng = np.random.default_rng(3)
    stamps = np.cumsum(rng.integers(1, 9, 400) * 1_000_000)
    rows = rng.normal(size=(400, 6)) * 0.2
    times = np.sort(rng.integers(0, stamps[-1] + 20_000_000, 37))
    times[5] = stamps[100]
    few, kept = rows_around(stamps, rows, times)
    assert len(few) < 80
    whole, part = (
        poses_at(s, poses_of_angles(r[:, :3], r[:, 3:]), times, Path("poses.csv"))
        for s, r in ((stamps, rows), (few, kept))
    )
    np.testing.assert_array_equal(part, whole)
    assert np.isnan(whole[-1]).all() or times[-1] <= stamps[-1]


def test_a_stamp_may_be_written_as_a_power(tmp_path: Path) -> None:
    text = "1.564718976161407e18 1\n1564718976161407002 2\n"
    stamps, _ = read_pose_table(write(tmp_path / "poses.csv", text), (1,), "copy it")
    assert stamps.tolist() == [1564718976161407000, 1564718976161407002]
