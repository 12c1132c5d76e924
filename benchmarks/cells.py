"""Cells of the synthetic suite: a scene seen by a sensor, with exact poses, classes and depth."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar, overload

import numpy as np
import scenes  # noqa: F401  adds its scenes
import yaml
from numpy.typing import NDArray
from results import parser_of, publish

from docdepth.config import Parameters
from docdepth.datasets import CameraStream, open_dataset
from docdepth.datasets.kitti_lidar import azimuth_relative_time
from docdepth.errors import RunError
from docdepth.evaluation import Table
from docdepth.geometry.points import DYNAMIC, STATIC
from docdepth.geometry.trajectory import Trajectory
from docdepth.io.atomic import write_atomically
from docdepth.io.inputs import RunInputs
from docdepth.io.labels import classes_of_labels
from docdepth.io.run_folder import RunFolder
from docdepth.io.tracks import TRACKS, read_tracks
from docdepth.pipeline import run_classify, run_odometry
from docdepth.render.scene import Scene
from docdepth.synthetic import Drive, scene, sensor, sensors, write_drive

# Sweeps of a whole drive: as long as something happens.
FRAMES = {"crossing": 100, "city": 125, "hills": 80, "residential": 90, "highway": 70}
# Drives of a suite if none are named: those of the published tables.
SUITE = tuple(FRAMES)
FRAMES |= {"arrivals": 150, "overtaking": 90, "queue": 140, "fences": 80, "still_fences": 80}


@dataclass(frozen=True)
class Cell:
    """A scene seen by a sensor, and the folder of its drive."""

    scene: str
    sensor: str
    frames: int
    seed: int
    drives: Path
    beam_width: float = 0.0
    """Full angle of a beam [deg]."""

    @property
    def name(self) -> str:
        return f"{self.scene}_{self.sensor}"

    @property
    def folder(self) -> Path:
        return self.drives / f"seed{self.seed}" / self.name

    def sequence(self) -> Path:
        """Folder of the drive; makes the drive if it is missing."""
        about = self.folder / "sequences" / "00" / "docdepth.yaml"
        wanted = {"scene": self.scene, "sensor": self.sensor, "seed": self.seed}
        wanted |= {"frames": self.frames, "motion_compensated": True}
        wanted |= {"beam_width_deg": self.beam_width} if self.beam_width else {}
        if not about.is_file():
            made_of = self.folder, self.scene, self.sensor, self.frames, self.seed
            write_drive(*made_of, images=False, beam_width_deg=self.beam_width)
        elif yaml.safe_load(about.read_text()) != wanted:
            raise RunError(f"{about.parent} holds another drive than {wanted}; delete it")
        _write_point_times(about.parent)
        return about.parent

    def run(self, path: Path | None = None, parameters: Parameters | None = None) -> RunFolder:
        """Run folder of the drive with exact poses, ready for the classification."""
        sequence, p = self.sequence(), parameters or Parameters()
        path = path or self.folder / "run"
        run, inputs = RunFolder(path), RunInputs(recording=sequence, poses="dataset")
        run.start(inputs, p, force=True)
        dataset = open_dataset(sequence)
        run_odometry(run, dataset, dataset.poses)
        return run


def write_file(path: Path, content: bytes) -> None:
    """Write a file that is whole or not there."""
    write_atomically(path, lambda stream: stream.write(content))


def _write_point_times(sequence: Path) -> None:
    """Tell when each point was measured, as recordings do; without it, moving objects blur."""
    folder = sequence / "point_times"
    folder.mkdir(exist_ok=True)
    for sweep in sorted((sequence / "velodyne").iterdir()):
        if (folder / sweep.name).exists():
            continue
        times = azimuth_relative_time(np.fromfile(sweep, "<f4").reshape(-1, 4)[:, :3]).tobytes()
        write_file(folder / sweep.name, times)


Item = TypeVar("Item")


class Lazy(Sequence[Item]):
    """A sequence whose items are computed on request."""

    def __init__(self, count: int, item: Callable[[int], Item]) -> None:
        self._count, self._item = count, item

    def __len__(self) -> int:
        return self._count

    @overload
    def __getitem__(self, index: int) -> Item: ...
    @overload
    def __getitem__(self, index: slice) -> list[Item]: ...
    def __getitem__(self, index: int | slice) -> Any:
        if isinstance(index, slice):
            return [self._item(k) for k in range(self._count)[index]]
        return self._item(range(self._count)[index])


@dataclass(frozen=True)
class ExactLabels:
    """Class and instance of each point, uint16 of shape (N,)."""

    classid: NDArray[np.uint16]
    instance: NDArray[np.uint16]


class ExactDrive:
    """The drive of a cell with its exact poses, classes and depth."""

    def __init__(self, cell: Cell) -> None:
        self.dataset = open_dataset(cell.sequence())
        world = scene(cell.scene, cell.seed)
        self.drive = Drive(world, sensor(cell.sensor), cell.frames, cell.seed)
        self.trajectory = Trajectory(self.drive.times, self.drive.poses)
        rig, times = self.drive.rig, self.drive.camera_times
        names = [f"{k:06d}" for k in range(len(times))]
        self.camera = CameraStream("image_2", rig.camera, rig.T_camera_lidar, times, names)

    def scene(self, parameters: Parameters) -> Scene:
        """The drive with exact classes, instances and tracks, ready for rendering."""
        count = len(self.dataset)
        sweeps, labels = Lazy(count, self.dataset.sweep), Lazy(count, self._labels)
        return Scene(sweeps, self.trajectory, labels, parameters, self.drive.tracks())

    def own_scene(self, run: RunFolder, parameters: Parameters, threads: int) -> Scene:
        """The drive with exact poses, and the classes and tracks that a run finds."""
        run_classify(run, threads)

        def labels(index: int) -> ExactLabels:
            record, of_record = run.classified_frame(index)
            classid, instance = np.full((2, record.input_points), (STATIC,), np.uint16)
            instance[:] = 0
            classid[record.index] = of_record
            if record.instance is not None:
                instance[record.index] = record.instance
            return ExactLabels(classid, instance)

        count, tracks = len(self.dataset), read_tracks(run.path / TRACKS)
        sweeps = Lazy(count, self.dataset.sweep)
        return Scene(sweeps, self.trajectory, Lazy(count, labels), parameters, tracks)

    def images(self, count: int, ends: bool = True) -> list[int]:
        """Indices of ``count`` images spread evenly over the drive, with or without its ends."""
        last = len(self.drive.camera_times) - 1
        spread = np.linspace(0, last, count) if ends else np.linspace(0, last, count + 2)[1:-1]
        return [int(k) for k in dict.fromkeys(spread.round().astype(int).tolist())]

    def _labels(self, index: int) -> ExactLabels:
        """Ground, static and dynamic; dynamic is what moves at any time of the drive."""
        labels = self.dataset.labels(index)
        assert labels is not None
        classid, instance = classes_of_labels(labels)
        return ExactLabels(classid, np.where(classid == DYNAMIC, instance, np.uint16(0)))


def cell_parser(doc: str | None, images: int) -> argparse.ArgumentParser:
    """Arguments that choose cells: scenes, sensors, seed, length and images; and parameters."""
    parser = parser_of(doc)
    parser.add_argument("drives", type=Path, help="folder of the drives; missing ones are made")
    parser.add_argument("--scenes", nargs="+", default=list(SUITE), choices=list(FRAMES))
    parser.add_argument("--sensors", nargs="+", choices=list(sensors()))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--frames", type=int, help="sweeps per drive instead of the usual number")
    parser.add_argument("--beam-width", type=float, default=0.0, help="of the LiDAR [deg]")
    parser.add_argument("--images", type=int, default=images, help="images per drive")
    parser.add_argument("--preset", default="default", choices=["default", "paper"])
    parser.add_argument("--set", action="append", default=[], metavar="STAGE.NAME=VALUE")
    parser.add_argument("-o", "--out", type=Path, required=True, help="folder of the results")
    parser.add_argument("--threads", type=int, default=0, help="0 uses all cores")
    return parser


Figures = TypeVar("Figures")


def each_cell(
    args: argparse.Namespace,
    out: Path,
    measure: Callable[[Cell], Figures],
    table: Callable[[dict[str, Figures]], Table],
) -> dict[str, Figures]:
    """Measure the chosen cells, sensor by sensor; their table is written after each."""
    found: dict[str, Figures] = {}
    for name in args.sensors:
        for street in args.scenes:
            frames = args.frames or FRAMES[street]
            cell = Cell(street, name, frames, args.seed, args.drives, args.beam_width)
            found[cell.name] = measure(cell)
            whole = table(found)
            write_file(out / "table.md", whole.markdown().encode())
            for line in whole.rows:
                if line[0] == cell.name:
                    print("  ".join(line), file=sys.stderr, flush=True)
    publish([whole], args.results)
    return found
