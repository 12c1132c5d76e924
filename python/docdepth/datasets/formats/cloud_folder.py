"""Folders of point clouds, one file a sweep, with a small ``docdepth.yaml`` beside them."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from docdepth.datasets.base import LidarStream
from docdepth.datasets.cloud import Cloud, SweepFiles
from docdepth.datasets.cloud_files import (
    KITTI_COLUMNS,
    READERS,
    RowFormat,
    read_cloud,
    read_viewpoint,
)
from docdepth.datasets.files import FILE, is_there, read_bytes
from docdepth.datasets.format import Format
from docdepth.datasets.kitti_files import check_increasing, in_order
from docdepth.datasets.recording import Recording
from docdepth.datasets.resampled import ResampledLidar
from docdepth.datasets.settings import (
    Numbers,
    RecordingSettings,
    Strict,
    read_settings,
    transform,
)
from docdepth.datasets.times import times_of_files
from docdepth.datasets.yaml_cameras import YamlCamera, yaml_cameras
from docdepth.errors import Collector, DatasetError
from docdepth.io.poses import read_poses_at

log = logging.getLogger(__name__)

VIEWPOINT = "viewpoint"
"""Entry ``poses`` that means the poses in the headers of PCD files."""

_NAMELESS = {".bin", ".npy"}  # suffixes of files that need not be clouds


class FolderLidar(Strict):
    """One of several LiDARs.

    Attributes
    ----------
    sweeps : str
        Folder of its sweeps.
    times : str, optional
    T_lidar_sensor : list of float, optional
        Takes its points to the frame of the first LiDAR; identity if left out.
    """

    sweeps: str
    times: str | None = None
    T_lidar_sensor: Numbers | None = None


class FolderSettings(RecordingSettings):
    """What ``docdepth.yaml`` of a folder of clouds may say.

    Attributes
    ----------
    sweeps : str, optional
        Folder of the sweeps.
    times : str, optional
        File with a line a sweep, or ``names``.
    rate : float, optional
        Sweeps a second, where there are no times. A number in the name of a file is that of its
        sweep.
    columns : tuple of str
        Values of a point in BIN and NPY files; ``_`` for those that mean nothing.
    dtype : str
        Of the values in BIN files.
    frame : {"lidar", "world"}
        What the coordinates of the points are of.
    labels : str
        Folder of labels.
    lidars : dict
        Several LiDARs by name, instead of ``sweeps``; the first gives stamps and frame.
    cameras : dict
    """

    sweeps: str | None = None
    times: str | None = None
    rate: float | None = Field(None, gt=0)
    columns: tuple[str, ...] = KITTI_COLUMNS
    dtype: Literal["float32", "float64"] = "float32"
    frame: Literal["lidar", "world"] = "lidar"
    labels: str = "labels"
    lidars: dict[str, FolderLidar] = Field(default_factory=dict)
    cameras: dict[str, YamlCamera] = Field(default_factory=dict)


@dataclass(frozen=True)
class FileLidar(SweepFiles):
    """A LiDAR whose sweeps are clouds of rows or of known suffixes."""

    rows: RowFormat

    def read(self, index: int) -> Cloud:
        """Own sweep ``index``."""
        return read_cloud(self.sweeps[index], index, self.rows)


class CloudFolder(Recording):
    """A folder of PCD, PLY, BIN, NPY, LAS or LAZ files, one a sweep.

    Parameters
    ----------
    path : Path
        The folder; its ``docdepth.yaml`` has the entries of :class:`FolderSettings`.
    image_size : (int, int), optional
        Width and height in pixels of cameras of which no more is known.
    name : str
        Of the format.
    usual : dict, optional
        Entries that the format has where ``docdepth.yaml`` leaves them out.
    """

    def __init__(
        self,
        path: Path,
        image_size: tuple[int, int] | None = None,
        name: str = "folder",
        usual: dict[str, Any] | None = None,
    ) -> None:
        settings, file = read_settings(path, FolderSettings, usual)
        if settings.lidars and (settings.sweeps or settings.times):
            raise DatasetError(f"{file}: sweeps and times are of one LiDAR, lidars of several")
        wanted = settings.lidars or {
            "lidar": FolderLidar(sweeps=settings.sweeps or ".", times=settings.times)
        }
        rows = RowFormat(settings.columns, settings.dtype)
        lidars = [
            _lidar(path, one, lidar, rows, settings.rate, file) for one, lidar in wanted.items()
        ]
        problems = Collector()
        cameras, uncalibrated = yaml_cameras(
            path, settings.cameras, lidars[0].stream, image_size, file, problems
        )
        poses = None
        with problems.collected():
            poses = _poses(path, settings.poses, lidars[0], file)
        problems.raise_errors()
        self._label_folder = path / settings.labels
        if "labels" in settings.model_fields_set and not self._label_folder.is_dir():
            raise DatasetError(f"{file}: there is no folder {self._label_folder} of labels")
        options = settings.options(settings.frame == "world")
        super().__init__(name, path, lidars, cameras, poses, options, uncalibrated=uncalibrated)

    def _measured_labels(self, own: int) -> NDArray[np.uint32] | None:
        """Labels of a sweep as it was recorded, of ``labels/NAME.label``, or None."""
        reader = self._readers[0]
        measured = reader.measured if isinstance(reader, ResampledLidar) else reader
        file = self._label_folder / f"{measured.stream.names[own]}.label"
        if not is_there(file):
            return None
        labels = read_bytes(file, "copy the labels again")
        points = self.sweep(own).points if measured is reader else measured.read(own).points
        count = len(points)
        if len(labels) != 4 * count:
            raise DatasetError(
                f"{file} (frame {own}) has {len(labels)} bytes for a sweep of {count} points; "
                "labels are one uint32 for each point, in the order of the sweep"
            )
        return np.frombuffer(labels, "<u4").astype(np.uint32)


def cloud_files(folder: Path) -> list[Path]:
    """The point clouds of a folder in the order of :func:`~.kitti_files.in_order`.

    Raises
    ------
    DatasetError
        There are none, or of several kinds.
    """
    files = [file for file in folder.glob("*") if file.suffix.lower() in READERS]
    kinds = sorted({file.suffix.lower() for file in files})
    if not folder.is_dir():
        raise DatasetError(f"{folder}, the folder of the sweeps, is not there")
    if not files:
        raise DatasetError(f"{folder} holds no point clouds ({', '.join(sorted(READERS))})")
    if len(kinds) > 1:
        raise DatasetError(
            f"{folder} holds {' and '.join(kinds)} files; a folder has sweeps of one kind"
        )
    return in_order(files)


def _lidar(
    folder: Path,
    name: str,
    settings: FolderLidar,
    rows: RowFormat,
    rate: float | None,
    file: Path,
) -> FileLidar:
    sweeps = cloud_files(folder / settings.sweeps)
    if rate:
        numbered = all(sweep.stem.isascii() and sweep.stem.isdigit() for sweep in sweeps)
        numbers = [int(sweep.stem) if numbered else k for k, sweep in enumerate(sweeps)]
        times = np.round(np.array(numbers) * 1e9 / rate).astype(np.int64)
        check_increasing(times, [sweep.name for sweep in sweeps], sweeps[0].parent)
    else:
        remedy = f"say times: FILE or rate: 10 (sweeps a second) in {file}"
        times = times_of_files(sweeps, settings.times, folder, remedy)
    T = np.eye(4)
    if settings.T_lidar_sensor is not None:
        T = transform(settings.T_lidar_sensor, f"{file}, {name}: T_lidar_sensor")
    return FileLidar(LidarStream(name, times, [s.stem for s in sweeps], T), sweeps, rows)


def _poses(
    folder: Path, wanted: str | None, lidar: FileLidar, file: Path
) -> NDArray[np.float64] | None:
    """Poses of a file, or of the sweeps' own headers; None without any."""
    sweeps = lidar.sweeps
    if wanted not in (None, VIEWPOINT):
        return read_poses_at(folder / str(wanted), lidar.stream.times)
    if sweeps[0].suffix.lower() != ".pcd":
        if wanted == VIEWPOINT:
            raise DatasetError(f"{file}: {sweeps[0]} is no PCD file and has no VIEWPOINT")
        return None
    if wanted is None:
        if not np.array_equal(read_viewpoint(sweeps[-1], len(sweeps) - 1), np.eye(4)):
            log.warning(
                "%s: PCD files hold poses (VIEWPOINT), which are not used; say poses: viewpoint, "
                "and frame: world if their points are in the world, in %s",
                folder, file,
            )  # fmt: skip
        return None
    poses = np.stack([read_viewpoint(sweep, k) for k, sweep in enumerate(sweeps)])
    if len(poses) > 1 and (poses == np.eye(4)).all():
        raise DatasetError(
            f"{folder}: VIEWPOINT is 0 0 0 1 0 0 0 in every file, which is no pose; say poses: "
            f"FILE in {file}"
        )
    return poses


def _recognises(path: Path) -> bool:
    """A folder with clouds, or one whose docdepth.yaml says where they are."""
    if not path.is_dir():
        return False
    kinds = {file.suffix.lower() for file in path.iterdir() if not file.name.startswith(".")}
    if (path / FILE).is_file():
        return True
    return bool(kinds & (READERS.keys() - _NAMELESS))


FORMAT = Format(
    "folder",
    "a folder of .pcd, .ply, .las or .laz files, one a sweep, or with .bin or .npy files and a "
    "docdepth.yaml",
    _recognises,
    CloudFolder,
    found_below=False,
)
