"""Classes, instances and tracks of the synthetic suite against exact truth.

    python benchmarks/tracks.py drives -o tracks --seed 7 --scenes arrivals overtaking queue

A cell is a scene seen by a sensor. Its drive is made below ``drives`` if it is missing; runs and
figures of each cell are written below ``tracks``. Poses are exact and sweeps are motion
compensated. `arrived` is the share of the standing points of objects that drove before and stand
from then on, which are labelled dynamic; `depart` that of objects which have not driven yet.

After a change of the code, give another -o.
"""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from cells import Cell, cell_parser, each_cell
from results import script

from docdepth._text import parse_settings
from docdepth.config import Parameters, parameters
from docdepth.evaluation import Table
from docdepth.evaluation.runs import evaluate_labels, evaluate_tracks
from docdepth.evaluation.tables import number
from docdepth.io.atomic import write_atomically
from docdepth.pipeline import run_classify
from docdepth.synthetic import Drive, scene, sensor, sensors
from docdepth.tuning.results import metric_of

# Heading of each column, where its figure is, and its digits.
_ALL = "tracks.kinds.all"
COLUMNS = [
    ("SA %", "labels.sa", 2),
    ("DA %", "labels.da", 2),
    ("precision", "labels.precision", 4),
    ("arrived: DA %", "labels.arrived.da", 1),
    ("depart: DA %", "labels.departs.da", 1),
    ("objects", f"{_ALL}.objects", 0),
    ("found %", f"{_ALL}.found_share", 1),
    ("right instance %", f"{_ALL}.right", 1),
    ("purity %", "tracks.purity", 1),
    ("HOTA", "tracks.hota", 3),
    ("AssA", "tracks.ass_a", 3),
    ("MOTA", "tracks.mota", 3),
    ("id switches", "tracks.id_switches", 0),
]
for _name, _heading, _digits in (
    ("along", "along m", 2), ("across", "across m", 2), ("up", "up m", 2),
    ("heading_deg", "heading deg", 1), ("velocity", "velocity m/s", 2),
):  # fmt: skip
    COLUMNS.append((_heading, f"{_ALL}.errors.{_name}.median", _digits))
    COLUMNS.append(("95 %", f"{_ALL}.errors.{_name}.p95", _digits))
COLUMNS.append(("error / deviation", f"{_ALL}.normalised_error", 2))
COLUMNS.append(("kind right %", f"{_ALL}.kind_right", 1))


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
        name: [metric_of(found, path) for _, path, _ in COLUMNS] for name, found in cells.items()
    }
    means = {"mean": _mean(list(rows.values()))}
    for one in dict.fromkeys(name.rpartition("_")[2] for name in rows):
        means[f"mean {one}"] = _mean([v for name, v in rows.items() if name.endswith(f"_{one}")])
    digits = [d for _, _, d in COLUMNS]
    lines = [(name, *map(number, values, digits)) for name, values in {**means, **rows}.items()]
    return Table(title, ("cell", *(heading for heading, _, _ in COLUMNS)), tuple(lines))


def _mean(rows: list[list[float]]) -> list[float]:
    """Of each column, where a row has a figure."""
    columns = np.array(rows, float).T
    return [float(v[np.isfinite(v)].mean()) if np.isfinite(v).any() else np.nan for v in columns]


def main(arguments: list[str] | None = None) -> dict[str, dict[str, Any]]:
    args = cell_parser(__doc__, images=0).parse_args(arguments)
    args.sensors = args.sensors or list(sensors())
    p, out = parameters(args.preset, parse_settings(args.set)), args.out / f"seed{args.seed}"
    title = f"tracks, seed {args.seed}, exact poses"
    return each_cell(
        args, out, lambda cell: figures(cell, out, p, args.threads), partial(table, title)
    )


if __name__ == "__main__":
    script(main)
