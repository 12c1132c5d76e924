"""How fast key frames vote on a recorded drive, beside the plain loop of Algorithm 1.

    python benchmarks/benchmark_voting.py DRIVE [--poses FILE] [--sweeps 5] [--repeat 5]

DRIVE is any recording that ``docdepth`` opens. Medians of several runs that take turns; seconds of
one core are processor time, so that they hold on a busy machine too. The votes of the two are
compared. Ground is taken by height: here it only decides how many points are voted on.
"""

from __future__ import annotations

import argparse
import statistics
import time
from pathlib import Path

import numpy as np

from docdepth import _core
from docdepth.config import parameters
from docdepth.datasets import open_dataset
from docdepth.dynamics.key_frames import key_frames
from docdepth.geometry.trajectory import Trajectory
from docdepth.io.poses import read_poses


class Query:
    """One sweep and its key frames, made ready for the fast way and for the plain loop."""

    def __init__(self, dataset, trajectory, index):
        p = parameters("paper").dynamics
        self.keys = key_frames(trajectory, p)[index]
        self.settings = np.radians(p.resolution_deg), p.window, p.tolerance
        self.key_sweeps = [self.read(dataset, k) for k in self.keys]
        self.images = {plain: [self.image(k, plain) for k in range(len(self.keys))]
                       for plain in (False, True)}  # fmt: skip
        self.sweep = (*self.read(dataset, index), trajectory.poses[index])
        self.poses = trajectory.poses[self.keys]
        self.votes = int((~self.sweep[1]).sum()) * len(self.keys)

    @staticmethod
    def read(dataset, index):
        points = dataset.sweep(int(index)).points
        return points, points[:, 2] < np.percentile(points[:, 2], 30)

    def image(self, key, plain=False):
        return _core.RangeImage(*self.key_sweeps[key], *self.settings, plain)

    def vote(self, plain=False, threads=1):
        return _core.vote(*self.sweep, self.images[plain], self.poses, threads)


def seconds(clock, work):
    start = clock()
    work()
    return clock() - start


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    arguments.add_argument("drive", type=Path)
    arguments.add_argument("--poses", type=Path, help="poses, where the recording has none")
    arguments.add_argument("--sweeps", type=int, default=5, help="sweeps voted on")
    arguments.add_argument("--repeat", type=int, default=5)
    options = arguments.parse_args()
    dataset = open_dataset(options.drive)
    poses = read_poses(options.poses, len(dataset)) if options.poses else dataset.poses
    if poses is None:
        arguments.error(f"{options.drive} has no poses; give --poses FILE (TUM or KITTI)")
    trajectory = Trajectory(dataset.times, poses)

    runs = {
        "plain loop, one core": (time.process_time, lambda q: q.vote(plain=True)),
        "fast, one core": (time.process_time, lambda q: q.vote()),
        "fast, two threads": (time.perf_counter, lambda q: q.vote(threads=2)),
    }
    rates = {name: [] for name in runs}
    builds = []
    for index in np.linspace(0, len(dataset) - 1, options.sweeps + 2).astype(int)[1:-1]:
        query = Query(dataset, trajectory, index)
        if not all(
            np.array_equal(*pair) for pair in zip(query.vote(), query.vote(True), strict=True)
        ):
            raise SystemExit(f"the votes on sweep {index} differ from those of the plain loop")
        times = {name: [] for name in runs}
        for _ in range(options.repeat):
            for name, (clock, run) in runs.items():
                times[name].append(seconds(clock, lambda run=run, query=query: run(query)))
            builds.append(seconds(time.process_time, lambda query=query: query.image(0)))
        print(f"sweep {index}: {len(query.keys)} key frames, {query.votes / 1e6:.2f} M votes")
        for name, values in times.items():
            rates[name].append(query.votes / statistics.median(values))
            print(f"    {name}: {1e3 * statistics.median(values):.1f} ms")
    plain = statistics.median(rates["plain loop, one core"])
    for name, values in rates.items():
        rate = statistics.median(values)
        print(f"{name}: {rate / 1e6:.1f} M votes/s, {rate / plain:.1f} times the plain loop")
    print(f"making a key frame: {1e3 * statistics.median(builds):.2f} ms")


if __name__ == "__main__":
    main()
