"""Writes drives in the layout of KITTI odometry and SemanticKITTI."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import yaml
from numpy.typing import NDArray

from docdepth.geometry.se3 import inverse
from docdepth.synthetic.drive import Drive
from docdepth.synthetic.scenes import scene as make_scene
from docdepth.synthetic.sensors import sensor as make_sensor


def write_drive(
    out: str | Path,
    scene: str = "city",
    sensor: str = "HDL-64",
    frames: int = 40,
    seed: int = 0,
    skew: bool = False,
    images: bool = True,
    blooming_deg: float = 0.0,
    progress: Callable[[int, int], None] | None = None,
) -> Path:
    """Make a synthetic drive and write it to ``out/sequences/00``.

    Parameters
    ----------
    out : path
        Output folder.
    scene, sensor : str
        Names known to :func:`scene` and :func:`sensor`.
    frames : int
        Number of sweeps. There is one image between each two sweeps.
    seed : int
    skew : bool
        Write raw sweeps and ``point_times``. Otherwise sweeps are motion compensated with the exact
        motion of the ego, as in SemanticKITTI.
    images : bool
        Write camera images and exact depth maps.
    blooming_deg : float
        Ghost returns appear around retro-reflectors, up to this angle from them [deg]. They have
        class 1, outlier.
    progress : callable, optional
        Called with the number of finished sweeps and the number of all sweeps.

    Returns
    -------
    Path
        The folder of the sequence.
    """
    lidar = replace(make_sensor(sensor), blooming=float(np.radians(blooming_deg)))
    drive = Drive(make_scene(scene, seed), lidar, frames, seed, skew)
    folder = Path(out) / "sequences" / "00"
    folder.mkdir(parents=True, exist_ok=True)
    _write_frame_of_reference(folder, drive)
    for k in range(frames):
        _write_sweep(folder, drive, k)
        if images and k + 1 < frames:
            _write_image(folder, drive, k)
        if progress is not None:
            progress(k + 1, frames)
    if images:
        _write_camera(folder, drive)
    about = {
        "scene": scene,
        "sensor": sensor,
        "seed": seed,
        "frames": frames,
        "motion_compensated": not skew,
    }
    if blooming_deg:
        about["blooming_deg"] = blooming_deg
    # Written last: a folder that has it is complete.
    (folder / "docdepth.yaml").write_text(yaml.safe_dump(about, sort_keys=False))
    return folder


def _write_frame_of_reference(folder: Path, drive: Drive) -> None:
    rig = drive.rig
    rows = {f"P{k}": rig.P[k] for k in range(4)} | {"Tr": rig.Tr[:3]}
    lines = [f"{name}: {_numbers(values)}" for name, values in rows.items()]
    (folder / "calib.txt").write_text("\n".join(lines) + "\n")
    (folder / "times.txt").write_text(_seconds(drive.times))
    poses = rig.Tr @ drive.poses @ inverse(rig.Tr)
    (folder / "poses.txt").write_text("".join(f"{_numbers(pose[:3])}\n" for pose in poses))


def _write_sweep(folder: Path, drive: Drive, index: int) -> None:
    sweep = drive.sweep(index)
    rows = np.column_stack([sweep.points, sweep.intensity]).astype(np.float32)
    rows.tofile(_file(folder, "velodyne", index, "bin"))
    sweep.labels.tofile(_file(folder, "labels", index, "label"))
    np.save(_file(folder, "speeds", index, "npy"), sweep.speed.astype(np.float16))
    if drive.skew:
        sweep.relative_time.tofile(_file(folder, "point_times", index, "bin"))


def _write_image(folder: Path, drive: Drive, index: int) -> None:
    view = drive.image(index)
    picture = np.ascontiguousarray(view.colour[..., ::-1])
    fast = [int(cv2.IMWRITE_PNG_COMPRESSION), 1]
    cv2.imwrite(str(_file(folder, "image_2", index, "png")), picture, fast)
    np.save(_file(folder, "depth_2", index, "npy"), view.depth)
    np.save(_file(folder, "class_2", index, "npy"), view.labels)


def _write_camera(folder: Path, drive: Drive) -> None:
    camera = drive.rig.camera
    (folder / "image_2" / "times.txt").write_text(_seconds(drive.camera_times))
    (folder / "image_2" / "size.txt").write_text(f"{camera.width} {camera.height}\n")


def _file(folder: Path, kind: str, index: int, suffix: str) -> Path:
    (folder / kind).mkdir(exist_ok=True)
    return folder / kind / f"{index:06d}.{suffix}"


def _seconds(times: NDArray[np.int64]) -> str:
    return "".join(f"{t // 10**9}.{t % 10**9:09d}\n" for t in times.tolist())


def _numbers(values: NDArray[np.float64]) -> str:
    return " ".join(f"{value:.12e}" for value in values.ravel())
