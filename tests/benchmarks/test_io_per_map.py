"""Counts of sweeps read and triangulated, from benchmarks/io_per_map.py."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "io_per_map.py"


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/io").exists(), reason="bytes are counted on Linux only")
def test_every_stage_is_counted(drive: Path) -> None:
    # In a process of its own: it replaces functions of docdepth.
    command = [sys.executable, str(SCRIPT), str(drive)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    rows = [line.split() for line in done.stdout.splitlines()[-4:]]
    assert [row[0] for row in rows] == ["odometry", "classify", "render", "all"]
    read, frames, triangulated, megabytes, written = (float(x) for x in rows[3][1:])
    assert read >= 5 / 4  # five sweeps, four images
    assert frames >= 5 / 4
    assert triangulated >= 5 / 4
    assert megabytes > 1
    assert written > 0.1
