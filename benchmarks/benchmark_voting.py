"""Speed of voting on a recorded drive, compared with a plain loop of Algorithm 1 (paper IV-C).

    python benchmarks/benchmark_voting.py DRIVE [--poses FILE] [--sweeps 5] [--repeat 5]

DRIVE is any recording that ``docdepth`` opens. Prints medians of runs that take turns. With one
core, processor time is measured, so that results also hold on a busy machine. The votes of both are
compared. Ground is taken by height: here it only sets how many points are voted on.
"""

from __future__ import annotations

import argparse
import statistics
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from timing import interleaved

import docdepth._core as _core
from docdepth.config import parameters
from docdepth.datasets import Dataset, open_dataset
from docdepth.dynamics.key_frames import key_frames
from docdepth.geometry.trajectory import Trajectory
from docdepth.io.poses import read_poses

PLAIN, FAST, PARALLEL, BUILD = "plain loop, one core", "one core", "two threads", "build"
CLOCKS = {PLAIN: time.process_time, FAST: time.process_time, BUILD: time.process_time}


class Query:
    """One sweep and its key frames, prepared for the fast code and for the plain loop."""

    def __init__(self, dataset: Dataset, trajectory: Trajectory, index: int) -> None:
        p = parameters("paper").dynamics
        keys = key_frames(trajectory, p)[index]
        self._settings = np.radians(p.resolution_deg), p.window, p.tolerance
        self._sweeps = [self._read(dataset, k) for k in keys]
        self._sweep = (*self._read(dataset, index), trajectory.poses[index])
        self._images = {plain: [self.build(k, plain) for k in range(len(keys))]
                        for plain in (False, True)}  # fmt: skip
        self._poses = trajectory.poses[keys]
        self.key_frames = len(keys)
        self.votes = int((~self._sweep[1]).sum()) * len(keys)

    @staticmethod
    def _read(dataset: Dataset, index: int) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        points = dataset.sweep(int(index)).points
        return points, points[:, 2] < np.percentile(points[:, 2], 30)

    def build(self, key: int = 0, plain: bool = False) -> _core.RangeImage:
        """The range image of a key frame."""
        return _core.RangeImage(*self._sweeps[key], *self._settings, plain)

    def vote(
        self, plain: bool = False, threads: int = 1
    ) -> tuple[NDArray[np.uint16], NDArray[np.uint16]]:
        """Votes of all key frames on the sweep."""
        return _core.vote(*self._sweep, self._images[plain], self._poses, threads)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("drive", type=Path)
    parser.add_argument("--poses", type=Path, help="needed if the recording has no poses")
    parser.add_argument("--sweeps", type=int, default=5, help="number of sweeps to vote on")
    parser.add_argument("--repeat", type=int, default=5)
    options = parser.parse_args()
    dataset = open_dataset(options.drive)
    poses = read_poses(options.poses, len(dataset)) if options.poses else dataset.poses
    if poses is None:
        parser.error(f"{options.drive} has no poses; give --poses FILE (TUM or KITTI)")
    trajectory = Trajectory(dataset.times, poses)

    rates: dict[str, list[float]] = {PLAIN: [], FAST: [], PARALLEL: []}
    builds = []
    for index in np.linspace(0, len(dataset) - 1, options.sweeps + 2).astype(int)[1:-1]:
        query = Query(dataset, trajectory, index)
        if not all(map(np.array_equal, query.vote(), query.vote(plain=True))):
            raise SystemExit(f"the votes on sweep {index} differ from those of the plain loop")
        jobs = {
            PLAIN: lambda q=query: q.vote(plain=True),
            FAST: query.vote,
            PARALLEL: lambda q=query: q.vote(threads=2),
            BUILD: query.build,
        }
        medians = interleaved(jobs, options.repeat, CLOCKS)
        builds.append(medians.pop(BUILD))
        print(f"sweep {index}: {query.key_frames} key frames, {query.votes / 1e6:.2f} M votes")
        for name, median in medians.items():
            rates[name].append(query.votes / median)
            print(f"    {name}: {1e3 * median:.1f} ms")
    plain = statistics.median(rates[PLAIN])
    for name, values in rates.items():
        rate = statistics.median(values)
        print(f"{name}: {rate / 1e6:.1f} M votes/s, {rate / plain:.1f} times the plain loop")
    print(f"building a range image: {1e3 * statistics.median(builds):.2f} ms")


if __name__ == "__main__":
    main()
