"""``--on-error skip``: a run without the broken frames is that of a recording that lacks them."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from command_line import cli
from docdepth.datasets import FrameRange, open_dataset
from docdepth.errors import DatasetError
from docdepth.io.run_folder import RunFolder
from docdepth.pipeline.plan import states
from docdepth.pipeline.run import run
from small_drive import results, write_image, write_small_drive

COUNT = 9
BROKEN = (0, 3, 7)
IMAGE = 5  # broken, too


def spoil(drive: Path) -> None:
    """Three broken sweeps, of them the first, and a broken image."""
    sweeps = [drive / "velodyne" / f"{k:06d}.bin" for k in BROKEN]
    sweeps[0].write_bytes(b"")
    sweeps[1].write_bytes(sweeps[1].read_bytes()[:-5])
    points = np.fromfile(sweeps[2], np.float32)
    points[:] = np.nan
    points.tofile(sweeps[2])
    (drive / "image_2" / f"{IMAGE:06d}.png").write_bytes(b"no image")


def lacking(drive: Path) -> None:
    """As if the broken frames had not been recorded."""
    for k in BROKEN:
        (drive / "velodyne" / f"{k:06d}.bin").unlink()
        (drive / "image_2" / f"{k:06d}.png").unlink()
    (drive / "image_2" / f"{IMAGE:06d}.png").unlink()


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    return write_small_drive(tmp_path / "drive", COUNT)


def make(drive: Path, output: Path, *more: object):
    return cli("run", drive, "-o", output, "--camera", "image_2", *more)


def told(folder: Path) -> list[str]:
    return json.loads(cli("status", folder, "--json").stdout)["skipped"]


def test_broken_frames_are_as_if_they_had_not_been_recorded(drive: Path, tmp_path: Path) -> None:
    shutil.copytree(drive, tmp_path / "lacking" / "drive")
    lacking(tmp_path / "lacking" / "drive")
    assert make(tmp_path / "lacking" / "drive", tmp_path / "without").exit_code == 0
    spoil(drive)
    stopped = make(drive, tmp_path / "run")
    assert stopped.exit_code == 2
    assert f"{BROKEN[0]:06d}.bin (frame {BROKEN[0]})" in str(stopped.exception)

    result = make(drive, tmp_path / "run", "--on-error", "skip")
    assert result.exit_code == 0, result.output
    made, expected = results(tmp_path / "run"), results(tmp_path / "without")
    assert made.keys() == expected.keys()
    assert [name for name in made if made[name] != expected[name]] == []
    assert len([name for name in made if name.startswith("labels/")]) == COUNT - len(BROKEN)
    for folder, suffix in (("labels", "label"), ("depth", "png")):
        for k in BROKEN:
            assert not (tmp_path / "run" / folder / f"{k:06d}.{suffix}").exists()
    assert {state.state for state in states(RunFolder.open(tmp_path / "run"))} == {"done"}

    lines = told(tmp_path / "run")
    reasons = ["is empty", "not a multiple of 16", "0 usable points", "not a readable image"]
    for line, k, reason in zip(lines, (*BROKEN, IMAGE), reasons, strict=True):
        assert f"{k:06d}" in line
        assert reason in line
    text = cli("status", tmp_path / "run").stdout
    page = (tmp_path / "run" / "report" / "index.html").read_text()
    for line in lines:
        assert f"left out: {line}" in text
        assert line in page


def test_frames_are_read_for_it_once(drive: Path, tmp_path: Path, monkeypatch) -> None:
    spoil(drive)
    read: list[int] = []
    sweep = FrameRange.sweep

    def counted(self: FrameRange, index: int):
        read.append(index)
        return sweep(self, index)

    assert make(drive, tmp_path / "run", "--on-error", "skip").exit_code == 0
    monkeypatch.setattr(FrameRange, "sweep", counted)
    for again in ((drive, "-o", tmp_path / "run"), (tmp_path / "run",)):
        read.clear()
        assert cli("run", *again).exit_code == 0
        assert len(read) < 4
    assert len(told(tmp_path / "run")) == 4


def test_a_mended_frame_comes_back_and_another_goes(drive: Path, tmp_path: Path) -> None:
    whole = (drive / "velodyne" / "000003.bin").read_bytes()
    spoil(drive)
    assert make(drive, tmp_path / "run", "--on-error", "skip").exit_code == 0
    (drive / "velodyne" / "000003.bin").write_bytes(whole)
    write_image(drive / "image_2" / f"{IMAGE:06d}.png", seed=1)
    (drive / "velodyne" / "000006.bin").unlink()  # a file that is lost
    (drive / "velodyne" / "000006.bin").symlink_to(tmp_path / "nowhere")
    assert cli("run", tmp_path / "run").exit_code == 0
    assert [line.split(":")[0] for line in told(tmp_path / "run")] == [
        "sweep 0", "sweep 6", "sweep 7"
    ]  # fmt: skip
    assert not (tmp_path / "run" / "labels" / "000006.label").exists()
    assert (tmp_path / "run" / "labels" / "000003.label").exists()
    assert (tmp_path / "run" / "depth" / f"{IMAGE:06d}.png").exists()


def test_a_frame_that_breaks_meanwhile_is_left_out(drive: Path, tmp_path: Path) -> None:
    def progress(stage: str, done: int, total: int) -> None:
        if stage == "register" and done == 1:
            (drive / "velodyne" / "000008.bin").write_bytes(b"")

    run(drive, tmp_path / "run", camera="image_2", on_error="skip", progress=progress, threads=1)
    assert [line.split(":")[0] for line in told(tmp_path / "run")] == ["sweep 8"]
    assert len(list((tmp_path / "run" / "frames").iterdir())) == COUNT - 1
    assert make(drive, tmp_path / "run", "--on-error", "stop").exit_code == 2


def test_what_stops_a_run_names_the_option_that_leaves_it_out(drive: Path, tmp_path: Path) -> None:
    image, sweep = drive / "image_2" / "000002.png", drive / "velodyne" / "000004.bin"
    content = bytearray(image.read_bytes())
    content[len(content) // 2] ^= 255  # begin and end are whole, so nothing says so before

    def broken_image(stage: str, done: int, total: int) -> None:
        if stage == "render":
            image.write_bytes(content)

    def broken_sweep(stage: str, done: int, total: int) -> None:
        if stage == "register":
            sweep.write_bytes(b"")

    for broken, file in ((broken_sweep, sweep), (broken_image, image)):
        whole, out = file.read_bytes(), tmp_path / file.stem
        with pytest.raises(
            DatasetError, match=rf"{file.name}.*; or leave it out by `on_error='skip'`"
        ):
            run(drive, out, camera="image_2", progress=broken, threads=1)
        with pytest.raises(
            DatasetError, match=rf"{file.name}.*; or leave it out by `on_error='skip'`"
        ):
            run(drive, out, camera="image_2")
        run(drive, out, camera="image_2", on_error="skip")
        file.write_bytes(whole)


def test_a_recording_that_is_broken_is_refused(drive: Path, tmp_path: Path) -> None:
    for k in range(0, COUNT, 2):
        (drive / "velodyne" / f"{k:06d}.bin").write_bytes(b"12345")
    result = make(drive, tmp_path / "run", "--on-error", "skip")
    assert result.exit_code == 2
    assert "5 of 9 sweeps are broken" in str(result.exception)
    assert "(frame 0)" in str(result.exception)
    assert make(drive, tmp_path / "run", "--on-error", "never").exit_code == 2


def test_a_recording_of_another_format_is_refused(drive: Path, tmp_path: Path) -> None:
    for k in range(COUNT):
        file = drive / "velodyne" / f"{k:06d}.bin"
        points = np.fromfile(file, np.float32).reshape(-1, 4)
        rows = np.zeros((len(points) // 4 * 4, 5), np.float32)
        rows[:, :4] = points[: len(rows)]
        rows.tofile(file)
    result = make(drive, tmp_path / "run", "--on-error", "skip")
    assert result.exit_code == 2
    assert "looks like 5 float32 a point" in str(result.exception)


def test_ranges_without_some_sweeps(drive: Path) -> None:
    whole = open_dataset(drive)
    part = FrameRange(whole, "1:8", [3, 4], {"image_2": ["000006"]})
    assert part.indices == [1, 2, 5, 6, 7]
    np.testing.assert_array_equal(part.times, whole.times[part.indices])
    assert [part.sweep(k).name for k in range(len(part))] == [f"{k:06d}" for k in part.indices]
    assert part.cameras["image_2"].names == [f"{k:06d}" for k in (0, 1, 2, 5, 7, 8)]
    assert part.cameras["image_3"].names == [f"{k:06d}" for k in (0, 1, 2, 5, 6, 7, 8)]
    assert next(iter(part.lidars.values())).names == [f"{k:06d}" for k in part.indices]
    with pytest.raises(DatasetError, match="every sweep is broken"):
        FrameRange(whole, "1:3", [1, 2])
