"""A synthetic drive by two sensors is the same in every format, and gives the same depth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from conformance import differences
from rewriting import write_bag, write_folder

from docdepth import read_depth, run
from docdepth.datasets import Dataset, open_dataset
from docdepth.io.poses import write_kitti
from docdepth.synthetic import write_drive

pytestmark = pytest.mark.slow

FRAMES = 3
_SAME_READER = ("db3", "ros1")
"""Bags that the reader of MCAP reads; maps of one kind are enough, and take time."""


@pytest.fixture(scope="module", params=["VLP-16", "Avia"])
def drive(request, tmp_path_factory) -> Dataset:
    """Raw sweeps with the times of their points, in SemanticKITTI's layout."""
    folder = tmp_path_factory.mktemp(request.param)
    return open_dataset(write_drive(folder, "crossing", request.param, FRAMES, 5, skew=True))


@pytest.fixture(scope="module")
def poses(drive: Dataset, tmp_path_factory) -> Path:
    """Exact poses of the LiDAR."""
    assert drive.poses is not None
    file = tmp_path_factory.mktemp("poses") / "poses.txt"
    write_kitti(file, drive.poses)
    return file


@pytest.fixture(scope="module")
def depth(drive: Dataset, poses: Path, tmp_path_factory) -> list[np.ndarray]:
    """Its depth maps."""
    return maps_of(drive, poses, tmp_path_factory.mktemp("depth") / "run")


def maps_of(drive: Dataset, poses: Path, folder: Path) -> list[np.ndarray]:
    camera = next(name for name, stream in drive.cameras.items() if stream.images)
    made = run(drive.path, folder, poses=str(poses), camera=camera)
    maps = (made.path / "depth").glob("*.png")
    return [read_depth(file) for file in sorted(maps, key=lambda file: int(file.stem))]


@pytest.mark.parametrize("form", ["folder", "db3", "mcap", "ros1"])
def test_every_sensor_in_every_format(form, drive, poses, depth, tmp_path) -> None:
    pytest.importorskip("rosbags")
    lines = poses.read_text().splitlines()
    if form == "folder":
        other = open_dataset(write_folder(tmp_path / "clouds", drive, lines))
    else:
        name = "drive.bag" if form == "ros1" else "drive"
        other = open_dataset(write_bag(tmp_path / "bag" / name, form, drive, lines))
    np.testing.assert_array_equal(other.times, drive.times)
    for k in range(FRAMES):
        assert set(differences(drive.sweep(k), other.sweep(k))) <= {"name"}, f"sweep {k}"
    streams = {name: s for name, s in drive.cameras.items() if s.images}
    (one,), (same,) = streams.values(), [s for s in other.cameras.values() if s.images]
    np.testing.assert_array_equal(one.times, same.times)
    np.testing.assert_array_equal(one.T_camera_lidar, same.T_camera_lidar)
    np.testing.assert_array_equal(one.camera.K, same.camera.K)
    if form in _SAME_READER:
        return  # from here on nothing knows the format
    for right, drawn in zip(depth, maps_of(other, poses, tmp_path / "run"), strict=True):
        np.testing.assert_array_equal(drawn, right)
        assert np.isfinite(right).mean() > 0.05
