"""Captures of Ouster LiDARs (``.pcap`` with metadata in JSON), through ouster-sdk."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from docdepth.datasets.base import LidarStream
from docdepth.datasets.cloud import Cloud
from docdepth.datasets.files import OpenedOnce, extra, files_of
from docdepth.datasets.format import Format
from docdepth.datasets.kitti_files import check_increasing
from docdepth.datasets.recording import Recording
from docdepth.datasets.settings import RecordingSettings, read_settings
from docdepth.errors import DatasetError

_MICROSECOND = 1000  # ns
_MILLIMETRE = 1e-3
_VALID = 1  # bit of a column's status
_SAME_CLOCK = 3_600_000_000_000  # ns between host and LiDAR; more, and the LiDAR counts since boot


class OusterSettings(RecordingSettings):
    """What ``docdepth.yaml`` beside a capture may say."""

    metadata: str | None = None  # file of the sensor's metadata; found by its name if left out


class OusterCapture:
    """The frames of a capture, read from any thread, and opened again in another process.

    Stamps are when the first packet of a frame arrived; where the LiDAR keeps Unix time, they are
    moved to its clock. Times of points count from the first column that is there.
    """

    def __init__(self, path: Path, metadata: Path) -> None:
        self.path, self.metadata = path, metadata
        self._opened = OpenedOnce(partial(_open_source, path, metadata))
        with self._opened as source:
            arrived = np.array(source.full_index, np.int64).reshape(-1, 2)[:, 0]
        if not len(arrived):
            raise DatasetError(
                f"{path} holds no frame that fits {metadata}: it is empty, its packets are not "
                "whole, or the metadata is of another sensor, session or port; say metadata: FILE "
                "in docdepth.yaml"
            )
        times = arrived * _MICROSECOND + self._clock_offset(arrived * _MICROSECOND)
        names = [str(time) for time in times.tolist()]
        check_increasing(times, names, path)
        self.stream = LidarStream("ouster", times, names)

    @property
    def height(self) -> float:
        """Metres of the lasers' centre above the origin of the sensor's frame."""
        with self._opened as source:
            return height_of(source.sensor_info[0])

    def read(self, index: int) -> Cloud:
        """Own sweep ``index``."""
        where = f"{self.path} (frame {index})"
        with self._opened as source:
            return cloud_of_frame(_frame(source, index, where), source.sensor_info[0], where)

    def files(self, index: int) -> list[Path]:
        """The capture and its metadata."""
        return [self.path, self.metadata]

    def _clock_offset(self, arrived: np.ndarray[Any, np.dtype[np.int64]]) -> int:
        """Nanoseconds from the host's clock to the LiDAR's; 0 where that is not Unix time."""
        offsets = []
        with self._opened as source:
            for k in sorted({0, len(arrived) // 2, len(arrived) - 1}):
                frame = _frame(source, k, f"{self.path} (frame {k})")
                valid = (frame.status & _VALID) > 0
                if valid.any():
                    offsets.append(int(frame.timestamp[valid].min()) - int(arrived[k]))
        return clock_offset(offsets)


def height_of(info: Any) -> float:
    """Metres of the lasers' centre above the origin of the sensor's frame."""
    return float(info.lidar_to_sensor_transform[2, 3]) * _MILLIMETRE


def cloud_of_frame(frame: Any, info: Any, where: str) -> Cloud:
    """A row for each pixel of a frame, zeros where nothing returned."""
    from ouster.sdk import core

    points = core.XYZLut(info)(frame).astype(np.float32)
    rows, columns = points.shape[:2]
    valid = (frame.status & _VALID) > 0
    if not valid.any():
        raise DatasetError(f"{where} has no valid column", "leave it out by `frames`")
    points[:, ~valid] = 0
    late = np.where(valid, frame.timestamp - frame.timestamp[valid].min(), 0).astype(np.int64)
    name = next((n for n in ("REFLECTIVITY", "SIGNAL") if n in list(frame.fields)), None)
    brightness = None if name is None else np.array(frame.field(name), np.float32).ravel()
    ring = np.repeat(np.arange(rows, dtype=np.uint16), columns)
    return Cloud(points.reshape(-1, 3), brightness, ring, np.tile(late, rows))


def clock_offset(offsets: Sequence[int]) -> int:
    """Nanoseconds from the host's clock to the LiDAR's, of some frames; 0 without Unix time."""
    offset = int(np.median(offsets)) if offsets else 0
    return offset if abs(offset) < _SAME_CLOCK else 0


@lru_cache(maxsize=8)
def sensor_info(metadata: str, source: str) -> Any:
    """What the metadata of a LiDAR tells; ``source`` names it in errors."""
    core = _sdk("packets in bags").core
    try:
        return core.SensorInfo(metadata)
    except Exception as error:  # the SDK raises RuntimeError, ValueError and its own
        raise DatasetError(
            f"{source} is no metadata of an Ouster ({error}); copy it again"
        ) from error


def _sdk(what: str) -> Any:
    needs = f"Ouster {what} need ouster-sdk, by itself (it wants another rosbags than bags do)"
    return extra("ouster.sdk", needs, "ouster")


def _open_source(path: Path, metadata: Path) -> Any:
    sdk = _sdk("captures")
    try:
        source = sdk.open_source(str(path), index=True, meta=[str(metadata)])
    except Exception as error:  # the SDK raises RuntimeError, ValueError and its own
        raise DatasetError(
            f"{path} with {metadata} is no capture that ouster-sdk opens ({error}); copy both again"
        ) from error
    if len(source.sensor_info) != 1:
        raise DatasetError(
            f"{path} holds {len(source.sensor_info)} LiDARs; docdepth reads captures of one"
        )
    return source


def _frame(source: Any, index: int, where: str) -> Any:
    try:
        (frame,) = source[index]
    except Exception as error:
        raise DatasetError(f"{where} cannot be decoded ({error}); copy the capture again") from None
    return frame


def _open(path: Path, image_size: tuple[int, int] | None) -> Recording:
    settings = read_settings(path, OusterSettings)
    file = settings.file
    metadata = file.parent / settings.metadata if settings.metadata else _metadata_of(path, file)
    if not metadata.is_file():
        raise DatasetError(f"{metadata} is missing; say metadata: FILE in {file}")
    capture = OusterCapture(path, metadata)
    poses = settings.poses_at(capture.stream.times)
    if settings.sensor_origin is None:
        settings = settings.model_copy(update={"sensor_origin": (0.0, 0.0, capture.height)})
    return Recording("ouster", path, [capture], {}, poses, settings)


def _metadata_of(path: Path, file: Path) -> Path:
    """The JSON beside a capture whose name is the longest that the capture's begins with."""
    beside = files_of(path.parent, ".json")
    fitting = [one for one in beside if path.stem.startswith(one.stem)]
    if not fitting:
        listed = ", ".join(one.name for one in beside) or "none"
        raise DatasetError(
            f"{path} has no metadata of its name beside it (JSON files there: {listed}); say "
            f"metadata: FILE in {file}"
        )
    return max(fitting, key=lambda one: len(one.stem))


def _recognises(path: Path) -> bool:
    """A capture with JSON beside it; others are Velodyne's."""
    is_capture = path.suffix.lower() == ".pcap" and path.is_file()
    return is_capture and bool(files_of(path.parent, ".json"))


FORMAT = Format("ouster", "an Ouster capture .pcap with its metadata .json", _recognises, _open)
