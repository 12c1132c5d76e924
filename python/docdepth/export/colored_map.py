"""The static map in the colours of the photos, as PLY and LAZ."""

from __future__ import annotations

import io
import logging
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from docdepth.concurrency import Progress, null_progress
from docdepth.export.posed_images import Colors, photos
from docdepth.geometry.points import STATIC
from docdepth.io.atomic import write_atomically
from docdepth.io.ply import write_vertices
from docdepth.pipeline.run_reader import Run

log = logging.getLogger(__name__)

_ROW = np.dtype(
    [(n, "<f8") for n in "xyz"]
    + [(n, "u1") for n in ("red", "green", "blue")]
    + [("classid", "<u2"), ("points", "<u4")]
)
_GROUND, _UNCLASSIFIED = 2, 1  # the classes of LAS
_STEP = 0.001  # of places in LAZ [m]


def write_colored_map(run: Run, output: Path, progress: Progress = null_progress) -> int:
    """Write ``map.ply``, and ``map.laz`` where laspy and lazrs are installed.

    A point is the mean of the static points of a voxel, in the world of the run. Its colour is the
    median of the photos whose depth map shows it; grey where none does.
    """
    static = run.static_map()
    colors = Colors(static.points)
    for photo in photos(run, progress):
        colors.add(photo)
    rgb = colors.rgb()
    rows = np.empty(len(rgb), _ROW)
    rows["x"], rows["y"], rows["z"] = static.points.T
    rows["red"], rows["green"], rows["blue"] = rgb.T
    rows["classid"], rows["points"] = static.classid, static.counts
    write_vertices(output / "map.ply", rows, ["world [m]"])
    if find_spec("laspy") and find_spec("lazrs"):
        import laspy

        header = laspy.LasHeader(point_format=7, version="1.4")
        header.scales, header.offsets = np.full(3, _STEP), np.floor(static.points.mean(axis=0))
        las = laspy.LasData(header)
        las.x, las.y, las.z = static.points.T
        las.red, las.green, las.blue = 257 * rgb.T.astype(np.uint16)  # 255 becomes 65535
        las.classification = np.where(static.classid < STATIC, _GROUND, _UNCLASSIFIED)
        stream = io.BytesIO()
        las.write(stream, do_compress=True)
        write_atomically(output / "map.laz", stream.getvalue())
    else:
        log.warning("map.laz is left out: it needs pip install 'docdepth[clouds]'")
    return len(rows)
