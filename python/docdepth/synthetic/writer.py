"""Writes drives in the layout of KITTI odometry and SemanticKITTI."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TypedDict, cast

import cv2
import numpy as np
import yaml
from numpy.typing import NDArray

from docdepth.concurrency import Progress, null_progress
from docdepth.errors import DatasetError
from docdepth.geometry.se3 import inverse
from docdepth.io.tracks import TRACKS, write_tracks
from docdepth.synthetic.drive import Drive
from docdepth.synthetic.scenes import scene as make_scene
from docdepth.synthetic.sensors import sensor as make_sensor

_ABOUT = "docdepth.yaml"
_UNFINISHED = ".docdepth.unfinished.yaml"

# Suffix of the files in each folder of a drive.
_KINDS = {
    "velodyne": "bin",
    "labels": "label",
    "speeds": "npy",
    "point_times": "bin",
    "image_2": "png",
    "depth_2": "npy",
    "class_2": "npy",
}


class _MadeOf(TypedDict):
    scene: str
    sensor: str
    seed: int
    frames: int


class WrittenDrive(_MadeOf, total=False):
    """How a synthetic drive was made, as the file beside it keeps it."""

    motion_compensated: bool
    beam_width_deg: float
    blooming_deg: float


def write_drive(
    out: str | Path,
    scene: str = "city",
    sensor: str = "HDL-64",
    frames: int = 40,
    seed: int = 0,
    skew: bool = False,
    images: bool = True,
    beam_width_deg: float = 0.0,
    blooming_deg: float = 0.0,
    progress: Progress = null_progress,
    force: bool = False,
) -> Path:
    """Make a synthetic drive and write it to ``out/sequences/00``.

    An interrupted call is repeated with the same arguments. Nothing else is written over.

    Parameters
    ----------
    out : path
        Output folder.
    scene, sensor : str
        Names known to :func:`scene` and :func:`sensor`.
    frames : int
        Number of sweeps. There is one image between each two sweeps.
    skew : bool
        Write raw sweeps and ``point_times``. Otherwise sweeps are motion compensated with the exact
        motion of the ego, as in SemanticKITTI, and have ``point_times`` only if the sensor does not
        spin.
    images : bool
        Write camera images and exact depth maps.
    beam_width_deg : float
        Full angle of a LiDAR's beam [deg]; 0 = a line. Real LiDARs have 0.1 to 0.35.
    blooming_deg : float
        Ghost returns appear around retro-reflectors, up to this angle from them [deg]. They have
        class 1, outlier.
    force : bool
        Replace the synthetic drive that is in ``out``. Files that are not of it stay.

    Returns
    -------
    Path
        The folder of the sequence.
    """
    about = WrittenDrive(
        scene=scene, sensor=sensor, seed=seed, frames=frames, motion_compensated=not skew
    )
    if beam_width_deg:
        about["beam_width_deg"] = beam_width_deg
    if blooming_deg:
        about["blooming_deg"] = blooming_deg
    folder = sequence_folder(out)
    _make_room(Path(out), folder, about, force)
    width, blooming = np.radians((beam_width_deg, blooming_deg)).tolist()
    lidar = replace(make_sensor(sensor), beam_width=width, blooming=blooming)
    drive = Drive(make_scene(scene, seed), lidar, frames, seed, skew)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / _UNFINISHED).write_text(yaml.safe_dump(dict(about), sort_keys=False))
    _write_frame_of_reference(folder, drive)
    returns = np.zeros((frames, len(drive.scene.actors) + 1), np.int64)
    for k in range(frames):
        instances = _write_sweep(folder, drive, k)
        moving = instances[instances < returns.shape[1]]  # parked vehicles have larger numbers
        returns[k] = np.bincount(moving, minlength=returns.shape[1])
        if images and k + 1 < frames:
            _write_image(folder, drive, k)
        progress("synth", k + 1, frames)
    if images:
        camera = drive.rig.camera
        (folder / "image_2" / "times.txt").write_text(_seconds(drive.camera_times))
        (folder / "image_2" / "size.txt").write_text(f"{camera.width} {camera.height}\n")
    tracks = [replace(track, points=returns[:, track.id]) for track in drive.tracks()]
    write_tracks(folder / TRACKS, tracks, drive.times)
    # Written last: a folder that has it is complete.
    (folder / _UNFINISHED).replace(folder / _ABOUT)
    return folder


def sequence_folder(out: str | Path) -> Path:
    """Where :func:`write_drive` puts a drive."""
    return Path(out) / "sequences" / "00"


def written_drive(folder: Path) -> WrittenDrive | None:
    """How the synthetic drive in a sequence folder was made, finished or not; None: it is none."""
    for name in (_ABOUT, _UNFINISHED):
        try:
            about = yaml.safe_load((folder / name).read_text(encoding="utf-8"))
        except (OSError, UnicodeError, yaml.YAMLError):
            continue
        if isinstance(about, dict) and {"scene", "sensor", "seed", "frames"} <= set(about):
            return cast(WrittenDrive, about)
    return None


def _make_room(out: Path, folder: Path, about: WrittenDrive, force: bool) -> None:
    """Refuse to write over anything but this drive, unfinished, and with ``force`` another one."""
    if (out.exists() or out.is_symlink()) and not out.is_dir():
        raise DatasetError(f"{out} is no folder; choose another name for the drive")
    names = sorted(entry.name for entry in out.iterdir()) if out.is_dir() else []
    there = written_drive(folder)
    if there is not None and force:
        _delete_drive(folder, int(there["frames"]))
    elif there is not None and (there != about or not (folder / _UNFINISHED).is_file()):
        raise DatasetError(
            f"{out} holds a synthetic drive ({described(there)})",
            "choose another folder, or replace it with `force=True`",
        )
    elif there is None and names:
        listed = ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
        raise DatasetError(f"{out} is not empty: it holds {listed}; choose another folder")


def described(about: WrittenDrive) -> str:
    """A synthetic drive in words."""
    return f"{about['scene']}, {about['sensor']}, {about['frames']} frames, seed {about['seed']}"


def _delete_drive(folder: Path, frames: int) -> None:
    """Delete the files of a synthetic drive, and no others."""
    names = ["calib.txt", "times.txt", "poses.txt", TRACKS, _ABOUT, _UNFINISHED]
    names += ["image_2/times.txt", "image_2/size.txt"]
    names += [f"{kind}/{k:06d}.{suffix}" for kind, suffix in _KINDS.items() for k in range(frames)]
    for name in names:
        (folder / name).unlink(missing_ok=True)


def _write_frame_of_reference(folder: Path, drive: Drive) -> None:
    rig = drive.rig
    poses = rig.Tr @ drive.poses @ inverse(rig.Tr)
    np.savetxt(folder / "poses.txt", poses[:, :3].reshape(-1, 12), "%.12e")
    (folder / "times.txt").write_text(_seconds(drive.times))
    with (folder / "calib.txt").open("w") as file:
        for name, values in zip(("P0", "P1", "P2", "P3", "Tr"), [*rig.P, rig.Tr[:3]], strict=True):
            np.savetxt(file, values.reshape(1, 12), f"{name}: %.12e" + " %.12e" * 11)


def _write_sweep(folder: Path, drive: Drive, index: int) -> NDArray[np.uint32]:
    """Write a sweep; returns the instance of each point."""
    sweep = drive.sweep(index)
    rows = np.column_stack([sweep.points, sweep.intensity])
    rows.tofile(_file(folder, "velodyne", index))
    sweep.labels.tofile(_file(folder, "labels", index))
    np.save(_file(folder, "speeds", index), sweep.speed.astype(np.float16))
    if drive.skew or not drive.sensor.spins:  # else the azimuth tells the time
        sweep.relative_time.tofile(_file(folder, "point_times", index))
    return sweep.labels >> np.uint32(16)


def _write_image(folder: Path, drive: Drive, index: int) -> None:
    view = drive.image(index)
    picture = np.ascontiguousarray(view.colour[..., ::-1])
    fast = [int(cv2.IMWRITE_PNG_COMPRESSION), 1]
    # OpenCV opens no path that is not UTF-8, and says nothing on a full disk.
    _file(folder, "image_2", index).write_bytes(cv2.imencode(".png", picture, fast)[1].tobytes())
    np.save(_file(folder, "depth_2", index), view.depth)
    np.save(_file(folder, "class_2", index), view.labels)


def _file(folder: Path, kind: str, index: int) -> Path:
    (folder / kind).mkdir(exist_ok=True)
    return folder / kind / f"{index:06d}.{_KINDS[kind]}"


def _seconds(times: NDArray[np.int64]) -> str:
    return "".join(f"{t // 10**9}.{t % 10**9:09d}\n" for t in times.tolist())
