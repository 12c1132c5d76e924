"""Cameras that ``docdepth.yaml`` describes, for recordings whose files tell of none."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from docdepth.datasets.base import CameraStream, ImageStream, LidarStream
from docdepth.datasets.cloud import LidarReader
from docdepth.datasets.kitti_files import IMAGES, agreed_size, image_files
from docdepth.datasets.recording import Poses, Recording
from docdepth.datasets.settings import CameraSettings, RecordingSettings, transform
from docdepth.datasets.times import read_times, times_of_files
from docdepth.errors import DatasetError, DocDepthError, collect_errors, raise_together

log = logging.getLogger(__name__)


class YamlCamera(CameraSettings):
    """A camera with its images."""

    images: str | None = None  # their folder
    # file with a line an image; ``names``: they are the images' names; ``sweeps``: the camera fires
    # with the sweeps. Found beside the images, or in their names, if left out
    times: str | None = None


class CameraRecordingSettings(RecordingSettings):
    """Entries of a format without a camera of its own."""

    cameras: dict[str, YamlCamera] = Field(default_factory=dict)


def yaml_recording(
    name: str,
    path: Path,
    lidars: Sequence[LidarReader],
    poses: Poses | Callable[[], Poses],
    settings: CameraRecordingSettings,
    image_size: tuple[int, int] | None,
) -> Recording:
    """A :class:`Recording` whose cameras are those that ``docdepth.yaml`` describes.

    ``image_size`` is width and height of cameras that are described without images.
    """
    cameras, uncalibrated = yaml_cameras(path, settings, lidars[0].stream, image_size)
    return Recording(name, path, lidars, cameras, poses, settings, uncalibrated=uncalibrated)


def yaml_cameras(
    folder: Path,
    settings: CameraRecordingSettings,
    lidar: LidarStream,
    asked: tuple[int, int] | None,
) -> tuple[dict[str, CameraStream], dict[str, ImageStream]]:
    """The cameras that ``docdepth.yaml`` describes, and those that it does not describe whole.

    Images and tables are relative to ``folder``, that of the recording. The sweeps of ``lidar`` may
    give the times. ``asked`` is width and height of cameras of which no more is known. Errors of
    all cameras are told together.
    """
    cameras: dict[str, CameraStream] = {}
    uncalibrated: dict[str, ImageStream] = {}
    problems: list[DocDepthError] = []
    for name, camera in settings.cameras.items():
        with collect_errors(problems):
            found = _camera(folder, name, camera, lidar, asked, f"{settings.file}, {name}")
            if isinstance(found, CameraStream):
                cameras[name] = found
            else:
                uncalibrated[name] = found
    raise_together(problems)
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
        raise DatasetError(
            f"{where}: {folder / settings.images} holds no images ({', '.join(IMAGES)})"
        )
    size = agreed_size(where, images, {"size": settings.size}) or asked
    times, names = _image_times(folder, settings, images, lidar, where)
    if images and (settings.K is None or settings.T_camera_lidar is None):
        lacks = "K" if settings.K is None else "T_camera_lidar"
        log.warning("%s has no %s, so it gets no depth maps; docdepth calibrate finds it",
                    where, lacks)  # fmt: skip
        camera = None if settings.K is None else settings.camera(size, where)
        return ImageStream(name, times, names, images, camera, settings.lens(where), settings.model)
    return CameraStream(
        name,
        settings.camera(size, where),
        transform(settings.T_camera_lidar, f"{where}: T_camera_lidar"),
        times,
        names,
        images,
        settings.lens(where),
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
