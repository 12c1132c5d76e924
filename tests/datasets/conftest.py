"""Made-up recordings in KITTI's layouts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from kitti_drives import (
    R_RECT,
    R_VELO,
    T_VELO,
    P,
    numbers,
    write_sweeps,
)  # fmt: skip


@pytest.fixture
def raw(tmp_path: Path) -> Path:
    """A KITTI raw drive of four sweeps, with camera 02."""
    drive = tmp_path / "2011_09_26" / "2011_09_26_drive_0001_sync"
    write_sweeps(drive / "velodyne_points" / "data", 4, 10)
    stamps = [f"2011-09-26 13:02:25.{k}51199337" for k in range(4)]
    (drive / "velodyne_points" / "timestamps.txt").write_text("\n".join(stamps) + "\n")
    (drive.parent / "calib_cam_to_cam.txt").write_text(
        "calib_time: 09-Jan-2012 13:57:47\ncorner_dist: 9.950000e-02\n"
        f"S_rect_02: 1.242000e+03 3.750000e+02\nR_rect_00: {numbers(R_RECT)}\n"
        f"P_rect_02: {numbers(P)}\n"
    )
    (drive.parent / "calib_velo_to_cam.txt").write_text(
        f"calib_time: 15-Mar-2012 11:37:16\nR: {numbers(R_VELO)}\nT: {numbers(T_VELO)}\n"
    )
    return drive


@pytest.fixture
def sequence(tmp_path: Path) -> Path:
    """A KITTI odometry sequence of four sweeps, with camera 2."""
    sequence = tmp_path / "dataset" / "sequences" / "07"
    write_sweeps(sequence / "velodyne", 4, 6)
    (sequence / "times.txt").write_text("0.000000e+00\n1.036224e-01\n2.072400e-01\n3.1e-01\n")
    Tr = np.hstack([R_VELO, T_VELO[:, None]])
    (sequence / "calib.txt").write_text(f"P2: {numbers(P)}\nTr: {numbers(Tr)}\n")
    (sequence / "image_2").mkdir()
    (sequence / "image_2" / "size.txt").write_text("1242 375\n")
    return sequence
