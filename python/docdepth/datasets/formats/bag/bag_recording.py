"""Recordings in ROS 1, ROS 2 and MCAP bags, without ROS."""

from __future__ import annotations

import logging
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from docdepth.datasets.base import CameraStream, ImageStream, LidarStream
from docdepth.datasets.cloud import Cloud
from docdepth.datasets.format import Format
from docdepth.datasets.formats.bag.bag_camera import BagRig, camera_name
from docdepth.datasets.formats.bag.bag_file import SUFFIXES, BagFile, Message, bag_files
from docdepth.datasets.formats.bag.bag_odometry import Body, read_bag_poses
from docdepth.datasets.formats.bag.bag_transforms import still_transforms
from docdepth.datasets.formats.bag.ros_frames import TRANSFORMS, StaticFrames
from docdepth.datasets.formats.bag.ros_images import IMAGES
from docdepth.datasets.formats.bag.ros_points import is_hesai, reader_of, undecoded
from docdepth.datasets.formats.pcap.hesai import read_angles
from docdepth.datasets.recording import Recording
from docdepth.datasets.settings import (
    CameraSettings,
    Numbers,
    RecordingSettings,
    Strict,
    read_settings,
    transform,
)
from docdepth.errors import CalibrationError, DatasetError

log = logging.getLogger(__name__)


class BagLidarSettings(Strict):
    """A topic of points.

    Attributes
    ----------
    T_lidar_sensor : list of float, optional
        Takes its points to the frame of the first LiDAR; from the static transforms if left out.
    angles : str, optional
        Of packets of a Hesai, see :func:`~.hesai.read_angles`.
    """

    T_lidar_sensor: Numbers | None = None
    angles: str | None = None


class BagSettings(RecordingSettings):
    """What ``docdepth.yaml`` beside a bag may say.

    Attributes
    ----------
    lidars : dict
        Topics of points, the first of which gives stamps and frame. Needed where there are several.
    cameras : dict
        By topic of images, what the bag lacks.
    stamps : {"header", "record"}
        Which times count: of the messages' headers, or of their recording.
    odometry_frame : str, optional
        The frame whose place the topic ``poses`` tells, where its messages do not name it.
    T_odometry_lidar : list of float, optional
        Takes points of the first LiDAR to the frame whose place the topic ``poses`` tells; from the
        static transforms if left out.
    """

    lidars: dict[str, BagLidarSettings | None] = Field(default_factory=dict)
    cameras: dict[str, CameraSettings] = Field(default_factory=dict)
    stamps: Literal["header", "record"] = "header"
    odometry_frame: str | None = None
    T_odometry_lidar: Numbers | None = None


@dataclass(frozen=True)
class BagLidar:
    """A topic of points.

    Attributes
    ----------
    bag : BagFile
    stream : LidarStream
    messages : list of Message
        In the order of their stamps.
    angles : ndarray of float64, shape (32, 2), optional
        Of a Hesai's lasers, see :func:`~.ros_points.reader_of`.
    """

    bag: BagFile
    stream: LidarStream
    messages: list[Message]
    angles: NDArray[np.float64] | None = None

    def read(self, index: int) -> Cloud:
        """Own sweep ``index``."""
        topic = self.stream.name
        where = f"{self.bag.path}, {topic} (frame {index})"
        message = self.bag.read(topic, self.messages[index], where)
        read = reader_of(self.bag.topics[topic], self.angles)
        assert read is not None
        try:
            return read(message, where)
        except AttributeError as error:  # the bag defines its messages, and may be damaged there
            raise DatasetError(
                f"{where}: it is no {self.bag.topics[topic]} ({error}); record it again"
            ) from None

    def files(self, index: int) -> list[Path]:
        """All files of the bag."""
        return list(self.bag.files)


def _open(path: Path, image_size: tuple[int, int] | None) -> Recording:
    """A bag with points, and perhaps images, CameraInfo and static transforms."""
    settings = read_settings(path, BagSettings)
    bag = BagFile(path)
    topics = _lidar_topics(bag, settings)
    images = [topic for topic, kind in bag.topics.items() if kind in IMAGES]
    index = bag.index([*topics, *images])
    static = [t for t, k in bag.topics.items() if k == TRANSFORMS and t.endswith("tf_static")]
    messages = (message for topic in static for message in bag.read_all(topic))
    frames = StaticFrames(messages, partial(still_transforms, bag))
    lidars = _lidars(bag, topics, index, settings, frames)
    lidars[0], poses = _with_poses(lidars[0], settings, frames)
    rig = BagRig(bag, frames, lidars[0].messages[0].frame, settings.file)
    streams = _cameras(rig, images, index, lidars[0].stream, settings)
    cameras = {n: s for n, s in streams.items() if isinstance(s, CameraStream)}
    uncalibrated = {n: s for n, s in streams.items() if isinstance(s, ImageStream)}
    return Recording("bag", path, lidars, cameras, poses, settings, uncalibrated=uncalibrated)


def _lidars(
    bag: BagFile,
    topics: Sequence[str],
    index: dict[str, list[Message]],
    settings: BagSettings,
    frames: StaticFrames,
) -> list[BagLidar]:
    lidars: list[BagLidar] = []
    file = settings.file
    for topic in topics:
        if not index[topic]:
            raise DatasetError(f"{bag.path}, {topic}: there is no message; record the topic again")
        messages, times = in_order(index[topic], topic, settings.stamps, file, bag.path)
        T, given = np.eye(4), settings.lidars.get(topic) or BagLidarSettings()
        if lidars:
            first = lidars[0].messages[0].frame
            T = _place(given, frames, first, messages[0].frame, f"{file}, {topic}")
        names = [str(time) for time in times.tolist()]
        angles = _angles(given, bag.topics[topic], topic, file)
        lidars.append(BagLidar(bag, LidarStream(topic, times, names, T), messages, angles))
    return lidars


def _angles(
    given: BagLidarSettings, kind: str, topic: str, file: Path
) -> NDArray[np.float64] | None:
    """Those of the lasers of a Hesai, where the user has its file."""
    if given.angles is None:
        return None
    if not is_hesai(kind):
        raise DatasetError(
            f"{file}, {topic}: angles are those of a Hesai's lasers, but the topic holds {kind}; "
            "leave them out"
        )
    return read_angles(file.parent / given.angles)


def _with_poses(
    lidar: BagLidar, settings: BagSettings, frames: StaticFrames
) -> tuple[BagLidar, NDArray[np.float64] | None]:
    """The first LiDAR, and the poses of its sweeps; without sweeps that the topic lacks."""
    wanted, file = settings.poses, settings.file
    if not wanted or (file.parent / wanted).is_file() or not wanted.startswith("/"):
        return lidar, settings.poses_at(lidar.stream.times)
    T = settings.T_odometry_lidar
    body = Body(
        frames,
        lidar.messages[0].frame,
        settings.odometry_frame and settings.odometry_frame.lstrip("/"),
        None if T is None else transform(T, f"{file}: T_odometry_lidar"),
        str(file),
    )
    told = read_bag_poses(lidar.bag, wanted, settings.stamps == "record", body)
    stream = lidar.stream
    inside, poses = told.at(stream.times, str(lidar.bag.path))
    kept = np.flatnonzero(inside)
    names = [stream.names[k] for k in kept]
    part = LidarStream(stream.name, stream.times[kept], names, stream.T_lidar_sensor)
    return replace(lidar, stream=part, messages=[lidar.messages[k] for k in kept]), poses


def _cameras(
    rig: BagRig,
    topics: Sequence[str],
    index: dict[str, list[Message]],
    lidar: LidarStream,
    settings: BagSettings,
) -> dict[str, CameraStream | ImageStream]:
    unknown = sorted(settings.cameras.keys() - set(topics))
    if unknown:
        raise DatasetError(
            f"{rig.file}: {rig.bag.path} has no images of {unknown[0]}; there are "
            f"{', '.join(topics) or 'none'}"
        )
    cameras: dict[str, CameraStream | ImageStream] = {}
    for topic in topics:
        if not index[topic]:
            continue
        messages, times = in_order(index[topic], topic, settings.stamps, rig.file, rig.bag.path)
        name = camera_name(topic, topics)
        stream = rig.open_camera(name, topic, messages, times, settings.cameras.get(topic))
        if stream is not None:
            _check_clocks(lidar, topic, times, rig)
            cameras[name] = stream
    return cameras


def in_order(
    messages: Sequence[Message],
    topic: str,
    stamps: Literal["header", "record"],
    file: Path,
    path: Path,
) -> tuple[list[Message], NDArray[np.int64]]:
    """Messages by their stamps, and nanoseconds of each, strictly increasing.

    Parameters
    ----------
    messages : sequence of Message
    topic : str
    stamps : {"header", "record"}
        Which times count.
    file : Path
        Where settings stand, for errors.
    path : Path
        The bag, for errors.

    Raises
    ------
    DatasetError
        Headers have no stamps, or two messages have one stamp.
    """
    if stamps == "record":
        return list(messages), _distinct([m.recorded for m in messages], topic, path, file)
    if messages and not any(m.stamp for m in messages):
        raise DatasetError(
            f"{path}, {topic}: headers have no stamps; say stamps: record in {file} to take the "
            "times of recording"
        )
    ordered = sorted(messages, key=lambda m: m.stamp)
    return ordered, _distinct([m.stamp for m in ordered], topic, path, file)


def _distinct(times: list[int], topic: str, path: Path, file: Path) -> NDArray[np.int64]:
    found = np.array(times, np.int64)
    twice = np.flatnonzero(np.diff(found) <= 0)
    if len(twice):
        k = int(twice[0])
        raise DatasetError(
            f"{path}, {topic}: frames {k} and {k + 1} have one stamp, {found[k]} ns"
            f"{f', and {len(twice) - 1} more' if len(twice) > 1 else ''}; record the topic once, "
            f"or say stamps: record in {file}"
        )
    return found


def _lidar_topics(bag: BagFile, settings: BagSettings) -> list[str]:
    """The topics of points that make the sweeps."""
    file = settings.file
    readable = [topic for topic, kind in bag.topics.items() if reader_of(kind)]
    if settings.lidars:
        for topic in settings.lidars:
            if topic not in readable:
                raise DatasetError(
                    f"{file}: {bag.path} has no points of {topic}; there are "
                    f"{', '.join(readable) or 'none'}"
                )
        return list(settings.lidars)
    if len(readable) == 1:
        return readable
    if readable:
        listed = ", ".join(f"{topic} ({bag.topics[topic]})" for topic in readable)
        raise DatasetError(
            f"{bag.path} has several topics of points: {listed}; say which in {file}, for example "
            f"lidars: {{{readable[0]}: }}"
        )
    packets = {topic: what for topic, kind in bag.topics.items() if (what := undecoded(kind))}
    if packets:
        raise DatasetError(
            f"{bag.path}, {', '.join(packets)}: docdepth does not decode "
            f"{next(iter(packets.values()))}; record PointCloud2, or decode them with the driver "
            "of the LiDAR"
        )
    raise DatasetError(
        f"{bag.path} has no points (PointCloud2, Livox CustomMsg, VelodyneScan or PandarScan); its "
        f"topics are {', '.join(bag.topics) or 'none'}"
    )


def _place(
    given: BagLidarSettings, frames: StaticFrames, first: str, own: str, where: str
) -> NDArray[np.float64]:
    """``T_lidar_sensor`` of another LiDAR than the first."""
    if given.T_lidar_sensor is not None:
        return transform(given.T_lidar_sensor, f"{where}: T_lidar_sensor")
    T = frames.between(first, own)
    if T is None:
        raise CalibrationError(
            f"{where}: no static transform connects the frames {own!r} and {first!r}; say "
            "T_lidar_sensor"
        )
    return T


def _check_clocks(lidar: LidarStream, topic: str, times: NDArray[np.int64], rig: BagRig) -> None:
    if times[-1] < lidar.times[0] or times[0] > lidar.times[-1]:
        log.warning(
            "%s: stamps of %s (%.3f to %.3f s) and %s (%.3f to %.3f s) are on different clocks; "
            "say stamps: record in %s to take the times of recording",
            rig.bag.path, lidar.name, lidar.times[0] * 1e-9, lidar.times[-1] * 1e-9,
            topic, times[0] * 1e-9, times[-1] * 1e-9, rig.file,
        )  # fmt: skip


def _recognises(path: Path) -> bool:
    if path.is_file():
        return path.suffix in SUFFIXES
    if not path.is_dir():
        return False
    files = bag_files(path)
    if (path / "metadata.yaml").is_file() or len(files) <= 1:
        return bool(files)
    # Parts of one bag are counted; other bags beside each other are recordings of their own.
    numbers = [re.search(r"_(\d+)$", file.stem) for file in files]
    counted = sorted(int(number[1]) for number in numbers if number)
    return counted == list(range(len(files)))


FORMAT = Format(
    "bag",
    "a ROS 1, ROS 2 or MCAP bag (.bag, .mcap, .db3, or the folder of a rosbag2)",
    _recognises,
    _open,
)
