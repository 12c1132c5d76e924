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

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from peer_maps import compare_map
from results import parser_of, publish, script

from docdepth.datasets import Dataset, open_dataset, usable_points
from docdepth.evaluation import LabelEvaluation, LabelResult, Table
from docdepth.evaluation.label_counts import NOTE, LabelCounts
from docdepth.evaluation.tables import number
from docdepth.geometry.lidar_frame import LidarView, lidar_views
from docdepth.geometry.points import DYNAMIC
from docdepth.io.poses import read_poses
from docdepth.io.run_folder import RunFolder
from docdepth.odometry.odometry import register_drive


@dataclass(frozen=True)
class Drive:
    """Usable points of each sweep with their true labels, read on request."""

    poses: np.ndarray
    source: str  # of the poses
    points: Callable[[int], np.ndarray]
    labels: Callable[[int], np.ndarray]
    dynamic: Callable[[int], np.ndarray] | None = None  # docdepth's own result
    seconds: float = float("nan")

    def __len__(self) -> int:
        return len(self.poses)

    def in_world(self, index: int) -> np.ndarray:
        """Points of a sweep, world frame, float32 (N, 3)."""
        pose = self.poses[index]
        return (self.points(index) @ pose[:3, :3].T + pose[:3, 3]).astype(np.float32)


def dufomap(
    drive: Drive, d_p: int, d_s: float, resolution: float, threads: int
) -> tuple[list[np.ndarray], float]:
    """Dynamic flags of all points by DUFOMap, and its seconds without reading.

    Each sweep is compared with the map of the whole drive.
    """
    try:
        from dufomap import dufomap as DufoMap
    except ImportError:
        raise SystemExit("DUFOMap is not installed: pip install dufomap") from None
    # A single point at the origin of the sensor makes it find nothing; drives have none.
    peer = DufoMap(resolution, d_s, d_p, num_threads=threads)
    dynamic, seconds = [], 0.0
    for segment in (False, True):
        for index in range(len(drive)):
            points, pose = drive.points(index), drive.poses[index]
            start = time.perf_counter()
            if segment:
                dynamic.append(peer.segment(points, pose, cloud_transform=True) > 0)
            else:
                peer.run(points, pose, cloud_transform=True)
            seconds += time.perf_counter() - start
        if not segment:
            start = time.perf_counter()
            peer.oncePropagateCluster(if_propagate=True, if_cluster=False)
            seconds += time.perf_counter() - start
    return dynamic, seconds


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
        source=folder.inputs.poses or "docdepth, deskewed",
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
    """Metrics of one method: point by point, and of its map by the nearest points and by voxels."""

    name: str
    seconds: float  # per sweep
    labels: LabelResult
    nearest: LabelCounts
    voxels: LabelCounts


def evaluate(name: str, drive: Drive, dynamic: Callable[[int], np.ndarray], seconds: float) -> Row:
    """Metrics of a method by all protocols."""
    by_point, sweeps = LabelEvaluation(drive.source), []
    for index in range(len(drive)):
        truth, found = drive.labels(index), dynamic(index)
        by_point.add(truth, found, np.linalg.norm(drive.points(index), axis=1))
        sweeps.append((drive.in_world(index), truth, found))
    return Row(name, seconds / len(drive), by_point.result(), *compare_map(sweeps))


def table(rows: list[Row]) -> Table:
    """One row per method."""
    header = (
        *("method", "SA %", "DA %", "F1", "precision", "IoU"),
        *("5 cm: SA %", "DA %", "HA %", "0.2 m: PR %", "RR %", "ms per sweep"),
    )
    digits = (2, 2, 4, 3, 3, 2, 2, 2, 2, 2, 0)
    lines = []
    for row in rows:
        own, near, voxels = row.labels.counts, row.nearest, row.voxels
        figures = [own.sa, own.da, own.f1, own.precision, own.iou, near.sa, near.da, 100 * near.f1]
        figures += [voxels.sa, voxels.da, 1e3 * row.seconds]
        lines.append((row.name, *map(number, figures, digits)))
    result = rows[0].labels
    title = f"{result.protocol}; poses: {result.poses}; {result.sweeps} sweeps"
    note = (
        f"{NOTE}; 5 cm: DynamicMap_Benchmark, HA = 100 F1; "
        "0.2 m: ERASOR, preservation rate PR and rejection rate RR"
    )
    return Table(title, header, tuple(lines), note)


def main(arguments: list[str] | None = None) -> list[Row]:
    parser = parser_of(__doc__)
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
    script(main)
