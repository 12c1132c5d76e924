"""Is confidence true? Errors of depth against it, on synthetic drives with exact depth.

    python benchmarks/confidence.py drives -o confidence.png

Poses and classes are exact, images spread evenly over the drives, which are made where missing
(see suite.py). In the table a row is a tenth of the scale of confidence: how many pixels lie in it,
what it promises (its mean), what was kept (share of pixels less than 5 % off), and the median
error. ``--fit`` also prints the constants that would fit these drives best (a, b, c of
``docdepth.render.layers.confidence``).
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from suite import FRAMES, Cell, Recording

from docdepth.config import RenderParameters, parameters
from docdepth.errors import DocDepthError, MissingExtraError
from docdepth.evaluation import Table
from docdepth.evaluation.tables import number
from docdepth.render.depth_map import compose_depth
from docdepth.render.frame import Frame
from docdepth.render.layers import compose_layers, confidence, confidence_features

Columns = dict[str, NDArray[Any]]


def pixels(cell: Cell, p: RenderParameters, images: int, threads: int) -> Columns:
    """Confidence and error of every pixel up to 80 m whose depth and truth are known."""
    record = Recording(cell)
    drive, rig = record.drive, record.drive.rig
    kept: list[Columns] = []
    for k in np.linspace(0, len(drive.camera_times) - 1, images + 2)[1:-1].round().astype(int):
        frames: dict[int, Frame] = {}

        def frame(i: int, frames: dict[int, Frame] = frames) -> Frame:
            if i not in frames:
                frames[i] = record.frame(i, p)
            return frames[i]

        time = int(drive.camera_times[k])
        view = (rig.camera, rig.T_camera_lidar, record.trajectory, time, frame, p, threads)
        depth, truth = compose_depth(*view), drive.image(int(k)).depth
        found = compose_layers(("support", "measures"), depth, *view)
        sure = confidence(depth, found["support"], found["measures"], p.primitive)
        odds, edge = confidence_features(depth, found["support"], found["measures"], p.primitive)
        known = np.isfinite(depth) & (truth <= 80)
        error = np.abs(depth - truth)
        columns = {"sure": sure, "error": error, "right": error < 0.05 * truth}
        columns |= {"odds": odds, "edge": edge}
        kept.append({name: values[known] for name, values in columns.items()})
    return {name: np.concatenate([c[name] for c in kept]) for name in kept[0]}


def reliability(columns: Columns, bins: int = 10) -> list[tuple[float, ...]]:
    """Share of pixels, mean confidence, share that is right and median error, bin by bin."""
    which = np.minimum((columns["sure"] * bins).astype(int), bins - 1)
    rows = []
    for b in range(bins):
        inside = which == b
        if inside.sum() >= 100:  # fewer tell nothing
            sure, right = columns["sure"][inside], columns["right"][inside]
            error = float(np.median(columns["error"][inside]))
            rows.append((float(inside.mean()), float(sure.mean()), float(right.mean()), error))
    return rows


def joined(cells: dict[str, Columns]) -> Columns:
    """The pixels of all drives."""
    names = ("sure", "error", "right")
    return {name: np.concatenate([c[name] for c in cells.values()]) for name in names}


def fit(cells: list[Columns]) -> NDArray[np.float64]:
    """a, b, c of the logistic function, all drives alike, by Newton's method."""
    weight = np.concatenate([np.full(len(c["odds"]), 1 / len(c["odds"])) for c in cells])
    features = [(np.ones(len(c["odds"])), c["odds"], -c["edge"]) for c in cells]
    X = np.concatenate([np.stack(f, axis=1) for f in features]).astype(np.float64)
    right = np.concatenate([c["right"] for c in cells])
    constants = np.zeros(3)
    for _ in range(30):
        chance = 1 / (1 + np.exp(-(X @ constants)))
        slope = X.T @ (weight * (right - chance))
        bend = (X * (weight * chance * (1 - chance))[:, None]).T @ X
        constants += np.linalg.solve(bend, slope)
    return constants


def plot(cells: dict[str, Columns], path: Path) -> None:
    """Share of wrong pixels and median error against confidence, a line a drive."""
    try:
        import matplotlib

        matplotlib.use("Agg")
        from matplotlib import pyplot
    except ImportError:
        raise MissingExtraError('plots need matplotlib: pip install "docdepth[viz]"') from None
    figure, axes = pyplot.subplots(1, 2, figsize=(11, 4.5))
    for name, columns in {**cells, "all": joined(cells)}.items():
        _, sure, right, error = np.array(reliability(columns)).T
        style: dict[str, Any] = {"lw": 1, "alpha": 0.5}
        if name == "all":
            style = {"color": "black", "lw": 2.5, "zorder": 5}
        axes[0].plot(sure, 100 * (1 - right), "o-", ms=3, label=name, **style)
        axes[1].plot(sure, error, "o-", ms=3, **style)
    axes[0].plot([0, 1], [100, 0], "k:", lw=1, label="as promised")
    axes[0].set(xlabel="confidence", ylabel="pixels more than 5 % off [%]", ylim=(0, 100))
    axes[1].set(xlabel="confidence", ylabel="median absolute error [m]", yscale="log")
    axes[0].legend(fontsize=6, ncol=2)
    figure.tight_layout()
    figure.savefig(path, dpi=120)


def main(arguments: list[str] | None = None) -> dict[str, Columns]:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("drives", type=Path, help="folder of the drives, made where missing")
    parser.add_argument("-o", "--out", type=Path, help="plot")
    parser.add_argument("--scenes", nargs="+", default=list(FRAMES), choices=list(FRAMES))
    parser.add_argument("--sensors", nargs="+", default=["HDL-64", "OS1-128", "XT-32"])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--frames", type=int, help="sweeps of every drive instead of its own")
    parser.add_argument("--images", type=int, default=4, help="of a drive")
    parser.add_argument("--preset", default="default", choices=["default", "paper"])
    parser.add_argument("--fit", action="store_true", help="also print constants fitted to these")
    parser.add_argument("--threads", type=int, default=0, help="0 takes every core")
    args = parser.parse_args(arguments)
    p = parameters(args.preset).render
    cells: dict[str, Columns] = {}
    for one in args.sensors:
        for street in args.scenes:
            cell = Cell(street, one, args.frames or FRAMES[street], args.seed, args.drives)
            cells[cell.name] = pixels(cell, p, args.images, args.threads)
            right = 100 * cells[cell.name]["right"].mean()
            promised = 100 * cells[cell.name]["sure"].mean()
            print(f"{cell.name}: {right:.1f} % right, {promised:.1f} % promised", file=sys.stderr)
    # All drives count alike, whatever their number of pixels.
    tables = [reliability(c) for c in cells.values()]
    lines = tuple(
        (number(100 * share, 1), number(100 * sure, 1), number(100 * right, 1), number(error, 3))
        for share, sure, right, error in reliability(joined(cells))
    )
    heading = ("pixels %", "confidence %", "within 5 % of the truth %", "median error m")
    print(Table(f"confidence, {args.preset}, seed {args.seed}", heading, lines))
    gaps = [abs(sure - right) * share for rows in tables for share, sure, right, _ in rows]
    print(f"mean gap between promised and kept: {100 * sum(gaps) / len(tables):.1f} points a drive")
    if args.fit:
        print("a, b, c =", ", ".join(f"{c:.2f}" for c in fit(list(cells.values()))))
    if args.out:
        plot(cells, args.out)
    return cells


if __name__ == "__main__":
    try:
        main()
    except DocDepthError as error:
        sys.exit(str(error))
