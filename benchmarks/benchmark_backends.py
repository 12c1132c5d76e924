"""Seconds per depth map with each renderer, compared with the CPU, and how far they agree.

    python benchmarks/benchmark_backends.py [RUN] [--sweeps 100] [--points 100000] [--repeat 5]

Draws the paper's splats at their released sizes into a KITTI image: static points of a street, one
sweep per metre, and dynamic points of one sweep. With RUN, a finished run, also the image in its
middle with both presets. Prints medians of runs that take turns, with all cores. The first image,
which also uploads the points, is timed apart. Freed memory is kept, as on the command line:
otherwise threads that request fresh pages wait for each other.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from numpy.typing import NDArray
from timing import interleaved, seconds

from docdepth.cli import keep_memory
from docdepth.config import RenderParameters, parameters
from docdepth.datasets import open_dataset
from docdepth.geometry.camera import Camera
from docdepth.geometry.points import DYNAMIC, STATIC
from docdepth.geometry.trajectory import Trajectory
from docdepth.io.run_folder import RunFolder
from docdepth.io.tracks import TRACKS, read_tracks
from docdepth.render import backends
from docdepth.render.depth_map import compose_depth
from docdepth.render.frame import Frame
from docdepth.render.scene import Scene

CAMERA = Camera(np.array([[721.5, 0, 609.6], [0, 721.5, 172.9], [0, 0, 1]]), 1242, 375)
T_CAMERA_LIDAR = np.array([[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1.0]])
Draw = Callable[[backends.Renderer], NDArray[np.float32]]
RELEASED = RenderParameters(primitive="splats", behind=0.5, ahead=1000.0, step=0.2)


def street_sweep(count: int, seed: int) -> Frame:
    """64 rings in a street: road, facades 9 m to the sides, houses ahead, one moving car."""
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
        road = np.where(ray[:, 2] < 0, -1.73 / ray[:, 2], np.inf)
    distance = np.minimum(distance, road) + random.normal(0, 0.02, count)
    car = (np.abs(azimuth - 0.2) < 0.03) & (elevation < 0)
    classid = np.where(car, DYNAMIC, STATIC).astype(np.uint16)
    return Frame((ray * distance[:, None]).astype(np.float32), classid, RELEASED)


def agreement(depth: NDArray[np.float32], expected: NDArray[np.float32]) -> tuple[float, float]:
    """Shares of pixels within 1 cm and exactly equal [%]."""
    equal = (depth == expected) | (np.isnan(depth) & np.isnan(expected))
    close = equal | (np.abs(depth - expected) <= 0.01)
    return 100 * float(close.mean()), 100 * float(equal.mean())


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("run", type=Path, nargs="?")
    parser.add_argument("--sweeps", type=int, default=100)
    parser.add_argument("--points", type=int, default=100_000, help="points per sweep")
    parser.add_argument("--repeat", type=int, default=5)
    arguments = parser.parse_args()
    keep_memory()

    renderers = {}
    for backend in backends.available():
        if backend.usable:
            renderers[backend.name] = backends.choose(backend.name)
        else:
            print(f"{backend.name:<12} not available: {backend.detail}")
    count = arguments.sweeps
    print(f"{count * arguments.points / 1e6:.1f} M points, {CAMERA.width} x {CAMERA.height}")
    compare(street(count, arguments.points), renderers, arguments.repeat)
    for preset in ("paper", "default") if arguments.run else ():
        print(f"the image in the middle of {arguments.run}, {preset}")
        compare(middle_image(arguments.run, preset), renderers, arguments.repeat)


def street(count: int, points: int) -> Draw:
    """The synthetic street, one sweep per metre."""
    frames = [street_sweep(points, seed) for seed in range(count)]
    poses = np.repeat(np.eye(4)[None], count, axis=0)
    poses[:, 0, 3] = np.arange(count)
    trajectory = Trajectory(np.arange(count) * 100_000_000, poses)
    view = CAMERA, T_CAMERA_LIDAR, trajectory, 0, frames.__getitem__, RELEASED
    return partial(compose_depth, *view, 0)


def middle_image(path: Path, preset: str) -> Draw:
    """The image in the middle of a run, with its tracks."""
    run, dataset = RunFolder.open(path), open_dataset(path, "run")
    trajectory, p = run.trajectory(), parameters(preset)
    sweeps, labels = [], []
    for k in range(len(dataset)):
        record, classid = run.classified_frame(k)
        sweeps.append(dataset.sweep(k))
        labels.append(SimpleNamespace(classid=classid, instance=record.instance))
    scene = Scene(sweeps, trajectory, labels, p, read_tracks(path / TRACKS))
    stream = next(iter(dataset.cameras.values()))
    time = int(stream.times[len(stream.times) // 2])
    view = stream.camera, stream.T_camera_lidar, trajectory, time
    frames = scene.frames_at(time).__getitem__
    return partial(compose_depth, *view, frames, p.render, 0, tracks=scene.tracks)


def compare(draw: Draw, renderers: dict[str, backends.Renderer], repeat: int) -> None:
    """Print how long each renderer takes, and how far it agrees with the CPU."""
    jobs = {name: partial(draw, renderer) for name, renderer in renderers.items()}
    first = {name: seconds(job) for name, job in jobs.items()}
    medians = interleaved(jobs, repeat)
    expected = draw(renderers["cpu"])
    for name, renderer in renderers.items():
        close, equal = agreement(draw(renderer), expected)
        print(
            f"{name:<12} {1000 * medians[name]:8.1f} ms (first {1000 * first[name]:8.1f})  "
            f"speedup over cpu {medians['cpu'] / medians[name]:6.1f}  "
            f"within 1 cm {close:.3f} %, equal {equal:.3f} %  {renderer.description}",
            flush=True,
        )


if __name__ == "__main__":
    main()
