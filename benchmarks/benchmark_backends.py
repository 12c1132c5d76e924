"""Seconds a depth map by every back end, beside the processor's rasteriser, and how far they agree.

    python benchmarks/benchmark_backends.py [--sweeps 100] [--points 100000] [--repeat 5]

The paper's splats at their released sizes into a KITTI image: static points of a street of sweeps
1 m apart, moving ones of one sweep. Medians of runs that take turns, all of them in this process
on all of its cores; the first image, which sends the points to the device, is counted apart. Freed
memory is kept, as the command line does: two threads that ask for fresh pages wait for each other.
"""

from __future__ import annotations

import argparse
import statistics
import time

import numpy as np

from docdepth.cli import keep_memory
from docdepth.config import RenderParameters
from docdepth.geometry.camera import Camera
from docdepth.geometry.trajectory import Trajectory
from docdepth.render import backends
from docdepth.render.depth_map import compose_depth
from docdepth.render.frame import Frame

CAMERA = Camera(np.array([[721.5, 0, 609.6], [0, 721.5, 172.9], [0, 0, 1]]), 1242, 375)
T_CAMERA_LIDAR = np.array([[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1.0]])
RELEASED = RenderParameters(primitive="splats", behind=0.5, ahead=1000.0, step=0.2)


def street_sweep(count: int, seed: int) -> Frame:
    """64 rings in a street: road, facades 9 m to the sides, houses ahead, a car's worth moving."""
    random = np.random.default_rng(seed)
    azimuth = random.uniform(0, 2 * np.pi, count)
    elevation = np.radians(2.0 - 26.8 * random.integers(0, 64, count) / 63)
    ray = np.stack(
        [
            np.cos(azimuth) * np.cos(elevation),
            np.sin(azimuth) * np.cos(elevation),
            np.sin(elevation),
        ],
        axis=1,
    )
    with np.errstate(divide="ignore"):
        distance = np.minimum(9 / np.abs(ray[:, 1]), 60 / np.abs(ray[:, 0]))
        down = np.where(ray[:, 2] < 0, -1.73 / ray[:, 2], np.inf)
    distance = np.minimum(distance, down) + random.normal(0, 0.02, count)
    classid = np.where((np.abs(azimuth - 0.2) < 0.03) & (elevation < 0), 100, 50)
    return Frame((ray * distance[:, None]).astype(np.float32), classid.astype(np.uint16), RELEASED)


def seconds(work) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--sweeps", type=int, default=100)
    parser.add_argument("--points", type=int, default=100_000, help="of a sweep")
    parser.add_argument("--repeat", type=int, default=5)
    arguments = parser.parse_args()
    keep_memory()

    count = arguments.sweeps
    frames = [street_sweep(arguments.points, seed) for seed in range(count)]
    poses = np.repeat(np.eye(4)[None], count, axis=0)
    poses[:, 0, 3] = np.arange(count)
    trajectory = Trajectory(np.arange(count) * 100_000_000, poses)

    def draw(renderer):
        return compose_depth(
            CAMERA, T_CAMERA_LIDAR, trajectory, 0, frames.__getitem__, RELEASED, renderer=renderer
        )

    renderers, first = {}, {}
    for backend in backends.available():
        if not backend.usable:
            print(f"{backend.name:<12} not available: {backend.detail}")
            continue
        renderers[backend.name] = renderer = backends.choose(backend.name)
        first[backend.name] = seconds(lambda r=renderer: draw(r))
    times = {name: [] for name in renderers}
    for _ in range(arguments.repeat):
        for name, renderer in renderers.items():
            times[name].append(seconds(lambda r=renderer: draw(r)))

    print(f"{count * arguments.points / 1e6:.1f} M points, {CAMERA.width} x {CAMERA.height}")
    expected, cpu = draw(renderers["cpu"]), statistics.median(times["cpu"])
    for name, renderer in renderers.items():
        depth, median = draw(renderer), statistics.median(times[name])
        equal = (depth == expected) | (np.isnan(depth) & np.isnan(expected))
        close = equal | (np.abs(depth - expected) <= 0.01)
        print(
            f"{name:<12} {1000 * median:8.1f} ms (first {1000 * first[name]:8.1f})  "
            f"cpu {median / cpu:6.1f} times as fast  "
            f"within 1 cm {100 * close.mean():.3f} %, equal {100 * equal.mean():.3f} %  "
            f"{renderer.description}"
        )


if __name__ == "__main__":
    main()
