"""Recordings on disk: one class for each format, all with the interface :class:`~.base.Dataset`."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from docdepth.datasets.base import CameraStream, Dataset, Sweep
from docdepth.datasets.frame_range import FrameRange
from docdepth.datasets.kitti_odometry import KittiOdometry
from docdepth.datasets.kitti_raw import KittiRaw
from docdepth.datasets.run import RunDataset
from docdepth.errors import DatasetError
from docdepth.geometry.points import usable_points

__all__ = ["CameraStream", "Dataset", "FrameRange", "Sweep", "open_dataset", "usable_points"]

_DEEPEST = 3  # levels below a folder that are searched: KITTI's ROOT/DATE/DRIVE, OUT/sequences/00
_MOST_NAMED = 8  # recordings in an error


@dataclass(frozen=True)
class _Format:
    marker: str  # a folder that every recording of this format holds
    expected: str
    open: Callable[[Path, tuple[int, int] | None], Dataset]


_FORMATS = {
    "kitti_raw": _Format(
        "velodyne_points/data",
        "a drive DATE/DATE_drive_NNNN_sync with velodyne_points/data/*.bin and "
        "velodyne_points/timestamps.txt, and DATE/calib_*.txt beside it",
        lambda path, size: KittiRaw(path, size),
    ),
    "semantic_kitti": _Format(
        "velodyne",
        "a sequence with velodyne/*.bin, labels/*.label, calib.txt, times.txt and poses.txt",
        lambda path, size: KittiOdometry(path, size, "semantic_kitti"),
    ),
    "kitti_odometry": _Format(
        "velodyne",
        "a sequence with velodyne/*.bin, calib.txt and times.txt",
        lambda path, size: KittiOdometry(path, size, "kitti_odometry"),
    ),
    "run": _Format(
        "frames",
        "a run folder with frames/frame_000000.ply and traj_odometry.ply",
        lambda path, size: RunDataset(path),
    ),
}


def open_dataset(
    path: Path | str,
    name: str | None = None,
    image_size: tuple[int, int] | None = None,
    frames: str | None = None,
) -> Dataset:
    """Open a recording.

    Parameters
    ----------
    path : Path
        The folder of one drive or sequence, or one that holds a single one of them.
    name : str, optional
        Its format; detected from the files of the folder if left out.
    image_size : (int, int), optional
        Width and height of the images in pixels, if no file tells them.
    frames : str, optional
        ``A:B``, sweeps A to B - 1 alone; all if left out.

    Raises
    ------
    DatasetError
        There is no such folder or format, the folder is of no known format, or a file is missing or
        broken. All problems of a recording are told together.
    CalibrationError
        The calibration is missing or contradicts the images.
    """
    path = Path(path)
    name = name.replace("-", "_") if name else None
    if name is not None and name not in _FORMATS:
        raise DatasetError(f"unknown dataset {name!r}; there are {', '.join(_FORMATS)}")
    try:
        if not path.is_dir():
            raise DatasetError(f"{path} is {'not a folder' if path.exists() else 'not there'}")
        folder, name = _find_recording(path, name)
        recording = _FORMATS[name].open(folder, image_size)
    except OSError as error:
        raise DatasetError(
            f"{error.filename or path} cannot be read ({error.strerror}); "
            "check that it is there and that you may read it"
        ) from None
    return FrameRange(recording, frames) if frames else recording


def _find_recording(path: Path, name: str | None) -> tuple[Path, str]:
    """The folder of the recording, and its format."""
    found = name or _detect_format(path)
    if found is not None and (path / _FORMATS[found].marker).is_dir():
        return path, found
    below = [
        (folder, kind)
        for folder, kind in _recordings_below(path, _DEEPEST)
        if name is None or (folder / _FORMATS[name].marker).is_dir()
    ]
    if len(below) == 1:
        return below[0][0], name or below[0][1]
    if below:
        names = ", ".join(str(folder) for folder, _ in below[:_MOST_NAMED])
        more = f" and {len(below) - _MOST_NAMED} more" if len(below) > _MOST_NAMED else ""
        raise DatasetError(f"{path} holds {len(below)} recordings; name one of {names}{more}")
    known = [f"{n}: {f.expected}" for n, f in _FORMATS.items() if name in (None, n)]
    raise DatasetError(f"{path} is no recording that docdepth reads ({'; '.join(known)})")


def _recordings_below(path: Path, levels: int) -> list[tuple[Path, str]]:
    """Recordings in the folders of a folder; runs do not count."""
    found: list[tuple[Path, str]] = []
    if not levels or not os.access(path, os.R_OK | os.X_OK):
        return found
    for child in sorted(child for child in path.iterdir() if child.is_dir()):
        kind = _detect_format(child)
        if kind is None:
            found += _recordings_below(child, levels - 1)
        elif kind != "run":
            found.append((child, kind))
    return found


def _detect_format(path: Path) -> str | None:
    if (path / "frames").is_dir() and (path / "traj_odometry.ply").is_file():
        return "run"
    if (path / "velodyne").is_dir():
        return "semantic_kitti" if (path / "labels").is_dir() else "kitti_odometry"
    return "kitti_raw" if (path / "velodyne_points" / "data").is_dir() else None
