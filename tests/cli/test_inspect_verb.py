"""``docdepth inspect`` prints figures and problems, and writes a page that needs nothing else."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from command_line import cli
from docdepth.datasets import open_dataset
from docdepth.geometry.se3 import inverse
from docdepth.io.poses import write_kitti
from small_drive import write_small_drive


def test_figures_and_a_page_with_pictures(drive: Path, tmp_path: Path) -> None:
    page = tmp_path / "drive.html"
    result = cli("inspect", drive, "-o", page)
    assert result.exit_code == 0, result.output
    for part in ("beams: 16", "rate [Hz]: 10", "tilt [degrees]: ", f"pictures: {page}"):
        assert part in result.output
    assert "warning" not in result.output
    text = page.read_text()
    assert "No problem was found." in text
    assert len(re.findall(r'src="data:image/jpeg;base64,', text)) >= 5
    assert not re.search(r'src="(?!data:)|href=', text), "nothing else is needed"
    assert cli("inspect", drive, "-o", page, "--frames", "1:4").exit_code == 0, "it is replaced"
    assert "count</td><td>3" in page.read_text()


def test_json_and_wrong_poses(drive: Path, tmp_path: Path) -> None:
    poses = open_dataset(drive).poses
    assert poses is not None
    write_kitti(tmp_path / "poses.txt", inverse(poses))
    page = tmp_path / "drive.html"
    result = cli("inspect", drive, "-o", page, "--poses", tmp_path / "poses.txt", "--json")
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    (wrong,) = [f for f in found["findings"] if f["severity"] == "warning"]
    assert "T_lidar_world" in wrong["text"]
    assert found["poses"]["source"] == "file"
    assert "give their inverses" in page.read_text()
    told = cli("inspect", drive, "-o", page, "--poses", tmp_path / "poses.txt")
    assert told.output.count("give their inverses") == 1


def test_errors_of_poses_and_pages(tmp_path: Path) -> None:
    sequence = write_small_drive(tmp_path / "00")
    poses = np.repeat(np.eye(4)[None], 4, axis=0)
    poses[:, 1, 1] = -1
    write_kitti(tmp_path / "poses.txt", poses)
    result = cli("inspect", sequence, "-o", tmp_path / "a.html", "--poses", tmp_path / "poses.txt")
    assert result.exit_code == 2
    assert "left-handed" in str(result.exception)
    other = tmp_path / "other.html"
    other.write_text("mine")
    result = cli("inspect", sequence, "-o", other)
    assert result.exit_code == 2
    assert "is no page of docdepth; name another file" in str(result.exception)
    assert other.read_text() == "mine"
    assert "is a folder" in str(cli("inspect", sequence, "-o", tmp_path).exception)


@pytest.mark.parametrize("with_poses", [True, False])
def test_a_problem_ends_with_exit_code_2_after_the_page(tmp_path: Path, with_poses: bool) -> None:
    sequence = write_small_drive(tmp_path / "00")
    poses = np.repeat(np.eye(4)[None], 4, axis=0)
    poses[:, 0, 3] = 0.5 * np.arange(4)
    write_kitti(tmp_path / "poses.txt", poses)
    (sequence / "velodyne" / "000002.bin").write_bytes(b"\0" * 16)
    options = ["--poses", tmp_path / "poses.txt"] if with_poses else []
    result = cli("inspect", sequence, "-o", tmp_path / "a.html", *options)
    assert result.exit_code == 2
    assert "000002.bin (frame 2) has 0 usable points" in result.output
    assert "000002.bin" in (tmp_path / "a.html").read_text()
