"""Recordings on disk: a file for each format, all with the interface :class:`~.base.Dataset`.

What is missing, damaged or contradicts itself raises a :class:`~docdepth.errors.DatasetError`, of a
calibration a :class:`~docdepth.errors.CalibrationError`, that names file, frame and remedy; what
needs a library that is not installed a :class:`~docdepth.errors.MissingExtraError`. That holds for
every reader here, so docstrings of single ones do not repeat it.
"""

from __future__ import annotations

from docdepth.datasets.base import CameraStream, Dataset, ImageStream, LidarStream, Sweep
from docdepth.datasets.format import Format
from docdepth.datasets.registry import (
    experimental_formats,
    find_recordings,
    format_names,
    open_dataset,
)
from docdepth.datasets.views import FrameRange, full_recording, image_streams
from docdepth.geometry.points import usable_points

__all__ = [
    "CameraStream",
    "Dataset",
    "Format",
    "FrameRange",
    "ImageStream",
    "LidarStream",
    "Sweep",
    "experimental_formats",
    "find_recordings",
    "format_names",
    "full_recording",
    "image_streams",
    "open_dataset",
    "usable_points",
]
