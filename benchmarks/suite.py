"""The synthetic suite: classes and depth maps of many scenes and sensors against exact truth.

    python benchmarks/suite.py drives -o suite            # classes, 25 cells
    python benchmarks/suite.py drives -o suite --depth    # depth, with exact poses and classes
    python benchmarks/suite.py drives -o suite --own      # depth, with own classes and tracks

A cell is a scene seen by a sensor. Its drive is made below ``drives`` if it is missing; tables and
metrics of each cell are written below ``suite``. Poses are exact and sweeps are motion compensated:
classes and depth are measured, odometry is not.

`temporarily static` are points of objects that stand at that moment and move at another. `travel in
view` are those whose object travels at least half a metre while it has returns: the others, such as
a car that departs as the drive ends, cannot be known to move. Of these, `arrived` has been seen to
move and stands from then on, `depart` has not been seen to move yet.

An interrupted suite resumes when the command is given again. After a change of the code, give
another -o.

``--trials benchmarks/switches.yaml`` compares parameter sets, as ``docdepth tune`` does. With
--depth a trial may set parameters of ``render``, and IP-Basic on the nearest sweep is one more row.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from cells import Cell, ExactDrive, cell_parser, each_cell, write_file
from ip_basic import ip_basic
from numpy.typing import NDArray
from results import script

from docdepth._core import __version__
from docdepth._text import parse_settings
from docdepth.config import Parameters, Preset, parameters
from docdepth.evaluation import DepthEvaluation, Table, label_counts, moving
from docdepth.evaluation import depth as depth_evaluation
from docdepth.evaluation.pixels import project
from docdepth.evaluation.tables import number
from docdepth.geometry.se3 import inverse
from docdepth.io.run_folder import stage_key
from docdepth.render.scene import Scene, render_depth
from docdepth.tuning import Objective, Trial, read_trials, tune
from docdepth.tuning.results import metric_of


def _splats(share: float) -> dict[str, Any]:
    """The preset ``paper`` with smaller splats."""
    p = parameters("paper").render
    scaled = {name: [share * size for size in getattr(p, name)] for name in _SIZES}
    return {"preset": "paper", **{f"render.{name}": sizes for name, sizes in scaled.items()}}


_SIZES = ("static_size", "dynamic_size")
DEFAULT_ALONE = [Trial("default", {})]
DEPTH_TRIALS = [
    Trial("default", {}),
    Trial("paper", {"preset": "paper"}),
    Trial("paper, sizes halved", _splats(0.5)),
    Trial("paper, a fifth", _splats(0.2)),
]
IP_BASIC = "IP-Basic, one sweep"

Row = dict[str, float]

Draw = Callable[[int], NDArray[np.float32]]
"""Gives the depth map of an image by its index."""


def label_rows(
    cell: Cell, trials: list[Trial], out: Path, jobs: int, threads: int
) -> dict[str, Row]:
    """Metrics of the classes of each trial."""
    run, objective = cell.run(), Objective("labels", cell.sequence())
    outcomes = tune([run.path], [objective], trials, out / cell.name, jobs, threads)
    return {outcome.name: _row(outcome.metrics, LABEL_COLUMNS) for outcome in outcomes}


def depth_rows(
    cell: Cell, trials: list[Trial], out: Path, images: int, threads: int, own: bool = False
) -> dict[str, Row]:
    """Metrics of the depth maps of each trial, with exact poses. Classes and tracks are exact, too,
    and IP-Basic is one more row; or they are the own ones of each trial."""
    chosen = {trial.name: _parameters(trial) for trial in trials}
    settings: dict[str, Any] = {name: p.model_dump() for name, p in chosen.items()}
    settings |= {} if own else {IP_BASIC: None}
    paths = {name: out / cell.name / f"{name}.json" for name in settings}
    keys = {name: stage_key(__version__, cell.frames, images, s) for name, s in settings.items()}
    rows = {name: row for name in settings if (row := _stored(paths[name], keys[name]))}
    if len(rows) < len(settings):
        exact = ExactDrive(cell)
        methods: dict[str, Draw] = {}
        for name in (name for name in settings if name not in rows):
            if name == IP_BASIC:
                methods[name] = _completion(exact)
                continue
            p = chosen[name]
            run = cell.run(paths[name].with_suffix(""), p) if own else None
            scene = exact.own_scene(run, p, threads) if run else exact.scene(p)
            methods[name] = _renderer(exact, scene, threads)
        for name, metrics in _compare(exact, methods, images).items():
            content = json.dumps({"key": keys[name], "metrics": metrics}, indent=1).encode()
            write_file(paths[name], content)
            rows[name] = _row(metrics, DEPTH_COLUMNS)
    return {name: rows[name] for name in settings}


def _compare(exact: ExactDrive, methods: dict[str, Draw], images: int) -> dict[str, dict[str, Any]]:
    """Metrics of each method, over images spread evenly over the drive."""
    evaluations = {name: DepthEvaluation(poses="exact") for name in methods}
    for k in exact.images(images):
        truth = exact.drive.image(k)
        mask = moving(truth.labels.ravel()).reshape(truth.labels.shape)
        for name, draw in methods.items():
            evaluations[name].add(draw(k), truth.depth, mask, exact.camera.camera.K)
    return {name: evaluation.result().as_dict() for name, evaluation in evaluations.items()}


def _renderer(exact: ExactDrive, scene: Scene, threads: int) -> Draw:
    return lambda index: render_depth(scene, exact.camera, index, threads=threads)


def _completion(exact: ExactDrive) -> Draw:
    camera, trajectory = exact.camera, exact.trajectory

    def draw(index: int) -> NDArray[np.float32]:
        time = int(camera.times[index])
        nearest = trajectory.nearest(time)
        T_lidar_sweep = inverse(trajectory.interpolate(time)[0]) @ trajectory.poses[nearest]
        points = exact.dataset.sweep(nearest).points
        return ip_basic(project(camera.camera, camera.T_camera_lidar @ T_lidar_sweep, points)[0])

    return draw


def _parameters(trial: Trial) -> Parameters:
    settings = dict(trial.settings)
    preset: Preset = "paper" if settings.pop("preset", "default") == "paper" else "default"
    return parameters(preset, settings)


def _stored(path: Path, key: str) -> Row | None:
    found = json.loads(path.read_text()) if path.is_file() else {}
    return _row(found["metrics"], DEPTH_COLUMNS) if found.get("key") == key else None


class Column(NamedTuple):
    """A metric of a table: its dotted name, its heading, and which direction is better."""

    key: str
    heading: str
    digits: int
    better: int = 1  # 1: larger is better, -1: smaller is better


def _row(metrics: Mapping[str, Any], columns: list[Column]) -> Row:
    """Metrics of a table; no points at all are none."""
    row = {column.key: metric_of(metrics, column.key) for column in columns}
    return {key: v if v or not key.endswith(".points") else math.nan for key, v in row.items()}


LABEL_COLUMNS = [
    Column("sa", "SA %", 2),
    Column("da", "DA %", 2),
    Column("f1", "F1", 4),
    Column("precision", "precision", 4),
    Column("iou", "IoU", 4),
]
for _key, _heading in (
    ("temporarily_static", "temporarily static"), ("seen_to_move", "travel in view"),
    ("arrived", "arrived"), ("departs", "depart"),
):  # fmt: skip
    LABEL_COLUMNS.append(Column(f"{_key}.da", f"{_heading}: DA %", 1))
    LABEL_COLUMNS.append(Column(f"{_key}.points", "of points", 0))
DEPTH_COLUMNS = [
    Column("abs_rel", "abs rel %", 2, -1),
    Column("rmse", "RMSE m", 2, -1),
    Column("delta1", "delta1 %", 2),
    Column("density", "density %", 1),
    Column("density_on_surfaces", "density on surfaces %", 1),
    Column("all.mae", "MAE m", 3, -1),
    Column("all.edge_displacement", "edge displacement px", 2, -1),
    Column("all.too_near", "too near %", 2, -1),
    Column("all.too_far", "too far %", 2, -1),
    Column("interior.mae", "interior MAE m", 3, -1),
    Column("interior.rmse", "interior RMSE m", 3, -1),
    Column("dynamic.density", "moving: density %", 1),
    Column("dynamic.edge_displacement", "moving: edge displacement px", 2, -1),
    Column("dynamic_interior.rmse", "moving: interior RMSE m", 3, -1),
]


def table(
    title: str, columns: list[Column], cells: dict[str, dict[str, Row]], note: str = ""
) -> Table:
    """Mean and worst of each trial for each metric, then all cells."""
    trials = list(dict.fromkeys(name for rows in cells.values() for name in rows))
    lines = []

    def add(name: str, trial: str, row: Row) -> None:
        lines.append((name, trial, *(number(row[c.key], c.digits) for c in columns)))

    for trial in trials:
        mean, worst = {}, {}
        for c in columns:
            values = [rows[trial][c.key] for rows in cells.values() if trial in rows]
            known = [value for value in values if not math.isnan(value)] or [math.nan]
            mean[c.key] = float(np.mean(known))
            worst[c.key] = c.better * min(c.better * value for value in known)
        add("mean", trial, mean)
        add("worst", trial, worst)
    for name, rows in cells.items():
        for trial, row in rows.items():
            add(name, trial, row)
    return Table(title, ("cell", "trial", *(c.heading for c in columns)), tuple(lines), note)


def main(arguments: list[str] | None = None) -> dict[str, dict[str, Row]]:
    parser = cell_parser(__doc__, images=20)
    parser.add_argument("--depth", action="store_true", help="depth instead of classes")
    parser.add_argument("--own", action="store_true", help="depth, by own classes and tracks")
    parser.add_argument("--trials", type=Path, help="YAML, NAME: {stage.parameter: value}")
    parser.add_argument("--jobs", type=int, default=1, help="trials of a cell at a time")
    args = parser.parse_args(arguments)
    args.depth |= args.own
    if not args.sensors:
        args.sensors = ["HDL-64", "OS1-128", "XT-32"] + ["VLP-16", "Avia"] * (not args.depth)
    trials = DEPTH_TRIALS if args.depth and not args.own else DEFAULT_ALONE
    trials = read_trials(args.trials) if args.trials else trials
    common = {"preset": args.preset, **parse_settings(args.set)}
    trials = [Trial(trial.name, {**common, **trial.settings}) for trial in trials]
    kind = ("depth-own" if args.own else "depth") if args.depth else "labels"
    out, title = args.out / kind / f"seed{args.seed}", f"{kind}, seed {args.seed}, exact poses"

    def measure(cell: Cell) -> dict[str, Row]:
        if args.depth:
            return depth_rows(cell, trials, out, args.images, args.threads, args.own)
        return label_rows(cell, trials, out, args.jobs, args.threads)

    def whole(cells: dict[str, dict[str, Row]]) -> Table:
        if args.depth:
            return table(title, DEPTH_COLUMNS, cells, depth_evaluation.NOTE)
        return table(title, LABEL_COLUMNS, cells, label_counts.NOTE)

    return each_cell(args, out, measure, whole)


if __name__ == "__main__":
    script(main)
