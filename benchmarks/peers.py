"""Other classifiers of moving points beside ours, on the same points and poses.

    docdepth run DRIVE -o RUN
    python benchmarks/peers.py DRIVE --run RUN

compares the classes in RUN with DUFOMap (Duberg et al., RA-L 2024; pip install dufomap scipy) on
the deskewed points and poses of RUN. Without --run only the peers are shown, on the sweeps of DRIVE
with poses from --poses, deskewed with the motion of these poses unless --raw is given.

Every method answers for every point, so that figures are by identity; the cleaned map that its
answer leaves is judged by the 5 cm protocol of DynamicMap_Benchmark and by ERASOR's voxels too.

BeautyMap (Jia et al., RA-L 2024) has no package: give a clone of its repository by --beautymap
(pip install dztimer fire tqdm). It looks 40 m far, at the sizes its authors give for KITTI.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from docdepth.datasets import open_dataset, usable_points
from docdepth.errors import DocDepthError
from docdepth.evaluation import LabelEvaluation, LabelResult, MapEvaluation, MapResult, Table
from docdepth.geometry.sensor_rig import LidarView, lidar_views
from docdepth.io.poses import read_poses
from docdepth.io.run_folder import RunFolder


@dataclass(frozen=True)
class Drive:
    """Usable points of every sweep with their labels, read when asked for."""

    poses: np.ndarray
    source: str  # of the poses
    points: Callable[[int], np.ndarray]
    labels: Callable[[int], np.ndarray]
    ours: Callable[[int], np.ndarray] | None = None
    ours_seconds: float = float("nan")

    def __len__(self) -> int:
        return len(self.poses)

    def in_world(self, index: int) -> np.ndarray:
        """Points of a sweep in the world, float32 (N, 3)."""
        pose = self.poses[index]
        return (self.points(index) @ pose[:3, :3].T + pose[:3, 3]).astype(np.float32)


def drive_of_run(run: Path, recording: Path) -> Drive:
    """Deskewed points, poses and classes of a run; labels of the recording."""
    folder, dataset = RunFolder.open(run), open_dataset(recording)

    def labels(index: int) -> np.ndarray:
        truth = dataset.labels(index)
        if truth is None:
            raise SystemExit(f"{recording} has no labels for sweep {index}")
        return truth[folder.frame(index).index]

    def seen(index: int) -> LidarView:
        # All look from where the LiDAR does.
        frame = folder.frame(index)
        return next(lidar_views(frame.points, folder.sensor_rig(frame)))

    return Drive(
        poses=folder.trajectory().poses @ seen(0).T_lidar_sensor,
        source=str(folder.manifest["source"].get("poses") or "kiss-icp, small_gicp, deskewed"),
        points=lambda index: seen(index).points,
        labels=labels,
        ours=lambda index: folder.frame(index).classid >= 100,
        ours_seconds=folder.stage("classify").get("wall_seconds", float("nan")),
    )


def drive_of_recording(recording: Path, poses_file: Path | None, raw: bool) -> Drive:
    """Sweeps of a recording with its own or given poses, deskewed with their motion."""
    dataset = open_dataset(recording)
    poses = read_poses(poses_file, len(dataset)) if poses_file else dataset.poses
    if poses is None:
        raise SystemExit(f"{recording} comes without poses; give --poses or --run")
    if raw:
        read = lambda index: dataset.sweep(index).points  # noqa: E731
    else:
        from docdepth.odometry.odometry import register_drive

        sweeps = register_drive(dataset, poses=poses).sweeps
        read = lambda index: sweeps[index].points  # noqa: E731

    def points(index: int) -> np.ndarray:
        found = read(index)
        return found[usable_points(found)]

    def labels(index: int) -> np.ndarray:
        truth = dataset.labels(index)
        if truth is None:
            raise SystemExit(f"{recording} has no labels for sweep {index}")
        return truth[usable_points(read(index))]

    source = f"{poses_file or 'of the recording'}, {'raw' if raw else 'deskewed'} sweeps"
    return Drive(poses, source, points, labels)


def dufomap(
    drive: Drive, d_p: int, d_s: float, resolution: float, threads: int
) -> tuple[list[np.ndarray], float]:
    """DUFOMap's answer for every point, and its seconds without reading.

    The map of the whole drive is asked about each sweep.
    """
    try:
        from dufomap import dufomap as DufoMap
    except ImportError:
        raise SystemExit("DUFOMap is not installed: pip install dufomap") from None
    # One point at the sensor's own place makes it find nothing at all: drives hold usable ones.
    peer = DufoMap(resolution, d_s, d_p, num_threads=threads)
    dynamic, seconds = [], 0.0
    for ask in (False, True):
        for index in range(len(drive)):
            points, pose = drive.points(index), drive.poses[index]
            start = time.perf_counter()
            if ask:
                dynamic.append(peer.segment(points, pose, cloud_transform=True) > 0)
            else:
                peer.run(points, pose, cloud_transform=True)
            seconds += time.perf_counter() - start
        if not ask:
            start = time.perf_counter()
            peer.oncePropagateCluster(if_propagate=True, if_cluster=False)
            seconds += time.perf_counter() - start
    return dynamic, seconds


def write_pcd(path: Path, points: np.ndarray, number: np.ndarray, origin: np.ndarray) -> None:
    """Points (N, 3) with a number each as intensity, seen from ``origin``."""
    rows = np.column_stack([points, number]).astype(np.float32)
    header = f"""VERSION .7
FIELDS x y z intensity
SIZE 4 4 4 4
TYPE F F F F
COUNT 1 1 1 1
WIDTH {len(rows)}
HEIGHT 1
VIEWPOINT {origin[0]} {origin[1]} {origin[2]} 1 0 0 0
POINTS {len(rows)}
DATA binary
"""
    path.write_bytes(header.encode() + rows.tobytes())


# It reads and writes with functions that numpy has dropped.
_RUN_BEAUTYMAP = """
import runpy, sys, numpy
sys.path.insert(0, ".")
numpy.fromstring = lambda text, dtype: numpy.frombuffer(text, dtype).copy()
import utils.pcdpy3
utils.pcdpy3.save_pcd = lambda path, points: numpy.save(path + ".npy", points)
runpy.run_path("main.py", run_name="__main__")
"""


def beautymap(drive: Drive, clone: Path) -> tuple[list[np.ndarray], float]:
    """BeautyMap's answer for every point, and its seconds with reading.

    What is missing in the map that it leaves is dynamic. Points are known again by their number.
    """
    counts = [len(drive.points(index)) for index in range(len(drive))]
    first = np.concatenate([[0], np.cumsum(counts)])
    if first[-1] >= 1 << 24:
        raise SystemExit("BeautyMap's floats count to 16.8 million points; give a shorter drive")
    with tempfile.TemporaryDirectory() as folder:
        data = Path(folder)
        (data / "pcd").mkdir()
        clouds = []
        for index in range(len(drive)):
            world, origin = drive.in_world(index), drive.poses[index][:3, 3]
            clouds.append(world)
            # It adds the place of the sensor to the points of a sweep.
            number = np.arange(len(world))
            write_pcd(data / "pcd" / f"{index:06d}.pcd", world - origin, number, origin)
        number = np.arange(first[-1])
        write_pcd(data / "raw_map.pcd", np.concatenate(clouds), number, np.zeros(3))
        start = time.perf_counter()
        command = [sys.executable, "-c", _RUN_BEAUTYMAP, "--data_dir", folder]
        command += ["--dis_range", "40", "--xy_resolution", "1", "--h_res", "0.5"]
        done = subprocess.run(command, cwd=clone, capture_output=True, text=True, check=False)
        seconds = time.perf_counter() - start
        left = data / "beautymap_output.pcd.npy"
        if done.returncode or not left.is_file():
            raise SystemExit(f"BeautyMap failed:\n{done.stderr[-2000:]}")
        dynamic = np.ones(first[-1], bool)
        dynamic[np.load(left)[:, 3].astype(np.int64)] = False
    return np.split(dynamic, first[1:-1]), seconds


@dataclass(frozen=True)
class Row:
    """What one method reached."""

    name: str
    seconds: float  # a sweep
    labels: LabelResult
    maps: MapResult

    def as_dict(self) -> dict:
        parts = {"labels": self.labels.as_dict(), "maps": self.maps.as_dict()}
        return {"method": self.name, "seconds_per_sweep": self.seconds, **parts}


def judge(name: str, drive: Drive, dynamic: Callable[[int], np.ndarray], seconds: float) -> Row:
    """Figures of a method by all protocols."""
    by_identity, maps = LabelEvaluation(drive.source), MapEvaluation(drive.source)
    for index in range(len(drive)):
        truth, called = drive.labels(index), dynamic(index)
        by_identity.add(truth, called, np.linalg.norm(drive.points(index), axis=1))
        maps.add(drive.in_world(index), truth, called)
    return Row(name, seconds / len(drive), by_identity.result(), maps.result())


def table(rows: list[Row]) -> Table:
    """All methods, one a row."""
    header = ("method", "SA %", "DA %", "F1", "precision", "IoU")
    header += ("5 cm: SA %", "DA %", "HA %", "0.2 m: PR %", "RR %", "ms a sweep")
    lines = []
    for row in rows:
        own, near, voxels = row.labels.counts, row.maps.nearest, row.maps.voxels
        cells = [f"{own.sa:.2f}", f"{own.da:.2f}", f"{own.f1:.4f}", f"{own.precision:.3f}"]
        cells += [f"{own.iou:.3f}", f"{near.sa:.2f}", f"{near.da:.2f}", f"{100 * near.f1:.2f}"]
        cells += [f"{voxels.pr:.2f}", f"{voxels.rr:.2f}", f"{1e3 * row.seconds:.0f}"]
        lines.append((row.name, *cells))
    result = rows[0].labels
    title = f"{result.protocol}; poses: {result.poses}; {result.sweeps} sweeps"
    return Table(title, header, tuple(lines))


def main(arguments: list[str] | None = None) -> list[Row]:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("recording", type=Path, help="a labelled recording")
    parser.add_argument("--run", type=Path, help="its classified run folder")
    parser.add_argument("--poses", type=Path, help="TUM or KITTI poses, without --run")
    parser.add_argument("--raw", action="store_true", help="do not deskew, without --run")
    parser.add_argument("--resolution", type=float, default=0.1, help="of DUFOMap [m]")
    parser.add_argument("--d-s", type=float, default=0.2, help="DUFOMap's inflation of hits [m]")
    parser.add_argument("--d-p", type=int, nargs="*", default=[2, 1], help="of the unknown [voxel]")
    parser.add_argument("--threads", type=int, default=0, help="0 takes every core")
    parser.add_argument("--beautymap", type=Path, help="a clone of BeautyMap's repository")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args(arguments)
    if args.run:
        drive = drive_of_run(args.run, args.recording)
    else:
        drive = drive_of_recording(args.recording, args.poses, args.raw)
    rows = []
    if drive.ours:
        rows.append(judge("docdepth", drive, drive.ours, drive.ours_seconds))
    for d_p in args.d_p:
        called, seconds = dufomap(drive, d_p, args.d_s, args.resolution, args.threads)
        rows.append(judge(f"DUFOMap d_p={d_p}", drive, called.__getitem__, seconds))
    if args.beautymap:
        called, seconds = beautymap(drive, args.beautymap)
        rows.append(judge("BeautyMap", drive, called.__getitem__, seconds))
    print(json.dumps([row.as_dict() for row in rows], indent=1) if args.json else table(rows))
    return rows


if __name__ == "__main__":
    try:
        main()
    except DocDepthError as error:
        sys.exit(str(error))
