"""Classes, instances and tracks of the synthetic suite against exact truth.

    python benchmarks/tracks.py drives -o tracks --seed 7 --scenes arrivals overtaking queue

A cell is a scene seen by a sensor. Its drive is made below ``drives`` if it is missing; runs and
figures of each cell are written below ``tracks``. Poses are exact and sweeps are motion
compensated. `arrived` is the share of the standing points of objects that drove before and stand
from then on, which are labelled dynamic; `depart` that of objects which have not driven yet.

After a change of the code, give another -o.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
from cells import Cell, add_cell_arguments, cells_of
from results import add_results_argument, publish

from docdepth.config import Parameters, parameters, parse_settings
from docdepth.errors import DocDepthError
from docdepth.evaluation import Table
from docdepth.evaluation.runs import evaluate_labels, evaluate_tracks
from docdepth.evaluation.tables import number
from docdepth.io.atomic import write_atomically
from docdepth.pipeline import run_classify
from docdepth.synthetic import Drive, scene, sensor, sensors

# Heading of each column, where its figure is, and its digits.
COLUMNS: dict[str, tuple[tuple[str, ...], int]] = {
    "SA %": (("labels", "sa"), 2),
    "DA %": (("labels", "da"), 2),
    "precision": (("labels", "precision"), 4),
    "arrived: DA %": (("labels", "arrived", "da"), 1),
    "depart: DA %": (("labels", "departs", "da"), 1),
    "objects": (("tracks", "kinds", "all", "objects"), 0),
    "found %": (("tracks", "kinds", "all", "found_share"), 1),
    "right instance %": (("tracks", "kinds", "all", "right"), 1),
    "purity %": (("tracks", "purity"), 1),
    "HOTA": (("tracks", "hota"), 3),
    "AssA": (("tracks", "ass_a"), 3),
    "MOTA": (("tracks", "mota"), 3),
    "id switches": (("tracks", "id_switches"), 0),
    "along m": (("tracks", "kinds", "all", "errors", "along", "median"), 2),
    "95 %": (("tracks", "kinds", "all", "errors", "along", "p95"), 2),
    "across m": (("tracks", "kinds", "all", "errors", "across", "median"), 2),
    "95 % ": (("tracks", "kinds", "all", "errors", "across", "p95"), 2),
    "up m": (("tracks", "kinds", "all", "errors", "up", "median"), 2),
    "95 %  ": (("tracks", "kinds", "all", "errors", "up", "p95"), 2),
    "heading deg": (("tracks", "kinds", "all", "errors", "heading_deg", "median"), 1),
    "95 %   ": (("tracks", "kinds", "all", "errors", "heading_deg", "p95"), 1),
    "velocity m/s": (("tracks", "kinds", "all", "errors", "velocity", "median"), 2),
    "95 %    ": (("tracks", "kinds", "all", "errors", "velocity", "p95"), 2),
    "error / deviation": (("tracks", "kinds", "all", "normalised_error"), 2),
    "kind right %": (("tracks", "kinds", "all", "kind_right"), 1),
}


def figures(cell: Cell, out: Path, p: Parameters, threads: int) -> dict[str, Any]:
    """Figures of the labels and of the tracks of a cell."""
    sequence, run = cell.sequence(), cell.run(out / cell.name, p)
    run_classify(run, threads)
    drive = Drive(scene(cell.scene, cell.seed), sensor(cell.sensor), cell.frames, cell.seed)
    result = {
        "labels": evaluate_labels(run, sequence).as_dict(),
        "tracks": evaluate_tracks(run, sequence, drive.tracks()).as_dict(),
    }
    content = json.dumps(result, indent=1).encode()
    write_atomically(out / f"{cell.name}.json", lambda stream: stream.write(content))
    return result


def table(title: str, cells: dict[str, dict[str, Any]]) -> Table:
    """The mean of all cells, of those of each sensor, and each cell."""
    rows = {
        name: [_figure(found, path) for path, _ in COLUMNS.values()]
        for name, found in cells.items()
    }
    sensors_of = dict.fromkeys(name.rpartition("_")[2] for name in rows)
    means = {"mean": _mean(list(rows.values()))}
    for one in sensors_of:
        means[f"mean {one}"] = _mean([v for name, v in rows.items() if name.endswith(f"_{one}")])
    digits = [d for _, d in COLUMNS.values()]
    lines = [
        (name, *(number(value, d) for value, d in zip(values, digits, strict=True)))
        for name, values in {**means, **rows}.items()
    ]
    return Table(title, ("cell", *(heading.strip() for heading in COLUMNS)), tuple(lines))


def _mean(rows: list[list[float]]) -> list[float]:
    """Of each column, where a row has a figure."""
    columns = np.array(rows, float).T
    return [float(v[np.isfinite(v)].mean()) if np.isfinite(v).any() else np.nan for v in columns]


def _figure(found: dict[str, Any], path: tuple[str, ...]) -> float:
    value: Any = found
    for name in path:
        value = value[name]
    return np.nan if value is None else float(value)


def main(arguments: list[str] | None = None) -> dict[str, dict[str, Any]]:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    add_cell_arguments(parser, images=0)
    parser.add_argument("-o", "--out", type=Path, required=True, help="folder of the results")
    parser.add_argument("--set", action="append", default=[], metavar="STAGE.NAME=VALUE")
    add_results_argument(parser)
    args = parser.parse_args(arguments)
    args.sensors = args.sensors or list(sensors())
    p = parameters(args.preset, parse_settings(args.set))
    out = args.out / f"seed{args.seed}"
    cells: dict[str, dict[str, Any]] = {}
    for cell in cells_of(args):
        cells[cell.name] = figures(cell, out, p, args.threads)
        whole = table(f"tracks, seed {args.seed}, exact poses", cells)
        text = whole.markdown().encode()
        write_atomically(out / "table.md", lambda stream, t=text: stream.write(t))
        print("  ".join(whole.rows[-1]), file=sys.stderr, flush=True)
    publish([whole], args.results)
    return cells


if __name__ == "__main__":
    try:
        main()
    except DocDepthError as error:
        sys.exit(str(error))
