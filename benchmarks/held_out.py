"""Held-out error against exact error, and what names each mistake.

    python benchmarks/held_out.py DRIVES -o RUNS

Raw synthetic drives with exact poses go through docdepth whole, as they are and with mistakes that
people make: poses 5 cm off, a calibration turned by 0.5 degrees, times of images 50 ms late, sweeps
that are said to be motion compensated and are not. A row tells the error of every pixel against
exact depth, the error against sweeps that were left out, and what docdepth says about the run.

Sweeps that are left out are looked at from where the LiDAR is, so they cannot tell where the camera
is and when it looked. The images can: what they say that a wrong camera adds is added to the
held-out error. Both errors are counted, with and without it.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from docdepth import run
from docdepth.config import parameters
from docdepth.errors import CalibrationError, DocDepthError
from docdepth.evaluation.camera_error import camera_error
from docdepth.evaluation.causes import causes
from docdepth.evaluation.held_out import evaluate_held_out
from docdepth.evaluation.runs import evaluate_depth
from docdepth.evaluation.tables import Table, number
from docdepth.evaluation.time_offset import time_offset
from docdepth.geometry.se3 import rotation_exp
from docdepth.io.run_folder import RunFolder
from docdepth.pipeline.calibration_check import check_calibration
from docdepth.synthetic import write_drive

SCENES, SENSORS, FRAMES = ("city", "residential", "crossing"), ("HDL-64", "XT-32"), 30
POSES_OFF, TURNED_DEG, LATE = 0.05, 0.5, 0.05  # metres, degrees, seconds

Mistake = Callable[[Path], None]


def poses_off(drive: Path) -> None:
    """Each pose is 5 cm off in a direction of its own."""
    random = np.random.default_rng(3)
    rows = np.loadtxt(drive / "poses.txt")
    off = random.normal(size=(len(rows), 3))
    rows[:, [3, 7, 11]] += POSES_OFF * off / np.linalg.norm(off, axis=1, keepdims=True)
    replace(drive / "poses.txt", "".join(f"{line(row)}\n" for row in rows))


def calibration_off(drive: Path) -> None:
    """The camera is turned about its vertical axis, which moves the image by 6 pixels."""
    texts = dict(text.split(": ", 1) for text in (drive / "calib.txt").read_text().splitlines())
    Tr = np.array(texts["Tr"].split(), float).reshape(3, 4)
    texts["Tr"] = line((rotation_exp(np.radians([0, TURNED_DEG, 0])) @ Tr).ravel())
    replace(drive / "calib.txt", "".join(f"{k}: {v}\n" for k, v in texts.items()))


def times_off(drive: Path) -> None:
    """The images are stamped late."""
    times = np.loadtxt(drive / "image_2" / "times.txt") + LATE
    images = drive / "image_2"
    source = images.resolve()
    images.unlink()
    images.mkdir()
    for file in source.iterdir():
        (images / file.name).symlink_to(file)
    replace(images / "times.txt", "".join(f"{time:.9f}\n" for time in times))


def not_compensated(drive: Path) -> None:
    """Raw sweeps are taken for motion compensated ones."""
    about = yaml.safe_load((drive / "docdepth.yaml").read_text())
    replace(drive / "docdepth.yaml", yaml.safe_dump({**about, "motion_compensated": True}))
    (drive / "point_times").unlink()


MISTAKES: dict[str, Mistake] = {
    "as it is": lambda drive: None,
    "poses 5 cm off": poses_off,
    "not compensated": not_compensated,
    "calibration 0.5 deg off": calibration_off,
    "images 50 ms late": times_off,
}
UNSEEN = ("calibration 0.5 deg off", "images 50 ms late")
"""Mistakes about the camera alone."""


def replace(file: Path, text: str) -> None:
    """Another content in place of a link to the file of the drive."""
    file.unlink()
    file.write_text(text)


def line(values: np.ndarray) -> str:
    return " ".join(f"{value:.12e}" for value in values)


def spoilt(drive: Path, copy: Path, mistake: Mistake) -> Path:
    """A copy of a drive by links, with a mistake; one that is there stays."""
    if not copy.is_dir():
        copy.mkdir(parents=True)
        for file in drive.iterdir():
            (copy / file.name).symlink_to(file.resolve())
        mistake(copy)
    return copy


def measure(drive: Path, out: Path, preset: str, name: str, every: int) -> dict[str, Any]:
    """Exact and held-out errors of a drive with a mistake, and what is said about it."""
    kept = out / f"{preset} {name}.json"
    if kept.is_file():
        return dict(json.loads(kept.read_text()))
    folder = out / f"{preset}_{name.replace(' ', '_')}"
    sequence = spoilt(drive, out / "drives" / folder.name / "sequences" / "00", MISTAKES[name])
    if not (folder / "report").is_dir():
        run(sequence, folder, parameters(preset), poses="dataset", camera="image_2")
    exact, held = evaluate_depth(folder, drive), evaluate_held_out(folder, every)
    camera = camera_error(RunFolder.open(folder))
    found = {
        "camera": {"mae": camera.mae, "wrong": camera.wrong}
        if camera and np.isfinite(camera.mae)
        else {"mae": 0, "wrong": 0},  # images that fit by chance only give no figure
        "exact": exact.all.as_dict() | {"interior_rmse": exact.interior.rmse},
        "held": held.as_dict(),
        "said": said(folder),
    }
    kept.write_text(json.dumps(found, indent=1))
    return found


def said(folder: Path) -> list[str]:
    """What docdepth finds wrong: by evaluate held-out, calibrate --check and --time."""
    found = causes(RunFolder.open(folder)).lines
    try:
        check = check_calibration(folder)
        found += [] if check.agrees else [check.verdict]
    except CalibrationError as error:
        found.append(str(error).replace(str(folder), "the run"))
    try:
        times = time_offset(folder)
        if abs(times.seconds) > max(2 * times.error, 0.005):
            found.append(times.lines[0])
    except CalibrationError as error:
        found.append(f"(no times: {error})")
    return found


def main(arguments: list[str] | None = None) -> None:
    """Print the table and the correlations."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("drives", type=Path, help="folder of the drives; missing ones are made")
    parser.add_argument("-o", "--out", type=Path, required=True, help="folder of the runs")
    parser.add_argument("--scenes", nargs="+", default=list(SCENES))
    parser.add_argument("--sensors", nargs="+", default=list(SENSORS))
    parser.add_argument("--frames", type=int, default=FRAMES)
    parser.add_argument("--every", type=int, default=5)
    parser.add_argument("--seed", type=int, default=7)
    args = parser.parse_args(arguments)
    rows = []
    for scene in args.scenes:
        for sensor in args.sensors:
            folder = args.drives / f"raw_{scene}_{sensor}_{args.frames}"
            drive = folder / "sequences" / "00"
            if not (drive / "docdepth.yaml").is_file():
                write_drive(folder, scene, sensor, args.frames, args.seed, skew=True)
            for preset in ("default", "paper"):
                for name in MISTAKES if preset == "default" else ("as it is",):
                    out = args.out / f"{scene}_{sensor}"
                    out.mkdir(parents=True, exist_ok=True)
                    found = measure(drive, out, preset, name, args.every)
                    rows.append((f"{scene}, {sensor}", preset, name, found))
                    print(rows[-1][:3], found["said"], file=sys.stderr, flush=True)
    print(table(rows))
    print(correlations(rows))


Row = tuple[str, str, str, dict[str, Any]]
FIGURES = tuple((judge, name) for name in ("mae", "wrong") for judge in ("exact", "held", "camera"))


def figure(found: dict[str, Any], judge: str, name: str) -> float:
    """A figure of a judge; wrong is the share of pixels more than 5 % off."""
    if judge == "both":
        return figure(found, "held", name) + figure(found, "camera", name)
    if judge == "camera":
        return float(found["camera"][name])
    errors = found["exact"] if judge == "exact" else found["held"]["all"]
    return float(errors["too_near"] + errors["too_far"] if name == "wrong" else errors[name])


def table(rows: list[Row]) -> Table:
    figures_of = (f"{judge} {name}" for name in ("MAE m", "wrong %")
                  for judge in ("exact", "held-out", "camera"))  # fmt: skip
    header = ("drive", "preset", "mistake", *figures_of, "named")
    lines = []
    for drive, preset, name, found in rows:
        named = "; ".join(one[:90] for one in found["said"] if not one.startswith("("))
        figures = [number(figure(found, *which), 3) for which in FIGURES]
        lines.append((drive, preset, name, *figures, named or "-"))
    return Table("held-out error against exact error", header, tuple(lines))


def correlations(rows: list[Row]) -> Table:
    """Of exact and held-out errors over the rows: of values, of logarithms, of ranks."""
    seen = [row for row in rows if row[2] not in UNSEEN]
    groups = {
        "what the LiDAR can see": seen,
        "the same, preset default": [row for row in seen if row[1] == "default"],
        "as it is and poses off, preset default": [
            row for row in seen if row[1] == "default" and row[2] != "not compensated"
        ],
        "all rows": rows,
        "all rows, and what the images say": rows,
    }
    lines = []
    for of, chosen in groups.items():
        for name in ("mae", "wrong"):
            judges = ("exact", "both" if of.endswith("say") else "held")
            pair = np.array([[figure(row[3], j, name) for j in judges] for row in chosen])
            ranks = pair.argsort(axis=0).argsort(axis=0)
            values = [np.corrcoef(x.T)[0, 1] for x in (pair, np.log(pair), ranks)]
            cells = (number(float(value), 3) for value in values)
            lines.append((of, name, str(len(pair)), *cells))
    header = ("rows", "figure", "number", "r", "r of logs", "of ranks")
    return Table("correlation", header, tuple(lines))


if __name__ == "__main__":
    try:
        main()
    except DocDepthError as error:
        sys.exit(str(error))
