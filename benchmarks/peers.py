"""Compare docdepth with other classifiers of moving points, on the same points and poses.

    docdepth run DRIVE -o RUN
    python benchmarks/peers.py DRIVE --run RUN

compares the classes of RUN with DUFOMap (Duberg et al., RA-L 2024; pip install dufomap) on
the deskewed points and the poses of RUN. Without --run only the peers run, on the sweeps of DRIVE
with poses from --poses, deskewed with the motion of these poses unless --raw is given.

All methods label all points, so labels are compared point by point. The cleaned map that remains is
also evaluated by the 5 cm protocol of DynamicMap_Benchmark and by ERASOR's voxels.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from peer_classifiers import Drive, dufomap
from peer_maps import MapEvaluation, MapResult
from results import add_results_argument, publish

from docdepth.datasets import Dataset, open_dataset, usable_points
from docdepth.errors import DocDepthError
from docdepth.evaluation import LabelEvaluation, LabelResult, Table
from docdepth.evaluation.label_counts import NOTE
from docdepth.geometry.points import DYNAMIC
from docdepth.geometry.sensor_rig import LidarView, lidar_views
from docdepth.io.poses import read_poses
from docdepth.io.run_folder import RunFolder
from docdepth.odometry.odometry import register_drive


def drive_of_run(run: Path, recording: Path) -> Drive:
    """Deskewed points, poses and classes of a run; labels of the recording."""
    folder, dataset = RunFolder.open(run), open_dataset(recording)

    def labels(index: int) -> np.ndarray:
        return labels_of(dataset, index)[folder.frame(index).index]

    def view(index: int) -> LidarView:
        # The peers assume that a sweep is measured from its origin.
        frame = folder.frame(index)
        return next(lidar_views(frame.points, frame.sensor_rig))

    return Drive(
        poses=folder.trajectory().poses @ view(0).T_lidar_sensor,
        source=folder.inputs.poses or "small_gicp, deskewed",
        points=lambda index: view(index).points,
        labels=labels,
        dynamic=lambda index: folder.classified_frame(index)[1] >= DYNAMIC,
        seconds=folder.stage("classify").wall_seconds,
    )


def drive_of_recording(recording: Path, poses_file: Path | None, raw: bool) -> Drive:
    """Sweeps of a recording with its own or given poses, deskewed with the motion of the poses."""
    dataset = open_dataset(recording)
    poses = read_poses(poses_file, len(dataset)) if poses_file else dataset.poses
    if poses is None:
        raise SystemExit(f"{recording} has no poses; give --poses or --run")
    deskewed = register_drive(dataset, poses=poses).sweeps

    def read(index: int) -> np.ndarray:
        return (dataset.sweep(index) if raw else deskewed[index]).points

    def points(index: int) -> np.ndarray:
        found = read(index)
        return found[usable_points(found)]

    def labels(index: int) -> np.ndarray:
        return labels_of(dataset, index)[usable_points(read(index))]

    source = f"{poses_file or 'of the recording'}, {'raw' if raw else 'deskewed'} sweeps"
    return Drive(poses, source, points, labels)


def labels_of(dataset: Dataset, index: int) -> np.ndarray:
    """True labels of a sweep, or the end of the program."""
    truth = dataset.labels(index)
    if truth is None:
        raise SystemExit(f"{dataset.path} has no labels for sweep {index}")
    return truth


@dataclass(frozen=True)
class Row:
    """Metrics of one method."""

    name: str
    seconds: float  # per sweep
    labels: LabelResult
    maps: MapResult


def evaluate(name: str, drive: Drive, dynamic: Callable[[int], np.ndarray], seconds: float) -> Row:
    """Metrics of a method by all protocols."""
    by_point, maps = LabelEvaluation(drive.source), MapEvaluation(drive.source)
    for index in range(len(drive)):
        truth, found = drive.labels(index), dynamic(index)
        by_point.add(truth, found, np.linalg.norm(drive.points(index), axis=1))
        maps.add(drive.in_world(index), truth, found)
    return Row(name, seconds / len(drive), by_point.result(), maps.result())


def table(rows: list[Row]) -> Table:
    """One row per method."""
    header = ("method", "SA %", "DA %", "F1", "precision", "IoU")
    header += ("5 cm: SA %", "DA %", "HA %", "0.2 m: PR %", "RR %", "ms per sweep")
    lines = []
    for row in rows:
        own, near, voxels = row.labels.counts, row.maps.nearest, row.maps.voxels
        cells = [f"{own.sa:.2f}", f"{own.da:.2f}", f"{own.f1:.4f}", f"{own.precision:.3f}"]
        cells += [f"{own.iou:.3f}", f"{near.sa:.2f}", f"{near.da:.2f}", f"{100 * near.f1:.2f}"]
        cells += [f"{voxels.pr:.2f}", f"{voxels.rr:.2f}", f"{1e3 * row.seconds:.0f}"]
        lines.append((row.name, *cells))
    result = rows[0].labels
    title = f"{result.protocol}; poses: {result.poses}; {result.sweeps} sweeps"
    note = (
        f"{NOTE}; 5 cm: DynamicMap_Benchmark, HA = 100 F1; "
        "0.2 m: ERASOR, preservation rate PR and rejection rate RR"
    )
    return Table(title, header, tuple(lines), note)


def main(arguments: list[str] | None = None) -> list[Row]:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("recording", type=Path, help="a labelled recording")
    parser.add_argument("--run", type=Path, help="a classified run folder of it")
    parser.add_argument("--poses", type=Path, help="TUM or KITTI poses, without --run")
    parser.add_argument("--raw", action="store_true", help="do not deskew, without --run")
    parser.add_argument("--resolution", type=float, default=0.1, help="voxel size of DUFOMap [m]")
    parser.add_argument("--d-s", type=float, default=0.2, help="DUFOMap's inflation of hits [m]")
    parser.add_argument(
        "--d-p",
        type=int,
        nargs="*",
        default=[2, 1],
        help="DUFOMap's inflation of unknown space [voxels]",
    )
    parser.add_argument("--threads", type=int, default=0, help="0 uses all cores")
    add_results_argument(parser)
    args = parser.parse_args(arguments)
    if args.run:
        drive = drive_of_run(args.run, args.recording)
    else:
        drive = drive_of_recording(args.recording, args.poses, args.raw)
    rows = []
    if drive.dynamic:
        rows.append(evaluate("docdepth", drive, drive.dynamic, drive.seconds))
    for d_p in args.d_p:
        found, seconds = dufomap(drive, d_p, args.d_s, args.resolution, args.threads)
        rows.append(evaluate(f"DUFOMap d_p={d_p}", drive, found.__getitem__, seconds))
    publish([table(rows)], args.results)
    return rows


if __name__ == "__main__":
    try:
        main()
    except DocDepthError as error:
        sys.exit(str(error))
