"""Every broken file of a recording ends in an error of its class that names the file."""

from __future__ import annotations

import gzip
import json
import pickle
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from formats import WRITERS
from kitti_drives import T_camera0_lidar, numbers
from writers import truncate

from docdepth.datasets import open_dataset
from docdepth.datasets.cloud_files import RowFormat, read_cloud
from docdepth.errors import CalibrationError, DatasetError

Change = Callable[[Path], object]


def gone(file: Path) -> None:
    file.unlink()


def text(content: str) -> Change:
    return lambda file: file.write_text(content)


def content(made: bytes) -> Change:
    return lambda file: file.write_bytes(made)


def content_at(place: int, made: bytes) -> Change:
    def change(file: Path) -> None:
        whole = file.read_bytes()
        file.write_bytes(whole[:place] + made + whole[place + len(made) :])

    return change


def begin_of(size: int) -> Change:
    return lambda file: file.write_bytes(file.read_bytes()[:size])


def without(column: str) -> Change:
    def change(file: Path) -> None:
        feather = pytest.importorskip("pyarrow.feather")
        table = feather.read_table(file, memory_map=False)
        feather.write_feather(table.drop_columns([column]), str(file))

    return change


def cut(file: Path) -> None:
    truncate(file, 20)


def lines(*chosen: int | str) -> Change:
    """The file has these of its lines, or others."""

    def change(file: Path) -> None:
        known = file.read_text().splitlines()
        new = [line if isinstance(line, str) else known[line] for line in chosen]
        file.write_text("\n".join(new) + "\n")

    return change


def swap(old: str, new: str) -> Change:
    return lambda file: file.write_text(file.read_text().replace(old, new))


def named(name: str) -> Change:
    return lambda file: file.rename(file.with_name(name))


def extrinsics(change: Callable[[np.ndarray], np.ndarray]) -> Change:
    def write(file: Path) -> None:
        wrong = change(T_camera0_lidar(rectified=file.name == "calib.txt")[:3])
        if file.name == "calib.txt":
            file.write_text(file.read_text().rpartition("Tr:")[0] + f"Tr: {numbers(wrong)}\n")
        else:
            file.write_text(f"R: {numbers(wrong[:, :3])}\nT: {numbers(wrong[:, 3])}\n")

    return write


D, C = DatasetError, CalibrationError
# Without mtime the bytes would tell the time.
NO_TABLES = (b"", b"nothing", gzip.compress(pickle.dumps([1, 2]), mtime=0))
STAMPS = "velodyne_points/timestamps.txt"
# Format, file, what happens to it, class of the error, what it tells besides the name of the file.
BROKEN: list[tuple[str, str, Change, type, str]] = [
    ("kitti_raw", STAMPS, lines(0, 1, 2), D, "0000000003.bin"),
    ("kitti_raw", STAMPS, lines(0, 2, 1, 3, 4), D, "frame 2 (0000000002.bin)"),
    ("kitti_raw", STAMPS, lines(0, 0, 2, 3, 4), D, "frame 1"),
    ("kitti_raw", STAMPS, lines(0, "noon", 2, 3, 4), D, "line 2: 'noon'"),
    ("kitti_raw", STAMPS, lines(0, "", 2, 3, 4), D, "line 2: there is no time"),
    ("kitti_raw", STAMPS, gone, D, "missing"),
    ("kitti_raw", "image_02/timestamps.txt", gone, D, "missing"),
    ("kitti_raw", "calib_cam_to_cam.txt", gone, C, "missing"),
    ("kitti_raw", "calib_cam_to_cam.txt", swap("R_rect_00", "R_rect_01"), C, "R_rect_00"),
    ("kitti_raw", "calib_cam_to_cam.txt", swap("P_rect_02: ", "P_rect_02: nan "), C, "P_rect_02"),
    ("kitti_raw", "calib_cam_to_cam.txt", swap("P_rect_02", "P_rect_09"), C, "no camera"),
    ("kitti_raw", "calib_velo_to_cam.txt", gone, C, "missing"),
    ("kitti_raw", "calib_velo_to_cam.txt", extrinsics(lambda T: T[[1, 0, 2]]), C, "mirrors"),
    ("kitti_raw", "calib_velo_to_cam.txt", extrinsics(lambda T: T * (1, 1, 1, 1000)), C, " m "),
    ("kitti_raw", "0000000002.bin", text(""), D, "(frame 2)"),
    ("kitti_odometry", "03/times.txt", lines(0, 1, 2, 3), D, "000004.bin (frame 4)"),
    ("kitti_odometry", "03/times.txt", lines(0, 1, 1, 3, 4), D, "frame 2 (000002.bin)"),
    ("kitti_odometry", "03/times.txt", lines(0, 1, "x", 3, 4), D, "line 3: 'x'"),
    ("kitti_odometry", "03/times.txt", lines(0, 1, "nan", 3, 4), D, "line 3: 'nan'"),
    ("kitti_odometry", "image_2/times.txt", lines(0, 1), D, "000002.png"),
    ("kitti_odometry", "calib.txt", gone, C, "missing"),
    ("kitti_odometry", "calib.txt", extrinsics(lambda T: T + np.eye(3, 4) * 5), C, "'Tr:'"),
    ("kitti_odometry", "calib.txt", extrinsics(lambda T: 0 * T), C, "'Tr:'"),
    ("kitti_odometry", "calib.txt", swap("Tr:", "P2: 1\nTr:"), C, "two lines 'P2:'"),
    ("folder of ply", "docdepth.yaml", named("docdepth.yml"), D, "call it docdepth.yaml"),
    ("kitti_odometry", "velodyne/000002.bin", text(""), D, "(frame 2)"),
    ("KITTI-360", "calib_cam_to_velo.txt", text("1 2 3"), C, "16 numbers"),
    ("KITTI-360", "calib_cam_to_velo.txt", text("a b c"), C, "no matrix of numbers"),
    ("KITTI-360", "calib_cam_to_velo.txt", gone, C, "missing"),
    ("KITTI-360", "calib_cam_to_pose.txt", text("image_01: 1 2"), C, "image_00"),
    ("KITTI-360", "perspective.txt", text("P_rect_02: 1"), C, "no camera"),
    ("KITTI-360", "perspective.txt", gone, C, "missing"),
    ("KITTI-360", "0000000004.bin", named("0000000003 (1).bin"), D, ""),
    ("KITTI-360", STAMPS, lines(0, 1, 2), D, "3 stamps for 5 files"),
    ("KITTI-360", "poses.txt", text(f"77 {numbers(np.eye(4)[:3])}\n"), D, ""),
    ("MulRan", "Ouster/17*.bin", named("sweep.bin"), D, "sweep.bin"),
    ("MulRan", "global_pose.csv", swap("17000", "17100"), D, ""),
    ("NCLT", "groundtruth_*.csv", swap("17000", "17100"), D, ""),
    ("HeLiPR, Ouster", "global_*_gt.txt", swap("17000", "17100"), D, ""),
    ("Boreas", "lidar_poses.csv", swap("17000", "17100"), D, ""),
    ("Boreas", "P_camera.txt", text("1 2 3"), C, "3 x 4"),
    ("Boreas", "P_camera.txt", text("a b"), C, "numbers"),
    ("Boreas", "T_camera_lidar.txt", text("1 0 0 0"), C, "16 numbers"),
    ("Boreas", "T_camera_lidar.txt", gone, C, "missing"),
    ("PandaSet", "front_camera/poses.json", text("[]"), D, "0 entries for 5 sweeps"),
    ("PandaSet", "front_camera/poses.json", text("[1, 2, 3, 4, 5]"), D, "(0: "),
    ("PandaSet", "front_camera/timestamps.json", text("[1, 2, 3, 3, 4]"), D, "frame 3"),
    ("PandaSet", "front_camera/timestamps.json", text('[1, 2, 3, 4, "x"]'), D, "(4: "),
    ("PandaSet", "front_camera/intrinsics.json", text("{}"), C, "fx"),
    *(("PandaSet", "lidar/02.pkl.gz", content(made), D, "(frame 2)") for made in NO_TABLES),
    ("Waymo", "lidar_calibration/*.parquet", gone, D, "missing"),
    ("Waymo", "lidar_calibration/*.parquet", cut, D, "no whole Parquet file"),
    ("Argoverse 2", "egovehicle_SE3_sensor.feather", gone, D, "missing"),
    ("nuScenes", "calibrated_sensor.json", swap('"translation": [', '"translation": [null, '), D,
     "(0: translation: 0: "),
    ("nuScenes", "sensor.json", swap("channel", "Channel"), D, "(0: channel: Field required)"),
    ("nuScenes", "sample_data.json", swap('stamp": ', f'stamp": 9{20 * "0"}'), D, "timestamp: "),
    ("nuScenes", "sample_data.json", swap("sweeps/", "../sweeps/"), D, "out of the recording"),
    ("nuScenes", "scene.json", swap('"name": "scene-0103"', '"name": -1'), D, "(1: name: "),
    ("DGP", "scene_1234.json", swap('"X"', '""'), D, "point_format"),
    ("DGP", "abc.json", swap('"fx": ', '"fx": "x", "FX": '), C, "intrinsics: "),
    ("DGP", "scene_1234.json", swap("point_cloud/", "/etc/"), D, "out of the recording"),
    ("nuScenes", "scene.json", content(b"\xff\xfe["), D, "is not a text file"),
    ("Argoverse 2", "intrinsics.feather", without("width_px"), D, "no column width_px"),
    ("Argoverse 2", "city_SE3_egovehicle.feather", without("qw"), D, "no column qw"),
    ("folder of las", "000000.las", content_at(131, bytes(24)), D, "its scales are [0.0, 0.0"),
    ("folder of las", "000000.las", content_at(155, b"\xff" * 8), D, "its offsets [nan"),
    ("folder of las", "000000.las", content_at(107, b"\xff" * 4), D, "too few bytes"),
    ("folder of laz", "000000.laz", content_at(107, b"\xff" * 4), D, "too few bytes"),
    ("folder of las", "000000.las", content_at(0, b"LASX"), D, "does not begin with LASF"),
    ("folder of las", "000000.las", content_at(24, b"\2\7"), D, "is LAS 2.7 of point format"),
    ("folder of laz", "000000.laz", content_at(104, b"\xbf"), D, "of point format 63; write LAS"),
    ("folder of las", "000000.las", content_at(105, b"\3\0"), D, "its points have 3 bytes, those"),
    ("folder of las", "000000.las", begin_of(150), D, "150 bytes, fewer than the header"),
    ("folder of laz", "000000.laz", begin_of(-9), D, "its records or points end early"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("what", "pattern", "change", "error", "told"),
    BROKEN,
    ids=[f"{row[0]} {row[1].rpartition('/')[2]} {k}" for k, row in enumerate(BROKEN)],
)
def test_it_is_named(
    what: str, pattern: str, change: Change, error: type, told: str, tmp_path: Path
) -> None:
    path = WRITERS[what][1](tmp_path).path
    file = min(tmp_path.rglob(pattern))
    before = set(tmp_path.rglob("*"))
    change(file)
    new = set(tmp_path.rglob("*")) - before
    with pytest.raises(error) as caught:
        _ = open_dataset(path).poses
    assert (new.pop() if new else file).name in str(caught.value)
    assert told in str(caught.value)


def test_chunks_that_a_file_is_too_short_for(tmp_path: Path) -> None:
    """Memory for them ended the process."""
    path = WRITERS["folder of laz"][1](tmp_path).path
    file = min(path.rglob("*.laz"))
    whole = bytearray(file.read_bytes())
    (points,) = struct.unpack_from("<I", whole, 96)
    (table,) = struct.unpack_from("<q", whole, points)
    struct.pack_into("<I", whole, table + 4, 1 << 31)
    file.write_bytes(whole)
    with pytest.raises(DatasetError, match=rf"{file.name} .* more chunks than it has bytes"):
        open_dataset(path).sweep(0)


def test_points_that_a_file_is_too_short_for(tmp_path: Path) -> None:
    """laspy reads those that are there, and only logs how many."""
    laspy = pytest.importorskip("laspy")
    las = laspy.create(point_format=1)
    las.x = las.y = las.z = np.arange(9.0)
    las.write(str(tmp_path / "a.las"))
    content = bytearray((tmp_path / "a.las").read_bytes())
    content[107:111] = (11).to_bytes(4, "little")
    (tmp_path / "a.las").write_bytes(content)
    with pytest.raises(DatasetError, match=r"frame 3.* tells of 11 points, for which"):
        read_cloud(tmp_path / "a.las", "frame 3", RowFormat())


def test_records_that_a_file_is_too_short_for(tmp_path: Path) -> None:
    """laspy read as many, for hours."""
    path = WRITERS["folder of laz"][1](tmp_path).path
    file = min(path.rglob("*.laz"))
    whole = bytearray(file.read_bytes())
    struct.pack_into("<I", whole, 100, 1 << 31)
    file.write_bytes(whole)
    with pytest.raises(DatasetError, match=rf"{file.name} .* more records than it has bytes"):
        open_dataset(path).sweep(0)


@pytest.mark.parametrize(
    "error", [TypeError("'x'"), struct.error("no"), KeyError("laser"), ArithmeticError()]
)
def test_whatever_a_library_raises_names_the_file(
    error: Exception, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def read(*_: object) -> None:
        raise error

    path = WRITERS["nuScenes"][1](tmp_path).path
    drive = open_dataset(path)
    monkeypatch.setattr("docdepth.datasets.cloud_files.read_rows", read)
    with pytest.raises(DatasetError, match=r"LIDAR_TOP.*bin \(frame 1\) is damaged") as caught:
        drive.sweep(1)
    assert repr(error) in str(caught.value)
    assert caught.value.__cause__ is error  # for whoever mends the reader
    monkeypatch.setattr("docdepth.datasets.formats.nuscenes.read_json", read)
    with pytest.raises(DatasetError, match=r"scene-0061 \(nuscenes\) is damaged"):
        open_dataset(path)


@pytest.mark.parametrize("what", ["kitti_raw", "kitti_odometry", "MulRan", "nuScenes"])
def test_a_sweep_that_went_after_the_recording_was_opened(what: str, tmp_path: Path) -> None:
    dataset = open_dataset(WRITERS[what][1](tmp_path).path)
    (file, *_) = dataset.sweep_files(2)
    file.unlink()
    with pytest.raises(DatasetError) as caught:
        dataset.sweep(2)
    assert file.name in str(caught.value)


@pytest.mark.parametrize("what", ["MulRan", "NCLT", "HeLiPR, Ouster", "Boreas"])
def test_poses_may_be_left_out(what: str, tmp_path: Path) -> None:
    path = WRITERS[what][1](tmp_path).path
    names = ("global_pose.csv", "groundtruth_*.csv", "global_*_gt.txt", "lidar_poses.csv")
    (table,) = (file for name in names for file in tmp_path.rglob(name))
    table.unlink()
    assert open_dataset(path).poses is None


def in_utf_16(file: Path) -> None:
    file.write_bytes(file.read_text().encode("utf-16"))


@pytest.mark.parametrize(
    ("what", "pattern", "change"),
    [
        ("nuScenes", "v1.0-mini/*.json", in_utf_16),
        ("nuScenes", "sample_data.json", swap("sweeps/LIDAR_TOP/", r"sweeps\\\\LIDAR_TOP\\\\")),
        ("DGP", "scene_1234.json", in_utf_16),
        ("DGP", "scene_1234.json", swap('Z"}, "key"', '+00:00"}, "key"')),
    ],
)
def test_tables_as_other_systems_write_them(
    what: str, pattern: str, change: Change, tmp_path: Path
) -> None:
    path = WRITERS[what][1](tmp_path).path
    before = open_dataset(path)
    for file in tmp_path.rglob(pattern):
        change(file)
    after = open_dataset(path)
    np.testing.assert_array_equal(after.times, before.times)
    np.testing.assert_array_equal(after.sweep(1).points, before.sweep(1).points)


@pytest.mark.parametrize(("what", "images"), [("nuScenes", "CAM_FRONT"), ("DGP", "CAMERA_01")])
def test_an_image_that_is_missing_at_the_beginning(tmp_path: Path, what: str, images: str) -> None:
    path = WRITERS[what][1](tmp_path).path
    first = min(tmp_path.rglob(f"{images}/*"))
    first.unlink()
    camera = open_dataset(path).cameras[images]
    assert camera.image(1) is not None
    with pytest.raises(DatasetError, match=rf"{first.name} is missing"):
        camera.image(0)


def test_millimetres_of_a_calibration(tmp_path: Path) -> None:
    path = WRITERS["nuScenes"][1](tmp_path).path
    file = tmp_path / "v1.0-mini" / "calibrated_sensor.json"
    rows = json.loads(file.read_text())
    for row in rows:
        row["translation"] = [1000 * metres for metres in row["translation"]]
    file.write_text(json.dumps(rows))
    with pytest.raises(CalibrationError, match=r"CAM_FRONT.*moves by more than 100 m"):
        open_dataset(path)


@pytest.mark.parametrize("scenes", [1, 2])
def test_nuscenes_rows_without_a_sample(tmp_path: Path, caplog, scenes: int) -> None:
    """They belong to the only scene there is; of several, none is guessed."""
    path = WRITERS["nuScenes"][1](tmp_path).path
    before = len(open_dataset(path))
    (file,) = tmp_path.rglob("sample_data.json")
    rows = json.loads(file.read_text())
    sweep = [row for row in rows if "LIDAR_TOP" in row["filename"]][1]
    sweep["sample_token"] = ""
    file.write_text(json.dumps(rows))
    table = file.with_name("scene.json")
    known = [row for row in json.loads(table.read_text()) if row["name"] == path.name]
    table.write_text(json.dumps(known + [{"token": "z", "name": "other"}] * (scenes - 1)))
    assert len(open_dataset(path)) == (before if scenes == 1 else before - 1)
    assert ("1 of" in caplog.text and "no sample_token" in caplog.text) == (scenes == 2)
