"""Topics of Ouster packets, each a message: a sweep is the packets of one frame."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from docdepth.datasets.cloud import Cloud
from docdepth.datasets.files import files_of, read_bytes
from docdepth.datasets.formats.bag.bag_file import BagFile, Message
from docdepth.datasets.formats.pcap.ouster import clock_offset, cloud_of_frame, sensor_info
from docdepth.errors import DatasetError

_FRAME = "os_sensor"  # of the points, as the driver names it: packets name none
_STILL_OPEN = 2  # latest frames that a packet may belong to: they arrive in any order
_WHOLE = 0.5  # of the packets of a frame; less at an end was cut off


def is_ouster(topic: str, kind: str) -> bool:
    """Whether a topic has packets of points: those of the IMU and of zones have the same type."""
    name = topic.rpartition("/")[2]
    return kind.rpartition("/")[2] == "PacketMsg" and not name.startswith(("imu", "zone"))


@dataclass(frozen=True)
class OusterPackets:
    """The packets of a topic. ``metadata`` is the JSON of the sensor, ``source`` names it."""

    bag: BagFile
    topic: str
    metadata: str
    source: str

    def frames(self) -> list[Message]:
        """The frames, as messages: ``number`` is the LiDAR's own, ``until`` when the last arrived.

        Stamps are when the first packet arrived; where the LiDAR keeps Unix time, they are moved
        to its clock.
        """
        found: list[list[int]] = []  # number, first and last arrival, packets, stamp by the LiDAR
        for arrived, number, first_column, _ in self._packets():
            known = [one for one in found[-_STILL_OPEN:] if one[0] == number]
            if known:
                known[-1][2:4] = arrived, known[-1][3] + 1
            else:
                found.append([number, arrived, arrived, 1, first_column])
        usual = sensor_info(self.metadata, self.source).format.lidar_packets_per_frame()
        for end in (0, -1):
            if found and found[end][3] < _WHOLE * usual:
                del found[end]
        if not found:
            raise DatasetError(
                f"{self.bag.path}, {self.topic} holds no frame that fits {self.source}: it is "
                "empty, or the metadata is of another sensor or session; say metadata: FILE for "
                "the topic in docdepth.yaml"
            )
        later = clock_offset([one[4] - one[1] for one in found])
        return [Message(first, n, first + later, _FRAME, last) for n, first, last, *_ in found]

    def read(self, message: Message, where: str) -> Cloud:
        """The points of a frame."""
        from ouster.sdk import core

        info = sensor_info(self.metadata, self.source)
        frame, batcher = core.LidarFrame(info), core.FrameBatcher(info)
        for _, number, _, packet in self._packets(message.recorded, message.until + 1):
            if number == message.number:
                batcher.batch(packet, frame)
        return cloud_of_frame(frame, info, where)

    def _packets(
        self, start: int | None = None, stop: int | None = None
    ) -> Iterator[tuple[int, int, int, Any]]:
        """When a packet arrived, which frame it is of, its first column's time (ns), and itself."""
        info = sensor_info(self.metadata, self.source)
        from ouster.sdk import core

        layout = core.PacketFormat(info)
        size = layout.lidar_packet_size
        for recorded, message in self.bag.each(self.topic, start, stop):
            content = np.asarray(getattr(message, "buf", ()), np.uint8)
            if len(content) - size not in (0, 1):  # older drivers add a byte
                continue
            packet = core.LidarPacket(layout)
            packet.buf[:] = content[:size]
            packet.host_timestamp = recorded
            if packet.validate(info) == core.PacketValidationFailure.NONE:
                times = layout.packet_header(core.ColHeader.TIMESTAMP, packet.buf)
                yield recorded, layout.frame_id(packet.buf), int(times[0]), packet


def open_packets(bag: BagFile, topic: str, metadata: Path | None) -> OusterPackets:
    """A topic of packets, with the metadata of a file, of its bag, or of the JSON beside it."""
    inside = topic.rpartition("/")[0] + "/metadata"
    if metadata is None and inside in bag.topics and (found := bag.read_all(inside, 1)):
        return OusterPackets(bag, topic, str(found[0].data), f"{bag.path}, {inside}")
    beside = [metadata] if metadata else files_of(bag.files[0].parent, ".json")
    if len(beside) != 1:
        raise DatasetError(
            f"{bag.path}, {topic}: the LiDAR's metadata is missing; there is no topic {inside}, "
            f"and {len(beside) or 'no'} JSON files are beside the bag; say in docdepth.yaml "
            f"lidars: {{{topic}: {{metadata: FILE}}}}"
        )
    content = read_bytes(beside[0], "name the metadata (JSON) of the LiDAR")
    return OusterPackets(bag, topic, content.decode(errors="replace"), str(beside[0]))
