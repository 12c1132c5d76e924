"""Wrong extrinsics and clocks, and what is said about each before a run.

    python benchmarks/extrinsics.py DRIVE [DRIVE ...]

Each DRIVE is a KITTI raw drive or a sequence of the odometry layout, with images. It is copied by
links, its calibration is spoilt in every way of the table, and its inputs are checked as at the
start of a run. A row tells what was done and the first error or warning.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from docdepth.config import Parameters
from docdepth.geometry.se3 import inverse, rotation_exp
from docdepth.pipeline.check import check_inputs

Floats = NDArray[np.float64]
CALIBRATIONS = ("calib.txt", "calib_velo_to_cam.txt")


def turned(tilt: float = 0, pan: float = 0, roll: float = 0) -> Callable[[Floats], Floats]:
    """The camera turns about its axes x, y, z [deg]."""
    T = np.eye(4)
    T[:3, :3] = rotation_exp(np.radians([tilt, pan, roll]))
    return lambda Tr: T @ Tr


def moved(x: float = 0, y: float = 0, z: float = 0) -> Callable[[Floats], Floats]:
    """The camera moves along its axes [m]."""
    T = np.eye(4)
    T[:3, 3] = (x, y, z)
    return lambda Tr: T @ Tr


def scaled(factor: float) -> Callable[[Floats], Floats]:
    """Another unit of the lever arm; one of 0.3 m at least, as that of KITTI."""

    def change(Tr: Floats) -> Floats:
        result = Tr.copy()
        result[:3, 3] *= factor
        return result

    return change


def first_number(Tr: Floats) -> Floats:
    result = Tr.copy()
    result[0, 0] = 5.0
    return result


def other_car(Tr: Floats) -> Floats:
    """LiDAR a metre higher and tilted by 5 degrees, camera half a metre to the side."""
    return turned(tilt=5)(moved(x=0.5, y=1.0)(Tr))


WAYS: dict[str, Callable[[Floats], Floats]] = {
    "right": lambda Tr: Tr,
    "first number is 5": first_number,
    "rows swapped": lambda Tr: Tr[[1, 0, 2, 3]],
    "all zeros": lambda Tr: Tr * 0,
    "millimetres": scaled(1000),
    "centimetres": scaled(100),
    "inverse": inverse,
    "transposed rotation": lambda Tr: np.block(
        [[Tr[:3, :3].T, Tr[:3, 3:]], [np.zeros((1, 3)), np.ones((1, 1))]]
    ),
    "no change of axes": lambda Tr: np.block(
        [[np.eye(3), Tr[:3, 3:]], [np.zeros((1, 3)), np.ones((1, 1))]]
    ),
    "axes in cyclic order": lambda Tr: Tr[[1, 2, 0, 3]],
    "upside down": turned(roll=180),
    "camera looks back": turned(pan=180),
    "on its side": turned(roll=90),
    "left-handed": lambda Tr: np.diag([-1.0, 1, 1, 1]) @ Tr,
    "another car's": other_car,
    "1.5 degrees to the right": turned(pan=-1.5),
    "1.5 degrees down": turned(tilt=1.5),
    "3 degrees to the left": turned(pan=3),
    "8 degrees to the left": turned(pan=8),
    "10 degrees up": turned(tilt=-10),
    "rolled by 4 degrees": turned(roll=4),
    "0.5 m to the side": moved(x=0.5),
    "0.5 m down": moved(y=0.5),
    "1 m to the side": moved(x=1),
    "2 m ahead": moved(z=2),
    "5 m to the side": moved(x=5),
}


def main(arguments: list[str]) -> None:
    """Print a table for each drive."""
    for argument in arguments:
        drive = Path(argument).resolve()
        print(f"\n{drive.name}\n")
        print("| what was done | what is said |\n| --- | --- |")
        for name, change in WAYS.items():
            print(f"| {name} | {said(drive, change)} |", flush=True)
        print(f"| images of 3 frames later | {said(drive, WAYS['right'], late=3)} |")


def said(drive: Path, change: Callable[[Floats], Floats], late: int = 0) -> str:
    """The first error or warning about a copy of the drive with other extrinsics."""
    with tempfile.TemporaryDirectory() as folder:
        copy = spoilt(drive, Path(folder), change, late)
        source = dict.fromkeys(("name", "camera", "poses", "camera_times", "image_size"))
        problems = check_inputs({"dataset": str(copy), **source}, Parameters())
        texts = [f"{p.severity}: {p.text}" for p in problems]
        return texts[0].replace(folder, "...") if texts else "nothing"


def spoilt(drive: Path, folder: Path, change: Callable[[Floats], Floats], late: int) -> Path:
    """A copy by links with another transform from LiDAR to camera, and images that lag."""
    copy = folder / drive.parent.name / drive.name
    copy.mkdir(parents=True)
    for file in drive.iterdir():
        (copy / file.name).symlink_to(file)
    for file in drive.parent.glob("calib*.txt"):
        (copy.parent / file.name).symlink_to(file)
    calibration = next(f for n in CALIBRATIONS for f in (copy / n, copy.parent / n) if f.exists())
    text = with_transform(calibration.read_text(), change)
    calibration.unlink()
    calibration.write_text(text)
    for cameras in sorted(
        copy.glob("image_0*" if (copy / "velodyne_points").exists() else "image_2")
    ):
        if late:
            delay(cameras, late)
    return copy


def with_transform(text: str, change: Callable[[Floats], Floats]) -> str:
    """The calibration with another ``Tr``, or ``R`` and ``T``."""
    rows = {key: value for key, _, value in (line.partition(":") for line in text.splitlines())}
    T = np.eye(4)
    if "Tr" in rows:
        T[:3] = np.array(rows["Tr"].split(), float).reshape(3, 4)
        rows["Tr"] = numbers(change(T)[:3])
    else:
        T[:3, :3] = np.array(rows["R"].split(), float).reshape(3, 3)
        T[:3, 3] = np.array(rows["T"].split(), float)
        T = change(T)
        rows["R"], rows["T"] = numbers(T[:3, :3]), numbers(T[:3, 3])
    return "".join(f"{key}:{value}\n" for key, value in rows.items())


def numbers(values: Floats) -> str:
    return " " + " ".join(f"{value:.9e}" for value in values.ravel())


def delay(camera: Path, late: int) -> None:
    """Every image gets the time of the one some frames before."""
    source = camera.resolve()
    camera.unlink()
    pictures = source / "data" if (source / "data").is_dir() else source
    folder = camera / "data" if pictures != source else camera
    folder.mkdir(parents=True)
    files = sorted(f for f in pictures.iterdir() if f.suffix in (".png", ".jpg"))
    for name, file in zip(files[:-late], files[late:], strict=True):
        (folder / f"{name.stem}{file.suffix}").symlink_to(file)
    for table in source.glob("*.txt"):
        lines = table.read_text().splitlines()
        kept = lines[:-late] if len(lines) == len(files) else lines
        (camera / table.name).write_text("\n".join(kept) + "\n")


if __name__ == "__main__":
    main(sys.argv[1:])
