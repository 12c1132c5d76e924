"""Captures of packets: what the LiDAR measured comes back, at its times."""

from __future__ import annotations

import re
import struct
from pathlib import Path

import numpy as np
import pytest
import yaml
from captures import (
    COLUMNS,
    FIRINGS,
    HESAI_MM,
    HESAI_PACKETS,
    PACKETS,
    ROWS,
    hesai_azimuths,
    hesai_drive,
    hesai_packet,
    hesai_ranges,
    ouster_ranges,
    velodyne_drive,
    velodyne_ranges,
    write_capture,
    write_ouster,
    write_ouster_bag,
    write_pieces,
)
from conformance import check
from made_up import DRIVE

from docdepth.datasets import open_dataset, usable_points
from docdepth.datasets.formats.pcap import hesai
from docdepth.errors import DatasetError


def test_points_of_an_ouster(tmp_path: Path) -> None:
    """Ranges from the centre of its lasers, rings and times of columns."""
    write_ouster(tmp_path / "drive.pcap")
    dataset = open_dataset(tmp_path / "drive.pcap")
    sweep, ranges = dataset.sweep(1), ouster_ranges(1).ravel()
    assert usable_points(sweep.points).tolist() == (ranges > 0).tolist()
    centre = sweep.sensor_rig.T_lidar_sensor[0, :3, 3]
    assert 0.03 < centre[2] < 0.05, "the lasers are above the origin of the sensor's frame"
    distance = np.linalg.norm(sweep.points - centre, axis=1)[ranges > 0]
    np.testing.assert_allclose(distance, ranges[ranges > 0] * 1e-3, atol=0.03)
    np.testing.assert_array_equal(sweep.ring, np.repeat(np.arange(ROWS), COLUMNS))
    np.testing.assert_array_equal(sweep.intensity, ranges % 200)
    column = np.tile(np.arange(COLUMNS), ROWS)
    share = column * (99_000_000 // COLUMNS) / DRIVE.period
    np.testing.assert_allclose(sweep.relative_time[ranges > 0], share[ranges > 0], atol=1e-6)


def test_columns_that_were_lost_have_no_points_and_the_rest_its_times(tmp_path: Path) -> None:
    write_ouster(tmp_path / "drive.pcap", missing=slice(100, 200))
    dataset = open_dataset(tmp_path / "drive.pcap")
    check(dataset, "ouster")
    sweep = dataset.sweep(2)
    column = np.tile(np.arange(COLUMNS), ROWS)
    lost = (column >= 96) & (column < 208)  # whole packets of 16 columns
    assert not usable_points(sweep.points)[(column >= 100) & (column < 200)].any()
    usable = usable_points(sweep.points) & ~lost
    share = column * (99_000_000 // COLUMNS) / DRIVE.period
    np.testing.assert_allclose(sweep.relative_time[usable], share[usable], atol=1e-6)


def test_stamps_are_on_the_clock_of_the_lidar_where_that_is_unix_time(tmp_path: Path) -> None:
    write_ouster(tmp_path / "drive.pcap", boot=False)
    times = open_dataset(tmp_path / "drive.pcap").times
    np.testing.assert_allclose(times, DRIVE.times - 40_000_000, atol=2000)


def test_metadata_that_is_missing_or_of_another_sensor(tmp_path: Path) -> None:
    write_ouster(tmp_path / "drive.pcap")
    (tmp_path / "drive.json").rename(tmp_path / "sensor.json")
    with pytest.raises(DatasetError, match=r"no metadata of its name.*files there: sensor.js"):
        open_dataset(tmp_path / "drive.pcap", dataset="ouster")
    (tmp_path / "docdepth.yaml").write_text(yaml.safe_dump({"metadata": "sensor.json"}))
    assert len(open_dataset(tmp_path / "drive.pcap", dataset="ouster")) == DRIVE.count
    (tmp_path / "sensor.json").write_text("{}")
    with pytest.raises(DatasetError, match=r"drive.pcap with .*sensor.json is no capture"):
        open_dataset(tmp_path / "drive.pcap", dataset="ouster")


@pytest.mark.parametrize(
    ("kind", "package", "inside"),
    [("ros1", "ouster_ros", True), ("ros1", "ouster_ros", False),
     ("db3", "ouster_sensor_msgs", True)],
)  # fmt: skip
def test_ouster_packets_in_bags(tmp_path: Path, kind: str, package: str, inside: bool) -> None:
    (tmp_path / "capture").mkdir()
    write_ouster(tmp_path / "capture" / "drive.pcap", boot=False)
    known = open_dataset(tmp_path / "capture" / "drive.pcap")
    path = tmp_path / ("drive.bag" if kind == "ros1" else "drive")
    write_ouster_bag(path, kind, package, inside, boot=False)
    dataset = open_dataset(path)
    check(dataset, "bag")
    assert len(dataset) == len(known) - 1, "the last one was cut off"
    np.testing.assert_allclose(dataset.times, known.times[:-1], rtol=0, atol=1000)
    for k in (0, 2):
        ours, theirs = dataset.sweep(k), known.sweep(k)
        for name in ("points", "ring", "intensity"):
            np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name))
        np.testing.assert_allclose(ours.relative_time, theirs.relative_time, rtol=0.01)


def test_ouster_packets_in_a_bag_without_metadata(tmp_path: Path) -> None:
    write_ouster_bag(tmp_path / "drive.bag", "ros1", inside=False)
    (tmp_path / "drive.json").rename(tmp_path / "os.txt")
    with pytest.raises(DatasetError, match=r"metadata is missing.*no JSON files.*metadata: FILE"):
        open_dataset(tmp_path / "drive.bag")
    said = "lidars: {/ouster/lidar_packets: {metadata: os.txt}}"
    (tmp_path / "docdepth.yaml").write_text(said)
    assert len(open_dataset(tmp_path / "drive.bag")) == DRIVE.count - 1
    (tmp_path / "os.txt").write_text("{}")
    with pytest.raises(DatasetError, match=r"os.txt is no metadata of an Ouster"):
        open_dataset(tmp_path / "drive.bag")


def test_a_real_bag_of_ouster_packets(recordings: Path) -> None:
    """One revolution of an OS1-128 at 512 x 10, as the SDK's own reader of bags has it."""
    sdk = pytest.importorskip("ouster.sdk")
    path = recordings / "ouster" / "512x10_raw.bag"
    dataset = open_dataset(path)
    assert dataset.times.tolist() == [1723828414279578824]
    (frame,), *others = sdk.open_source(str(path))
    assert not others
    known = sdk.core.XYZLut(frame.sensor_info)(frame).reshape(-1, 3)
    np.testing.assert_allclose(dataset.sweep(0).points, known, atol=1e-5)


def test_an_empty_capture(recordings: Path) -> None:
    pytest.importorskip("ouster.sdk")
    with pytest.raises(DatasetError, match=r"empty_pcap.pcap holds no frame that fits"):
        open_dataset(recordings / "ouster" / "empty_pcap.pcap")


def test_a_real_capture(recordings: Path) -> None:
    """Three revolutions of an OS1-128 that drives 0.25 m in each."""
    pytest.importorskip("ouster.sdk")
    from docdepth.odometry.odometry import estimate_poses

    dataset = open_dataset(recordings / "ouster" / "OS-1-128_v2.3.0_1024x10_lb_n3.pcap")
    check(dataset, "ouster")
    assert len(dataset) == 3
    assert (usable_points(dataset.sweep(1).points)).sum() == 107357
    steps = np.diff(estimate_poses(dataset)[:, :3, 3], axis=0)
    np.testing.assert_allclose(np.linalg.norm(steps, axis=1), 0.25, atol=0.03)


def test_a_capture_that_ends_within_a_packet(tmp_path: Path, caplog) -> None:
    file = tmp_path / "drive.pcap"
    write_capture(file, velodyne_drive())
    open_dataset(file)
    assert "truncated" not in caplog.text
    content = file.read_bytes()
    for cut in (5, 1250):  # within the last packet, and within the header before it
        caplog.clear()
        file.write_bytes(content[:-cut])
        open_dataset(file)
        assert "drive.pcap ends within a packet" in caplog.text, cut
    file.write_bytes(content[: int(0.7 * len(content))])
    dataset = open_dataset(file)
    check(dataset, "velodyne")
    assert len(dataset) in (3, 4)


# ---- Velodyne


def test_points_of_a_velodyne(tmp_path: Path) -> None:
    """Ranges but for the lasers' heights, the turn from behind, times from the first packet on."""
    write_capture(tmp_path / "drive.pcap", velodyne_drive())
    dataset = open_dataset(tmp_path / "drive.pcap")
    assert len(dataset) == DRIVE.count
    np.testing.assert_allclose(dataset.times, DRIVE.times, atol=500)
    sweep = dataset.sweep(2)
    usable = usable_points(sweep.points)
    ranges = np.concatenate([velodyne_ranges(2 * PACKETS + n).ravel() for n in range(PACKETS)])
    found = np.sort(np.linalg.norm(sweep.points[usable], axis=1))
    np.testing.assert_allclose(found, np.sort(ranges[ranges > 0]) * 2e-3, atol=4e-3)
    x, y = sweep.points[usable, 0], sweep.points[usable, 1]
    turned = np.mod(np.pi - np.arctan2(y, x), 2 * np.pi) / (2 * np.pi)  # clockwise from behind
    late = sweep.relative_time[usable] * DRIVE.period / (PACKETS * FIRINGS * 55_296)
    off = np.abs(turned - late)
    assert np.quantile(np.minimum(off, 1 - off), 0.99) < 0.003
    assert set(sweep.ring) == set(range(16))


def test_parts_of_revolutions_at_the_ends_are_left_out(tmp_path: Path, caplog) -> None:
    caplog.set_level("INFO")
    write_capture(tmp_path / "drive.pcap", velodyne_drive()[50:-40])
    dataset = open_dataset(tmp_path / "drive.pcap")
    check(dataset, "velodyne")
    assert len(dataset) == DRIVE.count - 2
    assert "2 partial sweeps at its ends are left out" in caplog.text


LINKS = {
    "IP": (101, b""),
    "IP of BSD": (12, b""),
    "IPv4": (228, b""),
    "loopback": (0, struct.pack("<I", 2)),
    "cooked": (113, struct.pack(">3H8sH", 0, 1, 6, bytes(8), 0x0800)),
    "cooked, version 2": (276, struct.pack(">HHIHBB8s", 0x0800, 0, 1, 1, 0, 6, bytes(8))),
    "VLAN": (1, bytes(12) + struct.pack(">3H", 0x8100, 5, 0x0800)),
}


@pytest.mark.parametrize("link", LINKS)
def test_captures_of_other_interfaces(tmp_path: Path, link: str) -> None:
    dpkt = pytest.importorskip("dpkt")
    write_capture(tmp_path / "a.pcap", velodyne_drive())
    expected = open_dataset(tmp_path / "a.pcap").sweep(1).points
    number, head = LINKS[link]
    with (tmp_path / "a.pcap").open("rb") as stream, (tmp_path / "b.pcap").open("wb") as out:
        writer = dpkt.pcap.Writer(out, linktype=number)
        for time, frame in dpkt.pcap.Reader(stream):
            writer.writepkt_time(head + frame[14:], time)
    np.testing.assert_array_equal(open_dataset(tmp_path / "b.pcap").sweep(1).points, expected)


def test_two_velodynes_in_one_capture(tmp_path: Path) -> None:
    dpkt = pytest.importorskip("dpkt")
    write_capture(tmp_path / "a.pcap", velodyne_drive()[:20], "10.0.0.1")
    write_capture(tmp_path / "b.pcap", velodyne_drive()[:20], "10.0.0.2")
    with (tmp_path / "both.pcap").open("wb") as stream:
        writer = dpkt.pcap.Writer(stream)
        for name in "ab":
            with (tmp_path / f"{name}.pcap").open("rb") as part:
                for time, data in dpkt.pcap.Reader(part):
                    writer.writepkt_time(data, time)
    with pytest.raises(DatasetError, match=r"both.pcap holds packets of 2 LiDARs; keep"):
        open_dataset(tmp_path / "both.pcap")


@pytest.mark.parametrize("content", [b"", b"\n\r\r\n" + b"\0" * 400, b"\xd4\xc3\xb2\xa1" * 3])
def test_captures_that_are_none(tmp_path: Path, content: bytes) -> None:
    pytest.importorskip("velodyne_decoder")
    (tmp_path / "drive.pcap").write_bytes(content)
    with pytest.raises(DatasetError, match=r"drive.pcap is no pcap capture"):
        open_dataset(tmp_path / "drive.pcap")


def test_real_packets_in_a_capture_are_the_bag_s(recordings: Path, tmp_path: Path) -> None:
    """The packets of four messages, written one after the other, cut anew behind the LiDAR."""
    pytest.importorskip("rosbags")
    from docdepth.datasets.formats.bag.bag_file import BagFile

    path = recordings / "nebula" / "vlp16" / "1673400471837873222"
    packets = [
        (p.stamp.sec * 10**9 + p.stamp.nanosec, bytes(p.data))
        for message in BagFile(path).read_all("/velodyne_packets")
        for p in message.packets
    ]
    write_capture(tmp_path / "drive.pcap", packets)
    dataset, bag = open_dataset(tmp_path / "drive.pcap"), open_dataset(path)
    check(dataset, "velodyne")
    ours = np.concatenate([dataset.sweep(k).points for k in range(len(dataset))])
    theirs = np.concatenate([bag.sweep(k).points for k in range(len(bag))])
    known = {point.tobytes() for point in theirs}
    share = np.mean([point.tobytes() in known for point in ours])
    assert share > 0.99, "points between packets are interpolated"
    assert len(ours) > 0.97 * len(theirs)


# ---- Hesai


def test_points_of_a_hesai(tmp_path: Path) -> None:
    """Each return by the manual, of a unit's own angles, over midnight of its clock."""
    rng = np.random.default_rng(3)
    angles = np.stack([15.0 - np.arange(32), np.zeros(32)], axis=1) + rng.normal(0, 0.1, (32, 2))
    lines = [f"{n},{up!r},{turn!r}" for n, (up, turn) in enumerate(angles.tolist(), 1)]
    (tmp_path / "xt32.csv").write_text("\n".join(["Channel,Elevation,Azimuth", *lines]) + "\n")
    (tmp_path / "docdepth.yaml").write_text("angles: xt32.csv\n")
    write_capture(tmp_path / "drive.pcap", hesai_drive(midnight=2))
    dataset = open_dataset(tmp_path / "drive.pcap")
    check(dataset, "hesai")
    assert len(dataset) == DRIVE.count
    sweep, rows = dataset.sweep(2), []
    for n in range(HESAI_PACKETS):
        packet = 2 * HESAI_PACKETS + n
        for firing, ranges in enumerate(hesai_ranges(packet)):
            for laser, (up, turn) in enumerate(np.radians(angles)):
                toward = np.radians(hesai_azimuths(packet)[firing] / 100) + turn
                ray = [np.cos(up) * np.sin(toward), np.cos(up) * np.cos(toward), np.sin(up)]
                nanoseconds = (
                    n * (DRIVE.period // HESAI_PACKETS) // 1000 * 1000
                    + 6000
                    - 50_000 * (3 - firing)
                    + 1512 * laser
                )
                for steps in dict.fromkeys(ranges[:, laser].tolist()):
                    if steps:
                        metres = steps * HESAI_MM / 1000
                        rows.append([*(metres * np.array(ray)), laser, nanoseconds / DRIVE.period])
    expected = np.array(rows)
    np.testing.assert_allclose(sweep.points, expected[:, :3], rtol=0, atol=1e-6)
    np.testing.assert_array_equal(sweep.ring, expected[:, 3])
    np.testing.assert_array_equal(sweep.intensity, expected[:, 3] + 100)
    np.testing.assert_allclose(sweep.relative_time, expected[:, 4], rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({6: 16}, "another LiDAR than a Hesai PandarXT-32 (16 lasers, 8 blocks)"),
        ({10: 3}, "packets of [3] returns a ray"),
        ({0: 0}, "another LiDAR than a Hesai"),
        (None, "is truncated; copy it again"),
    ],
)
def test_packets_that_are_no_pandar_xt_32(change: dict[int, int] | None, problem: str) -> None:
    packet = bytearray(hesai_packet(0, 0))
    for place, value in (change or {}).items():
        packet[place] = value
    with pytest.raises(DatasetError, match=re.escape(problem)):
        hesai.decode_packets([bytes(packet)[: 1080 if change else 900]], [0], 0, "here")


@pytest.mark.parametrize(
    "text", ["", "Channel,Elevation,Azimuth\n1,15,0\n", "a\n" + "x,y,z\n" * 32]
)
def test_angles_that_are_none(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(DatasetError, match=r"a.csv does not have the angles of a PandarXT-32"):
        hesai.read_angles(tmp_path / "a.csv")


@pytest.mark.parametrize("maker", ["velodyne", "hesai"])
def test_json_of_something_else_beside_a_capture(tmp_path: Path, maker: str) -> None:
    pytest.importorskip("velodyne_decoder")
    packets = velodyne_drive() if maker == "velodyne" else hesai_drive()
    write_capture(tmp_path / "drive.pcap", packets)
    (tmp_path / "notes.json").write_text("{}")
    assert open_dataset(tmp_path / "drive.pcap").name == maker


def test_two_velodynes_behind_one_address(tmp_path: Path) -> None:
    packets = velodyne_drive()
    write_capture(tmp_path / "drive.pcap", packets)
    write_capture(tmp_path / "other.pcap", packets, port=2369)
    head = 24
    joined = (tmp_path / "drive.pcap").read_bytes() + (tmp_path / "other.pcap").read_bytes()[head:]
    (tmp_path / "both.pcap").write_bytes(joined)
    with pytest.raises(DatasetError, match=r"both.pcap holds packets of 2 LiDARs"):
        open_dataset(tmp_path / "both.pcap")


@pytest.mark.parametrize("mtu", [576, 1200, 1500])
def test_packets_that_the_network_has_split(tmp_path: Path, mtu: int) -> None:
    pytest.importorskip("velodyne_decoder")
    file = tmp_path / "drive.pcap"
    write_pieces(file, velodyne_drive(), mtu, 1 << 16)
    if mtu > 1206 + 28:
        write_capture(tmp_path / "whole.pcap", velodyne_drive())
        whole = open_dataset(tmp_path / "whole.pcap").sweep(1).points
        np.testing.assert_array_equal(open_dataset(file).sweep(1).points, whole)
        return
    with pytest.raises(DatasetError, match=r"drive.pcap .* pieces .*IP fragments\).* MTU of 1500"):
        open_dataset(file)


@pytest.mark.parametrize("drive", [velodyne_drive, hesai_drive])
def test_packets_that_were_recorded_in_part(tmp_path: Path, drive) -> None:
    pytest.importorskip("velodyne_decoder")
    write_pieces(tmp_path / "drive.pcap", drive(), 1500, 262)
    with pytest.raises(DatasetError, match=r"holds the beginning alone; .*tcpdump -s 0"):
        open_dataset(tmp_path / "drive.pcap")
