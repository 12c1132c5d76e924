"""Classes and depth by a LiDAR that is mounted at an angle, against the level one.

    python benchmarks/mounts.py DRIVES -o RUNS [--scenes city] [--sensors XT-32 VLP-16] [--seed 7]

The sweeps of a synthetic drive are turned about an axis between x and y, which is no axis of any
sensor. Poses are those of docdepth's own odometry; which way is up is found.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from docdepth import run
from docdepth.evaluation.runs import evaluate_depth, evaluate_labels
from docdepth.evaluation.tables import Table, number
from docdepth.geometry.se3 import rotation_exp
from docdepth.io.run_folder import RunFolder
from docdepth.synthetic import write_drive

DEGREES = (0, 2, 10, 20, 45, 90)
"""2 degrees are left as they are, as those of any vehicle that leans: they show what is noise."""

AXIS = np.array([0.6, 0.8, 0.0])
HEADER = ("scene", "sensor", "degrees", "up is off by, degrees", "SA", "DA", "IoU", "density %",
          "MAE in shifts", "too near, too far %", "moving: shifts")  # fmt: skip


def turned(level: Path, folder: Path, degrees: float) -> Path:
    """A drive whose LiDAR leans; it shares all files but sweeps and calibration."""
    sequence = folder / "sequences" / "00"
    if (sequence / "calib.txt").is_file():
        return sequence
    (sequence / "velodyne").mkdir(parents=True, exist_ok=True)
    for name in ("times.txt", "poses.txt", "image_2", "labels", "point_times", "docdepth.yaml"):
        (sequence / name).symlink_to((level / name).resolve())
    R = rotation(degrees)
    for file in sorted((level / "velodyne").iterdir()):
        rows = np.fromfile(file, np.float32).reshape(-1, 4)
        rows[:, :3] = rows[:, :3].astype(np.float64) @ R.T
        rows.tofile(sequence / "velodyne" / file.name)
    lines = dict(line.split(": ", 1) for line in (level / "calib.txt").read_text().splitlines())
    Tr = np.array(lines["Tr"].split(), np.float64).reshape(3, 4)
    Tr[:, :3] = Tr[:, :3] @ R.T
    lines["Tr"] = " ".join(f"{value:.12e}" for value in Tr.ravel())
    (sequence / "calib.txt").write_text("".join(f"{k}: {v}\n" for k, v in lines.items()))
    return sequence


def rotation(degrees: float) -> NDArray[np.float64]:
    """From the level frame to that of the LiDAR as it is mounted."""
    return rotation_exp(np.radians(degrees) * AXIS)


def up_error(path: Path, degrees: float) -> float:
    """Degrees between the direction that the run takes for up and the true one."""
    found = np.array(RunFolder.open(path).manifest["source"].get("up") or (0.0, 0.0, 1.0))
    cosine = found @ rotation(degrees)[:, 2] / np.linalg.norm(found)
    return float(np.degrees(np.arccos(min(1.0, cosine))))


def main() -> None:
    """Print a table, a row for each angle."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("drives", type=Path, help="folder of the drives; missing ones are made")
    parser.add_argument("-o", "--out", type=Path, required=True, help="folder of the runs")
    parser.add_argument("--scenes", nargs="+", default=["city"])
    parser.add_argument("--sensors", nargs="+", default=["XT-32", "VLP-16"])
    parser.add_argument("--frames", type=int, default=24)
    parser.add_argument("--seed", type=int, default=7)
    args = parser.parse_args()
    rows = []
    for scene in args.scenes:
        for sensor in args.sensors:
            name = f"{scene}_{sensor}_{args.seed}"
            level = args.drives / name / "sequences" / "00"
            if not (level / "docdepth.yaml").is_file():
                write_drive(args.drives / name, scene, sensor, args.frames, args.seed, skew=True)
            for degrees in DEGREES:
                drive = turned(level, args.drives / f"{name}_{degrees}", degrees)
                made = args.out / f"{name}_{degrees}"
                run(drive, made, camera="image_2")
                labels = evaluate_labels(made, level).counts
                depth = evaluate_depth(made, level)
                rows.append((scene, sensor, str(degrees), number(up_error(made, degrees), 1),
                    number(labels.sa, 2), number(labels.da, 2), number(labels.iou, 3),
                    number(depth.all.density, 1), number(depth.all.shifts, 2),
                    f"{depth.all.too_near:.2f}, {depth.all.too_far:.2f}",
                    number(depth.dynamic.shifts, 2)))  # fmt: skip
                print(*rows[-1], flush=True)
    print(Table("LiDARs mounted at an angle", HEADER, tuple(rows)))


if __name__ == "__main__":
    main()
