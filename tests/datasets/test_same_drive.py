"""A drive written in other formats is the same drive, to the last bit of its depth maps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from conformance import check, differences
from rewriting import write_bag, write_folder

from docdepth import read_depth, run
from docdepth.datasets import CameraStream, Dataset, open_dataset
from docdepth.io.poses import read_poses, write_kitti
from docdepth.synthetic import write_drive

pytestmark = pytest.mark.slow

FORMATS = ["folder", "db3", "mcap", "ros1"]


@pytest.fixture(scope="module", params=["KITTI", "VLP-16", "Avia"])
def drive(request, tmp_path_factory) -> tuple[Dataset, Path]:
    """Raw sweeps with the times of their points, and a file of their poses."""
    folder = tmp_path_factory.mktemp(request.param)
    poses = folder / "poses.txt"
    if request.param == "KITTI":
        real = request.getfixturevalue("drive_9001")
        lines = (real / "lidar_poses_tum.txt").read_text().splitlines()
        poses.write_text("\n".join(lines[20:26]) + "\n")
        return open_dataset(real, frames="20:26"), poses
    dataset = open_dataset(write_drive(folder / "00", "crossing", request.param, 3, 5, skew=True))
    write_kitti(poses, dataset.poses)
    return dataset, poses


def rewritten(form: str, root: Path, dataset: Dataset, poses: Path) -> Dataset:
    lines = poses.read_text().splitlines()
    if form == "folder":
        return open_dataset(write_folder(root / "clouds", dataset, lines))
    pytest.importorskip("rosbags")
    name = "drive.bag" if form == "ros1" else "drive"
    return open_dataset(write_bag(root / "bag" / name, form, dataset, lines))


def with_images(dataset: Dataset) -> CameraStream:
    (stream,) = (stream for stream in dataset.cameras.values() if stream.images)
    return stream


@pytest.mark.parametrize("form", FORMATS)
def test_sweeps_times_poses_and_cameras(form, drive, tmp_path) -> None:
    dataset, poses = drive
    other = rewritten(form, tmp_path, dataset, poses)
    np.testing.assert_array_equal(other.times, dataset.times)
    np.testing.assert_array_equal(other.poses, read_poses(poses, len(dataset)))
    for k in range(len(dataset)):
        assert set(differences(dataset.sweep(k), other.sweep(k))) <= {"name"}, f"sweep {k}"
    one, same = with_images(dataset), with_images(other)
    np.testing.assert_array_equal(same.times, one.times)
    np.testing.assert_array_equal(same.camera.K, one.camera.K)
    np.testing.assert_array_equal(same.T_camera_lidar, one.T_camera_lidar)
    for k in range(len(one.times)):
        np.testing.assert_array_equal(same.rectified_image(k), one.rectified_image(k))


@pytest.mark.parametrize("drive", ["VLP-16"], indirect=True)
@pytest.mark.parametrize("form", ["mcap", "run"])
def test_depth_maps(form, drive, tmp_path) -> None:
    dataset, poses = drive
    camera = with_images(dataset).name
    first = run(dataset.path, tmp_path / "first", poses=poses, camera=camera).path
    if form == "run":
        check(open_dataset(first), "run")
        assert open_dataset(first).sweep(1).relative_time is not None
        second = run(first, tmp_path / "second").path
    else:
        other = rewritten(form, tmp_path, dataset, poses)
        second = run(other.path, tmp_path / "second", poses=poses, camera=camera).path
    ours, theirs = (
        sorted((r / "depth").glob("*.png"), key=lambda file: int(file.stem))
        for r in (first, second)
    )
    assert len(ours) == len(theirs) > 0
    for one, same in zip(ours, theirs, strict=True):
        np.testing.assert_array_equal(read_depth(same), read_depth(one))
        assert np.isfinite(read_depth(one)).mean() > 0.05
