"""Accuracy of ``docdepth calibrate`` on simulated boards: ``python benchmarks/calibration.py``.

Each trial has ten A0 boards in rooms and streets, a new extrinsic, and corners with 0.3 px of
noise; boards are found in whole sweeps. Printed are the median and what 90 % of the trials stay
below. `bound` is the median error that noise alone leaves, of any estimator without bias (Cramér
and Rao), as the corners and returns of that trial tell it.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from calibration_scenes import A0, CAMERA, random_extrinsic, random_pose, shoot

from docdepth.calibration.bundle import covariance, solve_bundle
from docdepth.calibration.calibrate import BoardPair, find
from docdepth.calibration.quality import difference
from docdepth.errors import CalibrationError
from docdepth.synthetic import sensors

SENSORS = ("HDL-64", "OS1-128", "XT-32", "Avia")
RANGE_NOISE = 0.02


def trial(name: str, seed: int, boards: int) -> dict[str, dict[str, float]]:
    """Errors with K given and with K estimated, of one rig."""
    rng = np.random.default_rng([seed, SENSORS.index(name)])
    sensor = replace(sensors()[name](), noise=RANGE_NOISE)
    T = random_extrinsic(rng)
    pairs = []
    for k in range(boards):
        pose = random_pose(A0, CAMERA, sensor, T, rng)
        shot = shoot(A0, CAMERA, sensor, T, pose, rng)
        pairs.append(BoardPair(f"{k}", shot.corners, shot.sweep))
    found = {}
    for way, lens in (("K given", CAMERA), ("K estimated", None)):
        start = time.perf_counter()
        try:
            used, begin, _ = find(A0, pairs, (CAMERA.width, CAMERA.height), lens)
        except CalibrationError as error:
            print(f"{name}, seed {seed}, {way}: {error}", flush=True)
            found[way] = {"degrees": 180.0, "centimetres": 1e3, "found": 0.0, "K": 1.0,
                          "degrees bound": np.nan, "centimetres bound": np.nan}  # fmt: skip
            continue
        solution = solve_bundle(A0, used, begin, lens is None)
        degrees, centimetres = difference(solution.T_camera_lidar, T)
        bound = rng.multivariate_normal(
            np.zeros(6), covariance(A0, used, solution, lens is None), 1000
        )
        focal = np.diag(solution.lens.K)[:2] / np.diag(CAMERA.K)[:2]
        found[way] = {
            "degrees": degrees,
            "centimetres": centimetres,
            "found": len(used) / boards,
            "K": float(np.abs(focal - 1).max()),
            "degrees bound": float(np.degrees(np.median(np.linalg.norm(bound[:, :3], axis=1)))),
            "centimetres bound": float(100 * np.median(np.linalg.norm(bound[:, 3:], axis=1))),
            "seconds": time.perf_counter() - start,
        }
    return found


def table(results: dict[str, list[dict[str, dict[str, float]]]]) -> str:
    """Medians and 90 % of each sensor and way."""
    lines = [
        f"{'sensor':8} {'':11} {'trials':>6} {'degrees: median':>16} {'90 %':>6} "
        f"{'bound':>6} {'cm: median':>11} {'90 %':>6} {'bound':>6} "
        f"{'boards found':>13} {'K: median':>10} {'90 %':>7}"
    ]
    for name, trials in results.items():
        for way in ("K given", "K estimated"):
            of = {key: np.array([t[way][key] for t in trials]) for key in
                  ("degrees", "centimetres", "found", "K")}  # fmt: skip
            turn, shift = (np.nanmedian([t[way][f"{key} bound"] for t in trials])
                           for key in ("degrees", "centimetres"))  # fmt: skip
            (d, d90), (c, c90), (k, k90) = (
                np.percentile(of[key], (50, 90)) for key in ("degrees", "centimetres", "K")
            )
            lines.append(
                f"{name:8} {way:11} {len(trials):6} {d:16.3f} {d90:6.3f} {turn:6.3f} "
                f"{c:11.2f} {c90:6.2f} {shift:6.2f} "
                f"{100 * of['found'].mean():11.1f} % {100 * k:8.2f} % {100 * k90:5.2f} %"
            )
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sensors", nargs="+", default=SENSORS, choices=SENSORS)
    parser.add_argument("--trials", type=int, default=50)
    parser.add_argument("--boards", type=int, default=10)
    parser.add_argument("--first-seed", type=int, default=100)
    parser.add_argument("-o", "--output", type=Path, help="JSON file of every trial")
    given = parser.parse_args()
    results: dict[str, list[dict[str, dict[str, float]]]] = {name: [] for name in given.sensors}
    for seed in range(given.first_seed, given.first_seed + given.trials):
        for name, trials in results.items():
            trials.append(trial(name, seed, given.boards))
            if given.output:
                given.output.write_text(json.dumps(results, indent=1))
    print(table(results))


if __name__ == "__main__":
    main()
