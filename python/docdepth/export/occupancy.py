"""Occ3D-nuScenes' layout: voxels around the vehicle at each sweep, free, occupied or unobserved."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from docdepth.concurrency import Progress, null_progress
from docdepth.io.atomic import npz_bytes, write_atomically
from docdepth.pipeline.run_reader import Run
from docdepth.render.occupancy import CORNER, DYNAMIC, FREE, GROUND, SIZE, STATIC, VOXEL

_CLASSES = {"dynamic": DYNAMIC, "ground": GROUND, "static": STATIC, "free": FREE}


def write_occupancy(run: Run, output: Path, progress: Progress = null_progress) -> int:
    """Write ``000000/labels.npz`` of each sweep, and ``occupancy.json``.

    The arrays are those of :class:`~docdepth.render.occupancy.Occupancy`, the masks as uint8. The
    JSON file has the classes, the grid, and the time and ``T_world_grid`` of each sweep.
    """
    frames = {}
    for k in range(len(run.sweeps)):
        found, name = run.occupancy(k), f"{k:06d}"
        content = npz_bytes(
            compressed=True,
            semantics=found.semantics,
            mask_lidar=found.mask_lidar.astype(np.uint8),
            mask_camera=found.mask_camera.astype(np.uint8),
            instance=found.instance,
            flow=found.flow,
        )
        write_atomically(output / name / "labels.npz", content)
        frames[name] = {"time": found.time, "T_world_grid": found.T_world_grid.tolist()}
        progress("convert", k + 1, len(run.sweeps))
    grid = {"voxel": VOXEL, "size": SIZE, "corner": CORNER}
    tree = {"classes": _CLASSES, "grid": grid, "frames": frames}
    write_atomically(output / "occupancy.json", json.dumps(tree, indent=1).encode())
    return len(frames)
