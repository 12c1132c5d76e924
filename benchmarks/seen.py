"""What the layer `seen` promises: depth errors of pixels in each state, with exact depth.

    python benchmarks/seen.py drives --images 4 --seed 7

Poses and classes are exact; images are spread evenly over the drives, which are made if they are
missing (see suite.py). For the pixels up to 80 m with depth and true depth: the share of them in
each state of the layer, and what share of those is more than 5 % off. Pixels where something moves
in truth stand apart.
"""

from __future__ import annotations

import argparse
import sys

import numpy as np
from cells import Cell, ExactDrive, add_cell_arguments, cells_of
from numpy.typing import NDArray

from docdepth.config import Parameters, parameters
from docdepth.errors import DocDepthError
from docdepth.evaluation import Table, moving
from docdepth.evaluation.tables import number
from docdepth.render.scene import render_depth, render_layers

STATES = ("not looked at", "agreed", "contradicted")

Counts = NDArray[np.int64]
"""Shape (2, 3, 2): static or moving in truth, state, all pixels and those more than 5 % off."""


def counts(cell: Cell, p: Parameters, images: int, threads: int) -> Counts:
    """Pixels of a drive by what is there, state and error."""
    exact = ExactDrive(cell)
    scene = exact.scene(p)
    found = np.zeros((2, len(STATES), 2), np.int64)
    for k in exact.images(images, ends=False):
        depth, truth = render_depth(scene, exact.camera, k, threads=threads), exact.drive.image(k)
        layers = render_layers(scene, exact.camera, ["seen"], k, depth=depth, threads=threads)
        known = np.isfinite(depth) & (truth.depth <= 80)
        moves = moving(truth.labels.ravel()).reshape(truth.labels.shape)[known].astype(int)
        wrong = np.abs(depth - truth.depth)[known] > 0.05 * truth.depth[known]
        np.add.at(found[..., 0], (moves, layers["seen"][known]), 1)
        np.add.at(found[..., 1], (moves[wrong], layers["seen"][known][wrong]), 1)
    return found


def row(name: str, found: Counts) -> tuple[str, ...]:
    """Shares of pixels and of errors: all, static and moving pixels, state by state [%]."""
    cells = []
    for part in (found.sum(axis=0), *found):
        for pixels, wrong in part:
            share = 100 * pixels / max(part[:, 0].sum(), 1)
            cells.append(f"{number(share, 1)}: {number(100 * wrong / max(pixels, 1), 2)}")
    return (name, *cells)


def main(arguments: list[str] | None = None) -> dict[str, Counts]:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    add_cell_arguments(parser, images=4)
    parser.set_defaults(sensors=["HDL-64", "OS1-128", "XT-32", "Avia"])
    args = parser.parse_args(arguments)
    cells: dict[str, Counts] = {}
    for cell in cells_of(args):
        cells[cell.name] = counts(cell, parameters(args.preset), args.images, args.threads)
        print(*row(cell.name, cells[cell.name]), sep="  ", file=sys.stderr, flush=True)
    heading = ("cell", *(f"{p}: {s}" for p in ("all", "static", "moving") for s in STATES))

    def joined(ending: str) -> Counts:
        some = [found for name, found in cells.items() if name.endswith(ending)]
        return sum(some, np.zeros((2, len(STATES), 2), np.int64))

    lines = [row("all", joined("")), *(row(s, joined(f"_{s}")) for s in args.sensors)]
    lines += [row(name, found) for name, found in cells.items()]
    title = f"share of pixels in each state %: of those more than 5 % off %, seed {args.seed}"
    print(Table(title, heading, tuple(lines)))
    return cells


if __name__ == "__main__":
    try:
        main()
    except DocDepthError as error:
        sys.exit(str(error))
