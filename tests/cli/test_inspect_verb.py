"""``docdepth inspect`` prints figures and problems, and writes a page that needs nothing else."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path

import numpy as np
import pytest

from command_line import cli
from docdepth.datasets import open_dataset
from docdepth.geometry.se3 import inverse
from docdepth.io.poses import write_kitti
from docdepth.visualization.inspection import inspection_lines
from motion import straight
from small_drive import write_small_drive


def test_figures_and_a_page_with_pictures(drive: Path, tmp_path: Path) -> None:
    page = tmp_path / "drive.html"
    result = cli("inspect", drive, "-o", page)
    assert result.exit_code == 0, result.output
    for part in ("26 beams; sees 360", ": 10 a second, 100 ms apart", f"pictures: {page}"):
        assert part in result.output
    assert re.search(
        r"ground +1\.\d+ m below the origin; z is [0-2]\S* degrees from", result.output
    )
    assert "warning" not in result.output
    text = page.read_text()
    assert "No problem was found." in text
    assert len(re.findall(r'src="data:image/jpeg;base64,', text)) >= 5
    assert not re.search(r'src="(?!data:)|href=', text), "nothing else is needed"
    assert cli("inspect", drive, "-o", page, "--frames", "1:4").exit_code == 0, "it is replaced"
    assert "count</td><td>3" in page.read_text()


def test_figures_that_are_not_known_are_said_so(tmp_path: Path) -> None:
    """A single sweep of points without times."""
    lines = list(
        inspection_lines(
            {
                "recording": {"path": "a", "format": "folder"},
                "sweeps": {"count": 1, "from_s": 12.5, "motion_compensated": False, "to_s": 12.5},
                "lidars": [
                    {
                        "name": "top",
                        "points": 9,
                        "range_m": [1, 2, 3, 4.26],
                        "field_of_view_deg": {"horizontal": 70, "vertical": [-5, 5]},
                        "beams": None,
                        "spacing_deg": None,
                        "same_ray": 0.0,
                        "same_point": 0.0,
                    }
                ],
                "rows": {"not_finite": 0.25, "at_origin": 0.0, "close": 0.0, "one_place": 0.0},
                "point_times": None,
                "ground": None,
                "poses": None,
            }
        )
    )
    assert [line.strip() for line in lines] == [
        "a, read as folder",
        "sweeps    1, at 12.500 s",
        "points have no times",
        "LiDAR     top: 9 points from 1.0 to 4 m, half of them within 2.0 m, 99 % within 3 m",
        "no beams that can be told apart; sees 70 degrees around, from -5 to 5 degrees of "
        "elevation",
        "rows      at most, of a sweep: 25 % are not finite",
        "ground    not found",
        "poses     none: a run estimates them",
    ]


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
    os.mkfifo(tmp_path / "pipe")
    assert "no regular file" in str(cli("inspect", sequence, "-o", tmp_path / "pipe").exception)
    (link := tmp_path / "link.html").symlink_to("page.html")
    assert cli("inspect", sequence, "-o", link).exit_code == 0
    assert link.readlink() == Path("page.html")
    assert "<html" in (tmp_path / "page.html").read_text()


@pytest.mark.parametrize("with_poses", [True, False])
def test_a_problem_ends_with_exit_code_2_after_the_page(tmp_path: Path, with_poses: bool) -> None:
    sequence = write_small_drive(tmp_path / "00")
    write_kitti(tmp_path / "poses.txt", straight(4, 0.5).poses)
    (sequence / "velodyne" / "000002.bin").write_bytes(b"\0" * 16)
    options = ["--poses", tmp_path / "poses.txt"] if with_poses else []
    result = cli("inspect", sequence, "-o", tmp_path / "a.html", *options)
    assert result.exit_code == 2
    assert "000002.bin (frame 2) has 0 usable points" in result.output
    assert "000002.bin" in (tmp_path / "a.html").read_text()
