"""Wrong extrinsics and times are seen in the images; right ones are left alone."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scenes  # noqa: F401  adds its scenes
import yaml

from docdepth.datasets import CameraStream, Dataset, Sweep, open_dataset
from docdepth.diagnostics.alignment import find_misalignment
from docdepth.diagnostics.sweeps import sample
from docdepth.geometry.se3 import matrix_to_quaternion, quaternion_to_matrix, rotation_exp

BETTER = "depth edges of the sweeps fit the images better when"


@pytest.fixture(scope="module")
def crossing(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Eleven sweeps on a crossing, ten images between them."""
    pytest.importorskip("embreex")
    from docdepth.synthetic import write_drive

    return write_drive(tmp_path_factory.mktemp("crossing"), "crossing", "XT-32", frames=11, seed=3)


@pytest.fixture(scope="module")
def recording(crossing: Path) -> Dataset:
    return open_dataset(crossing)


@pytest.fixture(scope="module")
def city(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """Fifteen sweeps of a street, fourteen images."""
    pytest.importorskip("embreex")
    from docdepth.synthetic import write_drive

    folder = tmp_path_factory.mktemp("city")
    return open_dataset(write_drive(folder, "city", "XT-32", frames=15, seed=2))


@pytest.fixture(scope="module", params=["VLP-16", "XT-32"])
def overtaking(tmp_path_factory: pytest.TempPathFactory, request: pytest.FixtureRequest) -> Dataset:
    """Nine raw sweeps of a motorway, eight images: nearly all edges are of what drives along."""
    pytest.importorskip("embreex")
    from docdepth.synthetic import write_drive

    folder = tmp_path_factory.mktemp("overtaking")
    return open_dataset(
        write_drive(folder, "overtaking", request.param, frames=9, seed=31, skew=True)
    )


def turned(stream: CameraStream, tilt: float = 0, pan: float = 0, roll: float = 0) -> CameraStream:
    T = np.eye(4)
    T[:3, :3] = rotation_exp(np.radians([tilt, pan, roll]))
    return replace(stream, T_camera_lidar=T @ stream.T_camera_lidar)


def moved(stream: CameraStream, x: float) -> CameraStream:
    T = stream.T_camera_lidar.copy()
    T[0, 3] += x
    return replace(stream, T_camera_lidar=T)


def later(stream: CameraStream, images: int) -> CameraStream:
    """The camera whose images are stamped too early."""
    count = len(stream.images) - images
    return replace(
        stream,
        images=stream.images[images:],
        times=stream.times[:count],
        names=stream.names[:count],
    )


def test_the_right_calibration_is_left_alone(recording: Dataset) -> None:
    assert find_misalignment(recording, recording.cameras["image_2"]) is None


def test_the_right_calibration_of_a_real_drive_is_left_alone(drive_9001: Path) -> None:
    real = open_dataset(drive_9001)
    stream = real.cameras["image_02"]
    assert find_misalignment(real, stream) is None
    found = find_misalignment(real, turned(stream, pan=1.5))
    assert found == f"{BETTER} the camera turns 1.5 degrees to the right"


@pytest.mark.nightly
def test_what_drives_along_is_no_shift(overtaking: Dataset) -> None:
    """At 25 m/s the LiDAR moves by 0.9 m from a sweep to its image, and they with it."""
    stream = overtaking.cameras["image_2"]
    assert find_misalignment(overtaking, stream) is None
    found = find_misalignment(overtaking, turned(stream, pan=2))
    assert found is not None
    assert found.startswith(f"{BETTER} the camera turns 2")


class Mirrored:
    """A recording in a left-handed frame, as of Unreal Engine."""

    def __init__(self, recording: Dataset) -> None:
        self._recording = recording

    def __getattr__(self, name: str) -> Any:
        return getattr(self._recording, name)

    def __len__(self) -> int:
        return len(self._recording)

    def sweep(self, index: int) -> Sweep:
        sweep = self._recording.sweep(index)
        return replace(sweep, points=sweep.points * np.float32([1, -1, 1]), sensor_rig=None)


@pytest.mark.slow
def test_points_of_a_left_handed_frame_are_named(crossing: Path) -> None:
    recording = open_dataset(crossing)
    stream = recording.cameras["image_2"]
    assert find_misalignment(recording, stream) is None
    found = find_misalignment(Mirrored(recording), stream)
    assert found is not None
    assert "left and right of the points are swapped" in found


@pytest.mark.slow
@pytest.mark.parametrize(
    ("turn", "text"),
    [
        ({"pan": -2}, "turns 2 degrees to the left"),
        ({"tilt": 1.5}, "turns 1.5 degrees up"),
        ({"tilt": -3}, "turns 3 degrees down"),
        ({"roll": 4}, "turns"),
    ],
)
def test_a_turned_camera_is_seen(recording: Dataset, turn: dict[str, float], text: str) -> None:
    found = find_misalignment(recording, turned(recording.cameras["image_2"], **turn))
    assert found is not None
    assert found.startswith(f"{BETTER} the camera {text}")


def test_sweeps_that_were_read_are_not_read_again(recording: Dataset, monkeypatch) -> None:
    sweeps = {k: recording.sweep(k) for k in sample(len(recording))}
    read: list[int] = []
    monkeypatch.setattr(recording, "sweep", read.append)
    found = find_misalignment(recording, turned(recording.cameras["image_2"], pan=1.5), sweeps)
    assert found == f"{BETTER} the camera turns 1.5 degrees to the right"
    assert read == []


def test_a_lever_arm_of_half_a_metre_is_seen(recording: Dataset) -> None:
    found = find_misalignment(recording, moved(recording.cameras["image_2"], 0.5))
    assert found == f"{BETTER} the camera moves 0.5 m to the right"


@pytest.mark.nightly
def test_images_of_other_times_are_seen(city: Dataset) -> None:
    found = find_misalignment(city, later(city.cameras["image_2"], 3))
    assert found == f"{BETTER} the camera moves 2 m forward, or they are of other times"


@pytest.mark.nightly
def test_another_cars_calibration_fits_by_chance_only(city: Dataset) -> None:
    other = turned(moved(city.cameras["image_2"], 0.5), tilt=20, pan=15)
    found = find_misalignment(city, other)
    assert found is not None
    assert "by chance only" in found or BETTER in found


@pytest.mark.nightly
@pytest.mark.parametrize("by", [-1, 1])
def test_a_quaternion_in_the_other_order_is_seen(recording: Dataset, by: int) -> None:
    stream = recording.cameras["image_2"]
    T = stream.T_camera_lidar.copy()
    T[:3, :3] = quaternion_to_matrix(np.roll(matrix_to_quaternion(T[:3, :3]), by))
    found = find_misalignment(recording, replace(stream, T_camera_lidar=T))
    assert found is not None
    assert "quaternion of the extrinsics is read in the other order" in found


@pytest.mark.slow
def test_a_turn_is_seen_without_poses(crossing: Path) -> None:
    recording = open_dataset(crossing)
    recording.poses = None
    stream = recording.cameras["image_2"]
    assert find_misalignment(recording, stream) is None
    assert find_misalignment(recording, turned(stream, pan=2)) is not None


def test_thin_evidence_says_nothing(recording: Dataset, drive: Path) -> None:
    stream = recording.cameras["image_2"]
    few = replace(stream, images=stream.images[:4], times=stream.times[:4], names=stream.names[:4])
    assert find_misalignment(recording, turned(few, pan=3)) is None
    assert find_misalignment(open_dataset(drive), open_dataset(drive).cameras["image_2"]) is None


@pytest.mark.slow
def test_sweeps_in_the_frame_of_the_vehicle_say_nothing(crossing: Path, tmp_path: Path) -> None:
    # Seen from the ground, returns have no neighbours, and jumps between them mean nothing.
    copy = Path(shutil.copytree(crossing, tmp_path / "00"))
    place = np.array([1.2, 0, 1.7])
    for file in (copy / "velodyne").iterdir():
        rows = np.fromfile(file, "<f4").reshape(-1, 4)
        rows[:, :3] += place
        rows.tofile(file)
    recording = open_dataset(copy)
    T = np.eye(4)
    T[:3, 3] = -place
    stream = recording.cameras["image_2"]
    shifted = replace(stream, T_camera_lidar=stream.T_camera_lidar @ T)
    assert find_misalignment(recording, turned(shifted, pan=3)) is None
    # Told where the LiDAR is, they do.
    about = yaml.safe_load((copy / "docdepth.yaml").read_text()) | {"sensor_origin": place.tolist()}
    (copy / "docdepth.yaml").write_text(yaml.safe_dump(about))
    recording = open_dataset(copy)
    recording.poses = None
    assert find_misalignment(recording, shifted) is None
    found = find_misalignment(recording, turned(shifted, pan=3))
    assert found == f"{BETTER} the camera turns 3 degrees to the right"
