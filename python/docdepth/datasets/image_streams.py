"""All images of a recording."""

from __future__ import annotations

from docdepth.datasets.base import Dataset, ImageStream
from docdepth.datasets.frame_range import FrameRange


def image_streams(recording: Dataset) -> dict[str, ImageStream]:
    """All images of a recording by camera, also of cameras that are not calibrated yet."""
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
