"""Captures (``.pcap``) of LiDARs whose packets tell their azimuth: cut into revolutions."""

from __future__ import annotations

import logging
import re
import struct
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.base import LidarStream
from docdepth.datasets.cloud import Cloud
from docdepth.datasets.files import extra, unreadable
from docdepth.datasets.kitti_files import check_increasing
from docdepth.datasets.recording import Recording
from docdepth.datasets.settings import RecordingSettings
from docdepth.errors import DatasetError
from docdepth.io.untrusted import open_file

log = logging.getLogger(__name__)

_LITTLE_ENDIAN = (b"\xd4\xc3\xb2\xa1", b"\x4d\x3c\xb2\xa1")  # begin of a capture
_RAW = 101  # link type of IP alone, which BSD numbers otherwise
_HEADER = 16  # bytes before each packet: seconds, fraction, bytes that are kept, bytes sent
_HEAD = 1 << 16  # bytes of a capture that show whose it is
_TURN = 36000  # hundredths of a degree
_UDP_HEADER = 8  # bytes
_SPLIT = "pieces of packets that the network has split (IP fragments)"
_CUT = "packets of which the capture holds the beginning alone"
_LOSSES = {
    _SPLIT: "record again with an MTU of 1500 bytes from the LiDAR to the computer",
    _CUT: "record again and keep all bytes of a packet (tcpdump -s 0)",
}
_WHOLE = 0.5  # of the usual number of packets; shorter sweeps at the ends were cut off


class Decode(Protocol):
    """Makes the points of a revolution of its packets; their times are seconds after ``stamp``.

    ``stamps`` are nanoseconds at which packets arrived, ``stamp`` those of the sweep, and ``where``
    names file and frame.
    """

    def __call__(
        self, packets: Sequence[bytes], stamps: Sequence[int], stamp: int, where: str
    ) -> Cloud: ...


class Packets(NamedTuple):
    """The packets of points of a maker."""

    maker: str
    size: int  # bytes; other packets are of another kind
    azimuth: int  # where the azimuth of the first block stands, hundredths of a degree in two bytes


class PacketCapture:
    """The sweeps of a capture, each a revolution that begins behind.

    Stamps are when the first packet of a sweep arrived.
    """

    def __init__(self, path: Path, kind: Packets, decode: Decode) -> None:
        self.path, self._kind, self._decode = path, kind, decode
        arrived, self._offsets, azimuths = _scan(path, kind)
        turned = (azimuths.astype(np.int64) + _TURN // 2) % _TURN
        begins = np.flatnonzero(np.diff(turned, prepend=turned[0] + _TURN) < -_TURN // 2)
        ends = np.append(begins[1:], len(arrived))
        usual = float(np.median(ends - begins))
        whole = ends - begins >= _WHOLE * usual
        whole[1:-1] = True
        if not whole.all():
            log.info("%s: %d partial sweeps at its ends are left out", path, (~whole).sum())
        self._parts = list(zip(begins[whole].tolist(), ends[whole].tolist(), strict=True))
        self._arrived = arrived
        times = arrived[begins[whole]]
        names = [str(time) for time in times.tolist()]
        check_increasing(times, names, path)
        self.stream = LidarStream(kind.maker.lower(), times, names)

    def read(self, index: int) -> Cloud:
        """Own sweep ``index``."""
        begin, end = self._parts[index]
        packets = []
        try:
            with open_file(self.path) as stream:
                for offset in self._offsets[begin:end].tolist():
                    stream.seek(offset)
                    packets.append(stream.read(self._kind.size))
        except OSError as error:
            raise unreadable(self.path, "put the capture back", error) from None
        stamps = self._arrived[begin:end].tolist()
        return self._decode(packets, stamps, stamps[0], f"{self.path} (frame {index})")

    def files(self, index: int) -> list[Path]:
        """The capture."""
        return [self.path]


def begins_with(path: Path, packet: re.Pattern[bytes]) -> bool:
    """Whether a capture holds such a packet near its beginning."""
    with open_file(path) as stream:
        return packet.search(stream.read(_HEAD)) is not None


def recording_of(capture: PacketCapture, settings: RecordingSettings) -> Recording:
    """A capture with the poses and options that its ``docdepth.yaml`` tells."""
    stream = capture.stream
    poses = settings.poses_at(stream.times)
    return Recording(stream.name, capture.path, [capture], {}, poses, settings)


def _scan(
    path: Path, kind: Packets
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.uint16]]:
    """Arrival (ns), place in the file and azimuth of each packet."""
    losses = Counter[str]()
    found = list(_packets(path, kind, losses))
    if not found and losses:
        (loss, count), *_ = losses.most_common(1)
        raise DatasetError(
            f"{path} holds no whole packets of a {kind.maker}, but {count} {loss}; {_LOSSES[loss]}"
        )
    if not found:
        raise DatasetError(
            f"{path} holds no packets of a {kind.maker} (UDP of {kind.size} bytes); for an Ouster "
            "put its metadata .json beside it"
        )
    sources = {source for *_, source in found}
    if len(sources) > 1:
        raise DatasetError(
            f"{path} holds packets of {len(sources)} LiDARs; keep those of one, for example by "
            "tcpdump -r IN -w OUT src host ADDRESS, or port PORT"
        )
    arrived, offsets, azimuths, _ = zip(*found, strict=True)
    return np.array(arrived, np.int64), np.array(offsets, np.int64), np.array(azimuths, np.uint16)


def _packets(
    path: Path, kind: Packets, losses: Counter[str]
) -> Iterator[tuple[int, int, int, bytes]]:
    """Arrival, place, azimuth and sender of each packet of points; those in pieces are counted."""
    dpkt = extra("dpkt", "captures of packets need dpkt", "velodyne")
    with open_file(path) as stream:
        try:
            reader = dpkt.pcap.Reader(stream)
        except (ValueError, dpkt.dpkt.Error) as error:
            raise DatasetError(
                f"{path} is no pcap capture ({error}); copy it again, or convert pcapng by editcap "
                "-F pcap IN OUT"
            ) from None
        begin = stream.tell()
        while True:
            try:
                begin, before = stream.tell(), begin
                time, frame = next(reader)
                sender, packet, loss = _payload(frame, reader.datalink())
            except StopIteration:
                _warn_of_end(path, before)
                return
            except dpkt.dpkt.Error:
                continue
            if loss:
                losses[loss] += 1
            if len(packet) == kind.size and len(frame) > kind.size:
                azimuth = int.from_bytes(packet[kind.azimuth : kind.azimuth + 2], "little")
                place = stream.tell() - len(frame) + frame.rfind(packet)
                yield round(float(time) * 1e9), place, azimuth, sender


def _warn_of_end(path: Path, begin: int) -> None:
    """Log a warning if the packet that begins there, the last, is longer than the capture."""
    with open_file(path) as stream:
        order = "<" if stream.read(4) in _LITTLE_ENDIAN else ">"
        stream.seek(begin)
        rest = stream.read()
    if rest and (
        len(rest) < _HEADER or struct.unpack_from(f"{order}I", rest, 8)[0] > len(rest) - _HEADER
    ):
        log.warning(
            "%s ends within a packet: it is truncated; copy it again if there is more of it", path
        )


def _payload(frame: bytes, datalink: int) -> tuple[bytes, bytes, str]:
    """Sender, with the port to which it sends, payload of a frame, and what it has lost."""
    import dpkt

    pcap = dpkt.pcap
    layers = {
        pcap.DLT_LINUX_SLL: dpkt.sll.SLL,
        pcap.DLT_LINUX_SLL2: dpkt.sll2.SLL2,
        pcap.DLT_NULL: dpkt.loopback.Loopback,
        pcap.DLT_LOOP: dpkt.loopback.Loopback,
        **dict.fromkeys((pcap.DLT_RAW, pcap.DLT_IPV4, _RAW), dpkt.ip.IP),
    }
    layer: object = layers.get(datalink, dpkt.ethernet.Ethernet)(frame)
    sender, loss = b"", ""
    while hasattr(layer, "data"):
        if isinstance(layer, dpkt.ip.IP):
            sender += layer.src
            if layer.mf or layer.offset:
                loss = _SPLIT
        elif isinstance(layer, dpkt.udp.UDP):  # of several LiDARs behind one address
            sender += b" %d" % layer.dport
            if not loss and len(layer.data) + _UDP_HEADER < layer.ulen:
                loss = _CUT
        layer = layer.data
    assert isinstance(layer, bytes)
    return sender, layer, loss
