"""Clouds of ROS messages: PointCloud2 of any layout, Livox CustomMsg, VelodyneScan, PandarScan."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.cloud import Cloud, cloud_from_fields
from docdepth.datasets.formats.pcap import hesai, velodyne
from docdepth.errors import DatasetError

POINT_CLOUD = "sensor_msgs/msg/PointCloud2"

ReadMessage: TypeAlias = Callable[[Any, str], Cloud]

_KINDS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""Numbers of ``sensor_msgs/PointField``."""

_DECODE_FIRST = {
    "NebulaPackets": "packets of the Nebula driver",
    "RslidarPacket": "RoboSense packets",
    "RslidarScan": "RoboSense packets",
    "InnovusionPacket": "packets of an Innovusion LiDAR",
}


def reader_of(kind: str, angles: NDArray[np.float64] | None = None) -> ReadMessage | None:
    """What turns messages of a type into clouds; None for other messages.

    ``angles`` (32, 2) are those of a Hesai's lasers, see :func:`~.hesai.decode_packets`; as
    designed if left out.
    """
    if kind == POINT_CLOUD:
        return _read_point_cloud
    name = kind.rpartition("/")[2]
    if name == "CustomMsg" and "livox" in kind:
        return _read_livox
    if is_hesai(kind):
        return partial(_read_hesai, angles=hesai.DESIGNED if angles is None else angles)
    return _read_velodyne if name == "VelodyneScan" else None


def is_hesai(kind: str) -> bool:
    """Whether messages of a type hold packets of a Hesai."""
    return kind.rpartition("/")[2] == "PandarScan"


def undecoded(kind: str) -> str | None:
    """Whose packets a type of message holds that docdepth does not decode; None for others."""
    return _DECODE_FIRST.get(kind.rpartition("/")[2])


def _read_point_cloud(message: Any, where: str) -> Cloud:
    fields = [f for f in message.fields if f.count and f.datatype in _KINDS]
    order = ">" if message.is_bigendian else "<"
    for f in fields:  # numpy adds offset and size in 32 bits, and crashes where they are too large
        if f.offset + f.count * int(_KINDS[f.datatype][1]) > message.point_step:
            raise DatasetError(
                f"{where}: the field {f.name!r} ends behind its point of {message.point_step} "
                "bytes; record it again"
            )
    try:
        dtype = np.dtype(
            {
                "names": [f.name for f in fields],
                "formats": [
                    (order + _KINDS[f.datatype], (f.count,)) if f.count > 1
                    else order + _KINDS[f.datatype]
                    for f in fields
                ],
                "offsets": [f.offset for f in fields],
                "itemsize": message.point_step,
            }
        )  # fmt: skip
    except ValueError as error:
        raise DatasetError(
            f"{where} has fields that contradict each other ({error}); record it again"
        ) from None
    width, height = message.width, message.height
    if not width or not height or not message.point_step:
        raise DatasetError(f"{where} holds no points; record it again")
    data, dense = np.asarray(message.data, np.uint8), width * message.point_step
    # Drivers get row_step wrong where it does not matter.
    step = dense if height == 1 or len(data) == height * dense else message.row_step
    if step < width * message.point_step or len(data) < height * step:
        raise DatasetError(
            f"{where} has {len(data)} bytes for {height} rows of {width} points of "
            f"{message.point_step} bytes; the message is truncated"
        )
    lines = data[: height * step].reshape(height, step)[:, : width * message.point_step]
    rows = np.ascontiguousarray(lines).reshape(-1).view(dtype)
    return cloud_from_fields(rows.astype(dtype.newbyteorder("<"), copy=False), where)


def _read_livox(message: Any, where: str) -> Cloud:
    """Livox's own message; its times count nanoseconds from ``timebase``."""
    points = message.points
    rows = np.array(
        [(p.x, p.y, p.z, p.reflectivity, p.line, p.offset_time) for p in points],
        [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("line", "u1"),
         ("offset_time", "<u4")],
    )  # fmt: skip
    return cloud_from_fields(rows, where)


def _read_velodyne(message: Any, where: str) -> Cloud:
    """Packets of one revolution, decoded by velodyne-decoder."""
    packets, stamps, stamp = _packets(message, where)
    return velodyne.decode_packets(packets, stamps, stamp, where)


def _read_hesai(message: Any, where: str, angles: NDArray[np.float64]) -> Cloud:
    packets, stamps, stamp = _packets(message, where)
    return hesai.decode_packets(packets, stamps, stamp, where, angles)


def _packets(message: Any, where: str) -> tuple[list[bytes], list[int], int]:
    """The packets of a revolution, nanoseconds at which they arrived, and those of the message."""
    if not len(message.packets):
        raise DatasetError(f"{where} holds no packets; the LiDAR or its recording failed")
    packets = [np.asarray(p.data, np.uint8).tobytes() for p in message.packets]
    return (
        packets,
        [_nanoseconds(p.stamp) for p in message.packets],
        _nanoseconds(message.header.stamp),
    )


def _nanoseconds(stamp: Any) -> int:
    return int(stamp.sec) * 10**9 + int(stamp.nanosec)
