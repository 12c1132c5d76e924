"""The images of a recording by camera, also of cameras that are not calibrated yet."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.base import Dataset, LensModel, check_distortion
from docdepth.datasets.frame_range import FrameRange
from docdepth.datasets.images import ImageSource
from docdepth.geometry.camera import Camera


@dataclass(frozen=True)
class ImageStream:
    """The images of one camera, and what is known of it.

    Attributes
    ----------
    name : str
    times : ndarray of int64, shape (m,)
        Time of each image in nanoseconds, on the clock of the sweeps.
    names : list of str
    images : sequence of Path or StoredImage
    camera : Camera, optional
        None if K is not known.
    distortion, model
        As :class:`~docdepth.datasets.CameraStream` has them.
    """

    name: str
    times: NDArray[np.int64]
    names: list[str]
    images: Sequence[ImageSource]
    camera: Camera | None = None
    distortion: NDArray[np.float64] | None = None
    model: LensModel = "pinhole"

    def __post_init__(self) -> None:
        if self.camera is not None:
            check_distortion(self.name, self.distortion, self.model)


def image_streams(recording: Dataset) -> dict[str, ImageStream]:
    """All images of a recording, by camera."""
    if isinstance(recording, FrameRange):
        streams = image_streams(recording.whole)
        return {name: recording.part_of(stream) for name, stream in streams.items()}
    found = {
        name: ImageStream(
            name, s.times, s.names, s.images, s.camera, s.distortion, s.model
        )
        for name, s in recording.cameras.items()
        if s.images
    }  # fmt: skip
    return found | getattr(recording, "uncalibrated", {})
