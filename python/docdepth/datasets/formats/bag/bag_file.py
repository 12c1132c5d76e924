"""ROS 1, ROS 2 and MCAP bags read through rosbags: an index of messages, any message by itself."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

from docdepth.datasets.files import OpenedOnce, extra, files_of
from docdepth.errors import DatasetError

SUFFIXES = (".bag", ".mcap", ".db3")

_MEND = "mend it with ros2 bag reindex, mcap recover or rosbag reindex, or copy it again"

# Messages of drivers, for bags that carry no definitions: rosbag2 before Iron.
_DEFINITIONS = {
    "velodyne_msgs/msg/VelodynePacket": "builtin_interfaces/Time stamp\nuint8[1206] data",
    "velodyne_msgs/msg/VelodyneScan": (
        "std_msgs/Header header\nvelodyne_msgs/VelodynePacket[] packets"
    ),
    "pandar_msgs/msg/PandarPacket": (
        "builtin_interfaces/Time stamp\nuint8[1500] data\nuint32 size"
    ),
    "pandar_msgs/msg/PandarScan": "std_msgs/Header header\npandar_msgs/PandarPacket[] packets",
    **{
        f"{package}/msg/PacketMsg": "uint8[] buf"
        for package in ("ouster_ros", "ouster_msgs", "ouster_sensor_msgs")
    },
    **{
        f"{package}/msg/{name}": text.replace("PACKAGE", package)
        for package in ("livox_ros_driver", "livox_ros_driver2", "livox_interfaces")
        for name, text in (
            (
                "CustomPoint",
                "uint32 offset_time\nfloat32 x\nfloat32 y\nfloat32 z\nuint8 reflectivity\n"
                "uint8 tag\nuint8 line",
            ),
            (
                "CustomMsg",
                "std_msgs/Header header\nuint64 timebase\nuint32 point_num\nuint8 lidar_id\n"
                "uint8[3] rsvd\nPACKAGE/CustomPoint[] points",
            ),
        )
    },
}


_MOST_UNPACKED = 256 << 20  # bytes of a chunk; recorders begin a new one after some megabytes


class Message(NamedTuple):
    """Where a message is, and what its header says."""

    recorded: int  # nanoseconds at which it was recorded
    number: int  # which of those of its topic that were recorded at this very time
    stamp: int  # nanoseconds of its header; 0 if it has none
    frame: str  # frame of its header, without a leading ``/``
    until: int = 0  # nanoseconds at which the last packet of an Ouster's frame was recorded


class BagFile:
    """A bag that is read from any thread, and opened again in another process.

    Parameters
    ----------
    path : Path
        A ``.bag``, ``.mcap`` or ``.db3`` file, or a folder: of rosbag2, or with parts of one bag.

    Attributes
    ----------
    topics : dict of str
        Type of the messages of each topic.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.files = bag_files(path)
        self._opened = OpenedOnce(partial(_open_reader, path, self.files))
        with self._opened as reader:
            self.topics = {c.topic: c.msgtype for c in reader.connections}

    def index(self, topics: Iterable[str]) -> dict[str, list[Message]]:
        """The messages of these topics in the order of their recording."""
        wanted = set(topics)
        found: dict[str, list[Message]] = {topic: [] for topic in wanted}
        if not wanted:
            return found
        with self._opened as reader:
            connections = [c for c in reader.connections if c.topic in wanted]
            for connection, recorded, raw in self._messages(reader, connections):
                known = found[connection.topic]
                number = 0
                if known and known[-1].recorded == recorded:
                    number = known[-1].number + 1
                stamp, frame = _header(raw, reader.is2)
                known.append(Message(recorded, number, stamp, frame))
        return found

    def read(self, topic: str, message: Message, where: str) -> Any:
        """A message, decoded; ``where`` names it in errors."""
        with self._opened as reader:
            connections = [c for c in reader.connections if c.topic == topic]
            at = message.recorded
            for number, (connection, _, raw) in enumerate(
                self._messages(reader, connections, at, at + 1)
            ):
                if number == message.number:
                    return self._decode(reader, raw, connection.msgtype, where)
        raise DatasetError(f"{where} has gone; copy the bag again")

    def read_all(self, topic: str, most: int | None = None) -> list[Any]:
        """All messages of a topic, or the first ones."""
        return [message for _, message in islice(self.each(topic), most)]

    def each(
        self, topic: str, start: int | None = None, stop: int | None = None
    ) -> Iterator[tuple[int, Any]]:
        """Nanoseconds of recording, and the message, one after the other."""
        with self._opened as reader:
            connections = [c for c in reader.connections if c.topic == topic]
            for connection, recorded, raw in self._messages(reader, connections, start, stop):
                yield (
                    recorded,
                    self._decode(reader, raw, connection.msgtype, f"{self.path}, {topic}"),
                )

    def _messages(
        self,
        reader: Any,
        connections: list[Any],
        start: int | None = None,
        stop: int | None = None,
    ) -> Iterator[tuple[Any, int, bytes]]:
        try:
            yield from reader.messages(connections, start=start, stop=stop)
        except DatasetError:
            raise
        except Exception as error:  # rosbags lets errors of sqlite3, lz4, zstd and struct through
            raise DatasetError(f"{self.path} is damaged ({error}); {_MEND}") from error

    def _decode(self, reader: Any, raw: bytes, kind: str, where: str) -> Any:
        try:
            return reader.deserialize(raw, kind)
        except Exception as error:
            raise DatasetError(
                f"{where}: a {kind} cannot be decoded ({error}); the bag is damaged, or holds no "
                "definition of the message"
            ) from error


def bag_files(path: Path) -> list[Path]:
    """The files of a bag."""
    if path.is_file():
        return [path]
    return files_of(path, *SUFFIXES)


def _open_reader(path: Path, files: list[Path]) -> Any:
    extra("rosbags", "bags need rosbags", "bags")
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    for file in files:
        if file.suffix not in SUFFIXES:
            raise DatasetError(f"{file}: call it {file.stem}{file.suffix.lower()}, as rosbags asks")
    _limit_chunks()
    types = get_typestore(Stores.LATEST)
    for name, text in _DEFINITIONS.items():
        types.register(get_types_from_msg(text, name))
    folder = path.is_dir() and (path / "metadata.yaml").is_file()
    for parts in ([path], files) if folder else (files,):
        # Without metadata.yaml, or with a wrong one, the files open by themselves.
        try:
            reader = AnyReader(parts, default_typestore=types)
            reader.open()
            return reader
        except UnicodeEncodeError:  # of the path
            raise
        except Exception as error:
            problem = error
    remedy = _MEND if "Profile" not in str(problem) else "docdepth reads MCAP of ROS 2 alone"
    raise DatasetError(f"{path} cannot be opened ({problem}); {remedy}") from problem


def _limit_chunks() -> None:
    """Have rosbags unpack no more of a chunk than any LiDAR or camera fills: 100 kB hold 1 GB."""
    from bz2 import BZ2Decompressor

    from lz4.frame import LZ4FrameDecompressor
    from rosbags.rosbag1 import reader
    from rosbags.rosbag2 import storage_mcap

    bz2, lz4 = partial(_unpacked, BZ2Decompressor), partial(_unpacked, LZ4FrameDecompressor)
    reader.decompressors.update(bz2=bz2, lz4=lz4)
    # Older releases of rosbags, which ouster-sdk needs, read MCAP in another way.
    if hasattr(storage_mcap, "DECOMPRESSORS"):
        zstd = partial(_unpacked, storage_mcap.zstd.ZstdDecompressor)
        storage_mcap.DECOMPRESSORS["lz4"] = lambda data, _: lz4(data)
        storage_mcap.DECOMPRESSORS["zstd"] = lambda data, _: zstd(data)


def _unpacked(decompressor: Callable[[], Any], data: bytes) -> bytes:
    parts, left, rest = list[bytes](), _MOST_UNPACKED, data
    while rest:
        stream = decompressor()
        parts.append(stream.decompress(rest, left))
        left -= len(parts[-1])
        if not stream.eof:
            raise ValueError(f"a chunk of {len(data)} bytes is cut off, or holds too much")
        rest = stream.unused_data
    return b"".join(parts)


def _header(raw: bytes, ros2: bool) -> tuple[int, str]:
    """Stamp and frame of a message that begins with a header."""
    try:
        if ros2:  # CDR: its byte order, then seconds, nanoseconds, length and text of the frame
            order = "<" if raw[1] & 1 else ">"
            seconds, nanoseconds, length = struct.unpack_from(f"{order}iII", raw, 4)
            begin = 16
        else:
            _, seconds, nanoseconds, length = struct.unpack_from("<IIII", raw)
            begin = 16
        frame = bytes(raw[begin : begin + length]).rstrip(b"\0").decode("utf-8", "replace")
    except (struct.error, IndexError):
        return 0, ""
    return seconds * 10**9 + nanoseconds, frame.lstrip("/")
