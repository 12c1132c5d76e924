"""Packets of the Hesai PandarXT-32, as its manual describes them; captures of them (``.pcap``)."""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.cloud import Cloud
from docdepth.datasets.files import read_lines
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

LASERS = 32
DESIGNED = np.stack([15.0 - np.arange(LASERS), np.zeros(LASERS)], axis=1)
"""Elevation and azimuth of each laser, degrees, (32, 2); a unit's own are 0.1 degrees off."""

_BLOCKS = 8
_PACKET = np.dtype(
    [
        ("magic", "S2"),
        ("version", "u1", 2),
        ("_", "V2"),
        ("lasers", "u1"),
        ("blocks", "u1"),
        ("__", "V1"),
        ("range_unit", "u1"),  # millimetres
        ("returns", "u1"),  # blocks of one firing
        ("flags", "u1"),
        (
            "block",
            [
                ("azimuth", "<u2"),  # hundredths of a degree
                ("laser", [("range", "<u2"), ("reflectivity", "u1"), ("_", "u1")], LASERS),
            ],
            _BLOCKS,
        ),
        ("tail", "V13"),
        ("date", "u1", 3),
        ("clock", "u1", 3),  # hour, minute and second at which the packet was sent
        ("microsecond", "<u4"),
        ("factory", "u1"),
        ("number", "<u4"),
    ]
)
_MAGIC = b"\xee\xff"
_BEGINNING = re.compile(rb"\xee\xff\x06...\x20\x08", re.DOTALL)  # of a packet
_KIND = Packets("Hesai", _PACKET.itemsize, 12)

# Nanoseconds: between firings, of the last one after the time of its packet, and between lasers.
_FIRING, _LAST, _LASER = 50_000, 5_632 + 368, 1_512
_DAY = 86_400_000_000  # microseconds


class HesaiSettings(RecordingSettings):
    """What ``docdepth.yaml`` beside a capture may say."""

    angles: str | None = None  # see :func:`read_angles`


def decode_packets(
    packets: Sequence[bytes],
    stamps: Sequence[int],
    stamp: int,
    where: str,
    angles: NDArray[np.float64] = DESIGNED,
) -> Cloud:
    """The points of a revolution, see :class:`~.packet_capture.Decode`; x right, y ahead, z up.

    Of two equal returns of a ray one is left out. Times are those of the LiDAR's clock, counted
    from the arrival of the first packet. ``angles`` are elevation and azimuth of each laser,
    degrees, (32, 2). What follows a packet itself is ignored.
    """
    rows = _rows(packets, where)
    returns = int(rows["returns"][0])
    firing = rows["block"].reshape(-1, returns)
    # (firing, laser, return): a ray's returns follow one another.
    laser = firing["laser"].transpose(0, 2, 1)
    ranges = laser["range"]
    kept = ranges > 0
    kept[..., 1:] &= ranges[..., 1:] != ranges[..., :1]
    number, ring, _ = np.nonzero(kept)
    metres = ranges[kept].astype(np.float64) * rows["range_unit"][0] * 1e-3
    elevation = np.radians(angles[ring, 0])
    azimuth = np.radians(firing["azimuth"][number, 0].astype(np.float64) / 100 + angles[ring, 1])
    level = metres * np.cos(elevation)
    points = [level * np.sin(azimuth), level * np.cos(azimuth), metres * np.sin(elevation)]
    start = stamps[0] - stamp + _since_first(rows)[number // (_BLOCKS // returns)]
    before = _BLOCKS // returns - 1 - number % (_BLOCKS // returns)
    late = start + _LAST - _FIRING * before + _LASER * ring
    return Cloud(
        np.stack(points, axis=1).astype(np.float32),
        laser["reflectivity"][kept].astype(np.float32),
        ring.astype(np.uint16),
        late * 1e-9,
    )


def _rows(packets: Sequence[bytes], where: str) -> NDArray[np.void]:
    """The packets as rows; all are of one PandarXT-32 that returns once or twice a ray."""
    size = _PACKET.itemsize
    if not packets or min(map(len, packets)) < size:
        raise DatasetError(f"{where} is truncated; copy it again")
    rows = np.frombuffer(b"".join(packet[:size] for packet in packets), _PACKET)
    its_own = (rows["lasers"] == LASERS) & (rows["blocks"] == _BLOCKS)
    if not (its_own & (rows["magic"] == _MAGIC)).all():
        told = f"{rows['lasers'][0]} lasers, {rows['blocks'][0]} blocks"
        if rows["magic"][0] != _MAGIC:
            told = f"they begin with {packets[0][:2].hex(' ')}"
        raise DatasetError(
            f"{where} holds packets of another LiDAR than a Hesai PandarXT-32 ({told}); record "
            "PointCloud2, or decode them with the driver of the LiDAR"
        )
    returns = sorted(set(rows["returns"].tolist()))
    if returns not in ([1], [2]):
        raise DatasetError(
            f"{where} holds packets of {returns} returns a ray, where all should be of 1 or 2; "
            "record it again"
        )
    return rows


def _since_first(rows: NDArray[np.void]) -> NDArray[np.int64]:
    """Nanoseconds by the LiDAR's clock from the first packet to each; days begin at midnight."""
    hours, minutes, seconds = rows["clock"].astype(np.int64).T
    clock = ((hours * 60 + minutes) * 60 + seconds) * 1_000_000 + rows["microsecond"]
    return (clock - clock[0] + _DAY // 2) % _DAY * 1000 - _DAY // 2 * 1000


def read_angles(file: Path) -> NDArray[np.float64]:
    """The angles of a unit's lasers, degrees, (32, 2), from the file that Hesai gives with it.

    A CSV with the columns Channel, Elevation and Azimuth, and a line for each laser.
    """
    lines = read_lines(file, "name the angle correction file (CSV) of the LiDAR")
    try:
        rows = np.array([[float(x) for x in line.split(",")[:3]] for line in lines[1:]])
        right = rows.shape == (LASERS, 3) and (rows[:, 0] == np.arange(1, LASERS + 1)).all()
    except ValueError:
        right = False
    if not right or not (np.abs(rows[:, 1:] - DESIGNED) < 5).all():
        raise DatasetError(
            f"{file} does not have the angles of a PandarXT-32: a line Channel,Elevation,Azimuth, "
            f"then {LASERS} lines such as 1,14.97,0.08 in degrees"
        )
    return rows[:, 1:]


def _open(path: Path, image_size: tuple[int, int] | None) -> Recording:
    settings = read_settings(path, HesaiSettings)
    angles = read_angles(settings.file.parent / settings.angles) if settings.angles else DESIGNED
    capture = PacketCapture(path, _KIND, partial(decode_packets, angles=angles))
    return recording_of(capture, settings)


def _recognises(path: Path) -> bool:
    if path.suffix.lower() != ".pcap" or not path.is_file():
        return False
    return begins_with(path, _BEGINNING)


FORMAT = Format("hesai", "a capture .pcap of a Hesai PandarXT-32", _recognises, _open)
