"""Cameras of a bag: images, CameraInfo, and where the camera sits."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.base import CameraStream, ImageStream
from docdepth.datasets.files import StoredImage
from docdepth.datasets.formats.bag.bag_file import BagFile, Message
from docdepth.datasets.formats.bag.opened_bag import OpenedBag
from docdepth.datasets.formats.bag.ros_images import (
    CAMERA_INFO,
    camera_of,
    decode_image,
    is_photo,
    is_video,
    measures,
    rectification_of,
    size_of,
)
from docdepth.datasets.settings import CameraSettings, transform
from docdepth.errors import CalibrationError

log = logging.getLogger(__name__)

_SUFFIXES = ("compressed", "image_raw", "image_color", "image_mono", "image", "image_rect",
             "image_rect_color")  # fmt: skip
"""Last parts of topics of images that do not tell cameras apart."""


def _read_image(bag: BagFile, topic: str, message: Message, index: int) -> NDArray[np.uint8]:
    where = f"{bag.path}, {topic} (image {index})"
    return decode_image(bag.read(topic, message, where), where)


def camera_name(topic: str, topics: Sequence[str]) -> str:
    """A name for files: the topic without what all topics of images end with."""
    short = _shortened(topic)
    same = [other for other in topics if _shortened(other) == short]
    return short if len(same) == 1 else topic.strip("/").replace("/", "_")


def _shortened(topic: str) -> str:
    parts = topic.strip("/").split("/")
    while len(parts) > 1 and parts[-1] in _SUFFIXES:
        parts.pop()
    return "_".join(parts)


def open_camera(
    opened: OpenedBag,
    name: str,
    topic: str,
    messages: list[Message],
    times: NDArray[np.int64],
    lidar_frame: str,
) -> CameraStream | ImageStream | None:
    """A camera; its images alone, with a warning, where the bag does not tell what it takes.

    None for a topic that holds no photos. What the user says of a camera wins over the bag.
    ``messages`` are in the order of their stamps, ``times`` nanoseconds of each image.
    ``lidar_frame`` is that of the points.
    """
    bag, settings = opened.file, opened.settings.cameras.get(topic)
    given, file = settings or CameraSettings(), opened.settings.file
    where = f"{bag.path}, {topic}"
    first = bag.read(topic, messages[0], where)
    if settings is None and not is_photo(first):
        if is_video(first):
            log.warning(
                "%s holds video (%s), which docdepth does not read, and is left out; record JPEG, "
                "PNG or raw images, or decode it to a topic of images",
                where, first.format,
            )  # fmt: skip
        elif measures(first):
            log.info("%s holds no photos and is left out", where)
        else:
            log.warning(
                "%s has the encoding %r, which docdepth does not read, and is left out",
                where, first.encoding,
            )  # fmt: skip
        return None
    names = [str(time) for time in times.tolist()]
    images = [
        StoredImage(bag.files[0], f"{topic} {stamp}", partial(_read_image, bag, topic, message, k))
        for k, (message, stamp) in enumerate(zip(messages, names, strict=True))
    ]
    known = ImageStream(name, times, names, images)
    try:
        info = _info(bag, topic)
        rectified = any("rect" in part for part in topic.split("/"))
        if given.K is not None:
            height, width = decode_image(first, where).shape[:2]
            camera = given.camera((width, height), f"{file}, {topic}")
            distortion, model = given.lens(f"{file}, {topic}"), given.model
        elif info is not None:
            size = size_of(first, where)
            camera, distortion, model = camera_of(info, rectified, size, where)
        else:
            raise CalibrationError(f"{where}: there is no CameraInfo")
        known = ImageStream(name, times, names, images, camera, distortion, model)
        T = _extrinsic(opened, lidar_frame, given, messages[0].frame or _frame_of(info), topic)
        if rectified and info is not None and given.T_camera_lidar is None:
            T = rectification_of(info) @ T
    except CalibrationError as error:
        if (given.K and known.camera is None) or given.T_camera_lidar:
            raise
        log.warning(
            "%s; the camera gets no depth maps. Say K and T_camera_lidar of cameras: {%s: } in "
            "%s, or find them by docdepth calibrate",
            error, topic, file,
        )  # fmt: skip
        return known
    return CameraStream(name, camera, T, times, names, images, distortion, model)


def _info(bag: BagFile, topic: str) -> Any:
    """The first CameraInfo near a topic of images; None without one."""
    parts = topic.split("/")
    for k in range(len(parts), 1, -1):
        near = "/".join([*parts[:k], "camera_info"])
        if bag.topics.get(near) == CAMERA_INFO:
            return next(iter(bag.read_all(near, most=1)), None)
    return None


def _extrinsic(
    opened: OpenedBag, lidar_frame: str, given: CameraSettings, camera_frame: str, topic: str
) -> NDArray[np.float64]:
    if given.T_camera_lidar is not None:
        where = f"{opened.settings.file}, {topic}: T_camera_lidar"
        return transform(given.T_camera_lidar, where)
    T = None
    if camera_frame and lidar_frame:
        T = opened.frames.between(camera_frame, lidar_frame)
    if T is None:
        known = ", ".join(opened.frames.names) or "none"
        raise CalibrationError(
            f"{opened.path}, {topic}: no static transform connects the frames {camera_frame!r} "
            f"of the images and {lidar_frame!r} of the points (there are {known})"
        )
    return T


def _frame_of(info: Any) -> str:
    return "" if info is None else str(info.header.frame_id).lstrip("/")
