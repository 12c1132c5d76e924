"""Recordings on disk: a file for each format, all with the interface :class:`~.base.Dataset`."""

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
