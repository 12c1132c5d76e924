"""Does a network learn more from denser truth? A small one, judged against exact depth.

    pip install 'docdepth[synth,train]'
    python benchmarks/training.py drives -o training [--runs 2] [--steps 800] [--jobs 1]

Writes synthetic drives with images below ``drives`` and runs ``docdepth run`` on the raw sweeps of
each, with the presets ``default`` and ``paper``. The same network is then trained with five truths:
the points of one sweep, IP-Basic on that sweep, ``paper``, ``default``, and exact depth, the best
that any truth could do. All see the same images in the same order from the same start. Networks
are judged on images of drives that no network saw, against exact depth of all pixels up to 80 m.

Prints the table after the last step, and how the error falls. Trains on a graphics card if there is
one. An interrupted run resumes.
"""

from __future__ import annotations

import argparse
import json
import math
import multiprocessing
import statistics
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import depth_network
import numpy as np
from depth_network import Sample
from ip_basic import ip_basic
from numpy.typing import NDArray

import docdepth
from docdepth.datasets import CameraStream
from docdepth.evaluation import moving
from docdepth.evaluation.pixels import EDGE_MARGIN, edge_distance, project
from docdepth.geometry.se3 import inverse
from docdepth.synthetic import Drive, scene, sensor, sensors, write_drive

SCENES = ("city", "hills", "residential")
FRAMES = 40
TRAINED_ON, JUDGED_ON = (51, 52), (61,)
IMAGES_OF_A_JUDGED_DRIVE = 10
FAR = 80.0
PRESETS = ("paper", "default")
TRUTHS = ("one sweep", "IP-Basic", *PRESETS, "exact")
Depth = NDArray[np.float32]
Errors = dict[str, float]


@dataclass(frozen=True)
class Judged:
    """An image with exact depth, and which pixels are below the highest beam, moving and so on."""

    image: NDArray[np.uint8]
    truth: Depth
    parts: dict[str, NDArray[np.bool_]]


def drive_with_runs(drives: Path, name: str, lidar: str, seed: int) -> Path:
    """Folder of a raw synthetic drive with both runs, made where it is missing."""
    folder = drives / f"seed{seed}" / f"{name}_{lidar}"
    sequence = folder / "sequences" / "00"
    if not (folder / "whole").is_file():
        write_drive(folder, name, lidar, FRAMES, seed, skew=True)
        (folder / "whole").touch()
    for preset in PRESETS:
        command = [sys.executable, "-m", "docdepth", "run", str(sequence), "-q"]
        subprocess.run([*command, "-o", str(folder / preset), "--preset", preset], check=True)
    return folder


def truths_of(folder: Path, kind: str) -> list[Sample]:
    """Images of a drive with one kind of truth; images without any are left out."""
    sequence = folder / "sequences" / "00"
    camera = docdepth.open_dataset(sequence).cameras["image_2"]
    run = docdepth.RunFolder.open(folder / (kind if kind in PRESETS else "default"))
    samples = []
    for k, name in enumerate(camera.names):
        image = camera.rectified_image(k)
        file = run.path / "depth" / f"{name}.png"
        if image is None or not file.is_file():
            continue
        if kind == "exact":
            truth = np.load(sequence / "depth_2" / f"{name}.npy")
        elif kind in PRESETS:
            truth = docdepth.read_depth(file)
        else:
            truth = one_sweep(run, camera, k)
            truth = ip_basic(truth) if kind == "IP-Basic" else truth
        truth[~(truth <= FAR)] = np.nan
        samples.append(Sample(image, truth))
    return samples


def one_sweep(run: docdepth.RunFolder, camera: CameraStream, k: int) -> Depth:
    """Points of the nearest sweep in an image, deskewed and placed by the odometry of the run."""
    trajectory, time = run.trajectory(), int(camera.times[k])
    nearest = trajectory.nearest(time)
    T_lidar_sweep = inverse(trajectory.interpolate(time)[0]) @ trajectory.poses[nearest]
    return project(camera.camera, camera.T_camera_lidar @ T_lidar_sweep, run.points(nearest))[0]


def judged_images(name: str, lidar: str, seed: int) -> list[Judged]:
    """Images of a drive that no network saw."""
    drive = Drive(scene(name, seed), sensor(lidar), FRAMES, seed)
    spread = np.linspace(0, len(drive.camera_times) - 1, IMAGES_OF_A_JUDGED_DRIVE)
    return [_judged(drive, int(k)) for k in spread.round()]


def _judged(drive: Drive, k: int) -> Judged:
    view = drive.image(k)
    truth = np.where(view.depth <= FAR, view.depth, np.nan).astype(np.float32)
    rig = drive.rig
    # The highest beam leaves the upper part of an image without returns.
    x, y, z = drive.sweep(k).points.T
    row = rig.camera.K[1, 2] - rig.camera.K[1, 1] * np.quantile(z / np.hypot(x, y), 0.999)
    above = np.arange(len(truth))[:, None] < row
    known = np.isfinite(truth)
    parts = {
        "all": known,
        "below the highest beam": known & ~above,
        "above the highest beam": known & above,
        "near edges": known & (edge_distance(truth) <= EDGE_MARGIN),
        "moving": known & moving(view.labels.ravel()).reshape(truth.shape),
    }
    return Judged(np.ascontiguousarray(view.colour[..., ::-1]), truth, parts)


def errors_of(predict: Callable[[NDArray[np.uint8]], Depth], judged: list[Judged]) -> Errors:
    """Figures of monocular depth over all pixels of all images, and of parts of them."""
    ratios: dict[str, list[Depth]] = {}
    squares, pixels = 0.0, 0
    for image in judged:
        guess = predict(image.image)
        for name, part in image.parts.items():
            ratios.setdefault(name, []).append(guess[part] / image.truth[part])
        known = image.parts["all"]
        squares += float(np.square(guess[known] - image.truth[known], dtype=np.float64).sum())
        pixels += int(known.sum())
    figures = {"RMSE m": math.sqrt(squares / pixels)}
    for name, parts in ratios.items():
        ratio = np.concatenate(parts).astype(np.float64)
        figures[f"AbsRel %: {name}"] = 100 * float(np.abs(ratio - 1).mean())
    everywhere = np.concatenate(ratios["all"])
    figures["within 1.25 %"] = 100 * float((np.maximum(everywhere, 1 / everywhere) < 1.25).mean())
    return figures


def train(
    folders: list[Path], kind: str, judged: list[Judged], steps: int, seed: int, file: Path
) -> None:
    """Train a network with one kind of truth; write its figures along the way."""
    if file.is_file():
        return
    samples = [s for folder in folders for s in truths_of(folder, kind)]
    curve: dict[int, Errors] = {}

    def watch(step: int, network: depth_network.DepthNetwork) -> None:
        curve[step] = errors_of(lambda image: depth_network.predict(network, image), judged)

    depth_network.train(samples, steps, seed, watch)
    file.write_text(json.dumps(curve, indent=1))


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("drives", type=Path, help="folder of the drives; missing ones are made")
    parser.add_argument("-o", "--out", type=Path, required=True, help="folder of the results")
    parser.add_argument("--sensor", default="HDL-64", choices=list(sensors()))
    parser.add_argument("--steps", type=int, default=800)
    parser.add_argument("--runs", type=int, default=2, help="trainings of each truth")
    parser.add_argument("--jobs", type=int, default=1, help="drives and trainings at once")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    trainings = [
        (kind, seed, args.out / f"{args.sensor}_{kind}_{args.steps}_{seed}.json")
        for seed in range(args.runs)
        for kind in TRUTHS
    ]
    curves: dict[str, list[dict[str, Errors]]] = {kind: [] for kind in TRUTHS}
    spawn = multiprocessing.get_context("spawn")  # a forked process cannot use the graphics card
    with ProcessPoolExecutor(args.jobs, spawn) as pool:
        drives = [
            pool.submit(drive_with_runs, args.drives, name, args.sensor, seed)
            for seed in TRAINED_ON
            for name in SCENES
        ]
        others = [
            pool.submit(judged_images, name, args.sensor, seed)
            for seed in JUDGED_ON
            for name in SCENES
        ]
        folders = [drive.result() for drive in drives]
        judged = [image for images in others for image in images.result()]
        running = [
            pool.submit(train, folders, kind, judged, args.steps, seed, file)
            for kind, seed, file in trainings
        ]
        for (kind, _, file), training in zip(trainings, running, strict=True):
            training.result()
            curves[kind].append(json.loads(file.read_text()))
            print(_tables({k: c for k, c in curves.items() if c}), flush=True)


def _tables(curves: dict[str, list[dict[str, Errors]]]) -> str:
    """The last figures of each truth, and how AbsRel falls; means over the trainings."""
    first = next(iter(curves.values()))[0]
    steps = list(first)
    figures = list(first[steps[-1]])
    head = ["truth", *figures]
    rows = [
        [kind, *(_mean([run[steps[-1]][f] for run in runs]) for f in figures)]
        for kind, runs in curves.items()
    ]
    fall = [
        [kind, *(_mean([run[step]["AbsRel %: all"] for run in runs]) for step in steps)]
        for kind, runs in curves.items()
    ]
    return f"\n{_table(head, rows)}\n\n{_table(['AbsRel % after steps', *steps], fall)}"


def _mean(values: list[float]) -> str:
    spread = f" ±{(max(values) - min(values)) / 2:.2f}" if len(values) > 1 else ""
    return f"{statistics.fmean(values):.2f}{spread}"


def _table(head: list[str], rows: list[list[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


if __name__ == "__main__":
    main()
