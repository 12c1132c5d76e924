"""The tables and experiments of the paper (DOC-Depth, IV 2025), each by one command.

    python benchmarks/paper_tables.py labels -o OUT [--data SEMANTIC_KITTI]      # Table I
    python benchmarks/paper_tables.py ablation -o OUT [--data SEMANTIC_KITTI]    # Table II
    python benchmarks/paper_tables.py completion -o OUT [--data ANNOTATED --raw KITTI_RAW]  # III
    python benchmarks/paper_tables.py cost -o OUT [--data DRIVE ...]             # Table IV
    python benchmarks/paper_tables.py lidars -o OUT                              # two LiDARs
    python benchmarks/paper_tables.py far -o OUT [--data DRIVE ...]              # 700 m
    python benchmarks/paper_tables.py release -o OUT --data KITTI_RAW            # KITTI's release

Without --data a synthetic stand-in takes the place of the data set: such a table shows that the
command works and what docdepth does on it, and says nothing about the paper's figures.
SEMANTIC_KITTI is the folder that holds ``sequences``, ANNOTATED a part of KITTI's depth completion
(``val``), and KITTI_RAW holds days (``2011_09_26``). What is done is not done again.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import scenes  # noqa: F401  adds its scenes
import two_lidars
from results import parser_of, publish, script

from docdepth import run
from docdepth.config import Preset, parameters
from docdepth.datasets import open_dataset
from docdepth.errors import DocDepthError
from docdepth.evaluation.pixels import project
from docdepth.evaluation.runs import evaluate_depth, evaluate_labels
from docdepth.evaluation.tables import Table, number
from docdepth.geometry.se3 import inverse
from docdepth.io.depth import maps_in, read_depth, write_depth
from docdepth.io.inputs import RunInputs
from docdepth.io.run_folder import RunFolder
from docdepth.pipeline import run_classify, run_odometry
from docdepth.pipeline.convert import INSIDE, write_release
from docdepth.synthetic import write_drive
from docdepth.tuning import Objective, read_trials, tune

WINDOWS = {"00": (4390, 4530), "01": (150, 250), "02": (860, 950), "05": (2350, 2670),
           "07": (630, 820)}  # fmt: skip
"""Frames of SemanticKITTI in Table I, first and last."""

STAND_INS = {"labels": ("city", "highway"), "ablation": ("city",), "completion": ("residential",),
             "cost": ("city",), "far": ("highway",)}  # fmt: skip
FAR = {"render.max_depth": 700, "render.crop": 700, "render.ahead": 700, "output.scale": 64}
"""Parameters of a scene of 700 m."""


def stand_ins(args: argparse.Namespace, frames: int) -> Iterator[Path]:
    """Synthetic drives by HDL-64; made if they are missing."""
    for name in STAND_INS[args.table]:
        count = args.frames or frames
        folder = args.out / "drives" / f"{args.table}_{name}_{count}"
        if not (folder / "sequences" / "00" / "docdepth.yaml").is_file():
            images = args.table not in ("labels", "ablation")
            write_drive(folder, name, "HDL-64", count, args.seed, images=images)
        yield folder / "sequences" / "00"


def done(
    drive: Path, out: Path, preset: Preset, changes: dict[str, Any] | None = None
) -> RunFolder:
    """The run of a drive; made if it is missing, and continued if it was interrupted."""
    run(drive, out, parameters(preset, changes))
    return RunFolder.open(out)


def labelled(drive: Path, out: Path, preset: Preset, frames: str) -> RunFolder:
    """A run of some frames by docdepth's own odometry, up to its labels."""
    folder = RunFolder.create(out, RunInputs(recording=drive, frames=frames), parameters(preset))
    run_odometry(folder, open_dataset(drive, frames=frames))
    run_classify(folder)
    return folder


def labels(args: argparse.Namespace) -> Table:
    """Table I: static and dynamic accuracy and F1 of the labels."""
    if args.data:
        sequences = [(args.data[0] / "sequences" / name, w) for name, w in WINDOWS.items()]
        missing = [str(path) for path, _ in sequences if not path.is_dir()]
        if missing:
            print(f"left out, since they are not there: {', '.join(missing)}", file=sys.stderr)
        drives = [(p, f"{a}:{b + 1}") for p, (a, b) in sequences if p.is_dir()]
    else:
        drives = [(path, ":") for path in stand_ins(args, 60)]
    rows = []
    for drive, frames in drives:
        name = drive.name if args.data else drive.parents[1].name
        for preset in args.presets:
            made = labelled(drive, args.out / "labels" / f"{name}_{preset}", preset, frames)
            counts = evaluate_labels(made, drive).counts
            cells = [number(x, 2) for x in (counts.sa, counts.da)]
            cells += [number(x, 4) for x in (counts.f1, counts.precision, counts.iou)]
            rows.append((name, frames, preset, *cells))
    header = ("sequence", "frames", "preset", "SA %", "DA %", "F1", "precision", "IoU")
    return Table(titled(args, "Table I: labels"), header, tuple(rows))


def ablation(args: argparse.Namespace) -> Table:
    """Table II: key frames P1, P2, P3 and both, on drives longer than R_coarse = 50 m."""
    trials = read_trials(Path(__file__).with_name("ablation.yaml"))
    drives = [args.data[0] / "sequences" / name for name in WINDOWS] if args.data else None
    rows = []
    for drive in drives or stand_ins(args, 100):
        name = drive.name if args.data else drive.parents[1].name
        window = WINDOWS.get(drive.name) if args.data else None
        frames = f"{window[0]}:{window[1] + 1}" if window else ":"
        made = labelled(drive, args.out / "ablation" / name, "paper", frames)
        length = float(made.trajectory().arc_length[-1])
        if length < 50:
            print(f"{drive} is only {length:.0f} m long", file=sys.stderr)
        out = args.out / "ablation" / f"{name}_trials"
        for outcome in tune(
            [made.path], [Objective("labels", drive)], trials, out, 1, args.threads
        ):
            cells = [number(outcome.metric(key), 2) for key in ("sa", "da")]
            f1 = number(outcome.metric("f1"), 4)
            rows.append((name, f"{length:.0f}", outcome.name, *cells, f1))
    header = ("drive", "metres", "key frames", "SA %", "DA %", "F1")
    return Table(titled(args, "Table II: key frames"), header, tuple(rows))


def completion(args: argparse.Namespace) -> Table:
    """Table III: depth against KITTI's own (depth completion)."""
    pairs: list[tuple[Path, Path]] = []
    if args.data:
        for truth in sorted(path for path in args.data[0].iterdir() if (path / INSIDE).is_dir()):
            pairs.append((args.raw / truth.name[:10] / truth.name, truth))
    else:
        pairs = [(drive, sparse_truth(drive)) for drive in stand_ins(args, 30)]
    rows = []
    for drive, truth in pairs:
        name = truth.name if args.data else drive.parents[1].name
        for preset in args.presets:
            made = done(drive, args.out / "completion" / f"{name}_{preset}", preset)
            for camera in made.cameras:
                if not (truth / INSIDE / camera).is_dir():
                    continue
                for mode in ("valid", "kitti"):
                    found = evaluate_depth(made.path, truth, mode, 80.0, camera)
                    k = found.kitti
                    errors = (k.mae, k.rmse, k.imae, k.irmse, k.abs_rel, k.delta1)
                    cells = [number(x, 3) for x in (*errors, found.point_to_point)]
                    rows.append((name, camera, preset, mode, number(found.density, 1), *cells))
    header = ("drive", "camera", "preset", "pixels", "density %", "MAE m", "RMSE m", "iMAE 1/km",
              "iRMSE 1/km", "abs rel %", "delta1 %", "point to point m")  # fmt: skip
    return Table(titled(args, "Table III: depth completion"), header, tuple(rows))


def sparse_truth(drive: Path) -> Path:
    """Exact depth at a sixth of the pixels as KITTI keeps it: up to 80 m, no map at both ends."""
    folder = drive.parents[1] / "annotated" / INSIDE / "image_2"
    names = sorted((drive / "depth_2").glob("*.npy"))
    for k, file in enumerate(names[5:-5]):
        if not (folder / f"{file.stem}.png").is_file():
            depth = np.load(file)
            kept = np.random.default_rng(k).random(depth.shape) < 1 / 6
            depth[~kept | (depth > 80)] = np.nan
            write_depth(folder / f"{file.stem}.png", depth)
    return drive.parents[1] / "annotated"


def cost(args: argparse.Namespace) -> Table:
    """Table IV: time of a depth map, its density, and its growth over the sweep that it is of."""
    rows = []
    for drive in args.data or stand_ins(args, 30):
        for preset in args.presets:
            name = drive.parents[1].name if not args.data else drive.name
            out = args.out / "cost" / f"{name}_{preset}"
            start, used = time.perf_counter(), sum(os.times()[:4])
            fresh = not out.is_dir()
            made = done(drive, out, preset)
            wall, processor = time.perf_counter() - start, sum(os.times()[:4]) - used
            dense, sparse, count = densities(made)
            times = [f"{x / count:.2f}" if fresh else "-" for x in (wall, processor)]
            growth = f"{dense / sparse:.1f}"
            rows.append((name, preset, str(count), *times, f"{100 * dense:.1f}",
                         f"{100 * sparse:.1f}", growth))  # fmt: skip
    header = ("drive", "preset", "maps", "wall s a map", "processor s a map", "density %",
              "of the sweep %", "times")  # fmt: skip
    return Table(titled(args, "Table IV: time and density"), header, tuple(rows))


def densities(made: RunFolder) -> tuple[float, float, int]:
    """Share of pixels with depth, with a return of the nearest sweep, and the number of maps."""
    recording = open_dataset(made.inputs.recording)
    camera = next(name for name, entry in made.cameras.items() if entry.virtual is None)
    maps, stream = maps_in(made.path / "depth" / made.cameras[camera].folder), None
    stream = recording.cameras[camera]
    trajectory, dense, sparse = made.trajectory(), [], []
    for name, path in maps.items():
        at = int(stream.times[stream.names.index(name)])
        nearest = trajectory.nearest(at)
        T = inverse(trajectory.interpolate(at)[0]) @ trajectory.poses[nearest]
        returns = project(stream.camera, stream.T_camera_lidar @ T, made.points(nearest))[0]
        sparse.append(float(np.isfinite(returns).mean()))
        dense.append(float(np.isfinite(read_depth(path)).mean()))
    return float(np.mean(dense)), float(np.mean(sparse)), len(maps)


def far(args: argparse.Namespace) -> Table:
    """Depth of a scene of 700 m: pixels by depth, and the farthest."""
    bins = list(pairwise((0, 80, 150, 300, 500, 700)))
    rows = []
    for drive in args.data or stand_ins(args, 70):
        name = drive.parents[1].name if not args.data else drive.name
        made = done(drive, args.out / "far" / name, "default", FAR)
        for camera, entry in made.cameras.items():
            maps = maps_in(made.path / "depth" / entry.folder)
            depths = [read_depth(path) for path in maps.values()]
            values = np.concatenate([d[np.isfinite(d)] for d in depths])
            shares = np.histogram(values, [0, *(b for _, b in bins)])[0] / sum(
                d.size for d in depths
            )
            cells = [f"{100 * share:.2f}" for share in shares]
            rows.append((f"{name}, {camera}", *cells, f"{values.max(initial=0):.0f}"))
    header = ("drive", *(f"{a}..{b} m: % of pixels" for a, b in bins), "farthest m")
    return Table(titled(args, "Depth up to 700 m"), header, tuple(rows))


def release(args: argparse.Namespace) -> Table:
    """KITTI's release: every drive of every day, DRIVE/proj_depth/groundtruth/CAMERA."""
    if not args.data:
        raise DocDepthError("the release needs --data KITTI_RAW, a folder with days of drives")
    rows = []
    for drive in sorted(path.resolve() for path in args.data[0].glob("*/*_sync")):
        target = args.out / "release" / drive.name
        if not target.is_dir():
            made = done(drive, args.out / "runs" / drive.name, args.presets[0])
            write_release(made, args.out / "release")
        for folder in sorted((target / INSIDE).iterdir()):
            rows.append((drive.name, folder.name, str(len(list(folder.glob("*.png"))))))
    return Table(f"release in {args.out / 'release'}", ("drive", "camera", "maps"), tuple(rows))


def titled(args: argparse.Namespace, title: str) -> str:
    return title if args.data else f"{title}; stand-in, not the data of the paper"


TABLES = {"labels": labels, "ablation": ablation, "completion": completion, "cost": cost,
          "far": far, "release": release}  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> Table | None:
    """Print a table."""
    parser = parser_of(__doc__)
    parser.add_argument("table", choices=[*TABLES, "lidars"])
    parser.add_argument("-o", "--out", type=Path, required=True, help="folder of runs and drives")
    parser.add_argument("--data", type=Path, nargs="+", help="the data set; else a stand-in")
    parser.add_argument("--raw", type=Path, help="KITTI raw, beside its depth completion")
    parser.add_argument("--presets", nargs="+", default=["default", "paper"])
    parser.add_argument("--frames", type=int, help="sweeps of a stand-in")
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--threads", type=int, default=0)
    args = parser.parse_args(arguments)
    if args.table == "completion" and args.data and not args.raw:
        parser.error("completion needs --raw KITTI_RAW beside --data ANNOTATED")
    if args.table == "lidars":
        frames = ["--frames", str(args.frames or 30), "--seed", str(args.seed)]
        two_lidars.main([str(args.out / "drives"), "-o", str(args.out / "lidars"), *frames,
                         "--presets", *args.presets])  # fmt: skip
        return None
    found = TABLES[args.table](args)
    publish([found], args.results)
    return found


if __name__ == "__main__":
    script(main)
