"""How often the first motion of a drive is found, if the drive begins anywhere.

    python benchmarks/first_motion.py DRIVES [--every 9] [--turned DEG]

DRIVES are raw synthetic drives, as ``benchmarks/odometry.py`` makes them. Each begins at every
ninth sweep in turn. A first motion is wrong if it is 0.3 m or more off. ``--turned`` turns the
LiDAR about the vertical, as if another side looked ahead.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from docdepth.config import OdometryParameters
from docdepth.datasets import Sweep, open_dataset
from docdepth.geometry.se3 import inverse
from docdepth.odometry.first_motion import FIRST_SWEEPS, first_motion
from docdepth.odometry.sweeps import FINE_SAMPLING, ThinnedSweeps

WRONG = 0.3  # metres
SHORTEST = 10  # sweeps of a drive


class Turned(ThinnedSweeps):
    """Thinned sweeps of a LiDAR that is turned about the vertical."""

    turn: NDArray[np.float64] = np.eye(3)

    def __getitem__(self, index: int) -> Sweep:
        sweep = super().__getitem__(index)
        return replace(sweep, points=(sweep.points @ self.turn.T).astype(np.float32))


def main() -> None:
    """Print a table, a row for each drive."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("drives", type=Path)
    parser.add_argument("--every", type=int, default=9, help="sweeps between two beginnings")
    parser.add_argument("--turned", type=float, default=0, help="degrees")
    options = parser.parse_args()
    Turned.turn = Rotation.from_euler("z", options.turned, degrees=True).as_matrix()
    print("| drive | beginnings | wrong | median error mm | ms of the processor |")
    print("| --- | --- | --- | --- | --- |")
    count = wrong = 0
    for folder in sorted(options.drives.glob("*/sequences/00")):
        dataset = open_dataset(folder)
        exact = np.asarray(dataset.poses)
        sweeps = Turned(dataset, OdometryParameters(), FINE_SAMPLING, FIRST_SWEEPS)
        begins = range(0, len(dataset) - SHORTEST, options.every)
        errors, started = [], time.process_time()
        for k in begins:
            found = first_motion(sweeps, range(k, len(dataset)))
            step = Turned.turn @ (inverse(exact[k]) @ exact[k + 1])[:3, 3]
            errors.append(np.inf if found is None else float(np.linalg.norm(found[:3, 3] - step)))
        spent = 1e3 * (time.process_time() - started) / len(begins)
        failed = sum(error >= WRONG for error in errors)
        count, wrong = count + len(errors), wrong + failed
        print(
            f"| {folder.parts[-3]} | {len(errors)} | {failed} | {1e3 * np.median(errors):.0f} "
            f"| {spent:.0f} |",
            flush=True,
        )
    print(f"| all | {count} | {wrong} | | |")


if __name__ == "__main__":
    main()
