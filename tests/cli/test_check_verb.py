"""``docdepth check`` tells all problems at once."""

from __future__ import annotations

import shutil
from pathlib import Path

from command_line import cli


def test_a_good_drive(drive: Path) -> None:
    result = cli("check", drive)
    assert result.exit_code == 0, result.output
    assert "ok: 5 sweeps" in result.output


def test_all_problems_and_exit_code_2(drive: Path, tmp_path: Path) -> None:
    copy = Path(shutil.copytree(drive, tmp_path / "00"))
    (copy / "velodyne" / "000001.bin").write_bytes(b"")
    (copy / "times.txt").unlink()
    (tmp_path / "file").write_text("")
    result = cli("check", copy, "-o", tmp_path / "file")
    assert result.exit_code == 2
    assert result.output.count("error:") == 3
    for part in ("000001.bin (frame 1) is empty", "times.txt is missing", "is a file"):
        assert part in result.output


def test_options_are_those_of_run(drive: Path) -> None:
    result = cli("check", drive, "--frames", "1:4", "--format", "npy", "--camera", "image_2")
    assert result.exit_code == 0, result.output
    assert "ok: 3 sweeps" in result.output
    assert cli("check", drive, "--frames", "9:").exit_code == 2
