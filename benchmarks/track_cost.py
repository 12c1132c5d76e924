"""Time and memory of tracking against the number of objects that seem to move.

    python benchmarks/track_cost.py [--scenes cars fences] [--objects 10 100 1000] [--sweeps 40]

``cars`` drive on a wide field, as many each way, so that each meets others. ``fences`` stand along
a road and are wrongly called dynamic: gaps that go along with the ego split them, so that the
pieces seem to move. All detections are made up. Each row is measured in a process of its own;
``growth`` is the time for an object in a sweep against that of the row above.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from results import parser_of, publish

import docdepth._core as _core
from docdepth.dynamics.tracking import track_objects
from docdepth.evaluation.tables import Table
from docdepth.geometry.trajectory import Trajectory

PERIOD = 0.1  # seconds between sweeps
NOISE = 0.02  # metres
SPACING = 0.2  # of samples [m]
CAR = (4.4, 1.8, 1.4)  # metres
CAR_SPEED, EGO_SPEED = 10.0, 8.0  # metres a second
FENCE = (7.5, 8.0, 1.6)  # length of a piece, from piece to piece, and height [m]
FENCES_APART = 5.0  # metres
POINTS = 100  # of an object

ROW = np.dtype(
    [(name, "u4") for name in ("first", "points", "dynamic_points", "samples", "edges", "hidden")]
    + [(f"{which}_occupied", "i4") for which in ("first", "last")]
    + [(f"stands_{which}", "i4") for which in ("since", "until")]
    + [(f"{which}area", "f4") for which in ("", "dynamic_", "free_", "porous_")]
    + [("time_offset", "f4"), ("middle", "f4", (3,))]
    + [("ground_height", "f4"), ("ground_deviation", "f4")]
    + [("low", "f4", (3,)), ("high", "f4", (3,))]
)
SAMPLE = np.dtype([("point", "f4", (3,)), ("normal", "f4", (3,)), ("time", "f4")])
BORDER = np.dtype([("point", "f4", (3,)), ("time", "f4")])
"""Rows of the core."""
Array = NDArray[np.float32]


def side(u: Array, v: Array) -> Array:
    """Samples of a rectangle between two vectors from a corner, (n, 3)."""
    count = [round(float(np.linalg.norm(w)) / SPACING) + 1 for w in (u, v)]
    a, b = np.meshgrid(*(np.linspace(0, 1, n, dtype=np.float32) for n in count))
    return a.reshape(-1, 1) * u + b.reshape(-1, 1) * v


def car() -> tuple[Array, Array]:
    """Samples and normals of a rear and a side."""
    length, width, height = np.diag(CAR).astype(np.float32)
    rear, right = side(width, height), side(length, height)
    normals = np.repeat(np.array([[-1, 0, 0], [0, -1, 0]], np.float32), [len(rear), len(right)], 0)
    return np.concatenate([rear, right]), normals


def fence() -> tuple[Array, Array]:
    """Samples and normals of a piece."""
    samples = side(np.array([FENCE[0], 0, 0], np.float32), np.array([0, 0, FENCE[2]], np.float32))
    return samples, np.repeat(np.array([[0, -1, 0]], np.float32), len(samples), 0)


def cars_at(objects: int, sweep: int) -> Array:
    """The corners of all cars in a sweep, (n, 3)."""
    rows = max(int(np.sqrt(objects) / 2), 2)
    lane, place = np.arange(objects) % rows, np.arange(objects) // rows
    way = np.where(lane % 2, -1, 1)
    x = 12.0 * place + way * CAR_SPEED * PERIOD * sweep
    return np.stack([x, 4.0 * lane, np.full(objects, 0.2)], 1).astype(np.float32)


def fences_at(objects: int, sweep: int) -> Array:
    """The corners of all pieces in a sweep, (n, 3); gaps go along with the ego."""
    rows = max(int(np.sqrt(objects) / 2), 2)
    row, place = np.arange(objects) % rows, np.arange(objects) // rows
    x = FENCE[1] * place + EGO_SPEED * PERIOD * sweep
    return np.stack([x, FENCES_APART * row, np.full(objects, 0.2)], 1).astype(np.float32)


SCENES: dict[str, tuple[Callable[[], tuple[Array, Array]], Callable[[int, int], Array]]] = {
    "cars": (car, cars_at),
    "fences": (fence, fences_at),
}


def detections_of(scene: str, objects: int, sweep: int) -> _core.Detections:
    """What a sweep sees: all of it is dynamic by the votes."""
    rng = np.random.default_rng([objects, sweep])
    (points, normals), corners = SCENES[scene][0](), SCENES[scene][1](objects, sweep)
    places = corners[:, None] + points[None] + rng.normal(0, NOISE, (objects, len(points), 3))
    rows = np.zeros(objects, ROW)
    rows["first"], rows["points"] = POINTS * np.arange(objects), POINTS
    rows["dynamic_points"], rows["samples"] = POINTS, len(points)
    rows["first_occupied"] = rows["last_occupied"] = sweep
    rows["stands_since"] = rows["stands_until"] = sweep
    ego = np.array([EGO_SPEED * PERIOD * sweep, -5, 1.7], np.float32)
    rows["middle"] = places.mean(1) - ego
    rows["area"] = rows["dynamic_area"] = rows["free_area"] = POINTS * 400.0
    rows["ground_deviation"] = 0.05
    rows["low"], rows["high"] = places.min(1), places.max(1)
    samples = np.zeros(objects * len(points), SAMPLE)
    samples["point"] = places.reshape(-1, 3)
    samples["normal"] = np.tile(normals, (objects, 1))
    return _core.Detections.of(rows, samples, np.zeros(0, BORDER))


def measure(scene: str, objects: int, sweeps: int) -> dict[str, float]:
    """Tracks, processor seconds and memory [MB] of tracking alone."""
    detections = [detections_of(scene, objects, k) for k in range(sweeps)]
    poses = np.repeat(np.eye(4)[None], sweeps, 0)
    poses[:, 0, 3] = EGO_SPEED * PERIOD * np.arange(sweeps)
    trajectory = Trajectory(np.round(np.arange(sweeps) * PERIOD * 1e9).astype(np.int64), poses)
    before, start = peak_memory(), time.process_time()
    tracks = track_objects(detections.__getitem__, trajectory, lambda sweep: None, threads=1)
    spent = time.process_time() - start
    return {"tracks": len(tracks), "seconds": spent, "memory": peak_memory() - before}


def peak_memory() -> float:
    """Of this process [MB]."""
    status = Path("/proc/self/status").read_text()
    return int(re.findall(r"VmHWM:\s+(\d+) kB", status)[0]) / 1024


def main(arguments: list[str] | None = None) -> list[tuple[str, ...]]:
    parser = parser_of(__doc__)
    parser.add_argument("--scenes", nargs="+", choices=list(SCENES), default=list(SCENES))
    parser.add_argument("--objects", type=int, nargs="+", default=[10, 100, 1000], help="a sweep")
    parser.add_argument("--sweeps", type=int, default=40)
    parser.add_argument("--alone", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.alone:
        print(json.dumps(measure(options.scenes[0], options.objects[0], options.sweeps)))
        return []
    rows: list[tuple[str, ...]] = []
    for scene in options.scenes:
        last = None
        for objects in options.objects:
            about = ["--scenes", scene, "--objects", str(objects), "--sweeps", str(options.sweeps)]
            command = [sys.executable, __file__, *about, "--alone"]
            done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
            found = json.loads(done.stdout)
            each = 1e3 * found["seconds"] / (objects * options.sweeps)
            growth = f"{each / last:.2f}" if last else ""
            figures = (f"{found['seconds']:.2f}", f"{each:.2f}", growth, f"{found['memory']:.0f}")
            rows.append((scene, str(objects), str(found["tracks"]), *figures))
            print(*rows[-1], file=sys.stderr, flush=True)
            last = each
    header = (
        "scene",
        "objects a sweep",
        "tracks",
        "processor s",
        "ms an object and sweep",
        "growth",
        "MB",
    )
    title = f"Tracking of {options.sweeps} sweeps in which all seems to move"
    publish([Table(title, header, tuple(rows))], options.results)
    return rows


if __name__ == "__main__":
    main()
