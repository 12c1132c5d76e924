"""A drive of a few small sweeps and images, so that a whole run takes a fraction of a second."""

from pathlib import Path

import cv2
import numpy as np

from motion import straight
from walled_yard import scan

SWEEPS, WIDTH, HEIGHT = 4, 96, 40
SPARSE = 7  # one ray of so many is measured
TR = "0 -1 0 0.02 0 0 -1 -0.06 1 0 0 -0.3"


def write_small_drive(folder: Path, sweeps: int = SWEEPS, images: bool = True) -> Path:
    """Write a KITTI odometry sequence with two cameras; returns its folder."""
    folder.mkdir(parents=True)
    for k, pose in enumerate(straight(sweeps, 0.5).poses):
        write_sweep(folder, k, scan(pose, -8 + 1.5 * k, SPARSE)[0])
    rows = [f"P{n}: 60 0 48 {-30 * (n - 2)} 0 60 20 0 0 0 1 0" for n in (2, 3)]
    (folder / "calib.txt").write_text("\n".join([*rows, f"Tr: {TR}"]) + "\n")
    (folder / "times.txt").write_text("".join(f"{k / 10:.6f}\n" for k in range(sweeps)))
    for n in (2, 3) if images else ():
        (folder / f"image_{n}").mkdir()
        for k in range(sweeps):
            write_image(folder / f"image_{n}" / f"{k:06d}.png", seed=10 * n + k)
    return folder


def write_sweep(folder: Path, k: int, points: np.ndarray) -> None:
    (folder / "velodyne").mkdir(exist_ok=True)
    rows = np.zeros((len(points), 4), np.float32)
    rows[:, :3] = points
    rows.tofile(folder / "velodyne" / f"{k:06d}.bin")


def write_image(path: Path, seed: int) -> None:
    noise = np.random.default_rng(seed).integers(0, 255, (HEIGHT, WIDTH, 3), np.uint8)
    cv2.imwrite(str(path), noise)


def results(folder: Path) -> dict[str, bytes]:
    """Content of every file of a run that tells no times, by its name."""
    found = {p.relative_to(folder).as_posix(): p for p in folder.rglob("*") if p.is_file()}
    return {
        name: path.read_bytes()
        for name, path in found.items()
        if not name.startswith(".docdepth/")
        and name not in ("run.yaml", "run.yaml.old", "report/index.html")
    }
