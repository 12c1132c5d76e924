"""All problems of a recording are told together; what cannot be read is named."""

from __future__ import annotations

import os
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from formats import WRITERS
from made_up import DRIVE

import docdepth
from docdepth.datasets import open_dataset
from docdepth.errors import (
    CalibrationError,
    ConfigError,
    DatasetError,
    DocDepthError,
    SeveralProblems,
    collect_errors,
    raise_together,
)


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sequence of five sweeps with labels, poses and four images."""
    return WRITERS["semantic_kitti"][1](tmp_path_factory.mktemp("drive")).path


@pytest.fixture
def copy(drive: Path, tmp_path: Path) -> Path:
    """One that may be broken."""
    return Path(shutil.copytree(drive, tmp_path / "out" / "sequences" / "00"))


def test_all_problems_of_a_sequence_are_told_together(copy: Path) -> None:
    with (copy / "velodyne" / "000003.bin").open("r+b") as sweep:
        sweep.truncate(1001)
    times = (copy / "times.txt").read_text().split()
    (copy / "times.txt").write_text("\n".join([times[1], times[0], *times[2:]]))
    text = (copy / "calib.txt").read_text().splitlines()
    rows = [line for line in text if not line.startswith("Tr")] + ["Tr: 5 0 0 0 0 1 0 0 0 0 1 0"]
    (copy / "calib.txt").write_text("\n".join(rows))
    (copy / "image_2" / "size.txt").write_text("wide")
    with pytest.raises(SeveralProblems) as caught:
        open_dataset(copy)
    assert len(caught.value.errors) == 3
    text = str(caught.value)
    assert text.startswith("3 problems:\n  ")
    for part in ("000003.bin (frame 3) has 1001 bytes", "is not after that of frame 0", "'Tr:'"):
        assert part in text


def test_all_problems_of_a_raw_drive_are_told_together(tmp_path: Path) -> None:
    drive = tmp_path / "2011_09_26" / "2011_09_26_drive_0001_sync"
    (drive / "velodyne_points" / "data").mkdir(parents=True)
    np.zeros(10, np.uint8).tofile(drive / "velodyne_points" / "data" / "0000000000.bin")
    with pytest.raises(SeveralProblems) as caught:
        open_dataset(drive)
    names = ("0000000000.bin", "timestamps.txt", "calib_velo_to_cam.txt", "calib_cam_to_cam.txt")
    assert len(caught.value.errors) == len(names)
    for name, problem in zip(names, caught.value.errors, strict=True):
        assert name in problem.text


def test_errors_of_docdepth_alone_are_kept() -> None:
    problems: list[DocDepthError] = []
    for text in ("first", "second", "first"):
        with collect_errors(problems):
            raise ConfigError(text)
    with pytest.raises(SeveralProblems, match=r"^2 problems:\n  first\n  second$"):
        raise_together(problems)
    with pytest.raises(ZeroDivisionError), collect_errors(problems):
        raise ZeroDivisionError
    raise_together([])


def test_many_broken_sweeps_are_one_problem(copy: Path) -> None:
    for file in (copy / "velodyne").iterdir():
        file.write_bytes(b"")
    with pytest.raises(DatasetError, match=r"000000.bin \(frame 0\) is empty.*and 4 more sweeps"):
        open_dataset(copy)


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        *((name, "folder") for name in ("velodyne/000002.bin", "calib.txt")),
        *((name, "dangling link") for name in ("times.txt", "poses.txt", "docdepth.yaml")),
        *((f"image_2/{name}", "dangling link") for name in ("times.txt", "000000.png")),
    ],
)
def test_links_that_lead_nowhere_and_folders_are_named(copy: Path, name: str, kind: str) -> None:
    file = copy / name
    if file.exists():
        file.unlink()
    if kind == "folder":
        file.mkdir()
    else:
        file.symlink_to(copy / "gone")
    text = "is a folder where a file" if kind == "folder" else "is a link to .*gone"
    with pytest.raises((DatasetError, CalibrationError), match=f"{Path(name).name}.* {text}"):
        open_dataset(copy).cameras["image_2"].image(0)


@pytest.mark.parametrize("name", ["labels/000002.label", "point_times/000002.bin"])
def test_links_beside_a_sweep_that_lead_nowhere_are_named(copy: Path, name: str) -> None:
    (copy / name).parent.mkdir(exist_ok=True)
    (copy / name).unlink(missing_ok=True)
    (copy / name).symlink_to(copy / "gone")
    recording = open_dataset(copy)
    with pytest.raises(DatasetError, match=r"000002.* is a link to"):
        recording.labels(2) if "labels" in name else recording.sweep(2)


@pytest.mark.parametrize("name", ["calib.txt", "times.txt", "velodyne/000002.bin", "docdepth.yaml"])
@pytest.mark.parametrize("make", [os.mkfifo, lambda path: path.symlink_to("/dev/zero")])
def test_pipes_and_devices_are_no_files(copy: Path, name: str, make) -> None:
    (copy / name).unlink(missing_ok=True)
    make(copy / name)
    with pytest.raises(DocDepthError, match=rf"{name} .*cannot be read \(it is no regular file\)"):
        open_dataset(copy).sweep(2)


def test_files_of_others_are_opened_in_one_place() -> None:
    """Which refuses what is no regular file."""
    package = Path(docdepth.__file__).parent
    found = {
        str(file.relative_to(package))
        for file in package.rglob("*.py")
        if re.search(r"\.read_bytes\(\)|\.read_text\(|\.open\(\"rb?\"", file.read_text())
    }
    # These read /proc, scripts of the package, and what they wrote.
    assert found == {
        "concurrency.py", "pipeline/execution.py", "visualization/page.py", "synthetic/writer.py"
    }  # fmt: skip


def test_a_file_larger_than_any_sweep_is_not_read(copy: Path) -> None:
    """A sparse one takes no place on the disk, and would take all memory."""
    os.truncate(copy / "velodyne" / "000002.bin", 1 << 42)
    with pytest.raises(DatasetError, match=r"000002.bin .frame 2. cannot be read .it has 4,398 GB"):
        open_dataset(copy).sweep(2)


def test_files_that_may_not_be_read(copy: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Who runs the tests as root may read all.
    opened = os.open

    def refuse(path: Path, *more: int) -> int:
        if Path(path).name == "calib.txt":
            raise PermissionError(13, "Permission denied", str(path))
        return opened(path, *more)

    monkeypatch.setattr(os, "open", refuse)
    with pytest.raises(CalibrationError, match=r"calib.txt may not be read.*permissions"):
        open_dataset(copy)


def test_an_image_whose_path_is_no_text(copy: Path, drive: Path) -> None:
    name = bytes(copy / "image_2") + b"/000003\xff.png"
    (copy / "image_2" / "000003.png").rename(os.fsdecode(name))
    image = open_dataset(copy).cameras["image_2"].rectified_image(3)
    assert image is not None
    stream = open_dataset(drive).cameras["image_2"]
    np.testing.assert_array_equal(image, stream.rectified_image(3))


# ---- a folder that holds recordings


def test_a_folder_with_one_recording_below_is_understood(copy: Path) -> None:
    assert open_dataset(copy.parents[1]).path == copy
    assert open_dataset(copy.parents[1], "semantic_kitti").path == copy


def test_a_folder_with_several_recordings_names_them(copy: Path) -> None:
    shutil.copytree(copy, copy.parent / "01")
    with pytest.raises(DatasetError, match=r"holds 2 recordings; name one of .*/00, .*/01$"):
        open_dataset(copy.parents[1])


def test_a_run_beside_a_recording_is_no_second_one(copy: Path) -> None:
    (copy.parents[1] / "run" / "frames").mkdir(parents=True)
    (copy.parents[1] / "run" / "traj_odometry.ply").write_text("")
    assert open_dataset(copy.parents[1]).path == copy


# ---- a range of frames


def test_a_range_has_the_images_of_its_time(drive: Path) -> None:
    part = open_dataset(drive, frames="2:4").cameras["image_2"]
    assert part.names == ["000001", "000002", "000003"]
    assert [image.stem for image in part.images] == part.names
    np.testing.assert_array_equal(part.times, DRIVE.image_times[1:4])


@pytest.mark.parametrize("frames", ["5:", "4:2"])
def test_a_range_without_sweeps(drive: Path, frames: str) -> None:
    with pytest.raises(DatasetError, match=f"{frames} holds no sweep.* has 5 sweeps, 0 to 4"):
        open_dataset(drive, frames=frames)


@pytest.mark.parametrize("frames", ["1", "-3:", "²:"])
def test_a_text_that_is_no_range(drive: Path, frames: str) -> None:
    with pytest.raises(DatasetError, match=r"write A:B .* has 5 sweeps"):
        open_dataset(drive, frames=frames)


def test_files_that_other_systems_hide_are_left_out(copy: Path) -> None:
    whole = open_dataset(copy)
    for folder, name in (("velodyne", "._000000.bin"), ("image_2", "._000000.png")):
        (copy / folder).mkdir(exist_ok=True)
        (copy / folder / name).write_bytes(b"\0\5\26\7")
    again = open_dataset(copy)
    assert len(again) == len(whole)
    assert again.cameras["image_2"].names == whole.cameras["image_2"].names


def test_a_byte_order_mark_is_no_part_of_a_time(copy: Path) -> None:
    times = open_dataset(copy).times
    text = (copy / "times.txt").read_text(encoding="utf-8")
    (copy / "times.txt").write_text("\ufeff" + text.replace("\n", "\r\n"), encoding="utf-8")
    np.testing.assert_array_equal(open_dataset(copy).times, times)


def test_sweeps_are_in_the_order_of_their_numbers(copy: Path) -> None:
    for folder in ("velodyne", "labels", "point_times"):
        for file in sorted((copy / folder).iterdir()):
            file.rename(file.with_name(f"{int(file.stem) + 8}{file.suffix}"))
    recording = open_dataset(copy)
    assert [recording.sweep(k).name for k in range(5)] == ["8", "9", "10", "11", "12"]


def test_a_copy_among_numbered_sweeps_is_named(copy: Path) -> None:
    shutil.copy(copy / "velodyne" / "000001.bin", copy / "velodyne" / "000001 (1).bin")
    with pytest.raises(DatasetError, match=r"none for 000001 \(1\)\.bin \(frame 2\)"):
        open_dataset(copy)
