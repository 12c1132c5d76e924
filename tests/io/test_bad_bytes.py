"""Broken files that fuzzing found (``benchmarks/fuzz.py``): each ends in a sentence now."""

from __future__ import annotations

import io
import json
import os
import struct
import zipfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import yaml

from docdepth import Parameters
from docdepth.cli.config_file import read_config
from docdepth.datasets import LidarStream
from docdepth.datasets.cloud_files import RowFormat, read_cloud
from docdepth.datasets.files import read_image
from docdepth.datasets.formats.bag import ros_images, ros_points
from docdepth.datasets.formats.bag.bag_recording import BagLidar, _read
from docdepth.datasets.kitti_files import Calibration, image_size
from docdepth.datasets.pose_tables import read_pose_table
from docdepth.datasets.settings import RecordingSettings, read_settings
from docdepth.datasets.times import read_times
from docdepth.errors import (
    CalibrationError,
    ConfigError,
    DamagedFileError,
    DatasetError,
    DocDepthError,
    InputError,
    OdometryError,
    RunError,
)
from docdepth.geometry.lidar_frame import LidarFrame, SensorRig
from docdepth.geometry.trajectory import Trajectory
from docdepth.io.calibration import read_camera_calibration
from docdepth.io.depth import encode_depth, read_depth
from docdepth.io.frames import read_frame, read_trajectory, write_frame, write_trajectory
from docdepth.io.images import decode_image
from docdepth.io.labels import read_classes
from docdepth.io.poses import read_poses, read_tum
from docdepth.io.run_folder import RunFolder
from docdepth.io.tracks import COLUMNS, read_tracks
from docdepth.io.untrusted import ArrayError, parse_json, parse_yaml, read_array, read_arrays
from docdepth.pipeline.plan import states

FRAME = LidarFrame(
    np.ones((2, 3), np.float32),
    np.arange(2, dtype=np.uint32),
    "7",
    2,
    sensor_rig=SensorRig.single((0, 0, 1), 2),
)
POSES = np.repeat(np.eye(4)[None], 3, axis=0)


def written(path: Path, content: bytes | str) -> Path:
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


# ---- files of one reader


def pcd(fields: str, kinds: str, counts: str, data: str, body: bytes, points: int = 2) -> bytes:
    sizes = " ".join("4" if kind == "F" else "1" for kind in kinds.split())
    head = f"FIELDS {fields}\nSIZE {sizes}\nTYPE {kinds}\nCOUNT {counts}\nPOINTS {points}\n"
    return f"{head}DATA {data}\n".encode() + body


def npy(values: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.save(stream, values, allow_pickle=True)
    return stream.getvalue()


def shaped(text: bytes) -> bytes:
    """An array whose header tells another shape."""
    content, wanted = npy(np.zeros(3)), b"(3,), }"
    return content.replace(wanted + b" " * (len(text) - len(wanted)), text)


def archive(method: int = 8, size: int | None = None, flags: int = 0, version: int = 20) -> bytes:
    """A depth map in an archive whose entry claims something else."""
    stream = io.BytesIO()
    np.savez_compressed(stream, depth=np.ones((4, 6), np.float32))
    content = bytearray(stream.getvalue())
    for sign, at in ((b"PK\1\2", 6), (b"PK\3\4", 4)):
        begin = content.index(sign)
        struct.pack_into("<HHH", content, begin + at, version, flags, method)
        if size is not None and at == 6:
            struct.pack_into("<I", content, begin + 24, size)
    return bytes(content)


def png(at: bytes, code: str, *values: int) -> bytes:
    """A depth map in which numbers are written over those before and in a chunk."""
    content = bytearray(encode_depth(np.full((40, 60), 3, np.float32)))
    struct.pack_into(code, content, content.index(at) - 4, *values)
    return bytes(content)


def read_a_cloud(path: Path) -> object:
    return read_cloud(path, "sweep (frame 3)", RowFormat())


def read_labels(path: Path) -> object:
    return read_classes(path, 2, 3, lambda: np.arange(2))


def read_table(path: Path) -> object:
    return read_pose_table(path, (12,), "restore it")


def read_description(path: Path) -> object:
    return read_settings(path.parent, RecordingSettings)


PACKED = struct.pack("<II", 8, 2**32 - 1) + bytes(8)
DEEP = "[" * 100_000
LONG_TRACK = f"0,{10**30},1,vehicle,1,2,3,0,0,4,2,1,0,0,0,0.1,5"
NO_TIMES = ("1e99999", "9999999999999", "inf", "nan")
BROKEN = {
    read_a_cloud: ("a.pcd", DatasetError, [
        (pcd("x y z i", "F F F U", "1 1 1 1", "ascii", b"1 2 3 4\n5 6 7 300"), "value of i"),
        (pcd("x y z", "F F F", "1 2 1", "binary", bytes(32)), "several values"),
        (pcd("x y z", "F F F", "1 -1 1", "binary", bytes(32)), "COUNT"),
        (pcd("x y z", "F F F", "0 0 0", "binary", b"", 10**12), "COUNT"),
        (pcd("x y z", "F F F", "1 1 1", "binary_compressed", PACKED), "cannot hold 4294967295"),
    ]),
    read_labels: ("a.pcd", DatasetError, [
        (pcd("x label", "F U", "1 2", "binary", bytes(12)), "frame 3.*2 values a point"),
    ]),
    read_array: ("a.npy", ArrayError, [
        (b"", "header"),
        (npy(np.zeros(3))[:90], "header"),
        (npy(np.zeros(3))[:-1], "23 of 24 bytes"),
        (shaped(b"(((((((((("), "header"),  # an error of Python's tokenizer
        (shaped(b"(9**9,), }"), "header"),
        (shaped(b"(-3,), }  "), "shape"),
        (shaped(b"(99999999999,), }"), "799999999992 bytes"),
        (npy(np.array([{"a": 1}])), "objects of Python"),
    ]),
    read_poses: ("a.npy", OdometryError, [(shaped(b"(((((((((("), r"a\.npy")]),
    read_depth: ("a.npz", DatasetError, [
        (archive(method=99), r"a\.npz is damaged"),
        (archive(method=0), r"a\.npz is damaged"),
        (archive(size=1 << 31), r"a\.npz is damaged"),
        (archive(flags=1), r"a\.npz is damaged"),
        (archive(version=255), r"a\.npz is damaged"),
        (archive()[:60] + bytes(4) + archive()[64:], r"a\.npz is damaged"),
    ]),
    read_table: ("a", DatasetError, [("1e999999999 " + "0 " * 12, "line 1")]),
    read_times: ("a", DatasetError, [(text, "is no time") for text in NO_TIMES]),
    read_tum: ("a.tum", OdometryError, [(f"{text} 0 0 0 0 0 0 1", "tum") for text in NO_TIMES]),
    read_tracks: ("tracks.csv", DamagedFileError, [
        (",".join(COLUMNS) + "\n" + LONG_TRACK, "tracks"),
    ]),
    read_camera_calibration: ("calib.json", CalibrationError, [
        (json.dumps({"mtx": [1, 2, 3]}), "shape"),
        (json.dumps({"mtx": [[1, 2], [3, 4]]}), "shape"),
        (DEEP, "too deep"),
    ]),
    read_config: ("settings.yaml", ConfigError, [(DEEP, "too deep")]),
    read_description: ("docdepth.yaml", DatasetError, [(DEEP, "too deep")]),
}  # fmt: skip


@pytest.mark.parametrize("read", BROKEN, ids=lambda read: read.__name__)
def test_broken_files_are_described(tmp_path: Path, read: Callable[[Path], object]) -> None:
    name, error, contents = BROKEN[read]
    if name == "a.pcd":
        pytest.importorskip("lzf")
    for content, match in contents:
        with pytest.raises(error, match=match):
            read(written(tmp_path / name, content))


def jpeg(cut: int = 0, size: int = 40) -> bytes:
    """A photo that tells another size, or lacks its end."""
    content = bytearray(cv2.imencode(".jpg", np.full((40, 40, 3), 99, np.uint8))[1].tobytes())
    struct.pack_into(">HH", content, content.index(b"\xff\xc0") + 5, size, size)
    return bytes(content[: len(content) - cut])


@pytest.mark.parametrize(
    "content",
    [
        png(b"IHDR", ">4x4xII", 6, 1 << 28), png(b"IDAT", ">I", 1 << 30),
        jpeg(size=32_000), jpeg(cut=2), jpeg(cut=300),
    ],
)  # fmt: skip
def test_images_that_claim_too_much(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, content: bytes
) -> None:
    monkeypatch.setattr("cv2.imdecode", lambda *_: pytest.fail("it would take a gigabyte"))
    with pytest.raises(DatasetError, match="not a readable image"):
        read_depth(written(tmp_path / "a.png", content))


@pytest.mark.parametrize(
    "values",
    [
        np.arange(6, dtype="<f4").reshape(2, 3), np.asfortranarray(np.arange(6.0).reshape(2, 3)),
        np.zeros((0, 3)), np.array(4), np.ones(3, [("x", ">f4"), ("y", "u1", (2,))]),
        np.array([True, False]), np.array(["a", "bcd"]),
    ],
)  # fmt: skip
def test_arrays_are_those_of_numpy(tmp_path: Path, values: np.ndarray) -> None:
    found = read_array(written(tmp_path / "a.npy", npy(values)))
    assert found.dtype == values.dtype
    assert found.flags.writeable
    np.testing.assert_array_equal(found, values)
    for save in (np.savez, np.savez_compressed):
        save(tmp_path / "a.npz", one=values, two=np.zeros(2))
        found_both = read_arrays(tmp_path / "a.npz")
        assert list(found_both) == ["one", "two"]
        np.testing.assert_array_equal(found_both["one"], values)


def test_no_object_of_python_is_loaded(tmp_path: Path) -> None:
    class Bad:
        def __reduce__(self):
            return Path.touch, (tmp_path / "touched",)

    content = npy(np.array([Bad()]))
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as made:
        made.writestr("depth.npy", content)
    with pytest.raises(DatasetError):
        read_depth(tmp_path / "a.npz")
    with pytest.raises(DatasetError):
        read_depth(written(tmp_path / "a.npy", content))
    (tmp_path / "docdepth.yaml").write_text(f"up: !!python/object/apply:os.mkdir [{tmp_path}/made]")
    with pytest.raises(DatasetError):
        read_settings(tmp_path, RecordingSettings)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.npy", "a.npz", "docdepth.yaml"]


@pytest.mark.parametrize("progressive", [0, 1])
@pytest.mark.parametrize("noise", [0, 255])
def test_photos_that_claim_what_they_hold(progressive: int, noise: int) -> None:
    image = np.random.default_rng(0).integers(0, noise + 1, (2000, 3000)).astype(np.uint8)
    flags = [cv2.IMWRITE_JPEG_PROGRESSIVE, progressive, cv2.IMWRITE_JPEG_QUALITY, 1]
    content = cv2.imencode(".jpg", image, flags)[1].tobytes()
    found = decode_image(content, cv2.IMREAD_GRAYSCALE)
    assert found is not None
    np.testing.assert_array_equal(found, cv2.imdecode(np.frombuffer(content, np.uint8), 0))


@pytest.mark.parametrize("name", ["a.png", "a.tiff"])
def test_photos_of_more_bits_than_eight(tmp_path: Path, name: str) -> None:
    """Of 16 bits cameras fill 10 or 12: the upper eight would be black."""
    ramp = np.arange(4096).astype(np.uint16).reshape(64, 64)
    assert cv2.imwrite(str(tmp_path / name), ramp)
    np.testing.assert_array_equal(read_image(tmp_path / name), (ramp >> 4)[..., None].repeat(3, 2))
    assert cv2.imwrite(str(tmp_path / "depth.tiff"), ramp.astype(np.float32))
    with pytest.raises(DatasetError, match=r"depth.tiff is not a readable image"):
        read_image(tmp_path / "depth.tiff")


def test_a_photo_on_its_side_has_the_size_of_its_pixels_as_all_programs_show_it(
    tmp_path: Path,
) -> None:
    content = cv2.imencode(".jpg", np.full((30, 50, 3), 99, np.uint8))[1].tobytes()
    entry = struct.pack("<HHII", 0x0112, 3, 1, 6)  # orientation: turn to the right
    exif = b"Exif\0\0II*\0\x08\0\0\0" + struct.pack("<H", 1) + entry + bytes(4)
    head = b"\xff\xd8\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif
    photo = written(tmp_path / "a.jpg", head + content[2:])
    assert read_image(photo).shape == (50, 30, 3)
    assert image_size([photo]) == (30, 50)


@pytest.mark.parametrize(
    "tag", ['!!float ""', '!!int ""', "!!bool maybe", "!!timestamp now", "!!binary é", "!!set [1]"]
)
def test_tags_that_do_not_fit(tag: str) -> None:
    with pytest.raises(ValueError, match=r"tag|expected|failed|float|could not|invalid"):
        parse_yaml(f"a: {tag}")


def test_trees_without_end() -> None:
    with pytest.raises(ValueError, match="more than 300 digits"):
        parse_yaml(f"a: [0x{'f' * 5000}]")
    lines = ["a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1]"]
    lines += [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]" for k in range(1, 10)]
    assert parse_yaml("\n".join(lines[:3]))["a2"][8] == [[1] * 9] * 9
    for text in ("\n".join(lines), "&a [*a]"):
        with pytest.raises(ValueError, match="repeat"):
            parse_yaml(text)
    with pytest.raises(ValueError, match="too deep"):
        parse_json(DEEP)


def test_texts_have_a_limit(tmp_path: Path) -> None:
    (tmp_path / "calib.txt").write_text("P2: 1\n")
    os.truncate(tmp_path / "calib.txt", 3 << 30)  # no place on the disk
    with pytest.raises(DocDepthError, match=r"calib.txt cannot be read .it has 3.2 GB"):
        Calibration(tmp_path / "calib.txt", "restore it")


# ---- messages of bags


def message(**changes: object) -> SimpleNamespace:
    fields = [
        SimpleNamespace(name=name, offset=4 * k, datatype=7, count=1)
        for k, name in enumerate("xyz")
    ]
    known = {"fields": fields, "is_bigendian": False, "point_step": 12, "row_step": 24, "width": 2}
    return SimpleNamespace(**known | {"height": 1, "data": np.zeros(24, np.uint8)} | changes)


def test_clouds_of_bags() -> None:
    read = ros_points.reader_of(ros_points.POINT_CLOUD)
    assert read is not None
    assert len(read(message(), "bag").points) == 2
    for lacking in ("width", "height", "point_step"):
        with pytest.raises(DatasetError, match="no points"):
            read(message(**{lacking: 0, "fields": []}), "bag")
    # With the first of them numpy took the process down.
    for place in ((117440512, 2030043136), (0, 1 << 30), (10, 1), (2**32 - 2, 1)):
        field = SimpleNamespace(name="x", offset=place[0], datatype=7, count=place[1])
        for big_endian in (False, True):
            with pytest.raises(DatasetError, match="'x' ends behind its point of 12 bytes"):
                read(message(fields=[field], is_bigendian=big_endian), "bag")
    image = message(__msgtype__=ros_images.IMAGES[0], encoding="rgb8", width=0, step=0)
    with pytest.raises(DatasetError, match="0 x 1 pixels"):
        ros_images.decode_image(image, "bag")


def test_messages_that_are_not_what_they_are_called(tmp_path: Path) -> None:
    """A bag defines its messages; where that is damaged, they lack what they should have."""

    class Bag:
        path, files = tmp_path, ()
        topics = {"/points": ros_points.POINT_CLOUD}  # noqa: RUF012

        def read(self, topic: str, index: object, where: str) -> object:
            return SimpleNamespace(fields=[])

    stream = LidarStream("/points", np.zeros(1, np.int64), ["0"])
    decode = partial(_read, Bag(), "/points", None)
    lidar = BagLidar(Bag(), stream, [None], decode)
    with pytest.raises(DatasetError, match=r"/points \(frame 0\): it is no sensor_msgs"):
        lidar.read(0)


# ---- run folders


@pytest.fixture
def run(tmp_path: Path) -> RunFolder:
    run = RunFolder.create(tmp_path / "run", None, Parameters())
    run.save()
    return run


def test_sensors_of_another_shape(run: RunFolder) -> None:
    run.write_sensors(FRAME.sensor_rig, {})
    run.write_frame(0, FRAME)
    assert run.frame(0).sensor_rig is not None
    for arrays in ({"depth": np.zeros(3)}, {"T_lidar_sensor": np.zeros((2, 3))}):
        np.savez(run.sensors_path, **{"lateral_offset": [], "lidar_id": [], **arrays})
        with pytest.raises(DamagedFileError, match=r"sensors\.npz"):
            RunFolder(run.path).frame(0)


def test_notes_that_name_themselves_end(run: RunFolder) -> None:
    for name in ("odometry", "classify"):
        run.set_stage(name, key="1", all_frames=1)
        run.set_stage_inputs(name, {"odometry": "1", "classify": "2"})
    run.write_frame(0, FRAME, {"odometry": "2"})
    found = {state.name: state.state for state in states(RunFolder.open(run.path))}
    assert found == {"odometry": "out of date", "classify": "out of date"}


@pytest.mark.parametrize("folder", ["../../out", "/tmp", "..", 3, None, "a/b"])
def test_a_camera_lies_in_the_run(run: RunFolder, folder: object) -> None:
    run.write(run.path / "labels" / "a.label", lambda stream: stream.write(b"1"), {})
    run.save()
    for file in (run.path / "run.yaml", run.state_dir / "run.yaml"):
        tree = yaml.safe_load(file.read_text())
        tree["cameras"]["front"] = {"folder": folder, "settings": {}}
        file.write_text(yaml.safe_dump(tree))
    with pytest.raises(RunError, match=r"run\.yaml is missing or damaged"):
        RunFolder.open(run.path)


@pytest.mark.parametrize("name", ["../../own", "/own", "..", "labels/../../../own"])
def test_nothing_outside_is_written_or_deleted(tmp_path: Path, run: RunFolder, name: str) -> None:
    own = written(tmp_path / "own", "mine")
    run.write(run.path / "labels" / "a.label", lambda stream: stream.write(b"1"), {"classify": "1"})
    records = run.state_dir / "records" / "labels.jsonl"
    line = json.loads(records.read_text().splitlines()[-1])
    records.write_text(json.dumps({**line, "name": name}) + "\n")
    opened = RunFolder.open(run.path)
    for known in opened.records(run.path / "labels").names():
        opened.remove(run.path / "labels" / known)
    outside = run.path / "labels" / name / "file"
    for act in (
        lambda: opened.write(outside, lambda stream: stream.write(b"2"), {}),
        lambda: opened.remove(outside),
        lambda: opened.invalidate(outside),
    ):
        with pytest.raises(RunError, match="lies outside"):
            act()
    assert own.read_text() == "mine"
    assert (run.path / "labels" / "a.label").is_file()
    write_frame(tmp_path / "frame.ply", LidarFrame(FRAME.points, FRAME.index, name, 2))
    with pytest.raises(DamagedFileError, match="its sweep is called"):
        read_frame(tmp_path / "frame.ply")


@pytest.mark.parametrize(
    "record",
    [
        {"size": "1"}, {"time": 1.5}, {"checksum": None}, {"key": [1]}, {"key": {"a": 1}},
        {"more": 1},
    ],
)  # fmt: skip
def test_records_of_other_types_count_as_lost(run: RunFolder, record: dict[str, object]) -> None:
    run.write_frame(0, FRAME, {"odometry": "1"})
    records = run.state_dir / "records" / "frames.jsonl"
    line = json.loads(records.read_text().splitlines()[-1])
    records.write_text(json.dumps({**line, **record}) + "\n")
    assert RunFolder.open(run.path).key(run.frame_path(0)) == {}


@pytest.mark.parametrize("first", [-5_050_000_000, -50_000_000, 0, 1_700_000_000_123_456_789])
def test_trajectories_keep_stamps_of_either_sign(tmp_path: Path, first: int) -> None:
    trajectory = Trajectory(first + np.arange(3) * 100_000_001, POSES)
    write_trajectory(tmp_path / "t.ply", trajectory, np.arange(3))
    np.testing.assert_array_equal(read_trajectory(tmp_path / "t.ply")[0].times, trajectory.times)


@pytest.mark.parametrize("first", [-(10**10) * 10**8 * 4, 2**32 * 10**9])
def test_stamps_that_are_no_times_are_named(tmp_path: Path, first: int) -> None:
    with pytest.raises(InputError, match="between 1902 and 2106"):
        write_trajectory(tmp_path / "t.ply", Trajectory(first + np.arange(3), POSES), np.arange(3))
