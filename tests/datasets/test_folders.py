"""Folders of point clouds: the layouts of PCD files, docdepth.yaml, several LiDARs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.lib.recfunctions as rfn
import pytest
import yaml
from conformance import check
from made_up import DRIVE
from writers import WRITERS, folder_rows, seconds, settings, write_beside, write_pcd

from docdepth.datasets import open_dataset
from docdepth.datasets.cloud import foreign_format
from docdepth.datasets.cloud_files import RowFormat, read_cloud
from docdepth.datasets.formats.cloud_folder import cloud_files
from docdepth.datasets.times import time_of_name, times_of_files
from docdepth.errors import DatasetError, DocDepthError
from docdepth.geometry.se3 import poses_from, rotation_exp, se3_exp
from docdepth.io.pcd import PcdError, read_pcd
from docdepth.io.ply import write_vertices
from docdepth.io.poses import write_kitti
from docdepth.odometry.sweeps import deskewed_points

T_OTHER = poses_from([rotation_exp([0.1, -0.05, 0.5])], [[0.3, 1.2, -0.4]])[0]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return WRITERS["folder of ply"][1](tmp_path).path


def change(folder: Path, **entries) -> None:
    (folder / "docdepth.yaml").write_text(yaml.safe_dump(settings() | entries))


# ---- what a file holds, whatever its name


def xyz(points: np.ndarray) -> np.ndarray:
    """Rows with named fields of points (n, 3)."""
    return rfn.unstructured_to_structured(points, names=list("xyz"))


@pytest.mark.parametrize("name", ["sweep.bin", "sweep.ply", "sweep.las"])
def test_a_file_is_read_by_what_it_begins_with(tmp_path: Path, name: str) -> None:
    points, file = np.random.default_rng(0).normal(0, 10, (9, 3)).astype("f4"), tmp_path / name
    for write in (lambda rows: write_vertices(file, rows, []), lambda rows: write_pcd(file, rows)):
        write(xyz(points))
        np.testing.assert_array_equal(read_cloud(file, "a", RowFormat()).points, points)
    with file.open("wb") as stream:
        np.save(stream, xyz(points))
    np.testing.assert_array_equal(read_cloud(file, "a", RowFormat()).points, points)


def test_coordinates_that_float32_rounds_are_refused(tmp_path: Path) -> None:
    points, file = np.random.default_rng(0).normal(0, 10, (999, 3)), tmp_path / "a.ply"
    points[::3] = np.nan
    points[1] = 1e30  # a row that is no return
    write_vertices(file, xyz(points.astype("f4")), [])
    read_cloud(file, "frame 3", RowFormat())
    points += [4e5, 5.8e6, 0]
    write_vertices(file, xyz(points), [])
    read_cloud(file, "frame 3", RowFormat())
    write_vertices(file, xyz(points.astype("f4")), [])
    with pytest.raises(DatasetError, match=r"frame 3.* rounded to 0.5 m"):
        read_cloud(file, "frame 3", RowFormat())


def test_one_sweep_with_other_columns_is_refused(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    points = rng.normal(0, 1, (5000, 3)) * [20, 20, 1] - [0, 0, 1]
    rows = np.column_stack([points, rng.random(5000), np.arange(5000) % 32]).astype("f4")
    file, told = tmp_path / "a.bin", RowFormat(("x", "y", "z", "intensity", "ring"))
    rows.tofile(file)
    np.testing.assert_array_equal(read_cloud(file, "a", told).ring, np.arange(5000) % 32)
    rows[:, :4].tofile(file)
    with pytest.raises(DatasetError, match=r"looks like 4 float32 a point \(KITTI\)"):
        read_cloud(file, "a", told)


@pytest.mark.parametrize("kind", ["c8", "?", "U9", "M8[s]"])
def test_coordinates_that_are_no_numbers(tmp_path: Path, kind: str) -> None:
    values = np.arange(12).reshape(-1, 3)
    np.save(tmp_path / "a.npy", xyz(values.astype(kind)))
    with pytest.raises(DatasetError, match=r"frame 3.* holds x, y and z as .*numbers in metres"):
        read_cloud(tmp_path / "a.npy", "frame 3", RowFormat())


def test_times_are_said_once(tmp_path: Path) -> None:
    folder = WRITERS["folder of npy"][1](tmp_path).path
    change(folder, rate=10)
    with pytest.raises(DatasetError, match=r"times and rate both tell the times; leave one out"):
        open_dataset(folder)


@pytest.mark.parametrize(
    "columns", [[], ["x", "y", "z", "x"], ["x", "y", "intensity"], ["X", "x", "y", "z"]]
)
def test_columns_name_each_value_once(tmp_path: Path, columns: list[str]) -> None:
    folder = WRITERS["folder of bin"][1](tmp_path).path
    change(folder, columns=columns)
    with pytest.raises(DatasetError, match=r"docdepth.yaml: columns must name x, y and z"):
        open_dataset(folder)


WINDOWS = ("1.#QNAN", "-1.#IND", "1.#INF", "-nan(ind)", "nan(snan)")
TEXTS = {
    "ply": "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
    "property float z\nend_header\n",
    "pcd": "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH 3\nHEIGHT 1\nDATA ascii\n",
}


@pytest.mark.parametrize("suffix", TEXTS)
@pytest.mark.parametrize("word", WINDOWS)
def test_what_windows_calls_no_number(tmp_path: Path, suffix: str, word: str) -> None:
    (tmp_path / f"a.{suffix}").write_text(f"{TEXTS[suffix]}1 2 3\n{word} 5 6\n7 8 9\n")
    points = read_cloud(tmp_path / f"a.{suffix}", "a", RowFormat()).points
    np.testing.assert_array_equal(points, [[1, 2, 3], [np.nan, 5, 6], [7, 8, 9]])


@pytest.mark.parametrize("suffix", TEXTS)
@pytest.mark.parametrize(("word", "told"), [("4,5", "'4,5', whose decimals"), ("four", "'four'")])
def test_a_word_that_is_no_number_is_named(
    tmp_path: Path, suffix: str, word: str, told: str
) -> None:
    (tmp_path / f"a.{suffix}").write_text(f"{TEXTS[suffix]}1 2 3\n{word} 5 6\n7 8 9\n")
    with pytest.raises(DatasetError, match=f"frame 3.*no number.*{told}"):
        read_cloud(tmp_path / f"a.{suffix}", "frame 3", RowFormat())


# ---- PCD


HEADER = (
    "# .PCD v0.7\nVERSION 0.7\nFIELDS {fields}\nSIZE {size}\nTYPE {type}\nCOUNT {count}\n"
    "WIDTH 3\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 3\nDATA binary\n"
)


def test_padding_of_no_values_means_natural_alignment(tmp_path: Path) -> None:
    """Some recorders write their C struct and call the gaps fields of COUNT 0."""
    rows = np.zeros(
        3,
        {
            "names": ["x", "y", "z", "intensity", "time", "ring"],
            "formats": ["<f4", "<f4", "<f4", "u1", "<f8", "<u2"],
            "offsets": [0, 4, 8, 12, 16, 24],
            "itemsize": 32,
        },
    )
    rows["x"], rows["time"], rows["ring"], rows["intensity"] = [1, 2, 3], [0.1, 0.2, 0.3], 7, 9
    header = HEADER.format(
        fields="x y z intensity _ time ring _",
        size="4 4 4 1 1 8 2 1",
        type="F F F U U F U U",
        count="1 1 1 1 0 1 1 0",
    )
    (tmp_path / "a.pcd").write_bytes(header.encode() + rows.tobytes())
    found, _ = read_pcd(tmp_path / "a.pcd")
    for name in rows.dtype.names:
        np.testing.assert_array_equal(found[name], rows[name])


def written_by_pcl(rows: np.ndarray, count: int) -> bytes:
    """As PCL writes it: its header takes the size of a field for that of the one before it."""
    assert rows.dtype.fields is not None
    names, sizes, types, counts, told = [], [], [], [], 0
    fields = sorted((entry[1], name, entry[0]) for name, entry in rows.dtype.fields.items())
    for k, (offset, name, dtype) in enumerate(fields):
        if told != offset:
            padding = offset - fields[k - 1][0] - dtype.itemsize if k else offset
            told += padding
            names.append("_"), sizes.append(1), types.append("U"), counts.append(padding)
        told += dtype.itemsize
        names.append(name), sizes.append(dtype.itemsize), counts.append(1)
        types.append({"f": "F", "u": "U", "i": "I"}[dtype.kind])
    if told < rows.dtype.itemsize:
        names.append("_"), sizes.append(1), types.append("U")
        counts.append(rows.dtype.itemsize - told)
    lists = (" ".join(map(str, words)) for words in (names, sizes, types, counts))
    header = HEADER.format(**dict(zip(("fields", "size", "type", "count"), lists, strict=True)))
    header = header.replace("WIDTH 3", f"WIDTH {count}").replace("POINTS 3", f"POINTS {count}")
    return header.encode() + rows.tobytes()


STRUCTS = {  # of point types in use, as a C++ compiler lays them out
    "velodyne": ([("intensity", "<f4", 16), ("ring", "<u2", 20), ("time", "<f4", 24)], 32),
    "robosense": ([("intensity", "<f4", 16), ("timestamp", "<f8", 24), ("ring", "<u2", 32)], 48),
    "hesai": ([("intensity", "u1", 16), ("timestamp", "<f8", 24), ("ring", "<u2", 32)], 48),
    "ouster": (
        [("intensity", "<f4", 16), ("t", "<u4", 20), ("reflectivity", "<u2", 24),
         ("ring", "u1", 26), ("ambient", "<u2", 28), ("range", "<u4", 32)],
        48,
    ),
}  # fmt: skip


@pytest.mark.parametrize("struct", STRUCTS)
@pytest.mark.parametrize("zeros", [0, 1000])
def test_padding_of_pcl(tmp_path: Path, struct: str, zeros: int) -> None:
    fields, size = STRUCTS[struct]
    names, formats, offsets = zip(
        ("x", "<f4", 0), ("y", "<f4", 4), ("z", "<f4", 8), *fields, strict=True
    )
    layout = {"names": names, "formats": formats, "offsets": offsets, "itemsize": size}
    rng = np.random.default_rng(0)
    content = rng.integers(1, 255, 5 * size, dtype=np.uint8).tobytes()
    rows = np.frombuffer(content, np.dtype(layout), 5)
    (tmp_path / "a.pcd").write_bytes(written_by_pcl(rows, 5) + bytes(zeros))
    found, _ = read_pcd(tmp_path / "a.pcd")
    assert found.dtype.names == names
    for name in names:
        np.testing.assert_array_equal(found[name], rows[name])


def test_the_header_of_a_recorder_that_pcl_wrote(tmp_path: Path) -> None:
    """Copied from a file in use: 48 bytes a row, times at 24, rings at 32."""
    header = HEADER.format(
        fields="x y z _ intensity _ timestamp _ ring _",
        size="4 4 4 1 4 1 8 1 2 1",
        type="F F F U f U f U U U",
        count="1 1 1 4 1 0 1 6 1 12",
    )
    rows = np.zeros((3, 48), np.uint8)
    rows[:, 24:32] = np.array([[1.5], [2.5], [3.5]]).view(np.uint8)
    rows[:, 32:34] = np.array([[7], [8], [9]], "<u2").view(np.uint8)
    (tmp_path / "a.pcd").write_bytes(header.encode() + rows.tobytes())
    found, _ = read_pcd(tmp_path / "a.pcd")
    assert found["timestamp"].tolist() == [1.5, 2.5, 3.5]
    assert found["ring"].tolist() == [7, 8, 9]


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (("POINTS 3", "POINTS 2"), "WIDTH 3, HEIGHT 1, POINTS 2"),
        (("WIDTH 3", "WIDTH 4"), "WIDTH 4, HEIGHT 1, POINTS 3"),
        (("1 2 3\n", "1 2\n"), "2 values for point 0, not 3"),
        (("7 8 9\n", "7 8 9 10\n"), "4 values for point 2, not 3"),
        (("7 8 9\n", ""), "2 of 3 points"),
        (("1 2 3\n4 5 6\n", "1 2\n3 4 5 6\n"), "2 values for point 0, not 3"),
    ],
)
def test_pcd_files_that_contradict_themselves(
    tmp_path: Path, change: tuple[str, str], told: str
) -> None:
    text = HEADER.format(fields="x y z", size="4 4 4", type="F F F", count="1 1 1")
    text = text.replace("binary", "ascii") + "1 2 3\n4 5 6\n7 8 9\n"
    (tmp_path / "a.pcd").write_text(text)
    assert read_pcd(tmp_path / "a.pcd")[0]["z"].tolist() == [3, 6, 9]
    (tmp_path / "a.pcd").write_text(text.replace(*change))
    with pytest.raises(PcdError, match=told):
        read_pcd(tmp_path / "a.pcd")


def test_bytes_behind_the_points_are_zeros(tmp_path: Path) -> None:
    header = HEADER.format(fields="x y z", size="4 4 4", type="F F F", count="1 1 1")
    (tmp_path / "a.pcd").write_bytes(header.encode() + bytes(36) + b"\1")
    with pytest.raises(PcdError, match="1 bytes more than its 3 points"):
        read_pcd(tmp_path / "a.pcd")
    (tmp_path / "a.pcd").write_bytes(header.encode() + bytes(36) + b"\r\n")
    assert len(read_pcd(tmp_path / "a.pcd")[0]) == 3


def test_integers_of_an_ascii_file_keep_their_digits(tmp_path: Path) -> None:
    text = HEADER.format(fields="x y z t", size="4 4 4 8", type="F F F U", count="1 1 1 1")
    text = text.replace("binary", "ascii") + "1 2 nan 1700000000123456789\n" * 3
    (tmp_path / "a.pcd").write_text(text)
    assert read_pcd(tmp_path / "a.pcd")[0]["t"].tolist() == [1700000000123456789] * 3


# ---- times


@pytest.mark.parametrize(
    ("name", "time"),
    [
        ("1673400678101968885", 1673400678101968885),
        ("1547131046260961", 1547131046260961000),
        ("1547131046260", 1547131046260000000),
        ("cloud_1583836591_182590976", 1583836591182590976),
        ("1583836591.18", 1583836591180000000),
        ("1583836591_5", 1583836591000000005),
        ("1234567890", 1234567890000000000),
        ("0000000012", None),
        ("000012", None),
        ("pose", None),
        ("15569195938203752", None),
    ],
)
def test_times_in_names(name: str, time: int | None) -> None:
    assert time_of_name(name) == time


def test_numbers_in_names_count_as_numbers(tmp_path: Path) -> None:
    """scan_10 comes after scan_9, though not in the alphabet; fractions are no counts."""
    names = [*(f"scan_{k}.ply" for k in range(12)), "scan_12.18.ply", "scan_12.9.ply"]
    for name in names[::-1]:
        (tmp_path / name).write_text("")
    assert [file.name for file in cloud_files(tmp_path)] == names


@pytest.mark.parametrize("digits", [3, 6])
def test_fractions_of_equal_length_are_milli_or_microseconds(digits: int) -> None:
    stamps = [1583836591_950_000_000, 1583836592_050_000_000]
    parts = [(stamp // 10**9, stamp % 10**9 // 10 ** (9 - digits)) for stamp in stamps]
    files = [Path(f"cloud_{second}_{rest:0{digits}d}.pcd") for second, rest in parts]
    assert times_of_files(files, "names", Path(), "").tolist() == stamps


def test_times_of_names_rates_and_tables(folder: Path) -> None:
    change(folder, times=None, poses=None)
    with pytest.raises(DatasetError, match=r"nothing tells the time of 000000.ply; say times"):
        open_dataset(folder)
    change(folder, times=None, rate=20)
    assert np.diff(open_dataset(folder).times).tolist() == [50_000_000] * 4
    (folder / "stamps.txt").rename(folder / "times.txt")
    change(folder, times=None)
    np.testing.assert_array_equal(open_dataset(folder).times, DRIVE.times)
    (folder / "times.txt").unlink()
    for k, time in enumerate(DRIVE.times):
        (folder / f"{k:06d}.ply").rename(folder / f"{time}.ply")
    change(folder, times=None)
    assert open_dataset(folder).sweep(1).name == str(DRIVE.times[1])
    np.testing.assert_array_equal(open_dataset(folder).times, DRIVE.times)


@pytest.mark.parametrize("digits", [19, 16, 13])
def test_counts_since_1970_and_comments_in_tables(folder: Path, digits: int) -> None:
    """As names of files give times; seconds are told by their point."""
    unit = 10 ** (19 - digits)
    counts = (DRIVE.times // unit).tolist()
    text = "# stamps\n" + "".join(f"{count}  # sweep {k}\n" for k, count in enumerate(counts))
    (folder / "stamps.txt").write_text(text.replace(str(counts[3]), seconds(DRIVE.times[3:4])[:-1]))
    (folder / "front.txt").write_text("".join(f"{t}\n" for t in DRIVE.image_times))
    dataset = open_dataset(folder)
    expected = DRIVE.times // unit * unit
    expected[3] = DRIVE.times[3]
    np.testing.assert_array_equal(dataset.times, expected)
    np.testing.assert_array_equal(dataset.cameras["front"].times, DRIVE.image_times)


def test_a_declared_instant_moves_the_points(folder: Path) -> None:
    """Times from the first point on, and a stamp at the end of the sweep."""
    before = open_dataset(folder).sweep(1).relative_time
    change(folder, stamp="end")
    late = open_dataset(folder).sweep(1).relative_time[DRIVE.usable(1)]
    assert -1 < late.min() < -0.95
    assert abs(late.max()) < 0.01
    shift = late - before[DRIVE.usable(1)]
    np.testing.assert_allclose(shift, shift[0], atol=1e-6)


def test_a_jump_of_the_points_clock_is_told(folder: Path, caplog) -> None:
    rows = folder_rows(3)
    rows["time"] += 4.0
    write_vertices(folder / "000003.ply", rows, [])
    dataset = open_dataset(folder)
    assert dataset.sweep(3).relative_time is None
    assert "000003.ply (frame 3): points are measured more than a sweep and a half" in caplog.text


# ---- poses, world, LiDARs


@pytest.mark.parametrize("name", ["time_us", "PointTimestamp", "scalar_GpsTime"])
def test_times_of_points_of_other_names(folder: Path, name: str) -> None:
    expected = open_dataset(folder).sweep(1).relative_time
    for k in range(DRIVE.count):
        rows = rfn.rename_fields(folder_rows(k), {"time": name})
        write_vertices(folder / f"{k:06d}.ply", rows, [])
    np.testing.assert_array_equal(open_dataset(folder).sweep(1).relative_time, expected)


def test_times_that_are_all_nan_are_none(folder: Path, caplog) -> None:
    for k in range(DRIVE.count):
        rows = folder_rows(k)
        rows["time"] = np.nan
        write_vertices(folder / f"{k:06d}.ply", rows, [])
    (folder / "docdepth.yaml").write_text("rate: 10\n")
    open_dataset(folder)
    assert "points have no times" in caplog.text


def test_points_of_the_world_come_to_the_lidar(folder: Path) -> None:
    """Doubles of a map far away lose nothing."""
    far = DRIVE.poses.copy()
    far[:, :3, 3] += [431_000, 5_400_000, 120]
    write_kitti(folder / "poses.txt", far)
    for k in range(DRIVE.count):
        rows = folder_rows(k)
        doubles = [(n, "<f8" if n in "xyz" else rows.dtype[n]) for n in rows.dtype.names]
        moved = DRIVE.points(k).astype("f8") @ far[k, :3, :3].T + far[k, :3, 3]
        moved[(DRIVE.points(k) == 0).all(axis=1)] = 0  # no returns
        rows = rows.astype(doubles)
        rows["x"], rows["y"], rows["z"] = moved.T
        write_vertices(folder / f"{k:06d}.ply", rows, [])
    change(folder, frame="world")
    dataset = open_dataset(folder)
    check(dataset, "folder")
    kept = DRIVE.usable(4)
    np.testing.assert_allclose(dataset.sweep(4).points[kept], DRIVE.points(4)[kept], atol=1e-5)
    change(folder, frame="world", poses=None)
    with pytest.raises(DatasetError, match="points are in the world, but there are no poses"):
        open_dataset(folder)


@pytest.mark.parametrize("late", [0, 50_000_000])
def test_two_lidars(tmp_path: Path, late: int) -> None:
    """Each is compensated to its own stamps, and moved from there."""
    clouds = tmp_path / "clouds"
    for name in ("left", "right"):
        (clouds / name).mkdir(parents=True)
        for k in range(DRIVE.count):
            rows = folder_rows(k)
            if name == "right":
                own = (DRIVE.points(k).astype("f8") - T_OTHER[:3, 3]) @ T_OTHER[:3, :3]
                rows["x"], rows["y"], rows["z"] = own.T
            write_vertices(clouds / name / f"{k:06d}.ply", rows, [])
    lidars = {
        "left": {"sweeps": "left", "times": "stamps.txt"},
        "right": {"sweeps": "right", "times": "late.txt", "T_lidar_sensor": T_OTHER.tolist()},
    }
    write_beside(clouds, lidars=lidars, times=None, motion_compensated=bool(late))
    (clouds / "late.txt").write_text(seconds(DRIVE.times + late))
    dataset = open_dataset(clouds)
    if not late:
        check(dataset, "folder")
    n, kept = len(DRIVE.rows(0)), DRIVE.usable(0)
    sweep = dataset.sweep(0)
    np.testing.assert_allclose(sweep.points[n:][kept], DRIVE.points(0)[kept], atol=2e-6)
    np.testing.assert_array_equal(sweep.sensor_rig.T_lidar_sensor[1], T_OTHER)
    if late:
        motion = se3_exp(np.zeros(3), np.array([2.0, 0, 0]))  # metres a sweep
        moved = deskewed_points(sweep, 0, motion) - sweep.points
        share = late / DRIVE.period
        np.testing.assert_allclose(moved[:n][kept], 0)
        np.testing.assert_allclose(
            moved[n:][kept], np.tile([2 * share, 0, 0], (kept.sum(), 1)), atol=2e-6
        )


def test_where_the_lidar_looks_from(folder: Path) -> None:
    change(folder, sensor_origin=[0.1, 0, 0.2])
    rig = open_dataset(folder).sweep(1).sensor_rig
    np.testing.assert_array_equal(rig.T_lidar_sensor[0, :3, 3], [0.1, 0, 0.2])
    change(folder, sensor_origin=[0, 0, 1e4])
    with pytest.raises(DatasetError, match=r"sensor_origin must be \[x, y, z\] in metres"):
        open_dataset(folder)


# ---- mistakes in docdepth.yaml


CAMERA = {"K": [9, 9, 5, 5], "size": [10, 10]}
LOOKS_AHEAD = {"model": "fisheye", "T_camera_lidar": [0.0, -1, 0, 0, 0, 0, -1, 0, 1, 0, 0, 0]}


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        ({"motion_compansated": True}, "motion_compansated is unknown; there are ego_boxes"),
        ({"cameras": {"a": {"k": [1]}}}, "cameras.a.k is unknown"),
        (
            {"cameras": {"a": CAMERA | {**LOOKS_AHEAD, "distortion": [0.1] * 5}}},
            "docdepth.yaml, a: the distortion of a fisheye is",
        ),
        ({"scene": "city", "seed": 3}, "scene, seed are unknown"),
        ({"motion_compensated": "maybe"}, "_compensated is 'maybe': it must be true or false$"),
        ({"stamp": "begin"}, "stamp is 'begin': it must be 'start', 'middle' or 'end'"),
        ({"times": None, "rate": 0}, "rate is 0: it must be greater than 0"),
        ({"times": "gone.txt"}, "gone.txt is missing"),
        ({"sweeps": "gone"}, "gone, the folder of the sweeps, is not there"),
        ({"poses": "gone.txt"}, "gone.txt is missing"),
        ({"cameras": {"a": {"K": [1, 2]}}}, "a: K must be 4 numbers"),
        ({"cameras": {"a": {"K": [9, 9, 5, 5]}}}, "a has neither images nor size"),
        ({"cameras": {"a": CAMERA | {"K": [9, float("nan"), 5, 5]}}}, "a: K must be a 3x3"),
        ({"cameras": {"a": CAMERA}}, "T_camera_lidar must be 16 numbers"),
        (
            {"cameras": {"a": CAMERA | {"T_camera_lidar": [2.0] * 16}}},
            "T_camera_lidar must be a 4x4 r",
        ),
        ({"cameras": {"a": {"images": "gone"}}}, "a: .*gone holds no images"),
        (
            {"cameras": {"a": CAMERA | {"T_camera_lidar": [1.0, 0, 0, 0, 0, -1, *[0] * 4, 1, 0]}}},
            "mirrors .determinant below 0",
        ),
        ({"labels": "gone"}, "there is no folder .*gone of labels"),
        ({"lidars": {"a": {"sweeps": "."}}}, "sweeps and times are of one LiDAR"),
        (
            {
                "times": None,
                "lidars": {n: {"sweeps": ".", "times": "stamps.txt"} for n in "ab"},
                "sensor_origin": [0, 0, 1],
            },
            "sensor_origin is of one LiDAR, but there are 2",
        ),
    ],
)
def test_wrong_entries_are_named(folder: Path, entries: dict, message: str) -> None:
    change(folder, **entries)
    with pytest.raises(DocDepthError, match=message) as caught:
        open_dataset(folder)
    assert "docdepth.yaml" in str(caught.value) or "gone" in str(caught.value)


@pytest.mark.parametrize("name", ["../../out", "", "all", "a\nb", "x" * 5000])
def test_names_of_cameras_stay_in_the_run(folder: Path, name: str) -> None:
    change(folder, cameras={name: settings()["cameras"]["front"]})
    with pytest.raises(DocDepthError, match="a camera cannot be called"):
        open_dataset(folder)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("times: [", r"line 1: a bracket is not closed"),
        ("rate: 10\ncameras:\n  a:\n    K: [1, 2\n  b: 3", r"line 4: a bracket is not closed"),
        ("rate: 10\n\tup: [0, 0, 1]", r"line 2: a tab .*; indent by spaces"),
        ("times: a: b", r"line 1: .* quote a text"),
        ("cameras:\n    a: 1\n  b: 2", r"line 3: the line is indented otherwise than those"),
        ("times: 'a", r"line 1: a quote is not closed"),
        ("times: *a", r"line 1: found undefined alias 'a'; write NAME: VALUE"),
        ("times: a\nrate: 10\ntimes: b", r"line 3: 'times' stands twice; keep one of the two"),
    ],
)
def test_a_file_that_is_not_yaml(folder: Path, text: str, message: str) -> None:
    (folder / "docdepth.yaml").write_text(text)
    with pytest.raises(DatasetError, match=rf"docdepth.yaml is not YAML: {message}") as caught:
        open_dataset(folder)
    assert "\n" not in str(caught.value)
    assert "<" not in str(caught.value)


def test_columns_that_do_not_fit(tmp_path: Path) -> None:
    written = WRITERS["folder of bin"][1](tmp_path)
    entries = yaml.safe_load((written.path / "docdepth.yaml").read_text())
    (written.path / "docdepth.yaml").write_text(
        yaml.safe_dump(entries | {"columns": [*"xyz____"], "dtype": "float32"})
    )
    with pytest.raises(
        DatasetError, match=r"000000.bin \(frame 0\).*a multiple of 28 \(x y z _ _ _ _ as fl"
    ):
        open_dataset(written.path)


def test_folders_of_two_kinds_or_of_none(folder: Path) -> None:
    write_pcd(folder / "000000.pcd", folder_rows(0))
    with pytest.raises(DatasetError, match=r"holds .pcd and .ply files"):
        open_dataset(folder)
    (folder / "other").mkdir()
    change(folder, sweeps="other")
    with pytest.raises(DatasetError, match=r"other holds no point clouds"):
        open_dataset(folder)


# ---- poses in VIEWPOINT


def test_classes_of_dynamicmap_benchmark_are_labels_and_no_intensity(tmp_path: Path) -> None:
    dataset = open_dataset(WRITERS["DynamicMap_Benchmark"][1](tmp_path).path)
    rings = DRIVE.rows(1)["ring"][DRIVE.usable(1)]
    np.testing.assert_array_equal(dataset.labels(1), np.where(rings == 3, 251, 9))
    assert dataset.sweep(1).intensity is None
    assert dataset.sweep(1).motion_compensated


def test_a_viewpoint_that_was_never_written_is_refused(tmp_path: Path) -> None:
    path = WRITERS["folder of binary pcd"][1](tmp_path).path
    change(path, poses="viewpoint", frame="world")
    with pytest.raises(DatasetError, match=r"VIEWPOINT is 0 0 0 1 0 0 0 in every file"):
        open_dataset(path)
    write_pcd(path / "000004.pcd", folder_rows(4), viewpoint=[1, 2, 3, 0, 0, 0, 0])
    with pytest.raises(DatasetError, match=r"000004.pcd \(frame 4\): VIEWPOINT is no pose"):
        open_dataset(path)


@pytest.mark.parametrize("written", ["lidar", "world"])
@pytest.mark.parametrize("told", ["lidar", "world"])
def test_points_of_another_frame_than_is_told(tmp_path: Path, written: str, told: str) -> None:
    """PCL keeps points in the sensor's frame, DynamicMap_Benchmark in the world."""
    (tmp_path / "pcd").mkdir()
    for k in range(5):
        rows, goes = folder_rows(k), np.array([4.0 * k, 1.0 * k, 0.5])
        if written == "world":
            for n, axis in enumerate("xyz"):
                rows[axis] += goes[n]
        viewpoint = [*goes, 1, 0, 0, 0]
        write_pcd(tmp_path / "pcd" / f"{k:06d}.pcd", rows, viewpoint=viewpoint)
    (tmp_path / "docdepth.yaml").write_text(f"frame: {told}\n")
    if told == written:
        open_dataset(tmp_path, "dynamic_map")
        return
    with pytest.raises(DatasetError, match=rf"not in the frame '{told}'.*say frame: {written}"):
        open_dataset(tmp_path, "dynamic_map")


def test_poses_in_headers_are_told_and_used_when_asked_for(tmp_path: Path, caplog) -> None:
    path = WRITERS["folder of binary pcd"][1](tmp_path).path
    for k in range(5):
        viewpoint = [k, 0, 0.5, 1, 0, 0, 0]
        write_pcd(path / f"{k:06d}.pcd", folder_rows(k), viewpoint=viewpoint)
    change(path, poses=None)
    assert open_dataset(path).poses is None
    assert "PCD files hold poses (VIEWPOINT), which are not used; say poses: view" in caplog.text
    change(path, poses="viewpoint")
    dataset = open_dataset(path)
    np.testing.assert_array_equal(dataset.poses[:, :3, 3], [[k, 0, 0.5] for k in range(5)])
    np.testing.assert_array_equal(dataset.sweep(2).points, DRIVE.points(2))


@pytest.mark.parametrize(("model", "kept"), [("fisheye", True), ("pinhole", False)])
def test_zeros_are_a_lens_of_a_fisheye_only(folder: Path, model: str, kept: bool) -> None:
    """A fisheye without coefficients is equidistant, which no pinhole is."""
    camera = settings()["cameras"]["front"]
    change(folder, cameras={"front": camera | {"model": model, "distortion": [0.0] * 4}})
    stream = open_dataset(folder).cameras["front"]
    assert stream.model == model
    assert (stream.distortion is not None) == kept


def test_doubles_with_rows_of_nan_are_told(tmp_path: Path) -> None:
    rows = np.random.default_rng(0).uniform(-40, 40, (900, 4))
    rows[:, 2:] /= 50
    rows[-60:] = np.nan
    assert "float64" in (foreign_format(rows.tobytes()) or "")
    assert foreign_format(rows.astype("<f4").tobytes()) is None


def test_compressed_pcd_that_did_not_become_smaller(tmp_path: Path) -> None:
    """pypcd4 and others store the values as they are, and call them compressed."""
    columns = np.random.default_rng(0).uniform(-40, 40, (3, 50)).astype("<f4")
    head = (
        "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 50\nHEIGHT 1\n"
        "VIEWPOINT 0 0 0 1 0 0 0\nPOINTS 50\nDATA binary_compressed\n"
    )
    size = columns.nbytes.to_bytes(4, "little")
    (tmp_path / "one.pcd").write_bytes(head.encode() + 2 * size + columns.tobytes())
    rows, _ = read_pcd(tmp_path / "one.pcd")
    np.testing.assert_array_equal(np.stack([rows[axis] for axis in "xyz"]), columns)
