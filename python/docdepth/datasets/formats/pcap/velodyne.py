"""Captures of Velodyne LiDARs (``.pcap``), through velodyne-decoder."""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from docdepth.datasets.cloud import Cloud, cloud_from_fields
from docdepth.datasets.files import extra, files_of
from docdepth.datasets.format import Format
from docdepth.datasets.formats.pcap.packet_capture import (
    PacketCapture,
    Packets,
    begins_with,
    recording_of,
)
from docdepth.datasets.recording import Recording
from docdepth.datasets.settings import RecordingSettings, read_settings
from docdepth.errors import DatasetError

_KIND = Packets("Velodyne", 1206, 2)
_BLOCKS = re.compile(rb"(?:\xff[\xee\xdd].{98}){12}", re.DOTALL)  # of a packet


def decode_packets(
    packets: Sequence[bytes],
    stamps: Sequence[int],
    stamp: int,
    where: str,
    capture: Path | None = None,
) -> Cloud:
    """The points of a revolution, see :class:`~.packet_capture.Decode`.

    ``capture`` is where the calibration of an HDL-64E may be found.
    """
    decoder = velodyne_decoder()
    if any(len(packet) != _KIND.size for packet in packets):
        raise DatasetError(f"{where} is truncated; copy it again")
    config = decoder.Config()
    try:
        if capture is not None:
            config.model, config.calibration = _hdl64(capture)
        vector = decoder.PacketVector(
            [
                decoder.VelodynePacket(time * 1e-9, packet)
                for time, packet in zip(stamps, packets, strict=True)
            ]
        )
        _, rows = decoder.ScanDecoder(config).decode(vector, True)
    except (RuntimeError, ValueError) as error:
        raise DatasetError(f"{where} holds packets that cannot be decoded ({error})") from None
    cloud = cloud_from_fields(rows, where)
    # The decoder counts from the last packet.
    seconds = rows["time"].astype(np.float64) + (stamps[-1] - stamp) * 1e-9
    return Cloud(cloud.points, cloud.intensity, cloud.ring, seconds)


@lru_cache(maxsize=8)
def _hdl64(capture: Path) -> tuple[Any, Any]:
    """Model and calibration of an HDL-64E, which sends them among its points; None of others."""
    found: tuple[Any, Any] = velodyne_decoder().hdl64e.detect_hdl64e(str(capture))
    return found


def velodyne_decoder() -> Any:
    """The library; an error tells what to install."""
    return extra("velodyne_decoder", "Velodyne packets need velodyne-decoder", "velodyne")


def _open(path: Path, image_size: tuple[int, int] | None) -> Recording:
    settings = read_settings(path, RecordingSettings)
    velodyne_decoder()  # tells what to install before the capture is searched
    capture = PacketCapture(path, _KIND, partial(decode_packets, capture=path))
    return recording_of(capture, settings)


def _recognises(path: Path) -> bool:
    """A capture whose packets look like Velodyne's, or that is nobody else's."""
    if path.suffix.lower() != ".pcap" or not path.is_file():
        return False
    return begins_with(path, _BLOCKS) or not files_of(path.parent, ".json")


FORMAT = Format("velodyne", "a Velodyne capture .pcap", _recognises, _open)
