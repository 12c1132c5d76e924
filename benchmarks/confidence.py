"""Calibration of the layer `confidence`: depth errors against it, with exact depth.

    python benchmarks/confidence.py drives -o confidence.png

Poses and classes are exact; images are spread evenly over the drives, which are made if they are
missing (see suite.py). A row of the table is a tenth of the scale of confidence: the share of
pixels in it, their mean confidence, the share of them that is less than 5 % off, and their median
error. ``--fit`` also prints the constants a to d of ``docdepth.render.layers.confidence`` that
fit these drives best.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np
from cells import Cell, ExactDrive, add_cell_arguments, cells_of
from numpy.typing import NDArray

from docdepth.config import Parameters, parameters
from docdepth.errors import DocDepthError, MissingExtraError
from docdepth.evaluation import Table
from docdepth.evaluation.tables import number
from docdepth.render.layers import confidence, confidence_features
from docdepth.render.scene import render_depth, render_layers

Columns = dict[str, NDArray[Any]]
"""Arrays of shape (k,), one value per pixel: confidence, error, right and the features."""


def pixels(cell: Cell, p: Parameters, images: int, threads: int) -> Columns:
    """Confidence and error of all pixels up to 80 m with depth and true depth."""
    exact = ExactDrive(cell)
    scene, primitive = exact.scene(p), p.render.primitive
    kept: list[Columns] = []
    for k in exact.images(images, ends=False):
        depth, truth = render_depth(scene, exact.camera, k, threads=threads), exact.drive.image(k)
        names = ["support", "measures"] + ["seen"] * (primitive == "triangles")
        layers = render_layers(scene, exact.camera, names, k, depth=depth, threads=threads)
        measured = depth, layers["support"], layers["measures"], layers.get("seen")
        log_odds, edge, unseen = confidence_features(*measured)
        known = np.isfinite(depth) & (truth.depth <= 80)
        error = np.abs(depth - truth.depth)
        columns = {"confidence": confidence(*measured), "error": error}
        columns |= {"right": error < 0.05 * truth.depth, "log_odds": log_odds, "edge": edge}
        columns["unseen"] = unseen
        kept.append({name: values[known] for name, values in columns.items()})
    return {name: np.concatenate([c[name] for c in kept]) for name in kept[0]}


def reliability(columns: Columns, bins: int = 10) -> list[tuple[float, ...]]:
    """For each bin: share of pixels, mean confidence, share that is right, median error [m]."""
    which = np.minimum((columns["confidence"] * bins).astype(int), bins - 1)
    rows = []
    for b in range(bins):
        inside = which == b
        if inside.sum() >= 100:  # fewer are no statistics
            promised, right = columns["confidence"][inside], columns["right"][inside]
            error = float(np.median(columns["error"][inside]))
            rows.append((float(inside.mean()), float(promised.mean()), float(right.mean()), error))
    return rows


def joined(cells: dict[str, Columns]) -> Columns:
    """The pixels of all drives together."""
    names = ("confidence", "error", "right")
    return {name: np.concatenate([c[name] for c in cells.values()]) for name in names}


def fit(cells: list[Columns]) -> NDArray[np.float64]:
    """Constants a, b, c, d of the logistic function, by Newton's method; all drives weigh alike.

    Of splats, whose pixels are all seen, d is 0.
    """
    weight = np.concatenate([np.full(len(c["log_odds"]), 1 / len(c["log_odds"])) for c in cells])
    rows = [(np.ones(len(c["edge"])), c["log_odds"], -c["edge"], -c["unseen"]) for c in cells]
    X = np.concatenate([np.stack(f, axis=1) for f in rows]).astype(np.float64)
    right = np.concatenate([c["right"] for c in cells])
    used = X.any(axis=0)
    X, constants = X[:, used], np.zeros(used.sum())
    for _ in range(30):
        probability = 1 / (1 + np.exp(-(X @ constants)))
        gradient = X.T @ (weight * (right - probability))
        hessian = (X * (weight * probability * (1 - probability))[:, None]).T @ X
        constants += np.linalg.solve(hessian, gradient)
    return np.concatenate([constants, np.zeros(4 - len(constants))])


def plot(cells: dict[str, Columns], path: Path) -> None:
    """Plot the share of wrong pixels and the median error over confidence, one line per drive."""
    try:
        import matplotlib

        matplotlib.use("Agg")
        from matplotlib import pyplot
    except ImportError:
        raise MissingExtraError('plots need matplotlib: pip install "docdepth[viz]"') from None
    figure, axes = pyplot.subplots(1, 2, figsize=(9, 3.6))
    sensors = list(dict.fromkeys(name.rsplit("_", 1)[1] for name in cells))
    least = 1.0
    for name, columns in {**cells, "all drives": joined(cells)}.items():
        _, promised, right, error = np.array(reliability(columns)).T
        least = min(least, promised.min())
        style: dict[str, Any] = {"color": "black", "lw": 2.5, "zorder": 5, "label": name}
        if name in cells:
            sensor = name.rsplit("_", 1)[1]
            style = {"color": f"C{sensors.index(sensor)}", "lw": 1, "alpha": 0.6, "label": sensor}
        axes[0].plot(promised, 100 * (1 - right), "o-", ms=3, **style)
        axes[1].plot(promised, error, "o-", ms=3, **style)
    axes[0].plot([least, 1], [100 * (1 - least), 0], "k:", lw=1.5, label="as promised")
    axes[0].set(xlabel="confidence", ylabel="pixels more than 5 % off [%]", ylim=(0, None))
    axes[1].set(xlabel="confidence", ylabel="median absolute error [m]", yscale="log")
    named = dict(zip(*axes[0].get_legend_handles_labels()[::-1], strict=True))
    axes[0].legend(named.values(), named.keys(), fontsize=8)
    figure.tight_layout()
    figure.savefig(path, dpi=120)


def main(arguments: list[str] | None = None) -> dict[str, Columns]:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    add_cell_arguments(parser, images=4)
    parser.set_defaults(sensors=["HDL-64", "OS1-128", "XT-32"])
    parser.add_argument("-o", "--out", type=Path, help="plot")
    parser.add_argument("--fit", action="store_true", help="also print constants fitted to these")
    args = parser.parse_args(arguments)
    p = parameters(args.preset)
    cells: dict[str, Columns] = {}
    for cell in cells_of(args):
        found = cells[cell.name] = pixels(cell, p, args.images, args.threads)
        right, promised = 100 * found["right"].mean(), 100 * found["confidence"].mean()
        print(f"{cell.name}: {right:.1f} % right, {promised:.1f} % promised", file=sys.stderr)
    # All drives weigh alike, whatever their number of pixels.
    tables = [reliability(c) for c in cells.values()]
    lines = tuple(
        (*(number(100 * share, 1) for share in row[:3]), number(row[3], 3))
        for row in reliability(joined(cells))
    )
    heading = ("pixels %", "confidence %", "within 5 % of the truth %", "median error m")
    print(Table(f"confidence, {args.preset}, seed {args.seed}", heading, lines))
    gaps = [abs(promised - right) * share for rows in tables for share, promised, right, _ in rows]
    gap = 100 * sum(gaps) / len(tables)
    print(f"mean gap between confidence and the share within 5 %: {gap:.1f} percentage points")
    if args.fit:
        print("a, b, c, d =", ", ".join(f"{c:.2f}" for c in fit(list(cells.values()))))
    if args.out:
        plot(cells, args.out)
    return cells


if __name__ == "__main__":
    try:
        main()
    except DocDepthError as error:
        sys.exit(str(error))
