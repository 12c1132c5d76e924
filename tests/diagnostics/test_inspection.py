"""Frames, poses and times that are wrong are found, each with what it is; right ones are not."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from drives import COUNT, T_CAMERA_LIDAR, Recorded, camera, moved, right_poses, turned

from docdepth.datasets import Sweep, open_dataset
from docdepth.diagnostics.recording_checks import Inspection
from docdepth.diagnostics.recording_pictures import pictures_of
from docdepth.diagnostics.recording_report import inspect_recording
from docdepth.errors import DatasetError, OdometryError
from docdepth.geometry.se3 import inverse, matrix_to_quaternion, quaternion_to_matrix
from docdepth.io.poses import read_poses, write_kitti


def warnings_of(result: Inspection) -> list[str]:
    return [str(found) for found in result.findings if found.severity != "note"]


def codes_of(result: Inspection) -> list[str]:
    return [found.code for found in result.findings]


def test_a_right_recording_has_no_warning() -> None:
    result = inspect_recording(Recorded(cameras=camera()))
    assert warnings_of(result) == []
    figures = result.figures
    assert figures["sweeps"]["rate_hz"] == 10
    assert figures["lidars"][0]["beams"] == 24
    np.testing.assert_allclose(figures["lidars"][0]["spacing_deg"], [0.985, 32 / 23], atol=0.02)
    np.testing.assert_allclose(
        figures["lidars"][0]["field_of_view_deg"]["vertical"], [-24, 8], atol=0.1
    )
    assert figures["ground"]["tilt_deg"] < 2
    np.testing.assert_allclose(figures["ground"]["height_m"], 1.8, atol=0.1)
    assert figures["point_times"]["span"] == [-0.5, 0.497]
    np.testing.assert_allclose(figures["poses"]["length_m"], 1.1 * (COUNT - 1), rtol=0.01)
    np.testing.assert_allclose(figures["registered"][0]["metres_a_sweep"], 1.1, atol=0.1)
    assert figures["cameras"][0]["within_sweeps"] == COUNT


def test_the_same_without_poses() -> None:
    result = inspect_recording(Recorded(poses=None))
    assert warnings_of(result) == []
    assert result.figures["poses"] is None


# ---- poses


def _mirrored(axis: int) -> Callable[[np.ndarray], np.ndarray]:
    S = np.eye(4)
    S[axis, axis] = -1
    return lambda poses: S @ poses @ S


def _of_camera(poses: np.ndarray) -> np.ndarray:
    return T_CAMERA_LIDAR @ poses @ inverse(T_CAMERA_LIDAR)


def _scaled(factor: float) -> Callable[[np.ndarray], np.ndarray]:
    return lambda poses: np.concatenate(
        [poses[:, :, :3], poses[:, :, 3:] * np.array([factor] * 3 + [1])[:, None]], axis=2
    )


def _wrong_order(poses: np.ndarray) -> np.ndarray:
    """Quaternions w x y z in a file that is read as x y z w."""
    result = poses.copy()
    for pose in result:
        x, y, z, w = matrix_to_quaternion(pose[:3, :3])
        pose[:3, :3] = quaternion_to_matrix([w, x, y, z])
    return result


def _without_rotations(poses: np.ndarray) -> np.ndarray:
    result = poses.copy()
    result[:, :3, :3] = np.eye(3)
    return result


def _jumping(poses: np.ndarray) -> np.ndarray:
    result = poses.copy()
    result[5:, 1, 3] += 3
    return result


WRONG_POSES: dict[str, tuple[Callable[[np.ndarray], np.ndarray], str]] = {
    "identity": (lambda p: np.repeat(np.eye(4)[None], len(p), axis=0), "poses-stand"),
    "inverse": (inverse, "inverse-poses"),
    "camera": (_of_camera, "poses-of-camera"),
    "mirrored": (_mirrored(1), "handedness"),
    "turned": (lambda p: p @ turned((0, 0, 90)), "turned-frame"),
    "millimetres": (_scaled(1000), "unit-of-poses"),
    "half": (_scaled(0.5), "unit-of-poses"),
    "quaternions": (_wrong_order, "quaternion-order"),
    "rotations": (_without_rotations, "no-rotations"),
    "jump": (_jumping, "trajectory-jumps"),
    "shuffled": (lambda p: p[[0, 3, 6, 9, 1, 4, 7, 2, 5, 8]], "poses-misfit"),
}


_SLOW = {
    "camera",
    "turned",
    "half",
    "rotations",
    "shuffled",
    "upside down",
    "copies",
    "two returns",
    "in the world",
}


def _named(kinds: dict[str, Any]) -> list[Any]:
    return [pytest.param(n, marks=[pytest.mark.slow] if n in _SLOW else []) for n in kinds]


@pytest.mark.parametrize("name", _named(WRONG_POSES))
def test_wrong_poses_are_told(name: str) -> None:
    change, code = WRONG_POSES[name]
    result = inspect_recording(Recorded(poses=None, cameras=camera()), change(right_poses()))
    assert code in codes_of(result)


def test_poses_in_any_other_world_are_right() -> None:
    T = turned((100, 20, -60))
    T[:3, 3] = 4e5, 5e6, 100
    assert warnings_of(inspect_recording(Recorded(poses=T @ right_poses()))) == []


def test_poses_that_are_no_rotations_but_mirrors(tmp_path: Path) -> None:
    poses = right_poses()
    poses[:, :3, 1] *= -1
    write_kitti(tmp_path / "poses.txt", poses)
    with pytest.raises(OdometryError, match=r"frame 0 .* mirrors .* left-handed"):
        read_poses(tmp_path / "poses.txt")


# ---- points


def _dual(sweep: Sweep, _: int) -> Sweep:
    """Half of the rays return twice."""
    again = sweep.points[::2] * np.float32(1.3)
    late = sweep.relative_time
    assert late is not None
    return replace(
        sweep,
        points=np.concatenate([sweep.points, again]),
        relative_time=np.concatenate([late, late[::2]]),
    )


def _copied(sweep: Sweep, _: int) -> Sweep:
    late = sweep.relative_time
    assert late is not None
    return replace(sweep, points=np.tile(sweep.points, (2, 1)), relative_time=np.tile(late, 2))


def _shuffled_times(sweep: Sweep, index: int) -> Sweep:
    late = sweep.relative_time
    assert late is not None
    return replace(sweep, relative_time=np.random.default_rng(index).permutation(late))


def _in_the_world(sweep: Sweep, index: int) -> Sweep:
    return moved(right_poses()[index])(sweep, index)


WRONG_POINTS: dict[str, tuple[Any, str]] = {
    "tilted": (moved(turned((0, 45, 0))), "tilted"),
    "of a camera": (moved(T_CAMERA_LIDAR), "tilted"),
    "upside down": (moved(turned((180, 0, 0))), "tilted"),
    "moved zeros": (moved(turned((0, 0, 30)) + np.eye(4, k=3)), "rows-in-one-place"),
    "two returns": (_dual, "two-returns"),
    "copies": (_copied, "repeated-points"),
    "times of others": (_shuffled_times, "times-of-other-points"),
    "short times": (
        lambda sweep, _: replace(sweep, relative_time=sweep.relative_time / 3),
        "span-of-times",
    ),
    "in the world": (_in_the_world, "in-the-world"),
}


@pytest.mark.parametrize("name", _named(WRONG_POINTS))
def test_wrong_points_are_told(name: str) -> None:
    change, code = WRONG_POINTS[name]
    result = inspect_recording(Recorded(poses=None, change=change))
    assert code in codes_of(result)


def test_a_viewpoint_of_zeros_is_no_pose(tmp_path: Path) -> None:
    """Points are in the world, and nobody wrote the poses: told, or refused if asked for."""
    for k, pose in enumerate(right_poses()):
        points = moved(pose)(Recorded().sweep(k), k).points[::2]
        header = (
            "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n"
            f"WIDTH {len(points)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(points)}\n"
            "DATA binary\n"
        )
        (tmp_path / f"{k:06d}.pcd").write_bytes(header.encode() + points.astype("<f4").tobytes())
    settings = tmp_path / "docdepth.yaml"
    settings.write_text("rate: 10\nmotion_compensated: true\n")
    assert "in-the-world" in codes_of(inspect_recording(open_dataset(tmp_path)))
    settings.write_text("rate: 10\nmotion_compensated: true\nframe: world\nposes: viewpoint\n")
    with pytest.raises(DatasetError, match="VIEWPOINT is 0 0 0 1 0 0 0 in every file"):
        open_dataset(tmp_path)


def test_mirrored_points_do_not_fit_right_poses() -> None:
    change = moved(np.diag([1.0, -1, 1, 1]))
    assert "handedness" in codes_of(inspect_recording(Recorded(change=change)))


def test_points_at_the_origin_are_noted_and_no_warning() -> None:
    def zeros(sweep: Sweep, _: int) -> Sweep:
        points = sweep.points.copy()
        points[::5] = 0
        return replace(sweep, points=points)

    result = inspect_recording(Recorded(poses=None, change=zeros))
    assert warnings_of(result) == []
    assert "rows-at-origin" in codes_of(result)


# ---- times


@pytest.mark.parametrize(
    ("late_ns", "code"),
    [
        (10**18, "image-times"),
        (-4 * 10**8, "images-outside"),
    ],
)
def test_clocks_that_differ(late_ns: int, code: str) -> None:
    result = inspect_recording(Recorded(poses=None, cameras=camera(late_ns)))
    assert code in codes_of(result)


def test_a_gap_and_a_wrong_unit_of_stamps() -> None:
    times = Recorded().times.copy()
    times[4:] += 3 * 10**8
    assert "sweep-gap" in codes_of(inspect_recording(Recorded(poses=None, times=times)))
    times = Recorded().times // 10  # 100 Hz
    assert "mini-sweeps" in codes_of(inspect_recording(Recorded(poses=None, times=times)))
    times = Recorded().times // 1000
    assert "sweep-period" in codes_of(inspect_recording(Recorded(poses=None, times=times)))


def test_halves_of_a_turn_are_named() -> None:
    """At 20 Hz, as whole turns of some LiDARs are."""

    def change(sweep: Sweep, index: int) -> Sweep:
        points = sweep.points
        return Sweep(points[(points[:, 1] > 0) == bool(index % 2)], sweep.name, sweep.time)

    times = Recorded().times // 2
    assert "mini-sweeps" not in codes_of(inspect_recording(Recorded(poses=None, times=times)))
    halves = inspect_recording(Recorded(poses=None, times=times, change=change))
    (found,) = (one for one in halves.findings if one.code == "mini-sweeps")
    assert "sweep_duration: 0.1 " in found.remedy


@pytest.mark.parametrize("empty", [0, 1])
def test_a_sweep_without_returns_is_no_part_of_a_turn(empty: int) -> None:
    def change(sweep: Sweep, index: int) -> Sweep:
        points = sweep.points * (0 if index == empty else 1)
        return Sweep(points.astype(np.float32), sweep.name, sweep.time)

    found = codes_of(inspect_recording(Recorded(poses=None, change=change)))
    assert "mini-sweeps" not in found


@pytest.mark.parametrize("broken", [range(COUNT), [COUNT - 1]])
def test_garbage_is_told_without_more(broken: Sequence[int]) -> None:
    """Warnings of numpy are errors in these tests."""
    bits = np.random.default_rng(0).integers(0, 2**32, (5000, 3), dtype=np.uint32).view("f4")

    def change(sweep: Sweep, index: int) -> Sweep:
        return Sweep(bits, sweep.name, sweep.time) if index in broken else sweep

    recording = Recorded(change=change, cameras=camera())
    result = inspect_recording(recording)
    list(pictures_of(recording, result))
    errors = [found for found in result.findings if found.severity == "error"]
    assert errors
    assert {found.code for found in errors} <= {"not-metres", "one-place"}
    hints = ["`on_error='skip'`" in found.remedy for found in errors]
    assert all(hints) if len(broken) == 1 else not any(hints)
    if len(broken) > 1:
        assert len(warnings_of(result)) == len(errors)


# ---- whole recordings


def test_a_synthetic_drive_has_no_warning(drive: Path) -> None:
    recording = open_dataset(drive)
    result = inspect_recording(recording)
    assert warnings_of(result) == []
    assert result.figures["lidars"][0]["beams"] == 26
    captions = [caption for _, caption in pictures_of(recording, result)]
    assert sum("by the given poses" in caption for caption in captions) == 1
    on_images = [caption for caption in captions if "on image" in caption]
    assert len(on_images) == len(recording.cameras)


@pytest.mark.nightly
def test_real_drives_have_no_warning(drive_0005: Path, drive_9001: Path) -> None:
    """But one: the last sweep of drive 9001 was cut off."""
    for path, cut_off in ((drive_0005, 0), (drive_9001, 1)):
        result = inspect_recording(open_dataset(path))
        warnings = warnings_of(result)
        assert len(warnings) == cut_off
        assert all("0000000077.bin (frame 77) has 1115504 bytes" in text for text in warnings)
        assert result.figures["lidars"][0]["beams"] == 64
        assert result.figures["ground"]["tilt_deg"] < 2
        np.testing.assert_allclose(result.figures["ground"]["height_m"], 1.76, atol=0.05)
        # On drive 9001 the vehicle goes less than 10 m.
        assert (result.figures["ego"] is not None) == (path == drive_0005)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_real_capture_of_an_ouster(recordings: Path) -> None:
    pytest.importorskip("ouster.sdk")
    result = inspect_recording(
        open_dataset(recordings / "ouster" / "OS-1-128_v2.3.0_1024x10_lb_n3.pcap")
    )
    assert warnings_of(result) == []
    assert result.figures["lidars"][0]["beams"] == 128
    assert result.figures["ground"]["tilt_deg"] < 2
    np.testing.assert_allclose(result.figures["registered"][0]["metres_a_sweep"], 0.25, atol=0.02)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_real_packets_of_a_velodyne_in_a_room(recordings: Path) -> None:
    pytest.importorskip("rosbags")
    pytest.importorskip("velodyne_decoder")
    path = recordings / "nebula" / "vlp16" / "1673400471837873222"
    result = inspect_recording(open_dataset(path))
    assert warnings_of(result) == []
    assert result.figures["lidars"][0]["beams"] == 15, "the lowest one sees nothing"
    assert result.ground is None


@pytest.mark.slow
def test_two_returns_of_a_real_lidar(recordings: Path) -> None:
    """Rows that follow each other lie on one ray, half a metre to 13 m apart."""
    path = recordings / "nebula" / "hesai_xt32"
    result = inspect_recording(open_dataset(path, dataset="folder"))
    assert codes_of(result).count("two-returns") == len(warnings_of(result)) == 1


@pytest.mark.nightly
def test_where_the_lidars_of_a_real_scene_of_dgp_are(recordings: Path) -> None:
    """Points are in the vehicle's frame, whose origin is on the ground, of several LiDARs."""
    result = inspect_recording(open_dataset(recordings / "dgp"))
    assert codes_of(result).count("sensor-origin") == len(warnings_of(result)) == 1
    np.testing.assert_allclose(result.figures["ground"]["height_m"], 0, atol=0.3)
    assert len(result.figures["cameras"]) == 3
