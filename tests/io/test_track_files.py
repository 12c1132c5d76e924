"""Tracks, and the files that hold them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from docdepth.errors import InputError, RunError
from docdepth.geometry.camera import Camera
from docdepth.geometry.se3 import rotation_exp
from docdepth.geometry.track import Track
from docdepth.geometry.trajectory import Trajectory
from docdepth.io.tracks import COLUMNS, read_tracks, write_kitti_tracking, write_tracks
from docdepth.synthetic import Drive, scene, sensor

TIMES = np.arange(5) * 100_000_000


def circling(kind="vehicle", number=7):
    """A car on a circle of 20 m, 8 m/s, uphill; it misses the fourth sweep."""
    times = TIMES[[0, 1, 2, 4]]
    angle = 0.4 * times * 1e-9
    poses = np.repeat(np.eye(4)[None], 4, 0)
    poses[:, :3, 3] = np.stack([20 * np.sin(angle), 20 - 20 * np.cos(angle), 0 * angle], 1)
    turn = rotation_exp(angle[:, None] * (0.0, 0.0, 1.0))
    poses[:, :3, :3] = turn @ rotation_exp((0.0, -0.05, 0.0))
    velocities = 8 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], 1)
    size, points = np.array([4.2, 1.8, 1.5]), np.array([9, 8, 7, 6])
    known = (0.01 * points, 0.002 * points)
    return Track(number, kind, times, poses, velocities, size, points, *known)


def test_a_track_is_interpolated_and_goes_on():
    track = circling()
    on_circle = lambda t: (20 * np.sin(0.4 * t), 20 - 20 * np.cos(0.4 * t))  # noqa: E731
    for seconds, tolerance in ((0.05, 0.01), (0.33, 0.02), (0.45, 0.02), (-0.05, 0.02)):
        pose = track.pose_at(round(seconds * 1e9))
        np.testing.assert_allclose(pose[:2, 3], on_circle(seconds), atol=tolerance)
        np.testing.assert_allclose(np.arctan2(pose[1, 0], pose[0, 0]), 0.4 * seconds, atol=1e-3)
    assert np.linalg.norm(track.velocity_at(330_000_000)) == pytest.approx(8, abs=0.01)
    np.testing.assert_allclose(track.turn_rate_at(200_000_000), (0, 0, 0.4), atol=1e-3)
    assert track.covers(400_000_000)
    assert not track.covers(400_000_001)


def test_tracks_are_read_as_they_were_written(tmp_path: Path):
    path = tmp_path / "tracks.csv"
    tracks = [circling(), circling("person", 9)]
    write_tracks(path, tracks, TIMES)
    lines = path.read_text().splitlines()
    assert lines[0] == ",".join(COLUMNS)
    assert [line.split(",")[0] for line in lines[1:]] == list("00112244")
    for read, track in zip(read_tracks(path), tracks, strict=True):
        assert (read.id, read.kind) == (track.id, track.kind)
        np.testing.assert_array_equal(read.times, track.times)
        np.testing.assert_array_equal(read.points, track.points)
        for name in ("poses", "velocities", "size", "deviations", "surface_deviations"):
            np.testing.assert_allclose(getattr(read, name), getattr(track, name), atol=1e-3)


@pytest.mark.parametrize(
    "content",
    ["", "frame,id\n0,1\n", "\xff", ",".join(COLUMNS) + "\n0,0,1,lorry" + ",1" * 14 + "\n",
     ",".join(COLUMNS) + "\n0,0,1,vehicle" + ",nan" * 13 + ",1\n"],
)  # fmt: skip
def test_files_that_are_no_tracks_are_refused(tmp_path: Path, content):
    path = tmp_path / "tracks.csv"
    path.write_bytes(content.encode("latin-1"))
    if not content:
        assert read_tracks(path) == []
        return
    with pytest.raises(RunError, match=r"tracks\.csv"):
        read_tracks(path)


def test_wrong_tracks_are_refused():
    track = circling()
    for changed in ({"id": 0}, {"id": 1 << 16}, {"kind": "lorry"}, {"size": np.zeros(3)},
                    {"times": track.times[::-1]}, {"points": track.points[1:]},
                    {"deviations": track.deviations[1:]},
                    {"surface_deviations": track.surface_deviations[1:]}):  # fmt: skip
        fields = {name: getattr(track, name) for name in track.__dataclass_fields__} | changed
        with pytest.raises(InputError):
            Track(**fields)


def test_exact_tracks_hold_the_points_of_their_objects():
    drive = Drive(scene("crossing", 3), sensor("XT-32"), 3, 3)
    sweep, pose, found = drive.sweep(1), drive.poses[1], 0
    for track in drive.tracks():
        own = sweep.points[(sweep.labels >> 16) == track.id] @ pose[:3, :3].T + pose[:3, 3]
        T = np.linalg.inv(track.pose_at(int(drive.times[1])))
        inside = own @ T[:3, :3].T + T[:3, 3]
        # Measured up to half a sweep before or after, with noise; limbs swing.
        reach = 0.05 * np.linalg.norm(track.velocity_at(int(drive.times[1]))) + 0.5
        limit = 0.5 * track.size + reach
        assert (np.abs(inside - (0, 0, 0.5 * track.size[2])) <= limit).all()
        found += len(own)
    assert found > 300


def kitti_corners(row):
    """Corners of a label in the camera frame, by the devkit's formula (its readme, and
    computeBox3D.m)."""
    height, width, length, *place, turn = map(float, row[10:17])
    x = length / 2 * np.array([1, 1, -1, -1, 1, 1, -1, -1])
    y = height * np.array([0, 0, 0, 0, -1, -1, -1, -1])
    z = width / 2 * np.array([1, -1, -1, 1, 1, -1, -1, 1])
    rotation = np.array(
        [[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]]
    )
    return (rotation @ [x, y, z]).T + place


def test_boxes_are_labels_of_kittis_tracking_benchmark(tmp_path: Path):
    """A level car, seen from a level camera that looks along x from 20 m behind it."""
    camera = Camera(np.array([[700.0, 0, 600], [0, 700, 180], [0, 0, 1]]), 1242, 375)
    T_world_camera = np.eye(4)
    T_world_camera[:3, :3] = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]
    T_world_camera[:3, 3] = (-20, 0, 1.6)
    away = T_world_camera.copy()
    away[:3, :3] = T_world_camera[:3, :3] @ np.diag([-1.0, 1, -1])  # looks back
    tracks = [circling("person", 9), circling()]
    for k, track in enumerate(tracks):
        poses = track.poses.copy()
        poses[:, :3, :3] = rotation_exp((0.3 * np.arange(4))[:, None] * (0.0, 0.0, 1.0))
        tracks[k] = replace(track, poses=poses)
    stamps = np.array([0, 50, 150, 420]) * 1_000_000
    poses = Trajectory(stamps, np.array([T_world_camera, T_world_camera, away, T_world_camera]))
    path = tmp_path / "tracks.txt"
    write_kitti_tracking(path, tracks, camera, poses, np.array([3, 5, 6, 7]))
    rows = [line.split() for line in path.read_text().splitlines()]
    assert [row[:5] for row in rows] == [
        ["3", "7", "Car", "0", "3"],
        ["3", "9", "Pedestrian", "0", "3"],
        ["5", "7", "Car", "0", "3"],
        ["5", "9", "Pedestrian", "0", "3"],
    ]
    for row, time in ((rows[0], stamps[0]), (rows[2], stamps[1])):
        assert len(row) == 17
        box = tracks[1].size * [[a, b, c] for a in (-0.5, 0.5) for b in (-0.5, 0.5) for c in (0, 1)]
        pose = np.linalg.inv(T_world_camera) @ tracks[1].pose_at(time)
        exact = box @ pose[:3, :3].T + pose[:3, 3]
        corners = kitti_corners(row)
        distances = np.linalg.norm(corners[:, None] - exact, axis=2)
        np.testing.assert_allclose(distances.min(1), 0, atol=1e-3)
        front = exact[4:].mean(0) - exact[:4].mean(0)  # the corners of the formula begin in front
        assert (corners[[0, 1]].mean(0) - corners[[2, 3]].mean(0)) @ front > 0
        pixels = exact / exact[:, 2:] @ camera.K[:2].T
        np.testing.assert_allclose(list(map(float, row[6:8])), pixels.min(0), atol=1e-2)
        np.testing.assert_allclose(list(map(float, row[8:10])), pixels.max(0), atol=1e-2)
        x, z, turn, alpha = (float(row[k]) for k in (13, 15, 16, 5))
        assert alpha == pytest.approx(turn - np.arctan2(x, z), abs=1e-3)
