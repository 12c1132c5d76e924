"""The layer ``normal`` against exact surfaces.

    python benchmarks/normals.py drives -o normals --seed 7 --scenes city highway --sensors HDL-64

A cell is a scene seen by a sensor. Its drive is made below ``drives`` if it is missing. Poses,
classes and tracks are exact. Pixels count whose depth is less than 5 % off. Each figure is the
median angle, and the shares of pixels within 11.25, 22.5 and 30 degrees.
"""

from __future__ import annotations

import argparse
from functools import partial

import numpy as np
from cells import Cell, ExactDrive, cell_parser, each_cell
from numpy.typing import NDArray
from results import script

from docdepth._text import parse_settings
from docdepth.config import parameters
from docdepth.evaluation import Table
from docdepth.evaluation.tables import number
from docdepth.render.scene import render_depth, render_layers

# SemanticKITTI's classes of each row.
KINDS = {
    "road": (40, 60),
    "pavement, grass": (44, 48, 49, 72),
    "building, wall": (50, 51, 52),
    "car": (10, 252),
    "lorry, bus, van": (13, 18, 20, 257, 258, 259),
    "leaves": (70,),
}
WITHIN_DEG = (11.25, 22.5, 30.0)
FEWEST = 300  # pixels of a kind


def measure(cell: Cell, args: argparse.Namespace) -> dict[str, list[float]]:
    """The figures of each kind of surface."""
    exact, p = ExactDrive(cell), parameters(args.preset, parse_settings(args.set))
    scene, angles, labels = exact.scene(p), [], []
    for index in exact.images(args.images, ends=False):
        truth = exact.drive.image(index)
        depth = render_depth(scene, exact.camera, index, threads=args.threads)
        found = render_layers(scene, exact.camera, "normal", index, None, depth, args.threads)
        cosine = (found["normal"] * truth.normals).sum(axis=2)
        with np.errstate(invalid="ignore"):
            right = np.abs(depth - truth.depth) < 0.05 * truth.depth
        angles.append(np.degrees(np.arccos(np.clip(cosine[right], -1, 1))))
        labels.append(truth.labels[right] & 0xFFFF)
    every, label = np.concatenate(angles), np.concatenate(labels)
    return {
        kind: _figures(every[np.isin(label, of) if of else label > 0])
        for kind, of in {"all": (), **KINDS}.items()
    }


def _figures(angles: NDArray[np.float64]) -> list[float]:
    if len(angles) < FEWEST:
        return [np.nan] * 4
    return [float(np.median(angles)), *(100 * float((angles < w).mean()) for w in WITHIN_DEG)]


def table(title: str, cells: dict[str, dict[str, list[float]]]) -> Table:
    """A row for each cell."""
    lines = [
        (name, *(" / ".join(map(number, of, (1, 0, 0, 0))) for of in kinds.values()))
        for name, kinds in cells.items()
    ]
    return Table(title, ("cell", "all", *KINDS), tuple(lines))


def main(arguments: list[str] | None = None) -> None:
    parser = cell_parser(__doc__, images=3)
    parser.set_defaults(
        scenes=["city", "crossing", "highway"], sensors=["HDL-64", "XT-32", "OS1-128"]
    )
    args = parser.parse_args(arguments)
    title = f"normals, seed {args.seed}, exact poses, classes and tracks"
    each_cell(args, args.out, lambda cell: measure(cell, args), partial(table, title))


if __name__ == "__main__":
    script(main)
