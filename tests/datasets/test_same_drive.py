"""A real drive written in other formats is the same drive, to the last bit of its depth maps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from conformance import check, differences
from rewriting import write_bag, write_folder

from docdepth import read_depth, run
from docdepth.datasets import Dataset, open_dataset
from docdepth.io.poses import read_poses

FRAMES = "20:42"


@pytest.fixture(scope="module")
def raw(drive_9001: Path) -> tuple[Dataset, list[str]]:
    """Part of the drive, and the lines of its poses."""
    lines = (drive_9001 / "lidar_poses_tum.txt").read_text().splitlines()
    return open_dataset(drive_9001, frames=FRAMES), lines[20:42]


@pytest.fixture(scope="module", params=["folder", "db3", "mcap", "ros1"])
def other(request, raw, tmp_path_factory) -> Dataset:
    """The same part in another format."""
    pytest.importorskip("rosbags")
    root, (dataset, poses) = tmp_path_factory.mktemp(request.param), raw
    if request.param == "folder":
        return open_dataset(write_folder(root / "clouds", dataset, poses))
    name = "drive.bag" if request.param == "ros1" else "drive"
    return open_dataset(write_bag(root / "bag" / name, request.param, dataset, poses))


@pytest.mark.slow
def test_sweeps_times_poses_and_cameras(raw, other, drive_9001) -> None:
    dataset, _ = raw
    poses = read_poses(drive_9001 / "lidar_poses_tum.txt")[20:42]
    np.testing.assert_array_equal(other.times, dataset.times)
    np.testing.assert_array_equal(other.poses, poses)
    for k in range(len(dataset)):
        sweep, same = dataset.sweep(k), other.sweep(k)
        assert sweep.sensor_rig is not None, "KITTI's lasers are found in every format"
        assert set(differences(sweep, same)) <= {"name"}, f"sweep {k}"
    (stream,), (again,) = dataset.cameras.values(), other.cameras.values()
    np.testing.assert_array_equal(again.times, stream.times)
    np.testing.assert_array_equal(again.camera.K, stream.camera.K)
    np.testing.assert_array_equal(again.T_camera_lidar, stream.T_camera_lidar)
    for k in range(len(stream.times)):
        np.testing.assert_array_equal(again.rectified_image(k), stream.rectified_image(k))


@pytest.fixture(scope="module")
def raw_run(raw, tmp_path_factory) -> Path:
    return run(raw[0].path, tmp_path_factory.mktemp("raw") / "run", frames=FRAMES).path


def _depth_maps(folder: Path) -> list[np.ndarray]:
    return [read_depth(file) for file in sorted((folder / "depth").glob("*.png"))]


@pytest.mark.nightly
def test_depth_maps(raw_run, other, tmp_path) -> None:
    _check_depth(raw_run, run(other.path, tmp_path / "run").path)


@pytest.mark.slow
def test_depth_maps_of_a_run_folder(raw_run, tmp_path) -> None:
    """The layout of the authors' release, with docdepth's further columns."""
    dataset = open_dataset(raw_run)
    check(dataset, "run")
    assert dataset.sweep(3).relative_time is not None
    _check_depth(raw_run, run(raw_run, tmp_path / "run").path)


def _check_depth(one: Path, two: Path) -> None:
    maps, again = _depth_maps(one), _depth_maps(two)
    assert len(maps) == len(again) > 8
    for a, b in zip(maps, again, strict=True):
        np.testing.assert_array_equal(a, b)
