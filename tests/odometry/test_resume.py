"""An interrupted estimation of poses goes on where it stopped, to the same last bit."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import docdepth._core as _core
from docdepth.config import OdometryParameters
from docdepth.errors import RunError
from docdepth.odometry.odometry import estimate_poses
from docdepth.odometry.registration_log import (
    CLEAR_CYCLE,
    FORGOTTEN,
    Found,
    RegistrationLog,
    first_insertion,
)
from exact_drive import Drive

COUNT = 40


@pytest.fixture(scope="module")
def drive() -> Drive:
    return Drive(COUNT)


@pytest.fixture(scope="module")
def whole(drive: Drive) -> np.ndarray:
    return estimate_poses(drive)


class Stopped(BaseException):
    """In place of a signal."""


def until(stop: int):
    """A progress that stops when so many poses are known."""

    def progress(step: str, done: int, total: int) -> None:
        if done == stop:
            raise Stopped

    return progress


@pytest.mark.parametrize("stops", [(1,), (14, 15, 20)])
def test_poses_are_the_same_bit_for_bit(drive, whole, tmp_path, stops: tuple[int, ...]) -> None:
    for stop in stops:
        with pytest.raises(Stopped):
            estimate_poses(drive, progress=until(stop), checkpoint=tmp_path)
    np.testing.assert_array_equal(estimate_poses(drive, checkpoint=tmp_path), whole)


def test_what_is_known_is_not_registered_again(drive, whole, tmp_path, monkeypatch) -> None:
    with pytest.raises(Stopped):
        estimate_poses(drive, progress=until(5), checkpoint=tmp_path)
    logs = [RegistrationLog(f, _head(f)) for f in sorted(tmp_path.glob("pass_*"))]
    known = [len(log) for log in logs]
    assert known[0] > known[1] >= 5
    aligned: list[object] = []
    align = _core.GaussianVoxelMap.align

    def counted(voxels, *arguments, **named):
        aligned.append(voxels)
        return align(voxels, *arguments, **named)

    monkeypatch.setattr(_core.GaussianVoxelMap, "align", counted)
    np.testing.assert_array_equal(estimate_poses(drive, checkpoint=tmp_path), whole)
    assert len(aligned) == 2 * COUNT - sum(known)
    drive.read.clear()
    aligned.clear()
    np.testing.assert_array_equal(estimate_poses(drive, checkpoint=tmp_path), whole)
    assert drive.read == []
    assert not aligned


def _head(file: Path) -> str:
    return file.read_bytes().split(b"\n")[0].decode()


def test_other_parameters_begin_anew(drive, tmp_path) -> None:
    estimate_poses(drive, checkpoint=tmp_path)
    drive.read.clear()
    estimate_poses(drive, OdometryParameters(voxel_size=1.5), checkpoint=tmp_path)
    assert len(set(drive.read)) == COUNT


@pytest.mark.parametrize(
    ("name", "cut"), [("pass_1_from_0.log", -1000), ("pass_2_from_0.log", -100)]
)
def test_a_torn_log_is_taken_up_to_the_tear(drive, whole, tmp_path, name: str, cut: int) -> None:
    with pytest.raises(Stopped):
        estimate_poses(drive, progress=until(10), checkpoint=tmp_path)
    file = tmp_path / name
    content = bytearray(file.read_bytes())
    content[cut:] = bytes(-cut)  # blocks that were not written when the power failed
    file.write_bytes(content)
    np.testing.assert_array_equal(estimate_poses(drive, checkpoint=tmp_path), whole)


def test_rows_are_read_as_they_were_written(tmp_path) -> None:
    rng, file = np.random.default_rng(3), tmp_path / "notes" / "pass_1.log"
    rows = [
        Found(rng.normal(size=(4, 4)), rng.normal(size=(6, 6)), k % 3 > 0, k / 9) for k in range(9)
    ]
    for begin, end in ((0, 4), (4, 4), (4, 9)):
        log = RegistrationLog(file, "key")
        assert len(log) == begin
        for row in rows[begin:end]:
            log.add(row)
        log.close()
    log = RegistrationLog(file, "key")
    for k, row in enumerate(rows):
        found = log.found(k)
        assert found is not None
        np.testing.assert_array_equal(found.pose, row.pose)
        np.testing.assert_array_equal(found.covariance, row.covariance)
        assert (found.usable, found.fitting) == (row.usable, row.fitting)
    assert log.found(9) is None
    assert len(RegistrationLog(file, "other")) == 0
    whole = file.read_bytes()
    for cut in range(0, len(whole), 7):
        file.write_bytes(whole[:cut])
        assert len(RegistrationLog(file, "key")) == max(cut - 4, 0) // 432


def test_a_log_that_cannot_be_written(tmp_path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(RunError, match=r"pass_1\.log: .*; it continues where it stopped"):
        RegistrationLog(tmp_path / "file" / "pass_1.log").add(Found(np.eye(4), np.eye(6), True))


def test_a_disk_that_fills_up_within_a_row(tmp_path) -> None:
    """The system then writes what fits, and says so only by the count."""
    rows = [Found(k * np.eye(4), np.eye(6), True) for k in range(3)]
    file = tmp_path / "\udcff" / "pass_1.log"
    log = RegistrationLog(file, "\udcff")
    log.add(rows[0])
    stream, write = log._stream, log._stream.write
    log._stream = SimpleNamespace(write=lambda data: write(data[:100]), close=stream.close)
    with pytest.raises(RunError, match="No space left on device; make room"):
        log.add(rows[1])
    log.close()
    log = RegistrationLog(file, "\udcff")
    assert len(log) == 1
    log.add(rows[2])
    log.close()
    found = RegistrationLog(file, "\udcff").found(1)
    assert found is not None
    np.testing.assert_array_equal(found.pose, rows[2].pose)


# ---- the map, built again from the last sweeps alone

REACH = 3.0  # metres that a sweep of these tests sees
VOXEL = 0.5


def _cloud(rng: np.random.Generator) -> _core.OrientedPoints:
    points = rng.normal(size=(300, 3))
    points *= REACH * rng.uniform(0, 1, (300, 1)) / np.linalg.norm(points, axis=1, keepdims=True)
    return _core.OrientedPoints(points.astype(np.float32), 10, 1)


def _paths() -> dict[str, np.ndarray]:
    steps = np.arange(400)
    ahead = np.stack([0.2 * steps, 0 * steps, 0 * steps], 1)
    there = np.where(steps < 200, steps, 399 - steps)
    stops = np.minimum(steps, 150) + np.maximum(steps - 300, 0)
    ring, large = 2 * np.pi * steps / 170, 2 * np.pi * steps / 350
    rng = np.random.default_rng(2)
    return {
        "ahead": ahead,
        "there and back": np.stack([0.2 * there, 0 * steps, 0 * steps], 1),
        "a stop": np.stack([0.2 * stops, 0 * steps, 0 * steps], 1),
        "round and round": 8 * np.stack([np.cos(ring), np.sin(ring), 0 * ring], 1),
        "large rings": 20 * np.stack([np.cos(large), np.sin(large), 0 * ring], 1),
        "at random": rng.normal(0, 0.6, (400, 3)).cumsum(0),
        "on the spot": rng.normal(0, 0.1, (400, 3)),
    }


@pytest.mark.parametrize("name", _paths())
def test_a_map_of_the_last_sweeps_is_the_whole_map(name: str) -> None:
    rng = np.random.default_rng(7)
    positions, clouds = _paths()[name], [_cloud(rng) for _ in range(40)]

    def insert(voxels: _core.GaussianVoxelMap, k: int) -> None:
        pose = np.eye(4)
        pose[:3, 3] = positions[k]
        voxels.insert(clouds[k % len(clouds)], pose)

    every, skipped = _core.GaussianVoxelMap(VOXEL), 0
    for k in range(len(positions)):
        insert(every, k)
        if k % 37 != 36:
            continue
        first = first_insertion(positions[: k + 1], 2 * REACH + 2 * VOXEL)
        assert first % CLEAR_CYCLE == 0
        skipped = max(skipped, first)
        again = _core.GaussianVoxelMap(VOXEL)
        for j in range(first, k + 1):
            insert(again, j)
        for expected, found in zip(every.voxels(), again.voxels(), strict=True):
            np.testing.assert_array_equal(found, expected)
    if name in ("ahead", "large rings"):
        assert skipped > 100
    if name == "on the spot":
        assert skipped == 0
    assert FORGOTTEN == 110
