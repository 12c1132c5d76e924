"""Read a recording in a format of your own: a class with the members of ``docdepth.Dataset``.

    python examples/own_dataset.py FOLDER

Here FOLDER holds ``sweeps/*.npy`` (float32 (N, 3), LiDAR frame, metres) and ``times.npy`` (int64
(n,), nanoseconds). Poses are estimated and moving points counted.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import docdepth


class NpyDrive:
    """A folder of sweeps as NumPy files."""

    def __init__(self, path: Path) -> None:
        self.name, self.path = "npy", path
        self.files = sorted((path / "sweeps").glob("*.npy"))
        self.times = np.load(path / "times.npy")
        self.poses = None  # or T_world_lidar, float64 (n, 4, 4)
        names = [file.stem for file in self.files]
        self.lidars = {"lidar": docdepth.LidarStream("lidar", self.times, names)}
        self.cameras: dict[str, docdepth.CameraStream] = {}

    def __len__(self) -> int:
        return len(self.files)

    def sweep(self, index: int) -> docdepth.Sweep:
        """Read one sweep. Add ``relative_time`` so that raw sweeps are deskewed."""
        file = self.files[index]
        points, time = np.load(file), int(self.times[index])
        return docdepth.Sweep(points, file.stem, time, motion_compensated=True)

    def sweep_files(self, index: int) -> list[Path]:
        """What ``sweep(index)`` reads, so that a run notices when it changes."""
        return [self.files[index]]

    def labels(self, index: int) -> None:
        """True SemanticKITTI labels, uint32 (N,), if there are any."""


def main(arguments: list[str]) -> None:
    drive = NpyDrive(Path(arguments[0]))
    odometry = docdepth.register_drive(drive)
    labels = docdepth.classify_drive(odometry.sweeps, odometry.trajectory)
    for k, found in enumerate(labels):
        x, y, z = odometry.trajectory.poses[k, :3, 3]
        dynamic = int((found.classid >= 100).sum())
        print(f"sweep {k} at ({x:.2f}, {y:.2f}, {z:.2f}) m: {dynamic} dynamic points")


if __name__ == "__main__":
    main(sys.argv[1:])
