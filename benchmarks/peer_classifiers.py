"""Other classifiers of moving points, run on the sweeps and poses of a drive."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np


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


def write_pcd(path: Path, points: np.ndarray, number: np.ndarray, origin: np.ndarray) -> None:
    """Write points (N, 3) with a number each as intensity; ``origin`` becomes VIEWPOINT."""
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


# BeautyMap reads and writes with functions that numpy has removed.
_RUN_BEAUTYMAP = """
import runpy, sys, numpy
sys.path.insert(0, ".")
numpy.fromstring = lambda text, dtype: numpy.frombuffer(text, dtype).copy()
import utils.pcdpy3
utils.pcdpy3.save_pcd = lambda path, points: numpy.save(path + ".npy", points)
runpy.run_path("main.py", run_name="__main__")
"""


def beautymap(drive: Drive, clone: Path) -> tuple[list[np.ndarray], float]:
    """Dynamic flags of all points by BeautyMap, and its seconds with reading.

    A point that is missing in its cleaned map is dynamic. Points are identified by their number.
    """
    counts = [len(drive.points(index)) for index in range(len(drive))]
    first = np.concatenate([[0], np.cumsum(counts)])
    if first[-1] >= 1 << 24:
        raise SystemExit("BeautyMap numbers at most 16.8 million points; give a shorter drive")
    with tempfile.TemporaryDirectory() as folder:
        data = Path(folder)
        (data / "pcd").mkdir()
        clouds = []
        for index in range(len(drive)):
            world, origin = drive.in_world(index), drive.poses[index][:3, 3]
            clouds.append(world)
            # BeautyMap takes sweeps in the frame of the map; VIEWPOINT tells where each was seen
            # from. It adds the position to the points when it reads them, and subtracts it again.
            number = np.arange(len(world))
            write_pcd(data / "pcd" / f"{index:06d}.pcd", world, number, origin)
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
