"""What made-up KITTI recordings are written of."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from made_up import DRIVE, SIZE, K

from docdepth.geometry.se3 import inverse, poses_from, rotation_exp

R_RECT = rotation_exp([0.01, -0.004, 0.002])
BESIDE = np.array([0.06, 0.0003, 0.003])  # metres from the reference camera to the one of images
P = np.hstack([K, (K @ BESIDE)[:, None]])


def numbers(matrix) -> str:
    return " ".join(f"{value:.15e}" for value in np.ravel(matrix))


def moved(rotation: np.ndarray, translation=(0, 0, 0)) -> np.ndarray:
    return poses_from([rotation], [translation])[0]


def T_camera0_lidar(rectified: bool) -> np.ndarray:
    """Of the reference camera, rectified or not, so that the camera of images is the drive's."""
    T = inverse(moved(np.eye(3), BESIDE)) @ DRIVE.T_camera_lidar
    return T if rectified else inverse(moved(R_RECT)) @ T


def date(time: int) -> str:
    return f"{np.datetime64(int(time), 'ns')}\n".replace("T", " ")


def write_velodyne(folder: Path, digits: int) -> Path:
    """The sweeps, and the folder."""
    folder.mkdir(parents=True)
    for k in range(DRIVE.count):
        table = np.column_stack([DRIVE.points(k), DRIVE.rows(k)["intensity"]]).astype("<f4")
        table.tofile(folder / f"{k:0{digits}d}.bin")
    return folder


S_RECT = f"S_rect_02: {SIZE[0]}.0 {SIZE[1]}.0\n"
