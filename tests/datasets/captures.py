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
