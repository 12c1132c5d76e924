"""The whole chain on raw synthetic drives: own odometry, own labels and tracks, depth.

    python benchmarks/whole_chain.py DRIVES -o RUNS [--scenes city] [--sensors XT-32] [--seed 7]

As ``docdepth run`` gets a recording: sweeps are distorted by the vehicle's motion, and no poses are
given. Each column is against exact truth: poses from sweep to sweep and over the drive, labels of
all points, depth of all images. ``--poses`` takes the exact poses instead. Runs that are there are
continued; drives that are missing are made.
"""

from __future__ import annotations

import sys
from pathlib import Path

from cells import FRAMES, SUITE
from results import parser_of, publish, script

from docdepth import run
from docdepth.evaluation.runs import evaluate_depth, evaluate_labels
from docdepth.evaluation.tables import Table, number
from docdepth.evaluation.trajectories import evaluate_trajectories
from docdepth.synthetic import sensors, write_drive

CAMERA = "image_2"
HEADER = ("scene", "sensor", "poses: mm a sweep", "largest", "end to end m", "DA %", "precision",
          "IoU", "density on surfaces %", "edge displacement px", "too near %", "too far %",
          "interior RMSE m", "moving: edge displacement px", "density %")  # fmt: skip


def measured(drive: Path, made: Path, exact_poses: bool) -> tuple[str, ...]:
    """The figures of a drive; its run is made or continued."""
    run(drive, made, camera=CAMERA, poses="dataset" if exact_poses else None)
    poses = evaluate_trajectories(made, "dataset")
    labels = evaluate_labels(made, drive).counts
    depth = evaluate_depth(made, drive)
    assert depth.dynamic is not None  # synthetic drives tell what moves
    return (
        *(number(1e3 * value, 1) for value in (poses.rpe.rmse, poses.rpe.max)),
        number(poses.ape.rmse, 3),
        number(labels.da, 2),
        *(number(value, 3) for value in (labels.precision, labels.iou)),
        number(depth.density_on_surfaces, 1),
        *(
            number(value, 2)
            for value in (depth.all.edge_displacement, depth.all.too_near, depth.all.too_far)
        ),
        number(depth.interior.rmse, 3),
        number(depth.dynamic.edge_displacement, 2),
        number(depth.dynamic.density, 1),
    )


def main() -> None:
    """Print a table, a row for each cell."""
    parser = parser_of(__doc__)
    parser.add_argument("drives", type=Path, help="folder of the drives; missing ones are made")
    parser.add_argument("-o", "--out", type=Path, required=True, help="folder of the runs")
    parser.add_argument("--scenes", nargs="+", default=list(SUITE), choices=list(FRAMES))
    parser.add_argument("--sensors", nargs="+", default=list(sensors()), choices=list(sensors()))
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--poses", action="store_true", help="exact poses instead of odometry")
    args = parser.parse_args()
    rows = []
    for sensor in args.sensors:
        for scene in args.scenes:
            name = f"{scene}_{sensor}_{args.seed}"
            drive = args.drives / name / "sequences" / "00"
            if not (drive / "docdepth.yaml").is_file():
                write_drive(args.drives / name, scene, sensor, FRAMES[scene], args.seed, skew=True)
            figures = measured(drive, args.out / name, args.poses)
            rows.append((scene, sensor, *figures))
            print(*rows[-1], file=sys.stderr, flush=True)
    publish([Table(f"The whole chain, seed {args.seed}", HEADER, tuple(rows))], args.results)


if __name__ == "__main__":
    script(main)
