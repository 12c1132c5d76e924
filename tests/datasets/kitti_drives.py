"""What made-up KITTI recordings are written of."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from docdepth.geometry.se3 import poses_from, rotation_exp

P = np.array([[700.0, 0, 600, 45], [0, 700, 180, 0.2], [0, 0, 1, 0.003]])
R_RECT = rotation_exp([0.01, -0.004, 0.002])
AXES = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])  # camera x = -lidar y, y = -z, z = x
R_VELO = rotation_exp([0.01, 0.02, -0.01]) @ AXES
T_VELO = np.array([0.1, -0.08, -0.27])


def numbers(matrix) -> str:
    return " ".join(f"{value:.12e}" for value in np.ravel(matrix))


def write_sweeps(folder: Path, count: int, digits: int) -> list[np.ndarray]:
    folder.mkdir(parents=True)
    rng = np.random.default_rng(0)
    sweeps = [rng.normal(0, 10, (50 + k, 4)).astype("<f4") for k in range(count)]
    for k, sweep in enumerate(sweeps):
        sweep.tofile(folder / f"{k:0{digits}d}.bin")
    return sweeps


def write_image(file: Path, width: int = 1242, height: int = 375) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(file), np.zeros((height, width), np.uint8))


def some_poses(count: int) -> np.ndarray:
    vectors = np.linspace([0, 0, 0], [0.02, -0.01, 0.3], count)
    return poses_from(list(rotation_exp(vectors)), np.linspace([0, 0, 0], [5, 1, 0.2], count))
