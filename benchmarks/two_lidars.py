"""The paper's experiment with two LiDARs, on a synthetic rig with exact truth.

    python benchmarks/two_lidars.py DRIVES -o RUNS --scenes city crossing

The rig carries two XT-32: one upright, one beside the camera and rolled by 90 degrees. Rows:

- `first LiDAR`: docdepth sees the first LiDAR alone, from odometry to depth; sweeps of the second
  evaluate its maps;
- `rig, second left out`: docdepth sees both, and the second is left out of the maps only;
- `exact depth`: what the exact depth would get from this evaluation;
- `first LiDAR, every pixel`: its maps against exact depth up to 80 m; clear are those farther than
  3 pixels from a depth edge.
"""

from __future__ import annotations

import math
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import scenes  # noqa: F401  adds its scenes
from numpy.typing import NDArray
from results import parser_of, publish, script

from docdepth import run
from docdepth.config import Preset, parameters
from docdepth.evaluation.depth_metrics import PixelSums, RegionErrors
from docdepth.evaluation.held_out import HeldOutResult, HeldOutView, evaluate_held_out
from docdepth.evaluation.left_out import LeftOut
from docdepth.evaluation.runs import evaluate_depth
from docdepth.evaluation.tables import Table, number
from docdepth.geometry.lidar_frame import LidarFrame
from docdepth.geometry.se3 import inverse, rotation_exp
from docdepth.io.frames import write_frame
from docdepth.io.manifest import RunManifest
from docdepth.io.run_folder import RunFolder
from docdepth.synthetic import Drive, Sensor, scene, sensor, write_drive

SENSOR = "XT-32"
PLACE = (0.35, -0.25, -0.15)
"""Of the second LiDAR in the frame of the first [m]: ahead, to the right, below."""


def T_lidar_second() -> NDArray[np.float64]:
    """From the second LiDAR's frame, rolled by 90 degrees, to the first one's."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation_exp(np.radians((90.0, 0.0, 0.0))), PLACE
    return T


def rolled() -> Sensor:
    """The second LiDAR; its rays and points are given in the frame of the first one."""
    upright, T = sensor(SENSOR), T_lidar_second()
    pattern = upright.pattern(0)
    directions = pattern.directions @ T[:3, :3].T
    origins = np.broadcast_to(T[:3, 3], directions.shape)
    turned = replace(pattern, directions=directions, ray_origins=origins)
    return replace(upright, pattern=lambda index: turned, spins=False)


def write_rig(folder: Path, name: str, frames: int, seed: int) -> tuple[Path, Path]:
    """Write a drive of the first LiDAR and one of both; drives that are there stay.

    Returns
    -------
    (Path, Path)
        Their sequences.
    """
    single, rig = (folder / kind / "sequences" / "00" for kind in ("first", "both"))
    if not (single / "docdepth.yaml").is_file():
        write_drive(folder / "first", name, SENSOR, frames, seed)
    if (rig / "calib.txt").is_file():
        return single, rig
    (single / "point_times").mkdir(exist_ok=True)
    rig.mkdir(parents=True, exist_ok=True)
    for kept in ("image_2", "velodyne", "depth_2", "class_2"):
        if not (rig / kept).is_symlink():
            (rig / kept).symlink_to((single / kept).resolve())
    for text in ("times.txt", "poses.txt", "docdepth.yaml"):
        (rig / text).write_text((single / text).read_text())
    world = scene(name, seed)
    first = Drive(world, sensor(SENSOR), frames, seed)
    second = Drive(world, rolled(), frames, seed + 1000)
    for k in range(frames):
        _write_second(single, rig, first, second, k)
    Tr = first.rig.Tr @ T_lidar_second()
    row = " ".join(f"{value:.12e}" for value in Tr[:3].ravel())
    (rig / "calib.txt").write_text((single / "calib.txt").read_text() + f"Tr_2: {row}\n")
    return single, rig


def _write_second(single: Path, rig: Path, first: Drive, second: Drive, index: int) -> None:
    """Add the sweep of the second LiDAR, and labels and times of both."""
    sweeps = first.sweep(index), second.sweep(index)
    T = inverse(T_lidar_second())
    own = sweeps[1].points.astype(np.float64) @ T[:3, :3].T + T[:3, 3]
    rows = np.column_stack([own, sweeps[1].intensity]).astype(np.float32)
    labels = np.concatenate([sweep.labels for sweep in sweeps])
    times = np.concatenate([sweep.relative_time for sweep in sweeps])
    written = (("velodyne_2", "bin", rows), ("labels", "label", labels))
    sweeps[0].relative_time.tofile(single / "point_times" / f"{index:06d}.bin")
    for kind, suffix, values in (*written, ("point_times", "bin", times)):
        (rig / kind).mkdir(exist_ok=True)
        values.tofile(rig / kind / f"{index:06d}.{suffix}")


def with_second(made: Path, rig: Path, evaluated: Path) -> Path:
    """The run of the first LiDAR with the sweeps of the second in its frames, to be left out."""
    source, other = RunFolder.open(made), RunFolder.open(rig)
    if (evaluated / "run.yaml").is_file():
        return evaluated
    (evaluated / "frames").mkdir(parents=True, exist_ok=True)
    for name in ("traj_odometry.ply", "calib.json", "calib_lidar_ref_cam.txt", "tracks.csv"):
        if (made / name).is_file():
            shutil.copy(made / name, evaluated / name)
    shutil.copy(other.sensors_path, evaluated / "sensors.npz")
    for index in range(len(source.trajectory())):
        own, all_points = source.frame(index), other.frame(index)
        assert all_points.sensor_rig is not None
        second = all_points.select(all_points.sensor_rig.index == 1)
        write_frame(RunFolder(evaluated).frame_path(index), joined(own, second))
    kept = RunManifest(cameras=source.cameras, parameters=source.parameters)
    (evaluated / "run.yaml").write_bytes(kept.text())
    return evaluated


def joined(own: LidarFrame, second: LidarFrame) -> LidarFrame:
    """The points of the first LiDAR as its own run has them, and those of the second."""
    count, more = len(own.points), len(second.points)
    both: dict[str, Any] = {}
    for name in ("points", "index", "classid", "time_offset"):
        both[name] = np.concatenate([getattr(own, name), getattr(second, name)])
    for name in ("instance", "votes_static", "votes_dynamic"):
        if getattr(own, name) is not None:
            both[name] = np.concatenate([getattr(own, name), np.zeros(more, np.uint16)])
    sensors = np.repeat(np.array([0, 1], np.uint8), [count, more])
    rig = None if second.sensor_rig is None else replace(second.sensor_rig, index=sensors)
    return replace(own, **both, sensor_rig=rig, input_points=count + more)


def row(name: str, result: HeldOutResult) -> tuple[str, ...]:
    """Figures of an evaluation: all returns, and clear ones."""
    distances = (result.point_to_point, result.clear_point_to_point)
    return (name, *cells(result.all, distances[0]), *cells(result.clear, distances[1]))


def cells(region: RegionErrors, point_to_point: float = math.nan) -> list[str]:
    """Number of pixels, density and errors."""
    figures = [number(value, 3) for value in (region.mae, region.rmse, point_to_point)]
    return [f"{region.pixels:,}", number(region.density, 1), *figures]


class ExactDepthErrors:
    """The errors of exact depth in the views of the second LiDAR."""

    def __init__(self, drive: Drive, T_camera_lidar: NDArray[np.float64]) -> None:
        self._drive, self._sums = drive, PixelSums(80.0)
        T_camera_second = T_camera_lidar @ T_lidar_second()
        T_camera_second[:3, 3] = 0
        self._T_lidar_camera = T_lidar_second() @ inverse(T_camera_second)

    def look(self, view: HeldOutView) -> None:
        """Compare a view."""
        drive, time = self._drive, int(self._drive.times[view.index])
        T_world_camera = drive.poses[view.index] @ self._T_lidar_camera
        compared = view.truth <= 80
        truth = view.truth[compared].astype(np.float64)
        error = drive.depth(drive.rig.camera, T_world_camera, time)[compared] - truth
        still = np.zeros(len(truth), bool)
        self._sums.add(error, truth, np.full(len(truth), np.nan), view.clear[compared], still)

    def row(self) -> tuple[str, ...]:
        return ("exact depth", *cells(self._sums.errors()), *cells(self._sums.errors(interior=1)))


FIGURES = ("number", "density %", "MAE m", "RMSE m", "point to point m")
HEADER = ("depth of", *FIGURES, *(f"clear: {figure}" for figure in FIGURES))


def main(arguments: list[str] | None = None) -> None:
    """Print a table, a row for each evaluation."""
    parser = parser_of(__doc__)
    parser.add_argument("drives", type=Path, help="folder of the drives; missing ones are made")
    parser.add_argument("-o", "--out", type=Path, required=True, help="folder of the runs")
    parser.add_argument("--scenes", nargs="+", default=["city", "crossing", "residential"])
    parser.add_argument("--presets", nargs="+", default=["default", "paper"])
    parser.add_argument("--frames", type=int, default=30)
    parser.add_argument("--every", type=int, default=5)
    parser.add_argument("--seed", type=int, default=7)
    args = parser.parse_args(arguments)
    tables = []
    for name in args.scenes:
        sequences = write_rig(args.drives / f"rig_{name}", name, args.frames, args.seed)
        drive = Drive(scene(name, args.seed), sensor(SENSOR), args.frames, args.seed)
        for preset in args.presets:
            rows = evaluate(sequences, args.out / f"{name}_{preset}", preset, args.every, drive)
            tables.append(Table(f"{name}, {preset}", HEADER, tuple(rows)))
    publish(tables, args.results)


def evaluate(
    sequences: tuple[Path, Path], out: Path, preset: Preset, every: int, drive: Drive
) -> list[tuple[str, ...]]:
    """The rows of one scene and preset."""
    runs = []
    for sequence, kind in zip(sequences, ("first", "both"), strict=True):
        if not (out / kind / "depth").is_dir():
            run(sequence, out / kind, parameters(preset), camera="image_2")
        runs.append(out / kind)
    evaluated, left_out = with_second(runs[0], runs[1], out / "evaluated"), LeftOut(lidar=1)
    best = ExactDepthErrors(drive, RunFolder.open(evaluated).calibration()[1])
    own = evaluate_held_out(evaluated, every, left_out=left_out, look=best.look)
    rig = evaluate_held_out(runs[1], every, left_out=left_out)
    rows = [row("first LiDAR", own), row("rig, second left out", rig), best.row()]
    exact = evaluate_depth(runs[0], sequences[0])
    both = (*cells(exact.all, exact.point_to_point), *cells(exact.interior))
    return [*rows, ("first LiDAR, every pixel", *both)]


if __name__ == "__main__":
    script(main)
