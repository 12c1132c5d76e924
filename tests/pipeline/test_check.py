"""Everything that can be wrong with the inputs is told before a run begins, all at once."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from docdepth.config import parameters
from docdepth.datasets import open_dataset
from docdepth.errors import (
    CalibrationError,
    DatasetError,
    Finding,
    OdometryError,
    SeveralProblems,
    raise_findings,
)
from docdepth.io.inputs import RunInputs
from docdepth.odometry.odometry import register_drive
from docdepth.pipeline import execution
from docdepth.pipeline.check import check_inputs
from docdepth.pipeline.execution import check_image_size


def source(dataset: Path, **values: Any) -> RunInputs:
    return RunInputs(recording=dataset, **values)


def problems(dataset: Path, output: Path | None = None, **values: Any) -> list[Finding]:
    return check_inputs(source(dataset, **values), parameters(), output).findings


def texts(found: list[Finding], severity: str) -> str:
    return "\n".join(str(p) for p in found if p.severity == severity)


@pytest.fixture
def copy(drive: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(drive, tmp_path / "00"))


def rewrite(file: Path, change: Any) -> None:
    rows = np.fromfile(file, "<f4").reshape(-1, 4)
    np.asarray(change(rows), "<f4").tofile(file)


def edit_calibration(sequence: Path, name: str, change: Any) -> None:
    lines = []
    for line in (sequence / "calib.txt").read_text().splitlines():
        key, _, values = line.partition(":")
        matrix = np.array(values.split(), float).reshape(3, 4)
        matrix = change(matrix) if key == name else matrix
        lines.append(f"{key}: " + " ".join(f"{v:.9e}" for v in np.ravel(matrix)))
    (sequence / "calib.txt").write_text("\n".join(lines) + "\n")


def test_a_good_drive_has_no_problem(drive: Path, tmp_path: Path) -> None:
    report = check_inputs(source(drive), parameters(), tmp_path / "run")
    assert report.findings == []
    assert report.summary.startswith("5 sweeps of ")
    assert "image_2 (4 images); by estimate 0." in report.summary
    assert not (tmp_path / "run").exists()


def test_a_real_drive_has_no_problem_but_its_own(drive_9001: Path, drive_0005: Path) -> None:
    """The last sweep of drive 9001 lacks its lower lasers: the file was cut off."""
    (found,) = problems(drive_9001)
    assert "0000000077.bin (frame 77) has 1115504 bytes, the sweeps around it 17" in found.text
    assert problems(drive_0005) == []


def test_all_problems_are_told_at_once(copy: Path, tmp_path: Path) -> None:
    rewrite(copy / "velodyne" / "000004.bin", lambda rows: rows[:1])
    (copy / "image_2" / "000003.png").write_bytes(b"no image")
    edit_calibration(copy, "Tr", lambda Tr: Tr + np.array([0, 0, 0, 5.0]))
    (tmp_path / "poses.txt").write_text("1 2 3\n")
    (tmp_path / "file").write_text("")
    found = problems(copy, tmp_path / "file" / "run", poses=str(tmp_path / "poses.txt"))
    errors, warnings = texts(found, "error"), texts(found, "warning")
    for part in ("000004.bin (frame 4) has 1 usable", "000003.png is not a readable image",
                 "poses.txt has 3 columns", "file is a file; name a folder"):  # fmt: skip
        assert part in errors
    assert "are 8" in warnings
    assert "m apart; is Tr in" in warnings
    assert found[-1].severity == "warning"


def test_errors_of_the_recording_and_of_other_files_come_together(
    copy: Path, tmp_path: Path
) -> None:
    (copy / "times.txt").unlink()
    found = problems(copy, poses=str(tmp_path / "none"), camera_times=str(tmp_path / "also"))
    assert [p.severity for p in found] == ["error"] * 3
    for name, problem in zip(("times.txt", "also", "none"), found, strict=True):
        assert f"{name} is missing" in problem.text


def test_problems_are_raised_as_one_error() -> None:
    error = Finding("empty", "a.bin", "it is empty", "copy it", "error")
    other = Finding("empty", "", "b.bin is empty", severity="error")
    raise_findings([Finding("small", "", "small")])
    with pytest.raises(DatasetError) as raised:
        raise_findings([error])
    assert (raised.value.code, raised.value.remedy) == ("empty", "copy it")
    assert str(raised.value) == "a.bin: it is empty; copy it"
    with pytest.raises(SeveralProblems) as several:
        raise_findings([error, other])
    lines = "2 problems:\n  a.bin: it is empty; copy it\n  b.bin is empty"
    assert str(several.value) == lines


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda rows: rows[:1], "has 1 usable points of 1"),
        (lambda rows: np.where(np.arange(4) < 3, np.nan, rows), "has 0 usable points"),
        (
            lambda rows: np.full_like(rows[:500], 4),
            r"all points lie in one place, (4.00, 4.00, 4.00)",
        ),
        (lambda rows: rows * np.float32(1000), "m away (median); coordinates are in metres"),
    ],
)
def test_sweeps_of_garbage_are_errors(copy: Path, change: Any, text: str) -> None:
    rewrite(copy / "velodyne" / "000002.bin", change)
    errors = texts(problems(copy), "error")
    assert "000002.bin (frame 2)" in errors
    assert text in errors


def test_half_a_sweep_of_nan_is_told(copy: Path) -> None:
    def spoil(rows: np.ndarray) -> np.ndarray:
        rows[len(rows) // 2 :, :3] = np.nan
        return rows

    rewrite(copy / "velodyne" / "000003.bin", spoil)
    warnings = texts(problems(copy), "warning")
    assert "000003.bin (frame 3)" in warnings
    assert "in one piece" in warnings
    assert "are not finite" in warnings


def test_rows_without_returns_here_and_there_are_no_problem(copy: Path) -> None:
    for file in (copy / "velodyne").iterdir():
        rewrite(file, lambda r: np.where(np.arange(len(r))[:, None] % 2 == 0, np.nan, r))
    assert problems(copy) == []


@pytest.mark.parametrize("share", [0.1, 0.6])
def test_a_partial_sweep_is_told_though_it_is_not_opened(
    copy: Path, share: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The last one often, where a copy was interrupted."""
    monkeypatch.setattr("docdepth.diagnostics.sweeps.sample", lambda count, most=0: [0])
    rewrite(copy / "velodyne" / "000004.bin", lambda rows: rows[: int(share * len(rows))])
    assert "000004.bin (frame 4) has" in texts(problems(copy), "warning")


def test_parameters_that_leave_no_point(drive: Path) -> None:
    settings = {"odometry.min_range": 4.99, "odometry.max_range": 5.0}
    found = check_inputs(source(drive), parameters("default", settings)).findings
    assert "max_range=5 leave 0 % of the points" in texts(found, "error")


def test_point_times_in_seconds_of_the_day(copy: Path) -> None:
    (copy / "point_times").mkdir()
    for file in (copy / "velodyne").iterdir():
        times = np.full(file.stat().st_size // 16, 40000, "<f4")
        times.tofile(copy / "point_times" / file.name)
    assert "points are measured 4e+04 to 4e+04 sweeps after" in texts(problems(copy), "error")


def test_times_in_milliseconds_are_told(copy: Path) -> None:
    for table in (copy / "times.txt", copy / "image_2" / "times.txt"):
        times = [1000 * float(time) for time in table.read_text().split()]
        table.write_text("".join(f"{time:.6f}\n" for time in times))
    found = problems(copy)
    assert "sweeps are 100 s apart" in texts(found, "error")
    assert len(found) == 1
    with pytest.raises(OdometryError, match="Are the times in seconds"):
        register_drive(open_dataset(copy))


def test_sweeps_that_are_taken_seldom_need_poses(copy: Path) -> None:
    """A scanner that is carried from place to place: odometry cannot follow, given poses can."""
    for table in (copy / "times.txt", copy / "image_2" / "times.txt"):
        times = [100 * float(time) for time in table.read_text().split()]
        table.write_text("".join(f"{time:.6f}\n" for time in times))
    assert "sweeps are 10 s apart" in texts(problems(copy), "error")
    found = problems(copy, poses="dataset")
    assert "sweeps are 10 s apart" in texts(found, "warning")
    assert texts(found, "error") == ""


def test_images_of_another_size_are_found_before_they_are_needed(copy: Path) -> None:
    cv2.imwrite(str(copy / "image_2" / "000002.png"), np.zeros((40, 60, 3), np.uint8))
    errors = texts(problems(copy), "error")
    assert "000002.png is 60x40 pixels" in errors
    (copy / "image_2" / "000001.png").write_bytes(b"")
    assert "000001.png is empty" in texts(problems(copy), "error")


@pytest.mark.parametrize("what", ["half a png", "half a jpg", "small"])
def test_every_image_that_is_odd_is_opened(
    copy: Path, what: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("docdepth.diagnostics.cameras.sample", lambda count, most=0: [0])
    suffix = "jpg" if what == "half a jpg" else "png"
    image = np.random.default_rng(0).integers(0, 255, (375, 1242, 3), np.uint8)
    for file in (copy / "image_2").glob("*.png"):
        file.unlink()
    for k in range(4):
        cv2.imwrite(str(copy / "image_2" / f"{k:06d}.{suffix}"), image)
    assert texts(problems(copy), "error") == ""
    file = copy / "image_2" / f"000002.{suffix}"
    if what == "small":
        cv2.imwrite(str(file), image[::2])
    else:
        file.write_bytes(file.read_bytes()[:-5000])
    assert f"000002.{suffix} is" in texts(problems(copy), "error")


def test_images_of_another_time(copy: Path) -> None:
    table = copy / "image_2" / "times.txt"
    times = [float(time) for time in table.read_text().split()]
    table.write_text("".join(f"{time + 100:.6f}\n" for time in times))
    errors = texts(problems(copy), "error")
    assert "none of the 4 images of image_2 lies between" in errors
    assert "images are from 100.0" in errors
    assert "one clock" in errors
    table.write_text("".join(f"{time + 0.31:.6f}\n" for time in times))
    assert "3 of 4 images lie outside the sweeps" in texts(problems(copy), "warning")


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda P: P * np.array([[0.01], [0.01], [1]]) + 0, "is the image size right?"),
        (lambda P: P * np.array([[3.0, 1, 1, 1], [1] * 4, [1] * 4]), "focal lengths"),
        (lambda P: P - np.array([[0, 0, 30.0, 0], [0] * 4, [0] * 4]), "far from the centre"),
        (lambda P: P * [[1.3], [1.3], [1]], "125 x 52 pixels, but images have 96 x 40"),
        (lambda P: P / [[1.3], [1.3], [1]], "were they resized? Then scale K, too"),
    ],
)
def test_intrinsics_that_no_camera_has(copy: Path, change: Any, text: str) -> None:
    edit_calibration(copy, "P2", change)
    assert text in texts(problems(copy), "warning")


AXES = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])


def inverted(Tr: np.ndarray) -> np.ndarray:
    return np.c_[Tr[:, :3].T, -Tr[:, :3].T @ Tr[:, 3]]


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda Tr: Tr + np.array([0, 0, 0, 4.0]), "m apart; is Tr in"),
        (inverted, "is it the inverse, or was a quaternion read"),
        (lambda Tr: Tr[[1, 2, 0]], "are its axes in this order"),
        (lambda Tr: np.diag([-1.0, -1, 1]) @ Tr, "180 degrees away from down"),
    ],
)
def test_extrinsics_that_no_car_has(copy: Path, change: Any, text: str) -> None:
    edit_calibration(copy, "Tr", change)
    warnings = texts(problems(copy), "warning")
    assert text in warnings
    assert str(copy / "calib.txt") in warnings


def test_a_view_without_points(copy: Path) -> None:
    for file in (copy / "velodyne").iterdir():
        rewrite(file, lambda rows: rows[rows[:, 0] < 0])
    assert "0.0 % of the points of the sweeps fall into the image" in texts(
        problems(copy), "warning"
    )


def test_missing_extras_and_formats_are_found_first(
    drive: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "OpenEXR", None)
    values = parameters("default", {"output.format": "exr,png", "output.scale": 10000})
    errors = texts(check_inputs(source(drive), values).findings, "error")
    assert 'pip install "docdepth[exr]"' in errors
    assert "a PNG of metres x 10000 holds no more" in errors


# ---- memory, disk, output


def test_images_that_cannot_be_held_are_refused(drive: Path) -> None:
    with pytest.raises(CalibrationError, match="100000 x 100000 pixels need 450"):
        check_image_size(100_000, 100_000)
    check_image_size(96, 40)
    found = problems(drive, image_size="96x40")
    assert texts(found, "error") == texts(problems(drive), "error")


def test_a_run_that_needs_too_much_is_refused(
    drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(execution, "available_memory", lambda: 10**8)
    assert "pixels need 0.1 GB of memory by estimate, 0.1 GB are free" in texts(
        problems(drive), "error"
    )
    monkeypatch.setattr(execution, "available_memory", lambda: 240 * 10**6)
    assert "the run needs 0." in texts(problems(drive), "error")
    monkeypatch.undo()
    usage = shutil.disk_usage(tmp_path)._replace(free=10**6)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage)
    assert "1 MB are free there; make room" in texts(problems(drive, tmp_path / "run"), "error")


def test_memory_of_a_container_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(execution, "_CGROUP", tmp_path)
    (tmp_path / "memory.max").write_text("1000000\n")
    (tmp_path / "memory.current").write_text("900000\n")
    (tmp_path / "memory.stat").write_text("anon 500000\nactive_file 100000\ninactive_file 200000\n")
    assert execution.available_memory() == 400_000
    (tmp_path / "memory.max").write_text("max\n")
    free = execution.available_memory()
    assert free is not None
    assert free > 400_000


def test_outputs_that_cannot_be(copy: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "link").symlink_to(tmp_path / "gone")
    for output, text in (
        (tmp_path / "file", "file is a file"),
        (tmp_path / "link", "is a link to"),
        (copy, "lies in the recording"),
        (copy / "velodyne" / "run", "lies in the recording"),
    ):
        assert text in texts(problems(copy, output), "error")
    assert problems(copy, copy / "run") == []
    assert problems(copy, tmp_path / "a" / "b") == []


# ---- the range of frames


def test_frames_are_opened_and_poses_cut(drive: Path, tmp_path: Path) -> None:
    from docdepth.pipeline.run_inputs import known_poses, open_inputs

    lines = [f"{k}" + " 0 0 0 0 0 0 1" for k in range(5)]
    (tmp_path / "poses.txt").write_text("\n".join(lines))
    times = (drive / "image_2" / "times.txt").read_text()
    (tmp_path / "times.txt").write_text(times)
    given = source(
        drive, frames="1:3", poses=tmp_path / "poses.txt", camera_times=tmp_path / "times.txt"
    )
    opened = open_inputs(given)
    recording, streams = opened.recording, opened.cameras
    poses = known_poses(given, recording)
    assert len(recording) == 2
    assert poses is not None
    assert len(poses) == 2
    assert streams[0].names == ["000000", "000001", "000002"]
    assert check_inputs(given, parameters()).summary.startswith("2 sweeps of ")


def test_maps_of_other_times_are_named_like_the_files_of_the_sequence(
    copy: Path, tmp_path: Path
) -> None:
    from docdepth.pipeline.run_inputs import open_inputs

    for image in (copy / "image_2").glob("*.png"):
        image.unlink()
    (tmp_path / "times.txt").write_text("0.05\n0.15\n")
    streams = open_inputs(source(copy, camera_times=tmp_path / "times.txt")).cameras
    assert streams[0].names == ["000000", "000001"]


def test_a_sweep_that_is_a_copy_of_the_one_before(copy: Path) -> None:
    for k in (2, 3):
        shutil.copy(copy / "velodyne" / "000001.bin", copy / "velodyne" / f"00000{k}.bin")
    text = texts(problems(copy), "warning")
    assert "000002.bin (frame 2) is a copy of the sweep before it, and 1 more are like it" in text


def test_a_sweep_that_lacks_in_a_drive_of_four(copy: Path) -> None:
    for k in (2, 4):
        (copy / "velodyne" / f"00000{k}.bin").unlink()
    text = texts(problems(copy), "warning")
    assert "0.20 s lie between frames 1 and 2, usually 0.10 s; are sweeps missing?" in text


def test_a_clock_that_jumps_back_or_sweeps_of_two_lidars(copy: Path) -> None:
    lines = (copy / "times.txt").read_text().split()
    lines[3] = f"{float(lines[2]) + 0.001:.6f}"
    (copy / "times.txt").write_text("\n".join(lines))
    text = texts(problems(copy), "warning")
    assert "0.001 s lie between frames 2 and 3, usually 0.10 s; did the clock" in text


def test_poses_that_do_not_fit_the_sweeps(copy: Path, tmp_path: Path) -> None:
    """Poses in millimetres lead out of all that sweeps overlap."""
    poses = open_dataset(copy).poses
    assert poses is not None
    for factor in (1, 1000):
        poses[:, :3, 3] *= factor
        np.save(tmp_path / "poses.npy", poses)
        found = problems(copy, poses=str(tmp_path / "poses.npy"))
        assert texts(found, "error") == ""
        assert any(f.code == "poses-misfit" for f in found) == (factor > 1)
