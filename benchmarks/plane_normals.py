"""The layer ``normal`` on flat surfaces of KITTI raw drive 9001, without truth.

    docdepth run 2011_09_26_drive_9001_sync -o RUN
    python benchmarks/plane_normals.py RUN

Angles to the median normal of a surface, and to the plane through the points of its depth.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from results import parser_of, publish, script

import docdepth
from docdepth.evaluation import Table

IMAGE = "0000000077"
SURFACES = {  # first and last column, first and last row
    "road": (420, 520, 290, 370),
    "tarpaulin": (232, 340, 150, 230),
    "rear of a tanker": (1100, 1230, 60, 230),
    "boot of a car": (590, 735, 295, 350),
}


def angles(normals: NDArray[np.float64], to: NDArray[np.float64]) -> str:
    """Median and 90 % [deg] to a normal, which need not be of unit length."""
    cosine = np.abs(normals @ to) / np.linalg.norm(to)
    found = np.degrees(np.arccos(np.clip(cosine, 0, 1)))
    return " / ".join(f"{value:.1f}" for value in np.quantile(found, (0.5, 0.9)))


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("run", type=Path)
    args = parser.parse_args()
    images = docdepth.open_run(args.run).cameras["image_02"]
    image = images[images.names.index(IMAGE)]
    depth, normal = image.depth, image.layers["normal"]
    rows = []
    for name, (left, right, top, bottom) in SURFACES.items():
        place = np.s_[top:bottom, left:right]
        v, u = np.mgrid[place]
        seen = np.isfinite(depth[place]) & np.isfinite(normal[place]).all(axis=2)
        z = depth[place][seen].astype(np.float64)
        points = np.stack([u[seen], v[seen], np.ones(len(z))], 1) @ np.linalg.inv(image.K).T
        points *= z[:, None]
        points -= np.median(points, axis=0)
        found = normal[place][seen].astype(np.float64)
        plane = np.linalg.svd(points, full_matrices=False)[2][2]
        share = f"{100 * seen.mean():.0f}"
        rows.append((name, share, angles(found, np.median(found, axis=0)), angles(found, plane)))
    title = f"Normals on flat surfaces, KITTI raw 9001, image {IMAGE}, degrees: median / 90 %"
    header = "surface", "pixels with normals %", "to their median", "to the plane of their depth"
    publish([Table(title, header, tuple(rows))], args.results)


if __name__ == "__main__":
    script(main)
