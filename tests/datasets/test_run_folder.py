"""A run folder as a recording: its maps keep their names."""

from __future__ import annotations

import filecmp
import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from docdepth import run
from docdepth.datasets import open_dataset
from docdepth.errors import DocDepthError
from docdepth.pipeline.convert import convert
from small_drive import write_small_drive

NAMES = ["000001", "000002", "000003"]


@pytest.fixture(scope="module")
def part(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of the second to fourth sweep."""
    root = tmp_path_factory.mktemp("part")
    drive, poses = write_small_drive(root / "00"), root / "poses.txt"
    poses.write_text("".join(f"1 0 0 {0.5 * k} 0 1 0 0 0 0 1 0\n" for k in range(4)))
    return run(drive, root / "run", poses=poses, frames="1:4").path


@pytest.mark.parametrize(
    "spoil",
    [
        lambda maps: maps.pop("000002"),
        lambda maps: maps.update({"../../000002": maps.pop("000002")}),
        lambda maps: maps["000002"].pop("time_ns"),
    ],
)
def test_names_that_are_not_all_there_or_lead_elsewhere_are_numbers(part: Path, spoil: Any) -> None:
    file = part / "depth" / "depth.json"
    text = file.read_text()
    described = json.loads(text)
    assert open_dataset(part).cameras["camera"].names == NAMES
    spoil(described["maps"])
    try:
        file.write_text(json.dumps(described))
        names = open_dataset(part).cameras["camera"].names
        assert [len(name) for name in names] == [10] * 3
        file.write_text("{")
        assert open_dataset(part).cameras["camera"].names == names
    finally:
        file.write_text(text)


def test_frames_may_be_deleted_and_come_back(part: Path, tmp_path: Path) -> None:
    run_again = tmp_path / "run"
    shutil.copytree(part, run_again)
    shutil.rmtree(run_again / "frames")
    assert convert(run_again, tmp_path / "poses.txt", "tum") == len(NAMES)
    for use in (
        lambda: convert(run_again, tmp_path / "labels", "label"),
        lambda: open_dataset(run_again).sweep_files(1),
        lambda: open_dataset(run_again).sweep(1),
    ):
        with pytest.raises(DocDepthError, match=r"frame_0.* is missing"):
            use()
    run(part.parent / "00", run_again, poses=part.parent / "poses.txt", frames="1:4")
    same = filecmp.dircmp(part, run_again, ignore=[".docdepth", "report", "run.yaml"])
    assert not same.left_only
    assert not same.right_only
    for folder in ("frames", "labels", "depth"):
        names = [file.name for file in (part / folder).iterdir()]
        assert filecmp.cmpfiles(part / folder, run_again / folder, names, shallow=False)[0] == names
