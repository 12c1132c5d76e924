"""Every broken file of a KITTI recording ends in a sentence that names it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from kitti_drives import (
    R_VELO,
    T_VELO,
    numbers,
    write_image,
)  # fmt: skip

from docdepth.datasets import open_dataset
from docdepth.errors import CalibrationError, DatasetError


def test_truncated_and_empty_sweeps(raw: Path, sequence: Path) -> None:
    for drive, name in ((raw, "velodyne_points/data/0000000002"), (sequence, "velodyne/000002")):
        file = drive / f"{name}.bin"
        whole = file.read_bytes()
        dataset = open_dataset(drive)
        for content, problem in ((whole[:-5], "multiple of 16"), (b"", "empty")):
            file.write_bytes(content)
            match = rf"{file.name} \(frame 2\).*{problem}"
            with pytest.raises(DatasetError, match=match):
                open_dataset(drive)
            with pytest.raises(DatasetError, match=match):
                dataset.sweep(2)
        file.unlink()
        with pytest.raises(DatasetError, match=rf"{file.name} \(frame 2\) has gone"):
            dataset.sweep(2)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (lambda lines: lines[:3], r"timestamps\.txt has 3 stamps for 4 files.*0000000003\.bin"),
        (lambda lines: [lines[0], lines[2], lines[1], lines[3]], r"frame 2 \(0000000002\.bin\)"),
        (lambda lines: [lines[0], lines[0], *lines[2:]], r"frame 1 .* after that of frame 0"),
        (lambda lines: [lines[0], "noon", *lines[2:]], r"line 2: 'noon' is no time"),
        (lambda lines: [lines[0], "", *lines[2:]], r"line 2: '' is no time"),
    ],
)
def test_broken_stamps(raw: Path, change, match: str) -> None:
    file = raw / "velodyne_points" / "timestamps.txt"
    file.write_text("\n".join(change(file.read_text().splitlines())))
    with pytest.raises(DatasetError, match=match):
        open_dataset(raw)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ("0.0\n0.1\n0.2\n", r"times\.txt has 3 times for 4 files.*000003\.bin \(frame 3\)"),
        ("0.0\n0.1\n0.1\n0.2\n", r"frame 2 \(000002\.bin\) is not after that of frame 1"),
        ("0.0\n0.1\nx\n0.2\n", "line 3: 'x' is no time"),
        ("0.0\n0.1\nnan\n0.2\n", "line 3: 'nan' is no time"),
    ],
)
def test_broken_times(sequence: Path, change: str, match: str) -> None:
    (sequence / "times.txt").write_text(change)
    with pytest.raises(DatasetError, match=match):
        open_dataset(sequence)


@pytest.mark.parametrize("name", ["velodyne_points/timestamps.txt", "image_02/timestamps.txt"])
def test_missing_stamps(raw: Path, name: str) -> None:
    write_image(raw / "image_02" / "data" / "0000000000.png")
    (raw / "image_02" / "timestamps.txt").write_text("2011-09-26 13:02:25.1\n")
    open_dataset(raw)
    (raw / name).unlink()
    with pytest.raises(DatasetError, match=rf"{name} is missing; "):
        open_dataset(raw)


@pytest.mark.parametrize("name", ["calib_cam_to_cam.txt", "calib_velo_to_cam.txt"])
def test_missing_raw_calibration(raw: Path, name: str) -> None:
    (raw.parent / name).unlink()
    with pytest.raises(CalibrationError, match=f"{name} is missing; unpack"):
        open_dataset(raw)


def test_broken_calibration(raw: Path, sequence: Path) -> None:
    file = raw.parent / "calib_cam_to_cam.txt"
    text = file.read_text()
    file.write_text(text.replace("R_rect_00", "R_rect_01"))
    with pytest.raises(CalibrationError, match="no line 'R_rect_00:'"):
        open_dataset(raw)
    file.write_text(text.replace("P_rect_02: ", "P_rect_02: nan "))
    with pytest.raises(CalibrationError, match="P_rect_02:' must be 12 finite numbers"):
        open_dataset(raw)
    file.write_text(text.replace("P_rect_02", "P_rect_09"))
    with pytest.raises(CalibrationError, match="has no camera"):
        open_dataset(raw)
    (sequence / "calib.txt").unlink()
    with pytest.raises(CalibrationError, match=r"calib\.txt is missing"):
        open_dataset(sequence)


BAD_EXTRINSICS = {
    "a first number of 5": lambda T: T * (np.arange(12).reshape(3, 4) != 0) + np.eye(3, 4) * 5,
    "swapped rows": lambda T: T[[1, 0, 2]],
    "all zeros": lambda T: 0 * T,
    "millimetres": lambda T: T * (1, 1, 1, 1000),
}


@pytest.mark.parametrize("change", BAD_EXTRINSICS.values(), ids=BAD_EXTRINSICS)
def test_extrinsics_that_cannot_be_are_refused(raw: Path, sequence: Path, change) -> None:
    wrong = change(np.hstack([R_VELO, T_VELO[:, None]]))
    file = sequence / "calib.txt"
    file.write_text(file.read_text().rpartition("Tr:")[0] + f"Tr: {numbers(wrong)}\n")
    with pytest.raises(CalibrationError, match=r"calib\.txt: 'Tr:' (holds no rotation|puts)"):
        open_dataset(sequence)
    file = raw.parent / "calib_velo_to_cam.txt"
    file.write_text(f"R: {numbers(wrong[:, :3])}\nT: {numbers(wrong[:, 3])}\n")
    with pytest.raises(CalibrationError, match=r"'R: and T:' (holds no rotation|puts)"):
        open_dataset(raw)


def test_layouts_are_named_with_hyphens_too(sequence: Path) -> None:
    assert open_dataset(sequence, "kitti-odometry").name == "kitti_odometry"


def test_image_size_that_does_not_fit(raw: Path) -> None:
    file = raw.parent / "calib_cam_to_cam.txt"
    text = file.read_text()
    with pytest.raises(CalibrationError, match="1242 x 375 but the image size asked for is 640"):
        open_dataset(raw, image_size=(640, 480))
    file.write_text(text.replace("S_rect_02: 1.242000e+03 3.750000e+02\n", ""))
    with pytest.raises(CalibrationError, match="by `image_size`"):
        open_dataset(raw)
    with pytest.raises(CalibrationError, match=r"principal point .* outside the 400 x 300"):
        open_dataset(raw, image_size=(400, 300))
    assert open_dataset(raw, image_size=(1242, 375)).cameras["image_02"].camera.width == 1242


def test_folders_without_a_recording(raw: Path, tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="not there"):
        open_dataset(tmp_path / "nowhere")
    (tmp_path / "empty").mkdir()
    with pytest.raises(DatasetError, match=r"that docdepth reads \(kitti_raw, .*say by `dataset`"):
        open_dataset(tmp_path / "empty")
    with pytest.raises(DatasetError, match="unknown dataset 'lyft'; there are kitti_raw"):
        open_dataset(raw, "lyft")
    with pytest.raises(DatasetError, match=r"no recording of semantic_kitti .a sequence"):
        open_dataset(raw, "semantic_kitti")
