"""A recording seen in another way: a part of it, without its own vehicle, with times of points."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from docdepth.datasets.base import (
    CameraStream,
    Dataset,
    DatasetRepr,
    ImageStream,
    LidarStream,
    Sweep,
)
from docdepth.datasets.point_times import median_period, nearest_rows
from docdepth.errors import DatasetError
from docdepth.geometry.turn import Turn

_Stream = TypeVar("_Stream", CameraStream, ImageStream)


class RecordingView(DatasetRepr):
    """A recording seen in another way: what a subclass does not change is as it was."""

    def __init__(self, whole: Dataset) -> None:
        self.whole = whole
        self.indices: Sequence[int] = range(len(whole))
        self.name: str = whole.name
        self.path: Path = whole.path
        self.times: NDArray[np.int64] = whole.times
        self.cameras = dict(whole.cameras)

    def __len__(self) -> int:
        return len(self.indices)

    @cached_property
    def partial_poses(self) -> NDArray[np.float64] | None:
        """``T_world_lidar`` (n, 4, 4), NaN for sweeps without a pose; None without any."""
        known = self.whole.poses
        known = getattr(self.whole, "partial_poses", None) if known is None else known
        return None if known is None else known[list(self.indices)]

    @cached_property
    def poses(self) -> NDArray[np.float64] | None:
        """``T_world_lidar`` (n, 4, 4) if every sweep has a pose."""
        known = self.partial_poses
        return known if known is not None and np.isfinite(known).all() else None

    @cached_property
    def lidars(self) -> dict[str, LidarStream]:
        """The LiDARs by name."""
        return {name: self._lidar(stream) for name, stream in self.whole.lidars.items()}

    def _lidar(self, stream: LidarStream) -> LidarStream:
        return stream

    def sweep(self, index: int) -> Sweep:
        """Sweep ``index`` of the view."""
        return self.whole.sweep(self.indices[index])

    def sweep_files(self, index: int) -> list[Path]:
        """The files of sweep ``index`` of the view."""
        return self.whole.sweep_files(self.indices[index])

    def labels(self, index: int) -> NDArray[np.uint32] | None:
        """Labels of sweep ``index`` of the view; None without a file."""
        return self.whole.labels(self.indices[index])


class FrameRange(RecordingView):
    """Sweeps A to B - 1 of a recording, and the images that were taken meanwhile.

    Files keep their names. A sweep that is left out is as if it had not been recorded, and so are
    the images that no other sweep is nearer to.

    Parameters
    ----------
    frames : str
        ``A:B`` as in a slice of Python; either may be left out.
    without : collection of int
        Sweeps of the whole recording that are left out.
    without_images : mapping of str to collection of str
        Names of images that are left out, by camera.
    """

    def __init__(
        self,
        whole: Dataset,
        frames: str = ":",
        without: Collection[int] = (),
        without_images: Mapping[str, Collection[str]] | None = None,
    ) -> None:
        super().__init__(whole)
        self._without, self._without_images = without, without_images or {}
        part = [k for k in _parse(frames, len(whole), whole.path) if k not in without]
        if not part:
            raise DatasetError(f"{whole.path}: every sweep is broken; copy the recording again")
        self.indices = part
        self.times = whole.times[part]
        self.cameras = {name: self.part_of(stream) for name, stream in whole.cameras.items()}

    def sweep(self, index: int) -> Sweep:
        """Sweep ``index`` of the range."""
        return self._first if index == 0 else super().sweep(index)

    @cached_property
    def _first(self) -> Sweep:
        """Kept, since each stage asks it whether sweeps have times and where rays begin."""
        return super().sweep(0)

    def part_of(self, stream: _Stream) -> _Stream:
        """A camera of the recording, cut to a sweep before the first and after the last one."""
        kept = self._within(stream.times)
        broken = self._without_images.get(stream.name, ())
        near = nearest_rows(self.whole.times, stream.times[kept]).tolist()
        names = [stream.names[k] for k in kept]
        whole = [n not in self._without and name not in broken
                 for n, name in zip(near, names, strict=True)]  # fmt: skip
        kept = kept[np.array(whole, np.bool_)]
        return replace(
            stream,
            times=stream.times[kept],
            names=[stream.names[k] for k in kept],
            images=[stream.images[k] for k in kept] if stream.images else [],
        )

    def _lidar(self, lidar: LidarStream) -> LidarStream:
        if np.array_equal(lidar.times, self.whole.times):
            kept = np.array(self.indices)
        else:
            kept = self._within(lidar.times)
        return replace(lidar, times=lidar.times[kept], names=[lidar.names[k] for k in kept])

    def _within(self, times: NDArray[np.int64]) -> NDArray[np.intp]:
        """Which times lie between a sweep before the first and after the last one."""
        all_times = self.whole.times
        margin = median_period(all_times) or 0
        begin, end = self.times[0] - margin, self.times[-1] + margin
        return np.flatnonzero((times >= begin) & (times <= end))


def _parse(frames: str, count: int, path: Path) -> range:
    match = re.fullmatch(r"\s*(\d*)\s*:\s*(\d*)\s*", frames, re.ASCII)
    if not match:
        raise DatasetError(
            f"frames {frames!r}: write A:B with numbers of sweeps, for example 100:200, 100: or "
            f":200; {path} has {count} sweeps"
        )
    first, last = match.groups()
    chosen = range(count)[int(first or 0) : int(last or count)]
    if not chosen:
        raise DatasetError(
            f"frames {frames} holds no sweep: {path} has {count} sweeps, 0 to {count - 1}"
        )
    return chosen


def full_recording(recording: Dataset) -> Dataset:
    """The recording that this is a part of, or itself."""
    return recording.whole if isinstance(recording, FrameRange) else recording


def image_streams(recording: Dataset) -> dict[str, ImageStream]:
    """All images of a recording by camera, also of cameras that are not calibrated yet."""
    if isinstance(recording, FrameRange):
        streams = image_streams(recording.whole)
        return {name: recording.part_of(stream) for name, stream in streams.items()}
    if isinstance(recording, RecordingView):
        return image_streams(recording.whole)
    found = {
        name: ImageStream(name, s.times, s.names, s.images, s.camera, s.distortion, s.model)
        for name, s in recording.cameras.items()
        if s.images
    }
    return found | getattr(recording, "uncalibrated", {})


def without_ego(sweep: Sweep, boxes: Sequence[ArrayLike]) -> Sweep:
    """A sweep whose points within the boxes are no returns.

    Rows stay, so that times, rings and labels keep theirs.

    Parameters
    ----------
    boxes : sequence of six numbers, or of three pairs
        Least and greatest x, y and z, metres in the LiDAR frame.
    """
    if not boxes:
        return sweep
    points = sweep.points.copy()
    points[in_boxes(points, boxes)] = np.nan
    return replace(sweep, points=points)


def in_boxes(points: NDArray[np.float32], boxes: Sequence[ArrayLike]) -> NDArray[np.bool_]:
    """Which points (N, 3) are in one of the boxes, as those of :func:`without_ego`."""
    inside = np.zeros(len(points), bool)
    for box in boxes:
        low, high = np.array(box, np.float32).reshape(3, 2).T
        here = np.ones(len(points), bool)
        for values, least, most in zip(points.T, low, high, strict=True):
            here &= (values >= least) & (values <= most)
        inside |= here
    return inside


class WithoutEgo(RecordingView):
    """A recording without what its LiDAR sees of its own vehicle."""

    def __init__(self, whole: Dataset, boxes: Sequence[ArrayLike]) -> None:
        super().__init__(whole)
        self._boxes = boxes

    def sweep(self, index: int) -> Sweep:
        """Sweep ``index``; points in the boxes are NaN."""
        return without_ego(super().sweep(index), self._boxes)


class TurningLidar(RecordingView):
    """A recording of one spinning LiDAR, as measured, whose points have no times of their own.

    Parameters
    ----------
    whole : Dataset
        z of its points is the axis of the LiDAR, about.
    turn : Turn, optional
        None: points get no times.
    """

    def __init__(self, whole: Dataset, turn: Turn | None) -> None:
        super().__init__(whole)
        self.turn = turn

    def sweep(self, index: int) -> Sweep:
        """Sweep ``index`` as measured, with times of points."""
        sweep = super().sweep(index)
        times = None if self.turn is None else self.turn.relative_time(sweep.points)
        return replace(sweep, relative_time=times, motion_compensated=False)


def is_lone_lidar(recording: Dataset) -> bool:
    """Whether a recording is a folder of clouds of one LiDAR, which may be of any kind."""
    return recording.name == "folder" and len(recording.lidars) == 1


def lacks_times(recording: Dataset) -> bool:
    """Whether points of such a folder have no times, which their rotation may tell."""
    if not is_lone_lidar(recording):
        return False
    first = recording.sweep(0)
    return first.relative_time is None and not first.motion_compensated
