"""Every loader passes one test, on a recording written by the format's own library."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from conformance import check
from formats import WRITERS, Written
from made_up import DISTORTION, DRIVE, K

from docdepth.datasets import (
    Dataset,
    experimental_formats,
    format_names,
    open_dataset,
    usable_points,
)
from docdepth.errors import DatasetError, DocDepthError


def test_every_format_is_written_by_a_test() -> None:
    assert {name for name, _ in WRITERS.values()} == set(format_names())


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize("what", WRITERS)
def test_loader(what: str, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    name, write = WRITERS[what]
    written = write(tmp_path)
    dataset = open_dataset(written.path)
    check(dataset, name)
    assert open_dataset(written.path, dataset=name).times.tolist() == dataset.times.tolist()
    said = [r.getMessage() for r in caplog.records if r.name.startswith("docdepth.datasets")]
    experimental = name in experimental_formats()
    assert len(said) == 2 * experimental, "one line each time it is opened"
    assert all(f"the reader of {name} is experimental" in line for line in said)
    _check_content(dataset, written)
    if written.damage is not None:  # else nothing in the format tells it
        file = written.damage()
        with pytest.raises(DocDepthError) as caught:
            open_dataset(written.path).sweep(2)
        assert file.name in str(caught.value)
        assert "frame 2" in str(caught.value) or "frame_000002" in str(caught.value)


def _of_windows(folder: Path, encoding: str) -> None:
    for file in folder.rglob("*.*"):
        if file.suffix in (".txt", ".yaml", ".json", ".csv"):
            file.write_bytes(file.read_text().replace("\n", "\r\n").encode(encoding))


def _in_capitals(folder: Path) -> None:
    for file in [*folder.rglob("*.*")]:
        if file.suffix in (".bin", ".pcd", ".ply", ".npy", ".las", ".png", ".pcap", ".json"):
            file.rename(file.with_suffix(file.suffix.upper()))


CHANGES = {
    "utf-8 with a mark": lambda folder: _of_windows(folder, "utf-8-sig"),
    "utf-16": lambda folder: _of_windows(folder, "utf-16"),
    "capitals": _in_capitals,
    "bytes": lambda folder: folder.rename(folder.with_name("\udce4")),
}
ANY = {"kitti_raw", "folder of binary pcd", "folder of bin", "folder of npy"}
UNCHANGED = {
    "utf-8 with a mark": {*ANY, "kitti_odometry", "nuScenes", "PandaSet", "DGP", "Boreas", "NCLT"},
    "utf-16": {*ANY, "kitti_odometry", "Boreas", "NCLT", "KITTI-360", "MulRan"},
    "capitals": {*ANY, "Velodyne capture", "Hesai capture", "folder of las", "HeLiPR, Avia"},
    # Not those that log the path: pytest-xdist sends only text.
    "bytes": {*ANY, "Velodyne capture", "MCAP", "ROS 1 bag", "nuScenes", "run"},
}


@pytest.mark.parametrize(
    ("change", "what"), [(change, what) for change in CHANGES for what in sorted(UNCHANGED[change])]
)
def test_files_as_other_systems_name_and_write_them(tmp_path: Path, change: str, what: str) -> None:
    (folder := tmp_path / "x").mkdir()
    path = WRITERS[what][1](folder).path
    before = open_dataset(path)
    first = before.sweep(0).points
    CHANGES[change](folder)
    (folder,) = tmp_path.iterdir()
    place = folder / path.relative_to(tmp_path / "x")
    capitals = place.with_suffix(place.suffix.upper())
    after = open_dataset(capitals if capitals.is_file() else place)
    np.testing.assert_array_equal(after.sweep(0).points, first)
    assert after.times.tolist() == before.times.tolist()
    assert after.cameras.keys() == before.cameras.keys()


@pytest.mark.parametrize("what", ["ROS 2 bag", "Argoverse 2", "Waymo"])
def test_paths_that_a_library_refuses_are_to_be_renamed(what: str, tmp_path: Path) -> None:
    (letters := tmp_path / "letters").mkdir()
    place = WRITERS[what][1](letters).path.relative_to(letters)
    folder = letters.rename(tmp_path / "\udce4")
    with pytest.raises(DatasetError, match="rename it, in letters"):
        open_dataset(folder / place)


@pytest.mark.parametrize("what", ["kitti_raw", "kitti_odometry", "folder of ply"])
def test_labels_beside_the_sweeps(what: str, tmp_path: Path) -> None:
    path = WRITERS[what][1](tmp_path).path
    file = path / "labels" / f"{open_dataset(path).sweep(1).name}.label"
    file.parent.mkdir()
    labels = np.arange(len(DRIVE.rows(1)), dtype="<u4") + (7 << 16)
    labels.tofile(file)
    dataset = open_dataset(path)
    np.testing.assert_array_equal(dataset.labels(1), labels)
    assert dataset.labels(0) is None
    labels[:-1].tofile(file)
    with pytest.raises(DatasetError, match=rf"{file.name} \(frame 1\).* 401 points"):
        dataset.labels(1)


def _check_content(dataset: Dataset, written: Written) -> None:
    """What is read is what was written."""
    if written.clock is None:
        np.testing.assert_allclose(dataset.times, DRIVE.times, rtol=0, atol=500)
    else:
        np.testing.assert_array_equal(dataset.times, written.clock(DRIVE.times))
    if not written.points:
        return
    for k in range(DRIVE.count):
        sweep, rows, kept = dataset.sweep(k), DRIVE.rows(k), DRIVE.usable(k)
        if written.reordered:
            odd = np.argsort(rows["ring"][kept] % 2, kind="stable")
            kept = np.flatnonzero(kept)[odd]
        usable = usable_points(sweep.points)
        assert usable.sum() == DRIVE.usable(k).sum()
        if not written.tolerance:
            np.testing.assert_array_equal(sweep.points[usable], DRIVE.points(k)[kept])
        elif np.isfinite(written.tolerance):
            np.testing.assert_allclose(
                sweep.points[usable], DRIVE.points(k)[kept], atol=written.tolerance
            )
        for column in ("intensity", "ring"):
            values = getattr(sweep, column)
            if not written.reordered:
                assert (values is not None) == (column in written.has), column
            if values is not None and column in written.has:
                np.testing.assert_array_equal(values[usable], rows[column][kept])
        if "times" in written.has:
            assert sweep.relative_time is not None
            assert not sweep.motion_compensated
            np.testing.assert_allclose(
                sweep.relative_time[usable], rows["share"][kept], atol=1e-6, rtol=0
            )
    if "poses" in written.has:
        assert dataset.poses is not None
        np.testing.assert_allclose(dataset.poses, DRIVE.poses, atol=1e-9)
    if "camera" in written.has:
        (stream,) = dataset.cameras.values()
        np.testing.assert_allclose(stream.T_camera_lidar, DRIVE.T_camera_lidar, atol=1e-9)
        np.testing.assert_array_equal(stream.times, written.clock(DRIVE.image_times))
        np.testing.assert_array_equal(stream.camera.K, K)
        for k in range(DRIVE.images_count):
            rectified = stream.rectified_image(k)
            assert rectified is not None
            expected = DRIVE.image(k)
            if written.lens:
                expected = cv2.undistort(expected, K, DISTORTION)
            np.testing.assert_array_equal(rectified, expected)
