"""Captures of Velodyne LiDARs (``.pcap``), through velodyne-decoder."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.base import LidarStream
from docdepth.datasets.cloud import Cloud, cloud_from_fields
from docdepth.datasets.files import unreadable
from docdepth.datasets.format import Format
from docdepth.datasets.kitti_files import check_increasing
from docdepth.datasets.recording import Recording
from docdepth.datasets.settings import RecordingSettings, read_settings
from docdepth.errors import DatasetError, MissingExtraError
from docdepth.io.poses import read_poses

log = logging.getLogger(__name__)

_PACKET = 1206  # bytes
_AZIMUTH = slice(2, 4)  # of a packet's first block, hundredths of a degree
_TURN = 36000
_WHOLE = 0.5  # of the usual number of packets; shorter sweeps at the ends were cut off


class VelodyneCapture:
    """The sweeps of a capture, each a revolution that begins behind.

    Stamps are when the first packet of a sweep arrived.

    Parameters
    ----------
    path : Path

    Attributes
    ----------
    stream : LidarStream
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        arrived, self._offsets, azimuths = _scan(path)
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
        self.stream = LidarStream("velodyne", times, names)

    def read(self, index: int) -> Cloud:
        """Own sweep ``index``."""
        begin, end = self._parts[index]
        where = f"{self.path} (frame {index})"
        packets = []
        try:
            with self.path.open("rb") as stream:
                for offset in self._offsets[begin:end].tolist():
                    stream.seek(offset)
                    packets.append(stream.read(_PACKET))
        except OSError as error:
            raise unreadable(self.path, "put the capture back", error) from None
        stamps = self._arrived[begin:end].tolist()
        return decode_packets(packets, stamps, stamps[0], where, self.path)

    def files(self, index: int) -> list[Path]:
        """The capture."""
        return [self.path]


def decode_packets(
    packets: Sequence[bytes],
    stamps: Sequence[int],
    stamp: int,
    where: str,
    capture: Path | None = None,
) -> Cloud:
    """The points of a revolution; their times are seconds after ``stamp``.

    Parameters
    ----------
    packets : sequence of bytes
    stamps : sequence of int
        Nanoseconds at which they arrived.
    stamp : int
        Nanoseconds of the sweep.
    where : str
        File and frame, for messages.
    capture : Path, optional
        Where the calibration of an HDL-64E may be found.

    Raises
    ------
    DatasetError
        They cannot be decoded.
    MissingExtraError
        velodyne-decoder is not installed.
    """
    decoder = velodyne_decoder()
    if any(len(packet) != _PACKET for packet in packets):
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
    """The library.

    Raises
    ------
    MissingExtraError
        It is not installed.
    """
    try:
        import velodyne_decoder as library
    except ImportError:
        raise MissingExtraError(
            "Velodyne packets need velodyne-decoder: pip install 'docdepth[velodyne]'"
        ) from None
    return library


def _scan(path: Path) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.uint16]]:
    """Arrival (ns), place in the file and azimuth of each packet."""
    found = list(_packets(path))
    if not found:
        raise DatasetError(
            f"{path} holds no packets of a Velodyne (UDP of {_PACKET} bytes); for an Ouster put "
            "its metadata .json beside it"
        )
    sources = {source for *_, source in found}
    if len(sources) > 1:
        raise DatasetError(
            f"{path} holds packets of {len(sources)} LiDARs; keep those of one, for example by "
            "tcpdump -r IN -w OUT src host ADDRESS"
        )
    arrived, offsets, azimuths, _ = zip(*found, strict=True)
    return np.array(arrived, np.int64), np.array(offsets, np.int64), np.array(azimuths, np.uint16)


def _packets(path: Path) -> Iterator[tuple[int, int, int, bytes]]:
    """Arrival, place, azimuth and sender of each packet of points."""
    velodyne_decoder()
    import dpkt

    with path.open("rb") as stream:
        try:
            reader = dpkt.pcap.Reader(stream)
        except (ValueError, dpkt.dpkt.Error) as error:
            raise DatasetError(
                f"{path} is no pcap capture ({error}); copy it again, or convert pcapng by editcap "
                "-F pcap IN OUT"
            ) from None
        while True:
            try:
                time, frame = next(reader)
                sender, packet = _payload(frame, reader.datalink())
            except StopIteration:
                return
            except dpkt.dpkt.Error:
                continue
            if len(packet) == _PACKET and len(frame) > _PACKET:
                azimuth = int.from_bytes(packet[_AZIMUTH], "little")
                place = stream.tell() - len(frame) + frame.rfind(packet)
                yield round(float(time) * 1e9), place, azimuth, sender


def _payload(frame: bytes, datalink: int) -> tuple[bytes, bytes]:
    """Sender and payload of a frame."""
    import dpkt

    layer: Any
    if datalink == dpkt.pcap.DLT_LINUX_SLL:
        layer = dpkt.sll.SLL(frame)
    else:
        layer = dpkt.ethernet.Ethernet(frame)
    sender = b""
    while hasattr(layer, "data"):
        sender = getattr(layer, "src", sender) if isinstance(layer, dpkt.ip.IP) else sender
        layer = layer.data
    return sender, layer


def _open(path: Path, image_size: tuple[int, int] | None) -> Recording:
    settings, file = read_settings(path, RecordingSettings)
    capture = VelodyneCapture(path)
    poses = None
    if settings.poses:
        poses = read_poses(file.parent / settings.poses, len(capture.stream.times))
    return Recording("velodyne", path, [capture], {}, poses, settings.facts())


def _recognises(path: Path) -> bool:
    return path.suffix == ".pcap" and path.is_file()


FORMAT = Format("velodyne", "a Velodyne capture .pcap", _recognises, _open)
