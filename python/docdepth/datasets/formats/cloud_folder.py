"""Folders of point clouds, one file a sweep, with a small ``docdepth.yaml`` beside them."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator

from docdepth.datasets.base import CameraStream, ImageStream, LidarStream, Sweep
from docdepth.datasets.cloud import FileLidar
from docdepth.datasets.cloud_files import READERS, TEXTS, RowFormat, read_cloud, read_viewpoint
from docdepth.datasets.files import FILE, files_of
from docdepth.datasets.format import Format
from docdepth.datasets.kitti_files import check_increasing, in_order
from docdepth.datasets.recording import Recording
from docdepth.datasets.settings import Numbers, Strict, read_settings, transform
from docdepth.datasets.times import TABLES, times_of_files
from docdepth.datasets.yaml_cameras import CameraRecordingSettings, yaml_cameras
from docdepth.errors import DatasetError, DocDepthError, collect_errors, raise_together
from docdepth.geometry.points import MOVING_LABEL, STATIC_LABEL
from docdepth.io.pcd import PcdError, read_pcd_header

log = logging.getLogger(__name__)

VIEWPOINT = "viewpoint"
"""Entry ``poses`` that means the poses in the headers of PCD files."""

_FAR = 10.0
"""From where on two sweeps tell of which frame their points are [m]: the middle of the points of a
sweep moves by metres from one to the next street."""

_SURE = 1 / 3  # how much better one frame explains this middle than the other

_NAMELESS = {".bin", ".npy", *TEXTS}  # suffixes of files that need not be clouds


class FolderLidar(Strict):
    """One of several LiDARs."""

    sweeps: str  # folder of its sweeps
    times: str | None = None
    # takes its points to the frame of the first LiDAR; identity if left out
    T_lidar_sensor: Numbers | None = None


class FolderSettings(CameraRecordingSettings):
    """What ``docdepth.yaml`` of a folder of clouds may say."""

    sweeps: str | None = None  # folder of the sweeps
    times: str | None = None  # file with a line a sweep, or ``names``
    # sweeps a second, where there are no times. A number in the name of a file is that of its sweep
    rate: float | None = Field(None, gt=0, le=1000)
    # values of a point in BIN, NPY and text files; ``_`` for those that mean nothing
    columns: tuple[str, ...] | None = None
    dtype: Literal["float32", "float64"] = "float32"  # of the values in BIN files
    frame: Literal["lidar", "world"] = "lidar"  # what the coordinates of the points are of
    labels: str = "labels"  # folder of labels
    # several LiDARs by name, instead of ``sweeps``; the first gives stamps and frame
    lidars: dict[str, FolderLidar] = Field(default_factory=dict)

    @field_validator("columns")
    @classmethod
    def _are_columns(cls, columns: tuple[str, ...] | None) -> tuple[str, ...] | None:
        named = [name.lower() for name in ("xyz" if columns is None else columns) if name != "_"]
        if not {"x", "y", "z"} <= set(named) or len(set(named)) < len(named):
            raise ValueError(
                "columns must name x, y and z, and each value of a point once, as in "
                f"[x, y, z, intensity, _]; got [{', '.join(columns or ())}]"
            )
        return columns


class CloudFolder(Recording):
    """A folder of PCD, PLY, BIN, NPY, LAS, LAZ or text files, one a sweep.

    Its ``docdepth.yaml`` has the entries of :class:`FolderSettings`; ``usual`` are those that the
    format ``name`` has where it leaves them out. ``image_size`` is width and height in pixels of
    cameras of which no more is known.

    Attributes
    ----------
    frame : {"lidar", "world"}
        What the coordinates in the files are said to be of.
    """

    def __init__(
        self,
        path: Path,
        image_size: tuple[int, int] | None = None,
        name: str = "folder",
        usual: Mapping[str, object] | None = None,
    ) -> None:
        settings = read_settings(path, FolderSettings, usual)
        file = settings.file
        if settings.lidars and (settings.sweeps or settings.times):
            raise DatasetError(f"{file}: sweeps and times are of one LiDAR, lidars of several")
        if settings.rate and settings.times:
            raise DatasetError(f"{file}: times and rate both tell the times; leave one out")
        wanted = settings.lidars or {
            "lidar": FolderLidar(sweeps=settings.sweeps or ".", times=settings.times)
        }
        lidars = [_lidar(path, one, lidar, settings) for one, lidar in wanted.items()]
        problems: list[DocDepthError] = []
        poses = None
        cameras: dict[str, CameraStream] = {}
        uncalibrated: dict[str, ImageStream] = {}
        with collect_errors(problems):
            cameras, uncalibrated = yaml_cameras(path, settings, lidars[0].stream, image_size)
        with collect_errors(problems):
            poses = _poses(settings, lidars[0])
        raise_together(problems)
        self.frame = settings.frame
        labels, world = path / settings.labels, settings.frame == "world"
        if "labels" in settings.model_fields_set and not labels.is_dir():
            raise DatasetError(f"{file}: there is no folder {labels} of labels")
        if poses is not None:
            _check_frame(lidars[0], poses, world, path / FILE)
        super().__init__(name, path, lidars, cameras, poses, settings, world, uncalibrated, labels)


def cloud_files(folder: Path) -> list[Path]:
    """The point clouds of a folder in the order of :func:`~.kitti_files.in_order`.

    A text is a cloud only where no file of another kind is there, ``.txt`` last of all.
    """
    found = [file for file in folder.glob("*") if file.suffix.lower() in READERS]
    files = [file for file in found if file.suffix.lower() not in TEXTS]
    files = files or [file for file in found if file.suffix.lower() != ".txt"]
    files = files or [file for file in found if file.name not in (*TABLES, "poses.txt")]
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


def _lidar(folder: Path, name: str, own: FolderLidar, settings: FolderSettings) -> FileLidar:
    sweeps, file = cloud_files(folder / own.sweeps), settings.file
    if settings.rate:
        numbered = all(sweep.stem.isascii() and sweep.stem.isdigit() for sweep in sweeps)
        numbers = [int(sweep.stem) if numbered else k for k, sweep in enumerate(sweeps)]
        times = np.round(np.array(numbers) * 1e9 / settings.rate).astype(np.int64)
        check_increasing(times, [sweep.name for sweep in sweeps], sweeps[0].parent)
    else:
        remedy = f"say times: FILE or rate: 10 (sweeps a second) in {file}"
        times = times_of_files(sweeps, own.times, folder, remedy)
    T = np.eye(4)
    if own.T_lidar_sensor is not None:
        T = transform(own.T_lidar_sensor, f"{file}, {name}: T_lidar_sensor")
    rows = RowFormat(settings.columns, settings.dtype)
    stream = LidarStream(name, times, [sweep.stem for sweep in sweeps], T)
    return FileLidar(stream, sweeps, partial(read_cloud, rows=rows))


def _poses(settings: FolderSettings, lidar: FileLidar) -> NDArray[np.float64] | None:
    """Poses of a file, or of the sweeps' own headers; None without any."""
    sweeps, wanted, file = lidar.sweeps, settings.poses, settings.file
    if wanted not in (None, VIEWPOINT):
        return settings.poses_at(lidar.stream.times)
    if sweeps[0].suffix.lower() != ".pcd":
        if wanted == VIEWPOINT:
            raise DatasetError(f"{file}: {sweeps[0]} is no PCD file and has no VIEWPOINT")
        return None
    if wanted is None:
        if not np.array_equal(read_viewpoint(sweeps[-1], len(sweeps) - 1), np.eye(4)):
            log.warning(
                "%s: PCD files hold poses (VIEWPOINT), which are not used; say poses: viewpoint, "
                "and frame: world if their points are in the world, in %s",
                sweeps[0].parent, file,
            )  # fmt: skip
        return None
    poses = np.stack([read_viewpoint(sweep, k) for k, sweep in enumerate(sweeps)])
    if len(poses) > 1 and (poses == np.eye(4)).all():
        raise DatasetError(
            f"{sweeps[0].parent}: VIEWPOINT is 0 0 0 1 0 0 0 in every file, which is no "
            f"pose; say poses: FILE in {file}"
        )
    return poses


def _check_frame(lidar: FileLidar, poses: NDArray[np.float64], world: bool, file: Path) -> None:
    """Refuse points of another frame than is said, where two sweeps from far apart tell.

    The middle of the points goes along with the LiDAR in the world, and stays in its own frame.
    """
    positions = poses[:, :3, 3]
    if len(positions) != len(lidar.sweeps):
        return
    far = int(np.linalg.norm(positions - positions[0], axis=1).argmax())
    way = positions[far] - positions[0]
    if not _FAR < np.linalg.norm(way) < np.inf:
        return
    middles = []
    for k in (0, far):
        try:
            points = lidar.read(k).points
        except DatasetError:  # told when the sweep is read
            return
        points = points[np.isfinite(points).all(axis=1) & points.any(axis=1)]
        if not len(points):
            return
        middles.append(np.median(points, axis=0))
    moved = middles[1] - middles[0]
    of_world, of_lidar = np.linalg.norm(moved - way), np.linalg.norm(moved)
    if (of_lidar < _SURE * of_world) if world else (of_world < _SURE * of_lidar):
        said, other = ("world", "lidar") if world else ("lidar", "world")
        raise DatasetError(
            f"{lidar.sweeps[far]}: its points are not in the frame {said!r}: since "
            f"{lidar.sweeps[0].name} the poses go {np.linalg.norm(way):.0f} m, the middle of the "
            f"points {of_lidar:.0f} m; say frame: {other} in {file}"
        )


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
    "a folder of .pcd, .ply, .las or .laz files, one a sweep, or with .bin, .npy, .csv or .txt "
    "files and a docdepth.yaml",
    _recognises,
    CloudFolder,
    found_below=False,
)


# Sweeps are SemanticKITTI's and the like: ten a second, motion compensated.
_OF_DYNAMIC_MAP = {
    "sweeps": "pcd",
    "rate": 10,
    "poses": VIEWPOINT,
    "frame": "world",
    "motion_compensated": True,
}


class DynamicMap(CloudFolder):
    """A sequence ``SEQUENCE/pcd/000000.pcd`` of DynamicMap_Benchmark.

    Points are in the world and are brought to the LiDAR frame by VIEWPOINT. Intensity is no
    intensity but the true class, 1 for what moves: :meth:`labels` has it.
    """

    def __init__(self, path: Path, image_size: tuple[int, int] | None = None) -> None:
        super().__init__(path, image_size, "dynamic_map", _OF_DYNAMIC_MAP)

    def sweep(self, index: int) -> Sweep:
        """Sweep ``index`` in the LiDAR frame, without intensity."""
        return replace(super().sweep(index), intensity=None)

    def labels(self, index: int) -> NDArray[np.uint32]:
        """SemanticKITTI labels: 251 for what moves, 9 for the rest."""
        classes = super().sweep(index).intensity
        if classes is None:
            raise DatasetError(
                f"{self.sweep_files(index)[0]} (frame {index}) has no intensity, in which "
                "DynamicMap_Benchmark keeps the classes"
            )
        return np.where(classes == 1, MOVING_LABEL, STATIC_LABEL).astype(np.uint32)


def _is_dynamic_map(path: Path) -> bool:
    """A folder pcd whose last file has a pose in its header."""
    files = files_of(path / "pcd", ".pcd")
    try:
        return bool(files) and bool(read_pcd_header(files[-1]).viewpoint[:3].any())
    except (OSError, PcdError):
        return False


DYNAMIC_MAP = Format(
    "dynamic_map",
    "a sequence of DynamicMap_Benchmark with pcd/*.pcd, whose VIEWPOINT is the sensor's pose",
    _is_dynamic_map,
    DynamicMap,
)
