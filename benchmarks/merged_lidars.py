"""Depth by several LiDARs merged into one cloud without numbers, against the same ones told apart.

    python benchmarks/merged_lidars.py DRIVES -o RUNS [--scenes crossing city] [--seed 83]

`roof` are two spinning LiDARs 1.2 m apart; `around` are four of 120 degrees on the roof and one in
the bumper. The merged cloud is in the frame of the vehicle, one LiDAR after the other.
"""

from __future__ import annotations

import argparse
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from docdepth import run
from docdepth.evaluation.runs import evaluate_depth
from docdepth.evaluation.tables import Table, number
from docdepth.synthetic import Drive, Sensor, scene, sensor, write_drive
from docdepth.synthetic.sensors import Pattern

ORIGIN = np.array([1.2, 0.0, 1.73])
"""Of the synthetic LiDAR frame in the frame of the vehicle [m]."""

Place = tuple[float, float, float]


def spinning(place: Place, columns: int, rows: int) -> tuple[Place, Sensor]:
    """A LiDAR that sees all around, column after column."""
    azimuth = np.linspace(-180, 180, columns, endpoint=False)
    angles = np.meshgrid(azimuth, np.linspace(12, -22, rows), indexing="ij")
    return place, lidar(place, *angles)


def narrow(place: Place, heading: float, columns: int, rows: int) -> tuple[Place, Sensor]:
    """A LiDAR that sees 120 degrees, row after row."""
    azimuth = heading + np.linspace(-60, 60, columns)
    elevation, azimuth = np.meshgrid(np.linspace(10, -15, rows), azimuth, indexing="ij")
    return place, lidar(place, azimuth, elevation)


def lidar(place: Place, azimuth: NDArray[np.float64], elevation: NDArray[np.float64]) -> Sensor:
    """A LiDAR whose rays begin at ``place`` and whose points are in the synthetic LiDAR frame."""
    a, e = np.radians(azimuth.ravel()), np.radians(elevation.ravel())
    directions = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], axis=1)
    none = np.zeros(len(a), np.int64)
    origins = np.broadcast_to(np.array(place), directions.shape)
    pattern = Pattern(directions, np.zeros(1), none, none, origins)
    return replace(sensor("XT-32"), pattern=lambda index: pattern, spins=False)


def rig(name: str, columns: int = 1200) -> list[tuple[Place, Sensor]]:
    """The LiDARs of a rig in the order of the merged cloud, with their places."""
    if name == "roof":
        return [spinning((0, y, 0), columns, 32) for y in (0.6, -0.6)]
    roof = {0: (0.8, 0.0, 0.2), 75: (0.4, 0.6, 0.2), -75: (0.4, -0.6, 0.2), 180: (-0.6, 0.0, 0.2)}
    bumper = spinning((2.3, 0, -1.1), 3 * columns // 4, 12)
    return [bumper, *(narrow(place, yaw, columns // 3, 40) for yaw, place in roof.items())]


def merged(drives: list[Drive], index: int) -> tuple[list[NDArray[np.float32]], NDArray[np.uint32]]:
    """Points of each LiDAR with intensity, in the synthetic LiDAR frame, and labels of all."""
    sweeps = [drive.sweep(index) for drive in drives]
    points = [np.column_stack([s.points, s.intensity]).astype(np.float32) for s in sweeps]
    return points, np.concatenate([s.labels for s in sweeps])


def write_rig(
    folder: Path, name: str, scene_name: str, frames: int, seed: int
) -> tuple[Path, Path, Path]:
    """Write the drive of a rig, told apart and merged; a drive that is there stays.

    Returns
    -------
    (Path, Path, Path)
        Sequences with exact depth, told apart, merged.
    """
    exact, apart, one = (folder / kind / "sequences" / "00" for kind in ("exact", "apart", "one"))
    if (one / "calib.txt").is_file():
        return exact, apart, one
    write_drive(folder / "exact", scene_name, "XT-32", frames, seed)
    lidars = rig(name)
    world = scene(scene_name, seed)
    drives = [Drive(world, own, frames, seed + 1000 * k) for k, (_, own) in enumerate(lidars)]
    for sequence in (apart, one):
        (sequence / "labels").mkdir(parents=True, exist_ok=True)
        (sequence / "image_2").symlink_to((exact / "image_2").resolve())
        for kept in ("times.txt", "poses.txt"):
            shutil.copy(exact / kept, sequence / kept)
        (sequence / "docdepth.yaml").write_text("motion_compensated: true\n")
    for k in range(frames):
        points, labels = merged(drives, k)
        for number_of, (own, (place, _)) in enumerate(zip(points, lidars, strict=True), 1):
            moved = own - np.array([*place, 0], np.float32)
            write(apart / ("velodyne" if number_of == 1 else f"velodyne_{number_of}"), k, moved)
        write(one / "velodyne", k, np.concatenate(points) + np.array([*ORIGIN, 0], np.float32))
        for sequence in (apart, one):
            labels.tofile(sequence / "labels" / f"{k:06d}.label")
    text = (exact / "calib.txt").read_text()
    Tr = drives[0].rig.Tr
    rows = {f"Tr_{k}": moved_by(Tr, place) for k, (place, _) in enumerate(lidars[1:], 2)}
    write_calibration(apart, text, {"Tr": moved_by(Tr, lidars[0][0]), **rows})
    write_calibration(one, text, {"Tr": moved_by(Tr, -ORIGIN)})
    return exact, apart, one


def write(folder: Path, index: int, points: NDArray[np.float32]) -> None:
    folder.mkdir(exist_ok=True)
    points.astype(np.float32).tofile(folder / f"{index:06d}.bin")


def moved_by(Tr: NDArray[np.float64], place: Place | NDArray[np.float64]) -> NDArray[np.float64]:
    """From the frame of a LiDAR at ``place`` to camera 0."""
    T = np.eye(4)
    T[:3, 3] = place
    return np.asarray((Tr @ T)[:3])


def write_calibration(folder: Path, text: str, changed: dict[str, NDArray[np.float64]]) -> None:
    lines = dict(line.split(": ", 1) for line in text.splitlines())
    for name, values in changed.items():
        lines[name] = " ".join(f"{value:.12e}" for value in values.ravel())
    (folder / "calib.txt").write_text("".join(f"{k}: {v}\n" for k, v in lines.items()))


HEADER = ("scene", "rig", "LiDARs", "density %", "MAE m", "MAE in shifts", "too near, too far %",
          "moving: density %", "moving: shifts")  # fmt: skip


def main() -> None:
    """Print a table, two rows for each scene and rig."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("drives", type=Path, help="folder of the drives; missing ones are made")
    parser.add_argument("-o", "--out", type=Path, required=True, help="folder of the runs")
    parser.add_argument("--scenes", nargs="+", default=["crossing", "city"])
    parser.add_argument("--rigs", nargs="+", default=["roof", "around"])
    parser.add_argument("--frames", type=int, default=16)
    parser.add_argument("--seed", type=int, default=83)
    args = parser.parse_args()
    rows = []
    for scene_name in args.scenes:
        for name in args.rigs:
            folder = args.drives / f"{name}_{scene_name}_{args.seed}"
            exact, *recordings = write_rig(folder, name, scene_name, args.frames, args.seed)
            for kind, recording in zip(("told apart", "merged"), recordings, strict=True):
                made = args.out / f"{name}_{scene_name}_{kind.split()[-1]}"
                run(recording, made, poses="dataset", camera="image_2")
                found = evaluate_depth(made, exact)
                far = f"{found.all.too_near:.2f}, {found.all.too_far:.2f}"
                figures = (number(found.all.density, 1), number(found.all.mae, 3))
                moving = (number(found.dynamic.density, 1), number(found.dynamic.shifts, 2))
                shifts = number(found.all.shifts, 2)
                rows.append((scene_name, name, kind, *figures, shifts, far, *moving))
    print(Table("several LiDARs in one cloud", HEADER, tuple(rows)))


if __name__ == "__main__":
    main()
