"""Memory and processor time of each stage against the length of the drive.

    python benchmarks/endless.py OUT [--frames 250 1000 2000 4000] [--sensor VLP-16] [--columns 600]

Drives along an endless street that is made while it is read; the longer drive begins as the shorter
one. Each stage runs in a process of its own. Of the first and the last hundred sweeps it prints the
IoU of the points that move at that moment, and of their images the error of depth up to 80 m.
``read`` makes every fifth sweep and nothing else, which is part of ``odometry``. The
street is not equally hard everywhere, so ``alone`` runs the last two hundred sweeps as a drive of
their own, and prints the same of its last hundred.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from results import parser_of, publish
from scenes.endless import EndlessRecording

from docdepth.cli import keep_memory, take_one_blas_thread
from docdepth.config import Parameters
from docdepth.datasets.base import Dataset
from docdepth.datasets.views import FrameRange
from docdepth.evaluation.tables import Table
from docdepth.geometry.points import DYNAMIC
from docdepth.io.depth import read_depth
from docdepth.io.run_folder import RunFolder
from docdepth.pipeline import run_classify, run_odometry, run_render

STAGES = ("read", "odometry", "classify", "render", "evaluate", "alone")
EVERY = 10  # sweeps from image to image
END = 100  # sweeps at both ends that are evaluated
FARTHEST, WRONG = 80.0, 0.05  # metres; share of the depth
MOVING = 0.1  # metres a second
FIRST_MOVING_CLASS = 252  # of SemanticKITTI


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--frames", type=int, nargs="+", default=[250, 500, 1000, 2000])
    parser.add_argument("--sensor", default="VLP-16")
    parser.add_argument("--columns", type=int, default=600, help="of a sensor that spins")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--tiles", type=int, default=40, help="of 600 m, until the street is back")
    parser.add_argument("--poses", choices=("exact", "estimated"), default="estimated")
    parser.add_argument("--stages", nargs="+", choices=STAGES, default=list(STAGES))
    parser.add_argument("--stage", choices=STAGES, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.stage:
        return run_stage(options)
    names = ("sensor", "columns", "seed", "tiles", "poses")
    same = [f"--{name}={getattr(options, name)}" for name in names]
    lines = []
    for frames in options.frames:
        for stage in options.stages:
            about = [str(options.out), f"--frames={frames}", f"--stage={stage}", *same]
            command = [sys.executable, __file__, *about]
            done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
            print(done.stdout, end="", file=sys.stderr, flush=True)
            lines.append(json.loads(done.stdout))
    header = tuple(dict.fromkeys(name for line in lines for name in line))
    rows = tuple(tuple(str(line.get(name, "")) for name in header) for line in lines)
    publish([Table("Drives of any length", header, rows)], options.results)


def run_stage(options: argparse.Namespace) -> None:
    """Run one stage of one drive, and print a line of JSON."""
    keep_memory()  # as the command line does
    take_one_blas_thread()
    frames = options.frames[0]
    start = time.process_time()
    told = _STAGES[options.stage](options, RunFolder(options.out / f"{frames}"))
    spent = 1e3 * (time.process_time() - start) / frames
    status = Path("/proc/self/status").read_text()
    peak = int(re.findall(r"VmHWM:\s+(\d+) kB", status)[0]) / 1024
    line = {"sweeps": frames, "stage": options.stage, "peak MB": round(peak), "ms": round(spent, 1)}
    print(json.dumps(line | (told or {})), flush=True)


def recording_of(options: argparse.Namespace) -> EndlessRecording:
    """The drive; its camera takes an image every ten sweeps, at half of the size."""
    names = ("sensor", "columns", "seed", "tiles")
    about = {name: getattr(options, name) for name in names} | {"frames": options.frames[0]}
    about |= {"image_every": EVERY, "image_scale": 0.5}
    path = options.out / f"{options.frames[0]}.endless.yaml"
    if not path.is_file():  # its time tells whether results are up to date
        path.write_text(yaml.safe_dump(about, sort_keys=False))
    elif yaml.safe_load(path.read_text()) != about:
        raise SystemExit(f"{path} describes another drive; choose another folder")
    return EndlessRecording(path)


def read(options: argparse.Namespace, run: RunFolder) -> None:
    options.out.mkdir(parents=True, exist_ok=True)
    recording = recording_of(options)
    for index in range(0, len(recording), 5):
        recording.sweep(index)


def odometry(options: argparse.Namespace, run: RunFolder) -> None:
    options.out.mkdir(parents=True, exist_ok=True)
    estimate(options, run, recording_of(options))


def estimate(options: argparse.Namespace, run: RunFolder, recording: Dataset) -> None:
    run.start(None, Parameters())
    run_odometry(run, recording, recording.poses if options.poses == "exact" else None)


def classify(options: argparse.Namespace, run: RunFolder) -> None:
    run_classify(run)


def render(options: argparse.Namespace, run: RunFolder) -> None:
    run_render(run, list(recording_of(options).cameras.values()))


def evaluate(options: argparse.Namespace, run: RunFolder) -> dict[str, Any]:
    """Figures of both ends."""
    recording = recording_of(options)
    result: dict[str, Any] = {}
    for name, first in (("first", 0), ("last", len(recording) - END)):
        figures = {"IoU": iou(recording, run, first), **depth(recording, run, first)}
        result |= {f"{k} {name}": v for k, v in figures.items()}
    return result


def alone(options: argparse.Namespace, run: RunFolder) -> dict[str, Any]:
    """Figures of the last sweeps, as a drive that begins a little before them."""
    whole, last = recording_of(options), options.frames[0] - END
    begin = max(last - END, 0)
    part, run = (
        FrameRange(whole, f"{begin}:"),
        RunFolder(run.path.with_name(f"{run.path.name}_alone")),
    )
    estimate(options, run, part)
    run_classify(run)
    run_render(run, list(part.cameras.values()))
    figures = {"IoU": iou(whole, run, last, begin), **depth(whole, run, last)}
    return {f"{name} last": value for name, value in figures.items()}


def iou(recording: EndlessRecording, run: RunFolder, first: int, begin: int = 0) -> float:
    """Of points that move at that moment, against those that never do; the run's sweep 0 is
    ``begin`` of the recording."""
    both = either = 0
    for index in range(first, first + END, 2):
        record, classid = run.classified_frame(index - begin)
        true = recording.drive.sweep(index)
        moves = true.speed[record.index] > MOVING
        known = moves | ((true.labels[record.index] & 0xFFFF) < FIRST_MOVING_CLASS)
        found = classid >= DYNAMIC
        both += int(np.count_nonzero(moves & found & known))
        either += int(np.count_nonzero((moves | found) & known))
    return round(both / max(either, 1), 4)


def depth(recording: EndlessRecording, run: RunFolder, first: int) -> dict[str, float]:
    """Mean error and share of wrong pixels of the images between sweeps."""
    stream, drive = recording.cameras["image_2"], recording.drive
    trajectory, errors = run.trajectory(), []
    begin, end = drive.times[first], drive.times[first + END - 1]
    # Their own poses: what is evaluated is depth, not where the vehicle is.
    inside = (stream.times >= begin) & (stream.times <= end) & trajectory.covers(stream.times)
    for k in np.flatnonzero(inside):
        made = read_depth(run.path / "depth" / f"{stream.names[k]}.png", 256.0)
        time_ns = int(stream.times[k])
        pose = drive.pose_at(stream.times[k : k + 1])[0] @ np.linalg.inv(stream.T_camera_lidar)
        exact = drive.depth(stream.camera, pose, time_ns)
        compared = np.isfinite(made) & (exact <= FARTHEST)
        errors.append(np.stack([np.abs(made - exact)[compared], exact[compared]]))
    off, exact = np.concatenate(errors, axis=1)
    return {
        "MAE m": round(float(off.mean()), 3),
        "wrong": round(float((off > WRONG * exact).mean()), 4),
    }


_STAGES = dict(zip(STAGES, (read, odometry, classify, render, evaluate, alone), strict=True))


if __name__ == "__main__":
    main()
