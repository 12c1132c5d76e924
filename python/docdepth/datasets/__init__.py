"""Recordings on disk: one class for each format, all with the interface :class:`~.base.Dataset`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from docdepth.datasets.base import CameraStream, Dataset, Sweep
from docdepth.datasets.kitti_odometry import KittiOdometry
from docdepth.datasets.kitti_raw import KittiRaw
from docdepth.datasets.run import RunDataset
from docdepth.errors import DatasetError
from docdepth.geometry.points import usable_points

__all__ = ["CameraStream", "Dataset", "Sweep", "open_dataset", "usable_points"]


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
    path: Path | str, name: str | None = None, image_size: tuple[int, int] | None = None
) -> Dataset:
    """Open a recording.

    Parameters
    ----------
    path : Path
        The folder of one drive or sequence.
    name : str, optional
        Its format; detected from the files of the folder if left out.
    image_size : (int, int), optional
        Width and height of the images in pixels, if no file tells them.

    Raises
    ------
    DatasetError
        There is no such folder or format, the folder is of no known format, or a file is missing or
        broken.
    CalibrationError
        The calibration is missing or contradicts the images.
    """
    path = Path(path)
    name = name.replace("-", "_") if name else None
    if name is not None and name not in _FORMATS:
        raise DatasetError(f"unknown dataset {name!r}; there are {', '.join(_FORMATS)}")
    if not path.is_dir():
        raise DatasetError(f"{path} is {'not a folder' if path.exists() else 'not there'}")
    name = name or _detect_format(path)
    if name is not None and (path / _FORMATS[name].marker).is_dir():
        return _FORMATS[name].open(path, image_size)
    inside = [child for child in sorted(path.iterdir()) if child.is_dir() and _detect_format(child)]
    hint = f"; did you mean {inside[0]}?" if inside else ""
    known = [f"{n}: {f.expected}" for n, f in _FORMATS.items() if name in (None, n)]
    raise DatasetError(f"{path} is no recording that docdepth reads{hint} ({'; '.join(known)})")


def _detect_format(path: Path) -> str | None:
    if (path / "frames").is_dir() and (path / "traj_odometry.ply").is_file():
        return "run"
    if (path / "velodyne").is_dir():
        return "semantic_kitti" if (path / "labels").is_dir() else "kitti_odometry"
    return "kitti_raw" if (path / "velodyne_points" / "data").is_dir() else None
