"""Recordings in ROS 1, ROS 2 and MCAP bags, without ROS."""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.base import CameraStream, ImageStream, LidarStream
from docdepth.datasets.cloud import Cloud
from docdepth.datasets.format import Format
from docdepth.datasets.formats.bag.bag_camera import camera_name, open_camera
from docdepth.datasets.formats.bag.bag_file import SUFFIXES, BagFile, Message, bag_files
from docdepth.datasets.formats.bag.bag_frames import TRANSFORMS, StaticFrames, still_transforms
from docdepth.datasets.formats.bag.bag_poses import poses_of_topic
from docdepth.datasets.formats.bag.opened_bag import BagLidarSettings, BagSettings, OpenedBag
from docdepth.datasets.formats.bag.ouster_packets import OusterPackets, is_ouster, open_packets
from docdepth.datasets.formats.bag.ros_images import IMAGES, unread_images
from docdepth.datasets.formats.bag.ros_points import is_hesai, reader_of, undecoded
from docdepth.datasets.formats.pcap.hesai import read_angles
from docdepth.datasets.recording import Recording
from docdepth.datasets.settings import read_settings, transform
from docdepth.errors import CalibrationError, DatasetError

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class BagLidar:
    """A topic of points."""

    bag: BagFile
    stream: LidarStream
    messages: list[Message]  # in the order of their stamps
    decode: Callable[[Message, str], Cloud]  # the second names the frame in errors

    def read(self, index: int) -> Cloud:
        """Own sweep ``index``."""
        where = f"{self.bag.path}, {self.stream.name} (frame {index})"
        return self.decode(self.messages[index], where)

    def files(self, index: int) -> list[Path]:
        """All files of the bag."""
        return list(self.bag.files)


def _read(
    bag: BagFile, topic: str, angles: NDArray[np.float64] | None, message: Message, where: str
) -> Cloud:
    """The points of a message; ``angles`` as for :func:`~.ros_points.reader_of`."""
    found = bag.read(topic, message, where)
    read = reader_of(bag.topics[topic], angles)
    assert read is not None
    try:
        return read(found, where)
    except AttributeError as error:  # the bag defines its messages, and may be damaged there
        raise DatasetError(
            f"{where}: it is no {bag.topics[topic]} ({error}); record it again"
        ) from None


def _open(path: Path, image_size: tuple[int, int] | None) -> Recording:
    """A bag with points, and perhaps images, CameraInfo and static transforms."""
    settings = read_settings(path, BagSettings)
    file = BagFile(path)
    topics = _lidar_topics(file, settings)
    images = [topic for topic, kind in file.topics.items() if kind in IMAGES]
    static = [t for t, k in file.topics.items() if k == TRANSFORMS and t.endswith("tf_static")]
    messages = (message for topic in static for message in file.read_all(topic))
    frames = StaticFrames(messages, partial(still_transforms, file))
    packets = {t: _packets(file, t, settings) for t in topics if is_ouster(t, file.topics[t])}
    index = file.index([*(topic for topic in topics if topic not in packets), *images])
    index.update({topic: one.frames() for topic, one in packets.items()})
    bag = OpenedBag(file, settings, frames, index)
    lidars = _lidars(bag, topics, packets)
    lidars[0], poses = _with_poses(lidars[0], bag)
    streams = _cameras(bag, images, lidars[0])
    cameras = {n: s for n, s in streams.items() if isinstance(s, CameraStream)}
    uncalibrated = {n: s for n, s in streams.items() if isinstance(s, ImageStream)}
    return Recording("bag", path, lidars, cameras, poses, settings, uncalibrated=uncalibrated)


def _packets(file: BagFile, topic: str, settings: BagSettings) -> OusterPackets:
    given = settings.lidars.get(topic) or BagLidarSettings()
    metadata = settings.file.parent / given.metadata if given.metadata else None
    return open_packets(file, topic, metadata)


def _lidars(
    bag: OpenedBag, topics: Sequence[str], packets: Mapping[str, OusterPackets]
) -> list[BagLidar]:
    lidars: list[BagLidar] = []
    file = bag.settings.file
    for topic in topics:
        if not bag.index[topic]:
            raise DatasetError(f"{bag.path}, {topic}: there is no message; record the topic again")
        messages, times = bag.in_order(topic)
        T, given = np.eye(4), bag.settings.lidars.get(topic) or BagLidarSettings()
        if lidars:
            first = lidars[0].messages[0].frame
            T = _place(given, bag.frames, first, messages[0].frame, f"{file}, {topic}")
        angles, kind = None, bag.file.topics[topic]
        if given.angles is not None:
            if not is_hesai(kind):
                raise DatasetError(
                    f"{file}, {topic}: angles are those of a Hesai's lasers, but the topic holds "
                    f"{kind}; leave them out"
                )
            angles = read_angles(file.parent / given.angles)
        stream = LidarStream(topic, times, [str(time) for time in times.tolist()], T)
        decode = partial(_read, bag.file, topic, angles)
        of_frames = packets[topic].read if topic in packets else decode
        lidars.append(BagLidar(bag.file, stream, messages, of_frames))
    return lidars


def _with_poses(lidar: BagLidar, bag: OpenedBag) -> tuple[BagLidar, NDArray[np.float64] | None]:
    """The first LiDAR, and the poses of its sweeps; without sweeps that the topic lacks."""
    wanted, file, stream = bag.settings.poses, bag.settings.file, lidar.stream
    if not wanted or (file.parent / wanted).is_file() or not wanted.startswith("/"):
        return lidar, bag.settings.poses_at(stream.times)
    inside, poses = poses_of_topic(bag, wanted, lidar.messages[0].frame, stream.times)
    kept = np.flatnonzero(inside)
    part = replace(stream, times=stream.times[kept], names=[stream.names[k] for k in kept])
    return replace(lidar, stream=part, messages=[lidar.messages[k] for k in kept]), poses


def _cameras(
    bag: OpenedBag, topics: Sequence[str], lidar: BagLidar
) -> dict[str, CameraStream | ImageStream]:
    file = bag.settings.file
    for topic, kind in bag.file.topics.items():
        if unread_images(kind):
            log.warning(
                "%s, %s holds images as %s, which docdepth does not read, and is left out; convert "
                "them to %s, or record JPEG, PNG or raw images",
                bag.path, topic, kind, IMAGES[1],
            )  # fmt: skip
    unknown = sorted(bag.settings.cameras.keys() - set(topics))
    if unknown:
        raise DatasetError(
            f"{file}: {bag.path} has no images of {unknown[0]}; there are "
            f"{', '.join(topics) or 'none'}"
        )
    cameras: dict[str, CameraStream | ImageStream] = {}
    topics = [topic for topic in topics if bag.index[topic]]
    twins = {raw: twin for raw in topics if (twin := f"{raw}/compressed") in topics}
    twins = {r: t for r, t in twins.items() if not {r, t} & bag.settings.cameras.keys()}
    distinct = [topic for topic in topics if topic not in twins.values()]
    # Whichever of raw and compressed images was recorded more often is the camera.
    for topic in _by_count(topics, twins, bag):
        raw = next((r for r, t in twins.items() if topic in (r, t)), topic)
        messages, times = bag.in_order(topic)
        name = camera_name(raw, distinct)
        if name in cameras:
            log.info("%s, %s: the same images as of camera %s are left out", bag.path, topic, name)
            continue
        stream = open_camera(bag, name, topic, messages, times, lidar.messages[0].frame)
        if stream is None:
            continue
        cameras[name] = stream
        sweeps = lidar.stream.times
        if times[-1] < sweeps[0] or times[0] > sweeps[-1]:
            log.warning(
                "%s: stamps of %s (%.3f to %.3f s) and %s (%.3f to %.3f s) are on different "
                "clocks; say stamps: record in %s to take the times of recording",
                bag.path, lidar.stream.name, sweeps[0] * 1e-9, sweeps[-1] * 1e-9,
                topic, times[0] * 1e-9, times[-1] * 1e-9, file,
            )  # fmt: skip
    return cameras


def _by_count(topics: Sequence[str], twins: Mapping[str, str], bag: OpenedBag) -> list[str]:
    """Topics in their order; of raw and compressed images those that are more come first."""
    ordered = list[str]()
    for topic in topics:
        if topic not in twins.values():
            both = [topic, *([twins[topic]] if topic in twins else [])]
            ordered += sorted(both, key=lambda one: -len(bag.index[one]))
    return ordered


def _lidar_topics(bag: BagFile, settings: BagSettings) -> list[str]:
    """The topics of points that make the sweeps."""
    file = settings.file
    readable = [topic for topic, kind in bag.topics.items() if reader_of(kind)]
    ouster = [topic for topic, kind in bag.topics.items() if is_ouster(topic, kind)]
    if settings.lidars:
        for topic in settings.lidars:
            if topic not in (*readable, *ouster):
                raise DatasetError(
                    f"{file}: {bag.path} has no points of {topic}; there are "
                    f"{', '.join([*readable, *ouster]) or 'none'}"
                )
        return list(settings.lidars)
    readable = readable or ouster  # many record packets beside the points made of them
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
        f"{bag.path} has no points (PointCloud2, Livox CustomMsg, VelodyneScan, PandarScan or "
        f"Ouster's PacketMsg); its topics are {', '.join(bag.topics) or 'none'}"
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


def _recognises(path: Path) -> bool:
    if path.is_file():
        return path.suffix.lower() in SUFFIXES
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
