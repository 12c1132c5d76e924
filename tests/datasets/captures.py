"""Writes captures of packets: Ouster's by its SDK."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
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


def write_ouster(path: Path, boot: bool = True, missing: slice = slice(0)) -> None:
    """A capture of an OS1-64 at 512 x 10; ``missing`` columns are not valid.

    The LiDAR counts since it was switched on, or Unix time 40 ms behind the host's.
    """
    pytest.importorskip("ouster.sdk")
    from ouster.sdk import core, pcap

    info = core.SensorInfo.from_default(core.LidarMode._512x10)
    info.config.udp_port_lidar, info.config.udp_port_imu = 7502, 7503
    path.with_suffix(".json").write_text(info.to_json_string())
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
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        pcap.record(packets, str(path), lidar_port=7502, imu_port=7503)


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


def write_velodyne(path: Path, packets: list[tuple[int, bytes]], sender: str = "10.0.0.1") -> None:
    """A capture of packets and the times of their arrival in ns, by dpkt."""
    dpkt = pytest.importorskip("dpkt")
    import socket

    with path.open("ab" if path.is_file() else "wb") as stream:
        writer = dpkt.pcap.Writer(stream, nano=True)
        for time, data in packets:
            udp = dpkt.udp.UDP(sport=2368, dport=2368, data=data, ulen=8 + len(data))
            ip = dpkt.ip.IP(src=socket.inet_aton(sender), dst=b"\xff" * 4, p=17, data=udp)
            ip.len = len(ip)
            ethernet = dpkt.ethernet.Ethernet(src=b"\1" * 6, dst=b"\xff" * 6, data=ip)
            writer.writepkt_time(bytes(ethernet), time / 1e9)


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
    write_velodyne(path, velodyne_drive())
    return Written(path, None, set(), clock=None, points=False)
