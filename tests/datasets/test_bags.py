"""Bags of all kinds of drivers, and the ways in which bags are odd or broken."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from bags import BagWriter, padded_rows, write_drive
from conformance import check, differences
from made_up import DISTORTION, DRIVE, EMPTY, SIZE, K

from docdepth.config import Parameters
from docdepth.datasets import image_streams, open_dataset
from docdepth.datasets.formats.bag import bag_file
from docdepth.errors import DatasetError
from docdepth.geometry.se3 import inverse, poses_from, rotation_exp
from docdepth.io.inputs import RunInputs
from docdepth.pipeline.check import check_inputs

pytest.importorskip("rosbags")

KINDS = ["ros1", "db3", "mcap"]
T_OTHER = poses_from([rotation_exp([0.1, -0.05, 0.5])], [[0.3, 1.2, -0.4]])[0]


def place(root: Path, kind: str) -> Path:
    return root / ("drive.bag" if kind == "ros1" else "drive")


def say(path: Path, **entries) -> None:
    folder = path if path.is_dir() else path.parent
    (folder / "docdepth.yaml").write_text(yaml.safe_dump(entries))


def points_alone(path: Path, kind: str, message, **recorded) -> Path:
    """A bag with ``message(bag, k, time)`` as /points for each sweep."""
    with BagWriter(path, kind) as bag:
        for k, time in enumerate(DRIVE.times.tolist()):
            bag.write("/points", message(bag, k, time), recorded.get("recorded", time) + k)
    return path


# ---- layouts of points


@pytest.mark.parametrize("kind", ["ros1", "mcap"])
def test_big_endian_clouds(tmp_path: Path, kind: str) -> None:
    path = place(tmp_path, kind)
    points_alone(path, kind, lambda bag, k, t: bag.cloud(padded_rows(k), t, big_endian=True))
    dataset = open_dataset(path)
    check(dataset, "bag")
    np.testing.assert_array_equal(dataset.sweep(1).points, DRIVE.points(1))


def test_clouds_of_rows_with_padding(tmp_path: Path) -> None:
    """Ouster's drivers send images of points: a row for each laser."""

    def message(bag, k, time):
        rows = padded_rows(k)[:400]
        cloud = bag.cloud(rows, time)
        lines = cloud.data.reshape(8, -1)
        cloud.height, cloud.width, cloud.row_step = 8, 50, lines.shape[1] + 24
        cloud.data = np.hstack([lines, np.full((8, 24), 77, np.uint8)]).ravel()
        return cloud

    dataset = open_dataset(points_alone(tmp_path / "drive", "db3", message))
    check(dataset, "bag")
    np.testing.assert_array_equal(dataset.sweep(2).points, DRIVE.points(2)[:400])
    np.testing.assert_array_equal(dataset.sweep(2).ring, DRIVE.rows(2)["ring"][:400])


@pytest.mark.parametrize(
    ("kind", "package"), [("ros1", "livox_ros_driver"), ("mcap", "livox_ros_driver2")]
)
def test_livox_messages(tmp_path: Path, kind: str, package: str) -> None:
    from rosbags.typesys import get_types_from_msg

    from docdepth.datasets.formats.bag.bag_file import _DEFINITIONS

    path = place(tmp_path, kind)
    with BagWriter(path, kind) as bag:
        for name in ("CustomPoint", "CustomMsg"):
            text = _DEFINITIONS[f"{package}/msg/{name}"]
            bag.types.register(get_types_from_msg(text, f"{package}/msg/{name}"))
        for k, time in enumerate(DRIVE.times.tolist()):
            rows = DRIVE.rows(k)[:-EMPTY]
            late = np.round((rows["share"] + 0.5) * DRIVE.period).astype(int)
            points = [
                bag.make(f"{package}/msg/CustomPoint", int(ns), float(r["x"]), float(r["y"]),
                         float(r["z"]), int(r["intensity"]), 0, int(r["ring"]))
                for r, ns in zip(rows, late, strict=True)
            ]  # fmt: skip
            message = bag.make(
                f"{package}/msg/CustomMsg", bag.header(time, "livox"), time, len(points), 0,
                np.zeros(3, np.uint8), points,
            )  # fmt: skip
            bag.write("/livox/lidar", message, time)
    dataset = open_dataset(path)
    check(dataset, "bag")
    sweep, rows = dataset.sweep(3), DRIVE.rows(3)[:-EMPTY]
    np.testing.assert_array_equal(sweep.points, DRIVE.points(3)[:-EMPTY])
    np.testing.assert_allclose(sweep.relative_time, rows["share"] + 0.5, atol=1e-6)
    np.testing.assert_array_equal(sweep.ring, rows["ring"])
    np.testing.assert_array_equal(sweep.intensity, rows["intensity"])


# ---- images and cameras


def one_camera(
    path: Path, image=lambda image: image, info=lambda info: None, topic="/cam/image_raw",
    transforms="/tf_static", moves=lambda k: DRIVE.T_camera_lidar, D=(0.0,) * 5, K=K,
    message=None, **encoding: str,
) -> Path:  # fmt: skip
    """A bag with a camera, whose images and CameraInfo are changed before they are written."""
    with BagWriter(path, "mcap") as bag:
        for k, time in enumerate(DRIVE.times.tolist()):
            bag.write("/points", bag.cloud(padded_rows(k), time), time)
        for k, time in enumerate(DRIVE.image_times.tolist()):
            sent = message(bag, k, time) if message else bag.image(
                image(DRIVE.image(k)), time, **encoding
            )  # fmt: skip
            bag.write(topic, sent, time)
            about = bag.camera_info(K, np.array(D), SIZE, time)
            info(about)
            bag.write("/cam/camera_info", about, time)
            bag.write(transforms, bag.transform("lidar", "camera", moves(k), time), time)
    return path


@pytest.mark.parametrize(
    ("encoding", "code"),
    [
        ("rgb8", cv2.COLOR_BGR2RGB),
        ("bgra8", cv2.COLOR_BGR2BGRA),
        ("mono8", cv2.COLOR_BGR2GRAY),
    ],
)
def test_encodings_of_images(tmp_path: Path, encoding: str, code: int) -> None:
    path = one_camera(tmp_path / "a", lambda image: cv2.cvtColor(image, code), encoding=encoding)
    expected = DRIVE.image(0)
    if encoding == "mono8":
        expected = cv2.cvtColor(cv2.cvtColor(expected, code), cv2.COLOR_GRAY2BGR)
    read = open_dataset(path).cameras["cam"].rectified_image(0)
    np.testing.assert_array_equal(read, expected)


@pytest.mark.parametrize("topic", ["/cam/image_rect", "/cam/image_raw"])
def test_rectified_images_of_a_stereo_pair_look_another_way(tmp_path: Path, topic: str) -> None:
    turn = rotation_exp(np.array([0.01, -0.02, 0.005]))
    path = one_camera(tmp_path / "a", info=lambda info: setattr(info, "r", turn.ravel()),
                      topic=topic)  # fmt: skip
    (camera,) = open_dataset(path).cameras.values()
    expected = DRIVE.T_camera_lidar.copy()
    if topic.endswith("rect"):
        expected[:3] = turn @ expected[:3]
    np.testing.assert_allclose(camera.T_camera_lidar, expected, atol=1e-9)


def test_intrinsics_of_other_images_are_refused(tmp_path: Path, caplog) -> None:
    """As kitti2bag writes them: rectified images, with K and D of those before."""
    larger = K.copy()
    larger[:2] *= 1.33
    larger[:2, 2] = 0.56 * SIZE[0], 0.6 * SIZE[1]
    P = np.hstack([K, np.zeros((3, 1))]).ravel()
    path = one_camera(
        tmp_path / "a", info=lambda info: setattr(info, "p", P), D=DISTORTION, K=larger
    )
    assert not open_dataset(path).cameras
    assert "they may be rectified already" in caplog.text


@pytest.mark.parametrize("big_endian", [False, True])
@pytest.mark.parametrize("encoding", ["mono16", "16UC1"])
def test_photos_of_sixteen_bits(tmp_path: Path, encoding: str, big_endian: bool) -> None:
    """Of 12 bits, as machine vision cameras and thermal ones send them; depth is no photo."""
    deep = cv2.cvtColor(DRIVE.image(0), cv2.COLOR_BGR2GRAY).astype(">u2" if big_endian else "<u2")
    deep[0, 0] = 255

    def message(bag, k, time):
        rows = (deep * 16).astype(deep.dtype).view(np.uint8).reshape(SIZE[1], -1)
        image = bag.image(rows, time, encoding=encoding)
        image.width, image.is_bigendian = SIZE[0], int(big_endian)
        return image

    cameras = open_dataset(one_camera(tmp_path / "a", message=message)).cameras
    assert list(cameras) == (["cam"] if encoding == "mono16" else [])
    for camera in cameras.values():
        np.testing.assert_array_equal(camera.rectified_image(0)[:, :, 0], deep)


def test_images_that_are_binned_or_a_part_of_the_sensor(tmp_path: Path) -> None:
    def tell(info) -> None:
        info.binning_x, info.binning_y = 2, 2
        info.roi.x_offset, info.roi.y_offset, info.roi.width, info.roi.height = 10, 6, 40, 30

    path = one_camera(tmp_path / "a", lambda image: image[6:36:2, 10:50:2], tell)
    camera = open_dataset(path).cameras["cam"].camera
    assert (camera.width, camera.height) == (20, 15)
    np.testing.assert_allclose(camera.K[:2, 2], (K[:2, 2] - (10, 6)) / 2)
    np.testing.assert_allclose(np.diag(camera.K)[:2], np.diag(K)[:2] / 2)


def test_a_camera_info_without_size_or_of_another_one(tmp_path: Path, caplog) -> None:
    def without(info) -> None:
        info.width = info.height = 0

    camera = open_dataset(one_camera(tmp_path / "a", info=without)).cameras["cam"]
    assert (camera.camera.width, camera.camera.height) == SIZE
    small = one_camera(tmp_path / "b", lambda image: image[::2, ::2])
    assert open_dataset(small).cameras == {}
    assert f"its CameraInfo is of {SIZE[0]} x {SIZE[1]} pixels" in caplog.text


def test_a_model_of_realsense_without_distortion(tmp_path: Path) -> None:
    def tell(info) -> None:
        info.distortion_model = "inverse_brown_conrady"

    path = one_camera(tmp_path / "a", info=tell)
    assert open_dataset(path).cameras["cam"].distortion is None


@pytest.mark.parametrize("topic", ["/tf", "/other"])
def test_extrinsics_that_are_sent_over_and_over(tmp_path: Path, topic: str) -> None:
    """Drivers of ROS 1 send them by /tf; any topic of transforms counts."""
    T = open_dataset(one_camera(tmp_path / "a", transforms=topic)).cameras["cam"].T_camera_lidar
    np.testing.assert_allclose(T, DRIVE.T_camera_lidar, atol=1e-12)


@pytest.mark.parametrize("wrong", ["rotation", "translation"])
def test_a_static_transform_that_is_none_is_named(tmp_path: Path, wrong: str, caplog) -> None:
    with BagWriter(tmp_path / "drive", "db3") as bag:
        for k, time in enumerate(DRIVE.times.tolist()):
            bag.write("/points", bag.cloud(padded_rows(k), time), time)
        message = bag.transform("wheel", "lidar", np.eye(4))
        transform = message.transforms[0].transform
        transform.rotation.w = 0.0 if wrong == "rotation" else 1.0
        transform.translation.x = 0.0 if wrong == "rotation" else float("nan")
        bag.write("/tf_static", message, 1)
    open_dataset(tmp_path / "drive")
    assert "the static transform of 'wheel' in 'lidar' is left out: " in caplog.text


def test_compressed_images_and_a_fisheye(tmp_path: Path) -> None:
    def message(bag, k, time):
        return bag.compressed(cv2.imencode(".png", DRIVE.image(k))[1].tobytes(), time)

    path = one_camera(
        tmp_path / "a", info=lambda info: setattr(info, "distortion_model", "equidistant"),
        topic="/cam/image_raw/compressed", D=DISTORTION[:4], message=message,
    )  # fmt: skip
    dataset = open_dataset(path)
    check(dataset, "bag")
    assert dataset.cameras["cam"].model == "fisheye"
    expected = cv2.fisheye.undistortImage(DRIVE.image(1), K, DISTORTION[:4], Knew=K)
    np.testing.assert_array_equal(dataset.cameras["cam"].rectified_image(1), expected)


def test_a_camera_without_calibration_is_named_and_left_out(tmp_path: Path, caplog) -> None:
    with BagWriter(tmp_path / "drive", "db3") as bag:
        for k, time in enumerate(DRIVE.times.tolist()):
            bag.write("/points", bag.cloud(padded_rows(k), time), time)
            bag.write("/cam/image_raw", bag.image(DRIVE.image(k), time), time)
    assert open_dataset(tmp_path / "drive").cameras == {}
    assert "there is no CameraInfo" in caplog.text
    say(tmp_path / "drive", cameras={"/cam/image_raw": {"K": [50, 51, 31.5, 24.25]}})
    caplog.clear()
    dataset = open_dataset(tmp_path / "drive")
    assert dataset.cameras == {}
    assert "no static transform connects" in caplog.text
    stream = image_streams(dataset)["cam"]
    np.testing.assert_array_equal(stream.camera.K, K)
    assert len(stream.images) == len(DRIVE.times)
    given = {"K": [50, 51, 31.5, 24.25], "T_camera_lidar": DRIVE.T_camera_lidar.tolist()}
    say(tmp_path / "drive", cameras={"/cam/image_raw": given})
    stream = open_dataset(tmp_path / "drive").cameras["cam"]
    np.testing.assert_array_equal(stream.camera.K, K)
    np.testing.assert_array_equal(stream.T_camera_lidar, DRIVE.T_camera_lidar)
    say(tmp_path / "drive", cameras={"/other": given})
    with pytest.raises(DatasetError, match=r"has no images of /other; there are /cam/image_raw"):
        open_dataset(tmp_path / "drive")


# ---- stamps


def test_messages_that_arrive_out_of_order_are_sorted_by_their_stamps(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "drive", "db3") as bag:
        for n, k in enumerate((1, 0, 3, 2, 4)):
            bag.write("/points", bag.cloud(padded_rows(k), int(DRIVE.times[k])), n)
    dataset = open_dataset(tmp_path / "drive")
    check(dataset, "bag")
    for k in range(5):
        np.testing.assert_array_equal(dataset.sweep(k).points, DRIVE.points(k))


def test_headers_without_stamps(tmp_path: Path) -> None:
    path = points_alone(tmp_path / "drive", "db3", lambda bag, k, t: bag.cloud(padded_rows(k), 0))
    with pytest.raises(DatasetError, match=r"/points: 5 of 5 headers have no stamps; say stamps: "):
        open_dataset(path)
    say(path, stamps="record")
    np.testing.assert_array_equal(open_dataset(path).times, DRIVE.times + np.arange(5))


def test_two_messages_with_one_stamp(tmp_path: Path) -> None:
    path = points_alone(
        tmp_path / "drive", "db3", lambda bag, k, t: bag.cloud(padded_rows(k), t - t % 10**9)
    )
    with pytest.raises(DatasetError, match=r"frames 0 and 1 have one stamp.*and 3 more"):
        open_dataset(path)


@pytest.mark.parametrize("kind", KINDS)
def test_messages_recorded_at_one_time_are_told_apart(tmp_path: Path, kind: str) -> None:
    with BagWriter(place(tmp_path, kind), kind) as bag:
        for k, time in enumerate(DRIVE.times.tolist()):
            bag.write("/points", bag.cloud(padded_rows(k), time), 5)
    dataset = open_dataset(place(tmp_path, kind))
    for k in (3, 0, 4):
        np.testing.assert_array_equal(dataset.sweep(k).points, DRIVE.points(k))


def test_clocks_that_differ_are_named(tmp_path: Path, caplog) -> None:
    boot = int(DRIVE.times[0]) - 5_000_000_000
    with BagWriter(tmp_path / "drive", "db3") as bag:
        for k, time in enumerate(DRIVE.times.tolist()):
            bag.write("/points", bag.cloud(padded_rows(k), time - boot), time)
        for k, time in enumerate(DRIVE.image_times.tolist()):
            bag.write("/cam/image_raw", bag.image(DRIVE.image(k), time), time)
            bag.write("/cam/camera_info", bag.camera_info(K, DISTORTION, SIZE, time), time)
        bag.write("/tf_static", bag.transform("lidar", "camera", DRIVE.T_camera_lidar), 1)
    open_dataset(tmp_path / "drive")
    assert "are on different clocks; say stamps: record" in caplog.text
    caplog.clear()
    say(tmp_path / "drive", stamps="record")
    dataset = open_dataset(tmp_path / "drive")
    check(dataset, "bag")
    np.testing.assert_array_equal(dataset.times, DRIVE.times)
    assert not caplog.records


@pytest.mark.parametrize("seconds", [2.0, 0.25])
def test_a_clock_that_is_set_back_is_named(tmp_path: Path, caplog, seconds: float) -> None:
    times = DRIVE.times.tolist()
    back = {time: time - (int(seconds * 1e9) if k >= 2 else 0) for k, time in enumerate(times)}
    with BagWriter(tmp_path / "drive", "mcap") as bag:
        for k, time in enumerate(times):
            bag.write("/points", bag.cloud(padded_rows(k), back[time]), time)
    open_dataset(tmp_path / "drive")
    step = seconds - 1e-9 * (times[2] - times[1])
    assert f"stamps jump back by {step:.1f} s behind message 1" in caplog.text
    assert "say stamps: record in" in caplog.text
    caplog.clear()
    say(tmp_path / "drive", stamps="record")
    assert open_dataset(tmp_path / "drive").times.tolist() == times
    assert "jump back" not in caplog.text


def test_a_message_that_comes_late_is_put_in_its_place(tmp_path: Path, caplog) -> None:
    times = DRIVE.times.tolist()
    with BagWriter(tmp_path / "drive", "mcap") as bag:
        for k, arrival in zip((0, 1, 3, 2, 4), times, strict=True):
            bag.write("/points", bag.cloud(padded_rows(k), times[k]), arrival)
    assert open_dataset(tmp_path / "drive").times.tolist() == times
    assert "jump back" not in caplog.text


@pytest.mark.parametrize(
    ("name", "word"), [("a.BAG", "call it a.bag"), ("a.bag.active", "rosbag reindex")]
)
def test_bags_of_other_names_are_to_be_renamed(tmp_path: Path, name: str, word: str) -> None:
    write_drive(tmp_path / "drive.bag", "ros1").rename(tmp_path / name)
    with pytest.raises(DatasetError, match=word):
        open_dataset(tmp_path / name)


# ---- several topics


def two_lidars(path: Path) -> Path:
    """A second LiDAR 20 ms later sees the same points, from another place."""
    with BagWriter(path, "mcap") as bag:
        message = bag.transform("right", "left", T_OTHER)
        bag.write("/tf_static", message, 1)
        for k, time in enumerate(DRIVE.times.tolist()):
            bag.write("/left", bag.cloud(padded_rows(k), time, "left"), time)
            rows = padded_rows(k)
            own = (DRIVE.points(k).astype("f8") - T_OTHER[:3, 3]) @ T_OTHER[:3, :3]
            rows["x"], rows["y"], rows["z"] = own.T
            later = time + 20_000_000
            bag.write("/right", bag.cloud(rows, later, "right"), later)
    return path


def test_several_topics_of_points_are_listed(tmp_path: Path) -> None:
    with pytest.raises(
        DatasetError,
        match=r"several topics of points: /left \(sensor_msgs.*/right .*lidars: {/left: }",
    ):
        open_dataset(two_lidars(tmp_path / "drive"))


def test_two_lidars_make_one_sweep(tmp_path: Path) -> None:
    path = two_lidars(tmp_path / "drive")
    say(path, lidars={"/left": None, "/right": None})
    dataset = open_dataset(path)
    check(dataset, "bag")
    assert list(dataset.lidars) == ["/left", "/right"]
    np.testing.assert_array_equal(dataset.lidars["/right"].times, DRIVE.times + 20_000_000)
    np.testing.assert_allclose(dataset.lidars["/right"].T_lidar_sensor, T_OTHER, atol=1e-12)
    sweep, n = dataset.sweep(2), len(DRIVE.rows(2))
    assert len(sweep.points) == 2 * n
    kept = DRIVE.usable(2)
    np.testing.assert_array_equal(sweep.points[:n], DRIVE.points(2))
    np.testing.assert_allclose(sweep.points[n:][kept], DRIVE.points(2)[kept], atol=2e-6)
    np.testing.assert_array_equal(sweep.sensor_rig.index, np.repeat([0, 1], n))
    shift = sweep.relative_time[n:][kept] - sweep.relative_time[:n][kept]
    np.testing.assert_allclose(shift, 20e6 / DRIVE.period, atol=1e-5)
    say(path, lidars={"/right": None})
    assert len(open_dataset(path).sweep(2).points) == n
    say(path, lidars={"/up": None})
    with pytest.raises(DatasetError, match="no points of /up; there are /left, /right"):
        open_dataset(path)


# ---- odd and broken bags


def test_a_bag_without_points(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "drive", "db3") as bag:
        bag.write("/cam/image_raw", bag.image(DRIVE.image(0), 5), 5)
    with pytest.raises(DatasetError, match=r"has no points .* its topics are /cam/image_raw"):
        open_dataset(tmp_path / "drive")


@pytest.mark.parametrize(
    ("kind", "metadata"), [("db3", None), ("mcap", "rosbag2_bagfile_information: {version: 5}\n")]
)
def test_bags_without_or_with_broken_metadata(tmp_path: Path, kind: str, metadata) -> None:
    path = write_drive(tmp_path / "drive", kind)
    right = open_dataset(path)
    (path / "metadata.yaml").unlink()
    if metadata:
        (path / "metadata.yaml").write_text(metadata)
    again = open_dataset(path)
    check(again, "bag")
    assert differences(again.sweep(3), right.sweep(3)) == []


@pytest.mark.parametrize("kind", ["bz2", "lz4", "mcap"])
def test_chunks_that_hold_too_much(tmp_path: Path, kind: str, monkeypatch) -> None:
    """A few kilobytes unpack to gigabytes."""
    path = tmp_path / ("drive" if kind == "mcap" else "drive.bag")
    bag = BagWriter(path, "mcap" if kind == "mcap" else "ros1")
    if kind == "mcap":
        from rosbags.rosbag2 import CompressionFormat, CompressionMode

        bag._bag.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    else:
        bag._bag.set_compression(type(bag._bag).CompressionFormat[kind.upper()])
    with bag:
        for k, time in enumerate(DRIVE.times.tolist()):
            bag.write("/points", bag.cloud(padded_rows(k), time), time)
        large = bag.compressed(bytes(1 << 21), int(DRIVE.times[-1]))
        bag.write("/cam/compressed", large, int(DRIVE.times[-1]))
    np.testing.assert_array_equal(open_dataset(path).sweep(1).points, DRIVE.points(1))
    monkeypatch.setattr(bag_file, "_MOST_UNPACKED", 1 << 20)
    with pytest.raises(DatasetError, match=r"drive.* is damaged .a chunk of [0-9]+ bytes is cut"):
        open_dataset(path)


def test_a_run_may_lie_beside_a_recording_that_is_a_file(tmp_path: Path) -> None:
    """As in ``docdepth run drive.bag -o run``."""
    bag = write_drive(tmp_path / "drive.bag", "ros1")
    inputs = RunInputs(recording=bag, camera="none")
    found = check_inputs(inputs, Parameters(), tmp_path / "run").findings
    assert [one for one in found if "lies in the recording" in str(one)] == []


@pytest.mark.parametrize("kind", KINDS)
def test_truncated_bags(tmp_path: Path, kind: str) -> None:
    path = write_drive(place(tmp_path, kind), kind)
    (file,) = [f for f in (path.iterdir() if path.is_dir() else [path]) if f.suffix != ".yaml"]
    content = file.read_bytes()
    for share in (0.05, 0.4, 0.8):
        file.write_bytes(content[: int(share * len(content))])
        with pytest.raises(DatasetError, match=f"{path.name}.*(reindex|copy)"):
            [open_dataset(path).sweep(k) for k in range(5)]


def test_bags_beside_each_other_are_recordings_of_their_own(tmp_path: Path) -> None:
    for name in ("morning.bag", "evening.bag"):
        write_drive(tmp_path / name, "ros1")
    with pytest.raises(DatasetError, match=r"holds 2 recordings; name one of .*evening.bag, "):
        open_dataset(tmp_path)


def test_parts_of_a_bag_are_one_recording(tmp_path: Path) -> None:
    folder = tmp_path / "parts"
    folder.mkdir()
    for part, frames in enumerate(([0, 1, 2], [3, 4])):
        with BagWriter(folder / f"2026-01-01_{part}.bag", "ros1") as bag:
            for k in frames:
                time = int(DRIVE.times[k])
                bag.write("/points", bag.cloud(padded_rows(k), time), time)
    dataset = open_dataset(folder)
    check(dataset, "bag")
    np.testing.assert_array_equal(dataset.times, DRIVE.times)
    shutil.copy(folder / "2026-01-01_1.bag", folder / "2026-01-01_3.bag")
    with pytest.raises(DatasetError, match="holds 3 recordings"):
        open_dataset(folder)


@pytest.mark.parametrize("first", [0, None])
def test_one_header_without_a_stamp(tmp_path: Path, first: int | None) -> None:
    """A simulation begins at 0; among stamps since 1970 there is none at 0."""
    since = DRIVE.times[0] if first is None else 0

    def message(bag, k, time):
        return bag.cloud(padded_rows(k), 0 if k == 0 else int(time - since))

    path = points_alone(tmp_path / "drive", "mcap", message)
    if first is None:
        assert open_dataset(path).times[0] == 0
    else:
        with pytest.raises(DatasetError, match=r"1 of 5 headers have no stamps; say stamps: rec"):
            open_dataset(path)


def test_lengths_of_rows_that_are_wrong(tmp_path: Path) -> None:
    def message(bag, k, time):
        cloud = bag.cloud(padded_rows(k), time)
        cloud.height, cloud.width = cloud.width, 1
        return cloud

    dataset = open_dataset(points_alone(tmp_path / "drive", "mcap", message))
    np.testing.assert_array_equal(dataset.sweep(2).points, DRIVE.points(2))


def test_of_two_fields_of_times_the_one_that_changes_is_taken(tmp_path: Path) -> None:
    def message(bag, k, time):
        rows = padded_rows(k)
        kinds = {"time": ("<f4", 0), "x": ("<f4", 4), "y": ("<f4", 8), "z": ("<f4", 12)}
        kinds["timestamp"] = ("<f8", 16)
        names, formats, offsets = list(kinds), *zip(*kinds.values(), strict=True)
        table = np.zeros(len(rows), {"names": names, "formats": formats, "offsets": offsets})
        for name in "xyz":
            table[name] = rows[name]
        table["timestamp"] = time * 1e-9 + rows["time"]
        return bag.cloud(table, time)

    sweep = open_dataset(points_alone(tmp_path / "drive", "mcap", message)).sweep(1)
    np.testing.assert_allclose(sweep.relative_time, DRIVE.rows(1)["share"], atol=1e-5)


def test_mcap_of_another_program(tmp_path: Path) -> None:
    writer = pytest.importorskip("mcap.writer").Writer(str(tmp_path / "a.mcap"))
    writer.start("", "a program")
    writer.finish()
    with pytest.raises(DatasetError, match=r"a.mcap cannot be opened.*MCAP of ROS 2 alone"):
        open_dataset(tmp_path / "a.mcap")


@pytest.mark.parametrize(
    ("sent", "told"),
    [
        ("base: designed, lidar: true", True),
        ("lidar: designed, base: true", True),  # which is the longer way
        ("base: true, lidar: designed, base: true", True),
        ("base: true, lidar: true", False),
    ],
)
def test_of_two_parents_of_a_frame_the_later_counts(tmp_path, caplog, sent, told) -> None:
    """A driver sends a place as designed, then the calibrated one in another frame."""
    true = inverse(DRIVE.T_camera_lidar)
    designed = true.copy()
    designed[:3, 3] += 1
    with BagWriter(tmp_path / "drive", "mcap") as bag:
        bag.write("/tf_static", bag.transform("base", "lidar", np.eye(4)), 0)
        for parent, place in (one.split(": ") for one in sent.split(", ")):
            T = true if place == "true" else designed
            bag.write("/tf_static", bag.transform("camera", parent, T), 0)
        for k, time in enumerate(DRIVE.times.tolist()):
            bag.write("/points", bag.cloud(padded_rows(k), time), time)
            bag.write("/cam/camera_info", bag.camera_info(K, DISTORTION, SIZE, time), time)
            bag.write("/cam/image_raw", bag.image(DRIVE.image(0), time), time)
    (camera,) = open_dataset(tmp_path / "drive").cameras.values()
    np.testing.assert_allclose(camera.T_camera_lidar, DRIVE.T_camera_lidar, atol=1e-9)
    assert ("static transforms put 'camera' in" in caplog.text) == told


@pytest.mark.parametrize(
    ("encoding", "named", "expected"),
    [
        ("bgr8", None, ["cam"]),
        ("unread", None, ["cam"]),
        ("bgr8", "/cam/image_raw/compressed", ["cam_image_raw", "cam_image_raw_compressed"]),
    ],
)
def test_raw_and_compressed_images_are_one_camera(
    tmp_path: Path, encoding: str, named: str | None, expected: list[str]
) -> None:
    path = tmp_path / "drive"
    with BagWriter(path, "mcap") as bag:
        bag.write("/tf_static", bag.transform("lidar", "camera", DRIVE.T_camera_lidar), 0)
        for k, time in enumerate(DRIVE.times.tolist()):
            bag.write("/points", bag.cloud(padded_rows(k), time), time)
            bag.write("/cam/camera_info", bag.camera_info(K, DISTORTION, SIZE, time), time)
            image = DRIVE.image(k)
            bag.write("/cam/image_raw", bag.image(image, time, encoding=encoding), time)
            png = cv2.imencode(".png", image)[1].tobytes()
            bag.write("/cam/image_raw/compressed", bag.compressed(png, time), time)
    if named:
        say(path, cameras={named: {}})
    assert sorted(open_dataset(path).cameras) == expected


def test_video_is_left_out_at_once(tmp_path: Path, caplog) -> None:
    path = tmp_path / "drive"
    with BagWriter(path, "mcap") as bag:
        for k, time in enumerate(DRIVE.times.tolist()):
            bag.write("/points", bag.cloud(padded_rows(k), time), time)
            bag.write("/cam/compressed", bag.compressed(bytes(99), time, format="h264"), time)
    assert not open_dataset(path).cameras
    assert "/cam/compressed holds video (h264)" in caplog.text
    assert "decode it to a topic of images" in caplog.text


@pytest.mark.parametrize(
    ("kind", "text", "values"),
    [
        (
            "ffmpeg_image_transport_msgs/msg/FFMPEGPacket",
            "std_msgs/Header header\nstring encoding\nuint64 pts\nuint8[] data",
            lambda bag, time: (bag.header(time, "cam"), "hevc", time),
        ),
        (
            "foxglove_msgs/msg/CompressedVideo",
            "builtin_interfaces/Time timestamp\nstring frame_id\nstring format\nuint8[] data",
            lambda bag, time: (bag.stamp(time), "cam", "h264"),
        ),
        (
            "theora_image_transport/msg/Packet",
            "std_msgs/Header header\nint32 b_o_s\nint64 packetno\nuint8[] data",
            lambda bag, time: (bag.header(time, "cam"), 1, 1),
        ),
        (
            "foxglove_msgs/msg/CompressedImage",
            "builtin_interfaces/Time timestamp\nstring frame_id\nstring format\nuint8[] data",
            lambda bag, time: (bag.stamp(time), "cam", "jpeg"),
        ),
    ],
)
def test_images_of_other_messages_are_told(tmp_path: Path, kind, text, values, caplog) -> None:
    from rosbags.typesys import get_types_from_msg

    path = write_drive(tmp_path / "plain", "mcap")
    open_dataset(path)
    assert "which docdepth does not read" not in caplog.text
    with BagWriter(tmp_path / "drive", "mcap") as bag:
        bag.types.register(get_types_from_msg(text, kind))
        for k, time in enumerate(DRIVE.times.tolist()):
            bag.write("/points", bag.cloud(padded_rows(k), time), time)
            message = bag.make(kind, *values(bag, time), np.zeros(9, np.uint8))
            bag.write("/cam/images", message, time)
    assert not open_dataset(tmp_path / "drive").cameras
    assert f"/cam/images holds images as {kind}, which docdepth does not read" in caplog.text
