"""What a sweep costs beside its points, by the length of the drive and the number of workers.

    python benchmarks/bookkeeping.py OUT [--frames 2000 8000 20000] [--jobs 1 2]

The drive is as long as the longest run; with other lengths, give another OUT.

The sweeps are tiny (480 rays, a street between two walls), and so are the images (64 x 24), with
poses given. So nearly all time goes to files, records, tracks and the choice of sweeps, which must
not grow with the drive. Two tracks for every three sweeps are made up, each 24 sweeps long, as many
as on drive 0005. Times are those of the stages, and of the whole process and its children.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from cost import measured
from numpy.typing import NDArray

STEP = 1.0
"""Path of a sweep [m]."""

HEIGHT, WALL, REACH = 1.7, 10.0, 80.0
"""Of the LiDAR above the road, to the walls beside it, and of its rays [m]."""

TRACK_SWEEPS = 24
CAMERA = np.array([[40.0, 0, 32, 0], [0, 40, 12, 0], [0, 0, 1, 0]])
T_CAMERA_LIDAR = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0]])


def write_drive(sequence: Path, sweeps: int) -> None:
    """A drive in the format ``kitti_odometry``."""
    azimuth = np.linspace(-np.pi, np.pi, 60, endpoint=False)
    a, e = np.meshgrid(azimuth, np.radians(np.linspace(-20, 2, 8)), indexing="ij")
    rays = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], -1).reshape(-1, 3)
    road = np.where(rays[:, 2] < 0, HEIGHT / np.maximum(-rays[:, 2], 1e-9), np.inf)
    distance = np.minimum(road, WALL / np.maximum(np.abs(rays[:, 1]), 1e-9))
    points = (rays * distance[:, None])[distance < REACH]
    content = np.column_stack([points, np.ones(len(points))]).astype(np.float32).tobytes()
    for folder in ("velodyne", "image_2"):
        (sequence / folder).mkdir(parents=True, exist_ok=True)
    for k in range(sweeps):
        (sequence / "velodyne" / f"{k:06d}.bin").write_bytes(content)

    def row(matrix: NDArray[np.float64]) -> str:
        return " ".join(f"{value:.9g}" for value in matrix.ravel())

    lines = [f"P{k}: {row(CAMERA)}\n" for k in range(4)] + [f"Tr: {row(T_CAMERA_LIDAR)}\n"]
    (sequence / "calib.txt").write_text("".join(lines))
    poses = np.repeat(np.eye(4)[None, :3], sweeps, 0)
    poses[:, 2, 3] = STEP * np.arange(sweeps)  # of the camera, whose z points forward
    np.savetxt(sequence / "poses.txt", poses.reshape(sweeps, 12), fmt="%.6f")
    for path in (sequence / "times.txt", sequence / "image_2" / "times.txt"):
        np.savetxt(path, 0.1 * np.arange(sweeps), fmt="%.6f")
    (sequence / "image_2" / "size.txt").write_text("64 24\n")


def made_up_tracks(
    read: Callable[[int], Any],
    trajectory: Any,
    take: Callable[[Any], None],
    threads: int = 0,
) -> list[Any]:
    """In place of :func:`docdepth.dynamics.tracking.follow_tracks`."""
    from docdepth.dynamics.tracking import TrackedSweep
    from docdepth.geometry.track import KINDS, MAX_TRACKS, Track

    rng, tracks = np.random.default_rng(0), []
    for _ in range(len(trajectory)):
        take(TrackedSweep())
    for first in np.arange(0, len(trajectory) - TRACK_SWEEPS, 1.5).astype(int)[:MAX_TRACKS]:
        rows = slice(first, first + TRACK_SWEEPS)
        poses = np.repeat(np.eye(4)[None], TRACK_SWEEPS, 0)
        poses[:, :3, 3] = trajectory.poses[rows, :3, 3] + (20, 4, -HEIGHT) + rng.normal(size=3)
        number, known = len(tracks) + 1, np.full(TRACK_SWEEPS, 0.05)
        about = np.array([4.0, 1.8, 1.5]), np.full(TRACK_SWEEPS, 50), known, known
        times, still = trajectory.times[rows], np.zeros((TRACK_SWEEPS, 3))
        tracks.append(Track(number, KINDS[number % 3], times, poses, still, *about))
    return tracks


def sequence_in(out: Path) -> Path:
    return out / "tiny_sweeps" / "sequences" / "00"


def run_in(out: Path) -> Path:
    return out / "tiny_sweeps_run"


def run_drive(out: Path, frames: int, jobs: int) -> None:
    """``docdepth run`` with made-up tracks, which are found in this process."""
    from docdepth import cli
    from docdepth.dynamics import sweep_classifier

    sweep_classifier.follow_tracks = made_up_tracks  # type: ignore[attr-defined]
    cli.keep_memory()
    options = f"--poses dataset --frames 0:{frames} --threads 1 --jobs {jobs} -q".split()
    command = ["run", str(sequence_in(out)), "-o", str(run_in(out)), *options]
    cli.app(command, standalone_mode=False)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--frames", type=int, nargs="+", default=[2000, 8000, 20_000])
    parser.add_argument("--jobs", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--alone", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.alone:
        run_drive(options.out, options.frames[0], options.jobs[0])
        return
    sequence = sequence_in(options.out)
    if not (sequence / "times.txt").is_file():
        write_drive(sequence, max(options.frames))
    print("| sweeps | jobs | classify, ms of wall time a sweep | render | whole run | processor |")
    print("| --- | --- | --- | --- | --- | --- |")
    for frames in options.frames:
        for jobs in options.jobs:
            print(row_of(options.out, frames, jobs), flush=True)


def row_of(out: Path, frames: int, jobs: int) -> str:
    """A row of the table: a run in a process of its own."""
    import yaml

    run = run_in(out)
    command = [sys.executable, __file__, str(out), "--alone"]
    command += ["--frames", str(frames), "--jobs", str(jobs)]
    shutil.rmtree(run, ignore_errors=True)
    processor, wall = measured(lambda: subprocess.run(command, check=True))
    stages = yaml.safe_load((run / "run.yaml").read_text())["stages"]
    seconds = [stages[name]["wall_seconds"] for name in ("classify", "render image_2")]
    cells = [f"{1e3 * value / frames:.1f}" for value in (*seconds, wall, processor)]
    return f"| {frames:,} | {jobs} | " + " | ".join(cells) + " |"


if __name__ == "__main__":
    main()
