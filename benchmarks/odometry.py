"""Error and processor time of odometry on raw drives with exact poses.

    python benchmarks/odometry.py DRIVES [--cells hills:VLP-16] [--seeds 3 4] [--frames 50]
        [--late MS] [--lost N]

Makes the drives that are missing in DRIVES, by default city and motorway by HDL-64 and a crossing
by XT-32, with raw sweeps and a time for each point. The error is that of the motion from sweep to
sweep. ``--late`` adds random errors to the stamps, as if a computer stamped the sweeps when they
arrive. ``--lost`` leaves out sweeps in the middle, without a gap in the stamps.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import scenes  # noqa: F401  adds its scenes
from results import parser_of, publish

from docdepth.datasets import Sweep, open_dataset
from docdepth.evaluation.tables import Table, number
from docdepth.geometry.se3 import inverse
from docdepth.odometry.odometry import estimate_poses
from docdepth.synthetic import write_drive

HEADER = ("drive", "seed", "mm a sweep", "largest", "degrees", "ms of the processor a sweep")
CELLS = ("city:HDL-64", "crossing:XT-32", "highway:HDL-64")


class Disturbed:
    """A dataset with wrong stamps: late ones, or sweeps that were lost without a trace."""

    def __init__(self, dataset: Any, late: float, lost: int) -> None:
        middle, count = len(dataset) // 2, len(dataset)
        self._dataset = dataset
        self._kept = [*range(middle), *range(middle + lost, count)]
        error = np.random.default_rng(1).normal(scale=1e6 * late, size=count)
        self.times = (dataset.times + error.astype(np.int64))[: len(self._kept)]
        self.poses = np.asarray(dataset.poses)[self._kept]

    def __len__(self) -> int:
        return len(self._kept)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._dataset, name)

    def sweep(self, index: int) -> Sweep:
        return self._dataset.sweep(self._kept[index])


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("drives", type=Path)
    parser.add_argument("--cells", nargs="+", default=list(CELLS), metavar="SCENE:SENSOR")
    parser.add_argument("--seeds", type=int, nargs="+", default=[3, 4])
    parser.add_argument("--frames", type=int, default=50)
    parser.add_argument("--late", type=float, default=0, help="error of the stamps [ms]")
    parser.add_argument("--lost", type=int, default=0, help="sweeps lost in the middle")
    options = parser.parse_args()
    rows = []
    for cell in options.cells:
        scene, lidar = cell.split(":")
        for seed in options.seeds:
            folder = options.drives / f"{scene}_{lidar}_{seed}"
            if not folder.exists():
                made_of = scene, lidar, options.frames, seed
                write_drive(folder, *made_of, skew=True, images=False)
            drive = open_dataset(folder / "sequences" / "00")
            dataset = Disturbed(drive, options.late, options.lost)
            start = time.process_time()
            poses = estimate_poses(dataset, threads=1)
            spent = 1e3 * (time.process_time() - start) / len(poses)
            steps, exact = (inverse(p[:-1]) @ p[1:] for p in (poses, np.asarray(dataset.poses)))
            error = inverse(exact) @ steps
            mm = 1e3 * np.linalg.norm(error[:, :3, 3], axis=1)
            cosine = (np.trace(error[:, :3, :3], axis1=1, axis2=2) - 1) / 2
            turn = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
            figures = (np.sqrt((mm**2).mean()), mm.max(), np.sqrt((turn**2).mean()), spent)
            digits = zip(figures, (1, 0, 3, 0), strict=True)
            rows.append((f"{scene}, {lidar}", str(seed), *(number(*pair) for pair in digits)))
            print(*rows[-1], file=sys.stderr, flush=True)
    publish([Table("Odometry on raw synthetic drives", HEADER, tuple(rows))], options.results)


if __name__ == "__main__":
    main()
