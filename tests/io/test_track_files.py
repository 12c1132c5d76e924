"""Tracks, and the files that hold them."""

from pathlib import Path

import numpy as np
import pytest

from docdepth.errors import InputError, RunError
from docdepth.geometry.se3 import rotation_exp
from docdepth.geometry.track import Track
from docdepth.io.tracks import COLUMNS, read_tracks, write_tracks
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
    return Track(number, kind, times, poses, velocities, size, points, 0.01 * points)


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
        for name in ("poses", "velocities", "size", "deviations"):
            np.testing.assert_allclose(getattr(read, name), getattr(track, name), atol=1e-3)


@pytest.mark.parametrize(
    "content",
    ["", "frame,id\n0,1\n", "\xff", ",".join(COLUMNS) + "\n0,0,1,lorry" + ",1" * 13 + "\n",
     ",".join(COLUMNS) + "\n0,0,1,vehicle" + ",nan" * 12 + ",1\n"],
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
                    {"deviations": track.deviations[1:]}):  # fmt: skip
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
