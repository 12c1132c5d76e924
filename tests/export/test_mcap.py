"""A bag in an MCAP file, read by Foxglove's library and by docdepth itself, and compared."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

import docdepth
from docdepth.datasets import open_dataset
from docdepth.errors import ConfigError
from docdepth.export import export
from docdepth.pipeline.run_reader import Run

read = pytest.importorskip("mcap_ros2.reader").read_ros2_messages


@pytest.fixture(scope="module")
def run(finished: tuple[Path, str]) -> Run:
    return docdepth.open_run(finished[0])


@pytest.fixture(scope="module")
def bag(run: Run, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bags") / "bag"
    assert export(run, folder, "mcap") == 4
    return folder


@pytest.fixture(scope="module")
def messages(bag: Path) -> dict[str, dict[int, Any]]:
    """By topic and time."""
    found: dict[str, dict[int, Any]] = defaultdict(dict)
    (file,) = bag.glob("*.mcap")
    for message in read(file):
        found[message.channel.topic][message.log_time_ns] = message.ros_msg
    return found


def matrix(transform: Any) -> NDArray[np.float64]:
    """By the formula for unit quaternions."""
    q = transform.rotation
    u, w = np.array([q.x, q.y, q.z]), q.w
    cross = np.array([[0, -u[2], u[1]], [u[2], 0, -u[0]], [-u[1], u[0], 0]])
    T = np.eye(4)
    T[:3, :3] = (w * w - u @ u) * np.eye(3) + 2 * np.outer(u, u) + 2 * w * cross
    T[:3, 3] = transform.translation.x, transform.translation.y, transform.translation.z
    return T


def test_sweeps_lie_where_they_are(run: Run, messages: dict[str, dict[int, Any]]) -> None:
    clouds, poses = messages["/points"], messages["/tf"]
    assert list(clouds) == run.trajectory.times.tolist()
    kinds = {7: "<f4", 4: "<u2"}
    for (time, cloud), frame, T in zip(
        clouds.items(), run.sweeps, run.trajectory.poses, strict=True
    ):
        names = [f.name for f in cloud.fields]
        dtype = np.dtype({
            "names": names,
            "formats": [kinds[f.datatype] for f in cloud.fields],
            "offsets": [f.offset for f in cloud.fields],
            "itemsize": cloud.point_step,
        })  # fmt: skip
        rows = np.frombuffer(bytes(cloud.data), dtype)
        assert np.array_equal(np.stack([rows[n] for n in "xyz"], 1), frame.points)
        assert np.array_equal(rows["class"], frame.classes)
        assert frame.instance is not None
        assert np.array_equal(rows["instance"], frame.instance)
        (transform,) = poses[time].transforms
        frames = transform.header.frame_id, transform.child_frame_id, cloud.header.frame_id
        assert frames == ("world", "lidar", "lidar")
        assert np.allclose(matrix(transform.transform), T, atol=1e-12)


def test_images_are_those_of_the_run(run: Run, messages: dict[str, dict[int, Any]]) -> None:
    images = run.cameras["image_2"]
    (fixed,) = messages["/tf_static"].values()
    T_lidar_camera = matrix(fixed.transforms[0].transform)
    for image in images:
        of = {
            name: messages[f"/image_2/{name}"][image.time]
            for name in ("camera_info", "depth", "image/compressed")
        }
        assert {message.header.frame_id for message in of.values()} == {"image_2"}
        assert np.array_equal(np.reshape(of["camera_info"].k, (3, 3)), image.K)
        size = of["depth"].height, of["depth"].width
        depth = np.frombuffer(bytes(of["depth"].data), np.float32).reshape(size)
        assert np.array_equal(depth, image.depth, equal_nan=True)
        png = np.frombuffer(bytes(of["image/compressed"].data), np.uint8)
        photo = cv2.imdecode(png, cv2.IMREAD_COLOR)
        assert photo is not None
        assert image.image is not None
        assert np.array_equal(photo[..., ::-1], image.image)
        (transform,) = messages["/tf"][image.time].transforms
        T = matrix(transform.transform) @ T_lidar_camera
        assert np.allclose(T, image.T_world_camera, atol=1e-9)


def test_boxes_hold_the_points_of_their_tracks(
    run: Run, messages: dict[str, dict[int, Any]]
) -> None:
    inside = every = 0
    for index, (time, found) in enumerate(messages["/objects"].items()):
        frame, T_world_lidar = run.sweeps[index], run.trajectory.poses[index]
        places = frame.points @ T_world_lidar[:3, :3].T + T_world_lidar[:3, 3]
        first, *boxes = found.markers
        assert first.action == 3  # deletes those before
        assert {box.id for box in boxes} == {t.id for t in run.tracks.between(time, time)}
        for box in boxes:
            box.pose.translation, box.pose.rotation = box.pose.position, box.pose.orientation
            T = np.linalg.inv(matrix(box.pose))
            half = np.array([box.scale.x, box.scale.y, box.scale.z]) / 2
            own = places[frame.instance == box.id]
            inside += (np.abs(own @ T[:3, :3].T + T[:3, 3]) < half + 0.3).all(1).sum()
            every += len(own)
    assert every > 100
    assert inside > 0.95 * every


def test_docdepth_reads_the_sweeps_again(run: Run, bag: Path) -> None:
    recording = open_dataset(bag)
    assert len(recording) == len(run.sweeps)
    for index, frame in enumerate(run.sweeps):
        assert np.array_equal(recording.sweep(index).points, frame.points)


def test_a_name_of_a_file_is_no_folder(run: Run, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"mcap is a folder of files; name it .*/bag$"):
        export(run, tmp_path / "bag.mcap", "mcap")
    assert not list(tmp_path.iterdir())
