"""Other classifiers of moving points, run on the sweeps and poses of a drive."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

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
