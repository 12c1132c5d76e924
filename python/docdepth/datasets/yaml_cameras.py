"""Cameras that ``docdepth.yaml`` describes, for recordings whose files tell of none."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from docdepth.datasets.base import CameraStream, ImageStream, LidarStream
from docdepth.datasets.cloud import LidarReader
from docdepth.datasets.kitti_files import image_files, image_size
from docdepth.datasets.recording import Recording
from docdepth.datasets.settings import CameraSettings, RecordingSettings
from docdepth.datasets.times import read_times, times_of_files
from docdepth.errors import CalibrationError, Collector, DatasetError

log = logging.getLogger(__name__)


class YamlCamera(CameraSettings):
    """A camera with its images.

    Attributes
    ----------
    images : str, optional
        Their folder.
    times : str, optional
        File with a line an image; ``names``: they are the images' names; ``sweeps``: the camera
        fires with the sweeps. Found beside the images, or in their names, if left out.
    """

    images: str | None = None
    times: str | None = None


class CameraRecordingSettings(RecordingSettings):
    """Entries of a format without a camera of its own."""

    cameras: dict[str, YamlCamera] = Field(default_factory=dict)


class LidarRecording(Recording):
    """A recording of one LiDAR alone; its cameras are those that ``docdepth.yaml`` describes.

    Parameters
    ----------
    name : str
        Of the format.
    path : Path
    lidar : LidarReader
    poses : ndarray of float64, shape (n, 4, 4), optional
        ``T_world_lidar`` of each sweep.
    settings : CameraRecordingSettings
    file : Path
        Of the settings, for messages.
    image_size : (int, int), optional
        Width and height of cameras that are described without images.
    """

    def __init__(
        self,
        name: str,
        path: Path,
        lidar: LidarReader,
        poses: NDArray[np.float64] | None,
        settings: CameraRecordingSettings,
        file: Path,
        image_size: tuple[int, int] | None,
    ) -> None:
        problems = Collector()
        cameras, uncalibrated = yaml_cameras(
            path, settings.cameras, lidar.stream, image_size, file, problems
        )
        problems.raise_errors()
        super().__init__(
            name, path, [lidar], cameras, poses, settings.options(), uncalibrated=uncalibrated
        )


def yaml_cameras(
    folder: Path,
    described: Mapping[str, YamlCamera],
    lidar: LidarStream,
    asked: tuple[int, int] | None,
    file: Path,
    problems: Collector,
) -> tuple[dict[str, CameraStream], dict[str, ImageStream]]:
    """The cameras that ``docdepth.yaml`` describes, and those that it does not describe whole.

    Parameters
    ----------
    folder : Path
        Of the recording; images and tables are relative to it.
    described : dict of YamlCamera
    lidar : LidarStream
        Its sweeps may give the times.
    asked : (int, int), optional
        Width and height of cameras of which no more is known.
    file : Path
        Of the settings, for messages.
    problems : Collector
        Gets what is wrong.
    """
    cameras: dict[str, CameraStream] = {}
    uncalibrated: dict[str, ImageStream] = {}
    for name, camera in described.items():
        with problems.collected():
            found = _camera(folder, name, camera, lidar, asked, f"{file}, {name}")
            if isinstance(found, CameraStream):
                cameras[name] = found
            else:
                uncalibrated[name] = found
    return cameras, uncalibrated


def _camera(
    folder: Path,
    name: str,
    settings: YamlCamera,
    lidar: LidarStream,
    asked: tuple[int, int] | None,
    where: str,
) -> CameraStream | ImageStream:
    images = image_files(folder / settings.images) if settings.images else []
    if settings.images and not images:
        raise DatasetError(f"{where}: {folder / settings.images} holds no images (png, jpg)")
    size = image_size(images) if images else None
    if size and settings.size and size != settings.size:
        raise CalibrationError(
            f"{where}: {images[0]} is {size} pixels, but size is {settings.size}"
        )
    times, names = _image_times(folder, settings, images, lidar, where)
    if images and (settings.K is None or settings.T_camera_lidar is None):
        lacks = "K" if settings.K is None else "T_camera_lidar"
        log.warning("%s has no %s, so it gets no depth maps; docdepth calibrate finds it",
                    where, lacks)  # fmt: skip
        camera = None if settings.K is None else settings.camera(size, where)
        return ImageStream(name, times, names, images, camera, settings.lens(), settings.model)
    return CameraStream(
        name,
        settings.camera(size or settings.size or asked, where),
        settings.extrinsic(where),
        times,
        names,
        images,
        settings.lens(),
        settings.model,
    )


def _image_times(
    folder: Path,
    settings: YamlCamera,
    images: Sequence[Path],
    lidar: LidarStream,
    where: str,
) -> tuple[NDArray[np.int64], list[str]]:
    if settings.times == "sweeps" or not (images or settings.times):
        if images and len(images) != len(lidar.times):
            raise DatasetError(
                f"{where}: times are those of the sweeps, but there are {len(images)} images for "
                f"{len(lidar.times)} sweeps; give times: FILE, with a line an image"
            )
        return lidar.times, [image.stem for image in images] or lidar.names
    files = list(images)
    if not files:
        count = len(read_times(folder / str(settings.times)))
        files = [Path(f"{k:06d}") for k in range(count)]
    remedy = f"say times: FILE, with a line an image, or times: sweeps in {where}"
    times = times_of_files(files, settings.times, folder, remedy)
    return times, [image.stem for image in files]
