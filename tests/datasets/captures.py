"""Writes captures of packets: Ouster's by its SDK."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
from bags import BagWriter
from made_up import DRIVE
from writers import Written, writes

COLUMNS, ROWS = 512, 64


def microseconds(times: np.ndarray) -> np.ndarray:
    return (times + 500) // 1000 * 1000


def ouster_ranges(k: int) -> np.ndarray:
    """Millimetres, (64, 512); every seventh pixel has no return."""
    rng = np.random.default_rng(k)
    ranges = rng.integers(4000, 9000, (ROWS, COLUMNS))
    ranges.ravel()[::7] = 0
    return ranges


def ouster_packets(boot: bool, missing: slice) -> tuple[str, list]:
    """The metadata of an OS1-64 at 512 x 10, and its packets, by the SDK."""
    pytest.importorskip("ouster.sdk")
    from ouster.sdk import core

    info = core.SensorInfo.from_default(core.LidarMode._512x10)
    info.config.udp_port_lidar, info.config.udp_port_imu = 7502, 7503
    packet_format = core.PacketFormat(info)
    packets = []
    for k, time in enumerate(DRIVE.times.tolist()):
        frame = core.LidarFrame(info)
        frame.frame_id = k + 1
        frame.field("RANGE")[:] = ouster_ranges(k)
        frame.field("REFLECTIVITY")[:] = ouster_ranges(k) % 200
        start = time - int(DRIVE.times[0]) + 5_000_000_000 if boot else time - 40_000_000
        frame.timestamp[:] = start + np.arange(COLUMNS) * (99_000_000 // COLUMNS)
        frame.measurement_id[:] = np.arange(COLUMNS)
        frame.status[:] = 1
        frame.status[missing] = 0
        frame.packet_timestamp[:] = time + np.arange(len(frame.packet_timestamp)) * 10**6
        packets += core.frame_to_packets(frame, packet_format, 0, 0)
    return info.to_json_string(), packets


def write_ouster(path: Path, boot: bool = True, missing: slice = slice(0)) -> None:
    """A capture of an OS1-64 at 512 x 10; ``missing`` columns are not valid.

    The LiDAR counts since it was switched on, or Unix time 40 ms behind the host's.
    """
    metadata, packets = ouster_packets(boot, missing)
    from ouster.sdk import pcap

    path.with_suffix(".json").write_text(metadata)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        pcap.record(packets, str(path), lidar_port=7502, imu_port=7503)


def write_ouster_bag(
    path: Path, kind: str, package: str = "ouster_ros", inside: bool = True, boot: bool = True
) -> None:
    """The same packets as the maker's driver records them, metadata ``inside`` or beside the bag.

    Some packets arrive after later ones, and the last frame lacks most of its packets.
    """
    metadata, packets = ouster_packets(boot, slice(0))
    from rosbags.typesys import get_types_from_msg

    arrivals = [
        int(DRIVE.times[k // 32]) + k % 32 * 3_000_000 + (8_000_000 if k % 32 in (9, 31) else 0)
        for k in range(len(packets) - 20)
    ]
    with BagWriter(path, kind) as bag:
        bag.types.register(get_types_from_msg("uint8[] buf", f"{package}/msg/PacketMsg"))
        first = int(DRIVE.times[0])
        if inside:
            text = bag.make("std_msgs/msg/String", metadata)
            bag.write("/ouster/metadata", text, first)
        else:
            path.with_suffix(".json").write_text(metadata)
        for time, k in sorted((time, k) for k, time in enumerate(arrivals)):
            message = bag.make(f"{package}/msg/PacketMsg", packets[k].buf)
            bag.write("/ouster/lidar_packets", message, time)
            bag.write("/ouster/imu_packets", message, time)


@writes("Ouster capture", "ouster")
def _ouster(root: Path) -> Written:
    path = root / "drive.pcap"
    write_ouster(path)
    return Written(path, None, set(), clock=microseconds, points=False)


# ---- Velodyne

FIRINGS = 24  # of 16 lasers in a packet of a VLP-16, two in each of twelve blocks
PACKETS = 76  # in a revolution
_FIRING_NS = 55_296


def velodyne_ranges(packet: int) -> np.ndarray:
    """In steps of 2 mm, (24, 16); every seventh has no return."""
    ranges = np.random.default_rng(packet).integers(2000, 4500, (FIRINGS, 16))
    ranges.ravel()[::7] = 0
    return ranges


def velodyne_packet(number: int) -> bytes:
    """A packet of a VLP-16 at 10 Hz, which turns clockwise and looks back at the first one."""
    packet = np.zeros(1206, np.uint8)
    blocks = packet[:1200].view(
        np.dtype(
            [("flag", "<u2"), ("azimuth", "<u2"), ("returns", [("d", "<u2"), ("i", "u1")], 32)]
        )
    )
    blocks["flag"] = 0xEEFF
    step = 36000 / (FIRINGS * PACKETS)
    azimuth = 18000 + step * (FIRINGS * number + 2 * np.arange(12))
    blocks["azimuth"] = np.round(azimuth).astype(int) % 36000
    blocks["returns"]["d"] = velodyne_ranges(number).reshape(12, 32)
    blocks["returns"]["i"] = number % 100
    packet[1200:1204] = np.array([FIRINGS * number * _FIRING_NS // 1000], "<u4").view(np.uint8)
    packet[1204:] = (0x37, 0x22)  # the strongest return, VLP-16
    return packet.tobytes()


def write_capture(
    path: Path, packets: list[tuple[int, bytes]], sender: str = "10.0.0.1", port: int = 2368
) -> None:
    """A capture of packets and the times of their arrival in ns, by dpkt."""
    dpkt = pytest.importorskip("dpkt")
    import socket

    with path.open("ab" if path.is_file() else "wb") as stream:
        writer = dpkt.pcap.Writer(stream, nano=True)
        for time, data in packets:
            udp = dpkt.udp.UDP(sport=time % 50_000, dport=port, data=data, ulen=8 + len(data))
            ip = dpkt.ip.IP(src=socket.inet_aton(sender), dst=b"\xff" * 4, p=17, data=udp)
            ip.len = len(ip)
            ethernet = dpkt.ethernet.Ethernet(src=b"\1" * 6, dst=b"\xff" * 6, data=ip)
            writer.writepkt_time(bytes(ethernet), time / 1e9)


def write_pieces(path: Path, packets: list[tuple[int, bytes]], mtu: int, kept: int) -> None:
    """A capture of packets that the network has split, ``kept`` bytes of each frame."""
    dpkt = pytest.importorskip("dpkt")
    step = (mtu - 20) // 8 * 8
    with path.open("wb") as stream:
        writer = dpkt.pcap.Writer(stream, snaplen=kept)
        for number, (time, data) in enumerate(packets):
            udp = bytes(dpkt.udp.UDP(sport=1, dport=2368, data=data, ulen=8 + len(data)))
            for begin in range(0, len(udp), step):
                piece = udp[begin : begin + step]
                ip = dpkt.ip.IP(src=b"\n\0\0\1", dst=b"\xff" * 4, p=17, id=number, data=piece)
                ip.len, ip.offset, ip.mf = 20 + len(piece), begin // 8, int(begin + step < len(udp))
                ethernet = dpkt.ethernet.Ethernet(src=b"\1" * 6, dst=b"\xff" * 6, data=ip)
                writer.writepkt_time(bytes(ethernet)[:kept], time / 1e9)


def velodyne_drive() -> list[tuple[int, bytes]]:
    """As many revolutions as the drive has, each from its stamp on, and position packets."""
    packets = []
    for k, time in enumerate(DRIVE.times.tolist()):
        for n in range(PACKETS):
            arrival = time + n * FIRINGS * _FIRING_NS
            packets.append((arrival, velodyne_packet(PACKETS * k + n)))
        packets.append((time + 99_000_000, b"\0" * 512))
    return packets


@writes("Velodyne capture", "velodyne")
def _velodyne(root: Path) -> Written:
    pytest.importorskip("velodyne_decoder")
    path = root / "drive.pcap"
    write_capture(path, velodyne_drive())
    return Written(path, None, set(), clock=None, points=False)


# ---- Hesai

HESAI_PACKETS = 50  # in a revolution of a PandarXT-32 of two returns, 4 firings each
HESAI_MM = 4


def hesai_ranges(packet: int) -> np.ndarray:
    """In steps of 4 mm, (4, 2, 32): every fifth ray returns twice alike, every seventh never."""
    ranges = np.random.default_rng(packet).integers(1000, 2200, (4, 2, 32))
    rays = np.arange(4 * 32).reshape(4, 32)
    ranges[:, 1] = np.where(rays % 5 == 0, ranges[:, 0], ranges[:, 1])
    return ranges * (rays % 7 > 0)[:, None]


def hesai_azimuths(packet: int) -> np.ndarray:
    """Hundredths of a degree, (4,); the first packet looks back."""
    return (18000 + 180 * (4 * packet + np.arange(4))) % 36000


def hesai_packet(number: int, microsecond: int) -> bytes:
    """A packet of a PandarXT-32, by the tables of its manual; ``microsecond`` is of the day."""
    head = bytes([0xEE, 0xFF, 6, 1, 0, 0, 32, 8, 1, HESAI_MM, 2, 1])
    body = b""
    for azimuth, firing in zip(hesai_azimuths(number), hesai_ranges(number), strict=True):
        for ranges in firing:
            body += int(azimuth).to_bytes(2, "little")
            for laser, steps in enumerate(ranges.tolist()):
                body += steps.to_bytes(2, "little") + bytes([laser + 100, 0])
    second, microsecond = divmod(microsecond % 86_400_000_000, 10**6)
    clock = bytes([second // 3600, second // 60 % 60, second % 60])
    tail = bytes(10) + b"\x39" + (600).to_bytes(2, "little") + bytes([124, 11, 24]) + clock
    tail += microsecond.to_bytes(4, "little") + b"\x42" + number.to_bytes(4, "little")
    return head + body + tail


def hesai_drive(midnight: int = 2) -> list[tuple[int, bytes]]:
    """As many revolutions as the drive has; midnight is in the middle of one of them."""
    packets = []
    for k, time in enumerate(DRIVE.times.tolist()):
        for n in range(HESAI_PACKETS):
            late = n * (DRIVE.period // HESAI_PACKETS) // 1000
            of_day = (time - int(DRIVE.times[midnight])) // 1000 + late - DRIVE.period // 2000
            packet = hesai_packet(HESAI_PACKETS * k + n, of_day)
            packets.append((time + late * 1000, packet))
        packets.append((time + 99_000_000, b"\0" * 512))
    return packets


@writes("Hesai capture", "hesai")
def _hesai(root: Path) -> Written:
    path = root / "drive.pcap"
    write_capture(path, hesai_drive())
    return Written(path, None, set(), clock=None, points=False)
