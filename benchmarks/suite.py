"""The synthetic suite: classes and depth of many streets and sensors, against exact truth.

    python benchmarks/suite.py drives -o suite            # classes, 25 cells
    python benchmarks/suite.py drives -o suite --depth    # depth with exact poses and classes

makes a drive for each cell (a scene seen by a sensor) below ``drives`` and writes tables and the
figures of each cell below ``suite``. Poses are exact and sweeps motion compensated: what is
measured are classes and depth, not odometry. `standing` are points of objects that wait at that
moment and move at another, `seen to move` those of them whose object goes at least half a metre
while it has returns: of a car that leaves its place as the drive ends nobody can know it.

Killed, it goes on where it stopped when it is given again; after a change of the code, give
another -o.

``--trials benchmarks/switches.yaml`` puts parts on and off, as ``docdepth sweep`` does. With
--depth
a trial may hold parameters of ``render``, and IP-Basic on the nearest sweep is always beside it.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from ip_basic import ip_basic
from numpy.typing import NDArray

from docdepth import __version__
from docdepth.config import (
    Parameters,
    RenderParameters,
    parameters,
    parse_settings,
)
from docdepth.datasets import open_dataset
from docdepth.errors import DocDepthError, RunError
from docdepth.evaluation import DepthEvaluation, Table, moving
from docdepth.evaluation.pixels import project
from docdepth.evaluation.tables import number
from docdepth.geometry.points import DYNAMIC, GROUND, STATIC
from docdepth.geometry.se3 import inverse
from docdepth.geometry.trajectory import Trajectory
from docdepth.io.atomic import write_atomically
from docdepth.io.run_folder import RunFolder, stage_key
from docdepth.pipeline import run_odometry
from docdepth.render.depth_map import compose_depth
from docdepth.render.frame import Frame
from docdepth.render.selection import needed_frames
from docdepth.synthetic import Drive, scene, sensor, sensors, write_drive
from docdepth.tuning import Trial, read_trials, tune

# Sweeps of a whole drive: as long as something happens.
FRAMES = {"crossing": 100, "city": 125, "hills": 80, "residential": 90, "highway": 70}
# Road, parking, pavement, other ground, lane marking, terrain.
GROUND_LABELS = (40, 44, 48, 49, 60, 72)


def _splats(share: float) -> dict[str, Any]:
    sizes = parameters("paper").render.model_dump()
    scaled = {f"render.{name}": share * sizes[name] for name in sizes if "_size_" in name}
    return {"preset": "paper", **scaled}


LABEL_TRIALS = [Trial("default", {})]
DEPTH_TRIALS = [
    Trial("default", {}),
    Trial("paper", {"preset": "paper"}),
    Trial("paper, sizes halved", _splats(0.5)),
    Trial("paper, a fifth", _splats(0.2)),
]
IP_BASIC = "IP-Basic, one sweep"

Row = dict[str, float]


@dataclass(frozen=True)
class Cell:
    """A scene seen by a sensor, and where its drive lies."""

    scene: str
    sensor: str
    frames: int
    seed: int
    drives: Path

    @property
    def name(self) -> str:
        return f"{self.scene}_{self.sensor}"

    @property
    def folder(self) -> Path:
        return self.drives / f"seed{self.seed}" / self.name

    def sequence(self) -> Path:
        """Folder of the drive, written now unless it is there."""
        about = self.folder / "sequences" / "00" / "docdepth.yaml"
        wanted = {"scene": self.scene, "sensor": self.sensor, "seed": self.seed}
        wanted |= {"frames": self.frames, "motion_compensated": True}
        if not about.is_file():
            write_drive(self.folder, self.scene, self.sensor, self.frames, self.seed, images=False)
        elif yaml.safe_load(about.read_text()) != wanted:
            raise RunError(f"{about.parent} holds another drive than {wanted}; delete it")
        return about.parent

    def run(self) -> RunFolder:
        """The drive as a run with exact poses, up to its classification."""
        sequence = self.sequence()
        path = self.folder / "run"
        run = RunFolder(path)
        if run.manifest:
            # Parameters of trials are filled up from those of the run: let them be today's.
            run.manifest["parameters"] = Parameters().model_dump()
            run.save()
        else:
            source = {"dataset": str(sequence.resolve()), "poses": "exact"}
            run = RunFolder.create(path, source, Parameters())
        dataset = open_dataset(sequence)
        run_odometry(run, dataset, dataset.poses)
        return run


def label_rows(
    cell: Cell, trials: list[Trial], out: Path, jobs: int, threads: int
) -> dict[str, Row]:
    """Figures of each trial's classes."""
    run, sequence = cell.run(), cell.sequence()
    outcomes = tune(run.path, sequence, trials, out / cell.name, jobs, threads)
    rows = {}
    for outcome in outcomes:
        row = {name: outcome.figure(name) for name in ("sa", "da", "f1", "precision", "iou")}
        for name in ("temporarily_static", "seen_to_move"):
            points, da = outcome.figures[name]["points"], outcome.figures[name]["da"]
            row |= {name: math.nan if da is None else da, f"{name}_points": points or math.nan}
        rows[outcome.name] = row
    return rows


def depth_rows(
    cell: Cell, trials: list[Trial], out: Path, images: int, threads: int
) -> dict[str, Row]:
    """Figures of each trial's depth maps, and of IP-Basic, with exact poses and classes."""
    chosen = {trial.name: _parameters(trial) for trial in trials}
    settings = {name: p.model_dump() for name, p in chosen.items()} | {IP_BASIC: None}
    paths = {name: out / cell.name / f"{name}.json" for name in settings}
    keys = {name: stage_key(__version__, cell.frames, images, s) for name, s in settings.items()}
    rows = {name: row for name in settings if (row := _stored(paths[name], keys[name]))}
    if len(rows) < len(settings):
        rec = Recording(cell)
        made = {name: _completion(rec) for name in (IP_BASIC,) if name not in rows}
        made |= {n: _renderer(rec, p, threads) for n, p in chosen.items() if n not in rows}
        for name, figures in _compare(rec.drive, made, images).items():
            content = json.dumps({"key": keys[name], "figures": figures}, indent=1).encode()
            write_atomically(paths[name], lambda stream, c=content: stream.write(c))
            rows[name] = _depth_row(figures)
    return {name: rows[name] for name in settings}


Draw = Callable[[int], NDArray[np.float32]]
"""Depth map of the image taken at a time [ns]."""


class Recording:
    """The drive of a cell with the world it was made in and exact classes."""

    def __init__(self, cell: Cell) -> None:
        self.dataset = open_dataset(cell.sequence())
        world = scene(cell.scene, cell.seed)
        self.drive = Drive(world, sensor(cell.sensor), cell.frames, cell.seed)
        self.trajectory = Trajectory(self.drive.times, self.drive.poses)

    def frame(self, index: int, p: RenderParameters) -> Frame:
        """A sweep, dynamic where it is of what moves at any time of the drive."""
        labels, sweep = self.dataset.labels(index), self.dataset.sweep(index)
        assert labels is not None
        classid = np.where(np.isin(labels & 0xFFFF, GROUND_LABELS), GROUND, STATIC)
        classid[moving(labels)] = DYNAMIC
        time_offset, velocity = self._late(sweep.points), self.trajectory.velocity(index)
        seen_by = sweep.sensors
        return Frame(sweep.points, classid.astype(np.uint16), p, time_offset, seen_by, velocity)

    def _late(self, points: NDArray[np.float32]) -> NDArray[np.float32] | None:
        """Seconds after the stamp at which each was measured; None for a sensor that does not spin.

        What moves was seen there and then, motion compensated or not.
        """
        if self.drive.sensor.name == "Avia":
            return None
        turn = -np.arctan2(points[:, 1], points[:, 0]) / (2 * np.pi)
        return (turn * self.drive.sensor.period).astype(np.float32)


def _compare(drive: Drive, made: dict[str, Draw], images: int) -> dict[str, dict[str, Any]]:
    """Figures of all that can draw, over images spread evenly over the drive."""
    evaluations = {name: DepthEvaluation(poses="exact") for name in made}
    last = len(drive.camera_times) - 1
    for k in np.unique(np.linspace(0, last, images).round().astype(int)):
        truth = drive.image(int(k))
        mask = moving(truth.labels.ravel()).reshape(truth.labels.shape)
        for name, draw in made.items():
            depth = draw(int(drive.camera_times[k]))
            evaluations[name].add(depth, truth.depth, mask, drive.rig.camera.K)
    return {name: evaluation.result().as_dict() for name, evaluation in evaluations.items()}


def _renderer(recording: Recording, p: Parameters, threads: int) -> Draw:
    frames: dict[int, Frame] = {}
    rig, trajectory = recording.drive.rig, recording.trajectory

    def draw(time: int) -> NDArray[np.float32]:
        needed = needed_frames(trajectory, time, p.render)
        for index in set(frames) - needed:
            del frames[index]
        for index in needed - set(frames):
            frames[index] = recording.frame(index, p.render)
        place = rig.camera, rig.T_camera_lidar, trajectory, time
        return compose_depth(*place, frames.__getitem__, p.render, threads)

    return draw


def _completion(recording: Recording) -> Draw:
    rig, trajectory = recording.drive.rig, recording.trajectory

    def draw(time: int) -> NDArray[np.float32]:
        nearest = trajectory.nearest(time)
        T_lidar_sweep = inverse(trajectory.interpolate(time)[0]) @ trajectory.poses[nearest]
        points = recording.dataset.sweep(nearest).points
        return ip_basic(project(rig.camera, rig.T_camera_lidar @ T_lidar_sweep, points)[0])

    return draw


def _parameters(trial: Trial) -> Parameters:
    settings = dict(trial.settings)
    return parameters(settings.pop("preset", "default"), settings)


def _stored(path: Path, key: str) -> Row | None:
    found = json.loads(path.read_text()) if path.is_file() else {}
    return _depth_row(found["figures"]) if found.get("key") == key else None


def _depth_row(figures: dict[str, Any]) -> Row:
    everywhere, interior, dynamic = (figures[region] for region in ("all", "interior", "dynamic"))
    row = {"density": figures["density_on_surfaces"], "mae": everywhere["mae"]}
    row |= {name: everywhere[name] for name in ("shifts", "too_near", "too_far")}
    row |= {"interior_mae": interior["mae"], "interior_rmse": interior["rmse"]}
    row |= {"moving_density": dynamic["density"], "moving_shifts": dynamic["shifts"]}
    return {name: math.nan if value is None else value for name, value in row.items()}


# Name of a figure, heading, digits, and 1 where more is better, -1 where less is.
LABEL_COLUMNS = [("sa", "SA %", 2, 1), ("da", "DA %", 2, 1), ("f1", "F1", 4, 1)]
LABEL_COLUMNS += [("precision", "precision", 4, 1), ("iou", "IoU", 4, 1)]
LABEL_COLUMNS += [("temporarily_static", "standing DA %", 1, 1)]
LABEL_COLUMNS += [("temporarily_static_points", "of points", 0, 1)]
LABEL_COLUMNS += [("seen_to_move", "seen to move DA %", 1, 1)]
LABEL_COLUMNS += [("seen_to_move_points", "of points", 0, 1)]
DEPTH_COLUMNS = [("density", "density on surfaces %", 1, 1), ("mae", "MAE m", 3, -1)]
DEPTH_COLUMNS += [("shifts", "shifts", 2, -1), ("too_near", "too near %", 2, -1)]
DEPTH_COLUMNS += [("too_far", "too far %", 2, -1), ("interior_mae", "interior MAE m", 3, -1)]
DEPTH_COLUMNS += [("interior_rmse", "RMSE m", 3, -1), ("moving_density", "moving: density %", 1, 1)]
DEPTH_COLUMNS += [("moving_shifts", "shifts", 2, -1)]


def table(
    title: str, columns: list[tuple[str, str, int, int]], cells: dict[str, dict[str, Row]]
) -> Table:
    """Mean and worst of each trial, figure by figure, then every cell."""
    trials = list(dict.fromkeys(name for rows in cells.values() for name in rows))
    lines = []

    def add(name: str, trial: str, row: Row) -> None:
        lines.append((name, trial, *(number(row[key], digits) for key, _, digits, _ in columns)))

    for trial in trials:
        mean, worst = {}, {}
        for key, _, _, up in columns:
            values = [of[trial][key] for of in cells.values() if trial in of]
            known = [value for value in values if not math.isnan(value)] or [math.nan]
            mean[key], worst[key] = float(np.mean(known)), up * min(up * value for value in known)
        add("mean", trial, mean)
        add("worst", trial, worst)
    for name, of in cells.items():
        for trial, row in of.items():
            add(name, trial, row)
    return Table(title, ("cell", "trial", *(heading for _, heading, *_ in columns)), tuple(lines))


def cells_of(args: argparse.Namespace) -> Iterator[Cell]:
    """Cells in order, sensors outside, since the first sensor alone already tells much."""
    for one in args.sensors:
        for street in args.scenes:
            yield Cell(street, one, args.frames or FRAMES[street], args.seed, args.drives)


def main(arguments: list[str] | None = None) -> dict[str, dict[str, Row]]:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("drives", type=Path, help="folder of the drives, made where missing")
    parser.add_argument("-o", "--out", type=Path, required=True, help="folder of the results")
    parser.add_argument("--depth", action="store_true", help="depth instead of classes")
    parser.add_argument("--scenes", nargs="+", default=list(FRAMES), choices=list(FRAMES))
    parser.add_argument("--sensors", nargs="+", choices=list(sensors()))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--frames", type=int, help="sweeps of every drive instead of its own")
    parser.add_argument("--images", type=int, default=20, help="of a drive, with --depth")
    parser.add_argument("--preset", default="default", choices=["default", "paper"])
    parser.add_argument("--set", action="append", default=[], metavar="STAGE.NAME=VALUE")
    parser.add_argument("--trials", type=Path, help="YAML, NAME: {stage.parameter: value}")
    parser.add_argument("--jobs", type=int, default=1, help="trials of a cell at a time")
    parser.add_argument("--threads", type=int, default=0, help="0 takes every core")
    args = parser.parse_args(arguments)
    if not args.sensors:
        args.sensors = ["HDL-64", "OS1-128", "XT-32"] + ["VLP-16", "Avia"] * (not args.depth)
    trials = DEPTH_TRIALS if args.depth else LABEL_TRIALS
    trials = read_trials(args.trials) if args.trials else trials
    common = {"preset": args.preset, **parse_settings(args.set)}
    trials = [Trial(trial.name, {**common, **trial.settings}) for trial in trials]
    what = "depth" if args.depth else "labels"
    out = args.out / what / f"seed{args.seed}"
    columns = DEPTH_COLUMNS if args.depth else LABEL_COLUMNS
    cells: dict[str, dict[str, Row]] = {}
    for cell in cells_of(args):
        if args.depth:
            cells[cell.name] = depth_rows(cell, trials, out, args.images, args.threads)
        else:
            cells[cell.name] = label_rows(cell, trials, out, args.jobs, args.threads)
        whole = table(f"{what}, seed {args.seed}, exact poses", columns, cells)
        text = whole.markdown().encode()
        write_atomically(out / "table.md", lambda stream, t=text: stream.write(t))
        for line in whole.rows[-len(cells[cell.name]) :]:
            print("  ".join(line), file=sys.stderr, flush=True)
    print(whole)
    return cells


if __name__ == "__main__":
    try:
        main()
    except DocDepthError as error:
        sys.exit(str(error))
