"""Labels and depth do not depend on where the world's origin is, when the drive began, how its
ground is cut into chunks, by how many threads, nor in which order files are listed.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from docdepth import (
    Camera,
    CameraStream,
    Scene,
    Trajectory,
    classify_drive,
    open_dataset,
    parameters,
    render_depth,
)
from docdepth.geometry.se3 import se3_exp
from docdepth.ground import growing
from motion import pose
from small_drive import write_small_drive
from walled_yard import scan

COUNT = 8


@pytest.fixture(scope="module")
def drive() -> tuple[list[np.ndarray], np.ndarray]:
    poses = np.array([pose(0.5 * k) for k in range(COUNT)])
    return [scan(T, -8 + 1.5 * k, 7)[0].astype(np.float32) for k, T in enumerate(poses)], poses


def labels(
    sweeps: list[np.ndarray], poses: np.ndarray, begin: int = 0, p=None, threads: int = 0
) -> np.ndarray:
    trajectory = Trajectory(begin + 10**8 * np.arange(len(poses)), poses)
    found = classify_drive(sweeps, trajectory, p, threads=threads)
    return np.concatenate([of.classid for of in found])


@pytest.fixture(scope="module")
def known(drive: tuple[list[np.ndarray], np.ndarray]) -> np.ndarray:
    found = labels(*drive)
    assert len(np.unique(found)) == 3
    return found


@pytest.mark.parametrize("away", [1e3, 1e5, 5e6])
@pytest.mark.parametrize("turn", [0.0, 0.7, -3.0])
def test_the_origin_of_the_world(drive, known, away: float, turn: float) -> None:
    world = se3_exp(np.array([0, 0, turn]), np.zeros(3))
    world[:3, 3] = away, -0.7 * away, 50.0
    differing = np.mean(labels(drive[0], world @ drive[1]) != known)
    # A point at the border of a voxel may be rounded into the next one.
    assert differing <= (5e-5 if turn else 0)


@pytest.mark.parametrize("step", [(0, 0, 0), (0, 0, 0.3), (0.2, -0.1, -0.1), (1000.03, 0, 0)])
def test_each_part_has_the_labels_that_it_has_alone(drive, step: tuple[float, ...]) -> None:
    """Over a gap, poses may step by what a GNSS errs, or begin anew elsewhere."""
    sweeps, poses = drive[0], drive[1].copy()
    poses[COUNT // 2 :, :3, 3] += step
    times = 10**8 * np.arange(COUNT)
    times[COUNT // 2 :] += 2 * 10**9
    whole = classify_drive(sweeps, Trajectory(times, poses))
    for part in (slice(COUNT // 2), slice(COUNT // 2, COUNT)):
        alone = classify_drive(sweeps[part], Trajectory(times[part], poses[part]))
        for of_whole, of_alone in zip(whole[part], alone, strict=True):
            np.testing.assert_array_equal(of_whole.classid, of_alone.classid)


def test_the_time_and_the_type_of_poses(drive, known) -> None:
    np.testing.assert_array_equal(labels(*drive, begin=1_700_000_000 * 10**9), known)
    single = drive[1].astype(np.float32)
    np.testing.assert_array_equal(labels(drive[0], single), known)


@pytest.fixture(scope="module")
def uneven() -> tuple[list[np.ndarray], np.ndarray]:
    """Steps of even lengths would lie on the limits by which sweeps are chosen for an image."""
    places = [(0.47 * k + 0.013 * k**2, 0.017 * k, 0, 0.003 * k) for k in range(COUNT)]
    poses = np.array([pose(*place) for place in places])
    return [scan(T, -8 + 1.5 * i, 7)[0].astype(np.float32) for i, T in enumerate(poses)], poses


def rendered(drive: tuple[list[np.ndarray], np.ndarray], world: np.ndarray) -> np.ndarray:
    """The depth map of a camera that looks ahead; classes are those of the world as it was."""
    sweeps, poses = drive
    times = 10**8 * np.arange(COUNT)
    classes = classify_drive(sweeps, Trajectory(times, poses))
    camera = Camera(np.array([[60.0, 0, 48], [0, 60, 20], [0, 0, 1]]), 96, 40)
    T_camera_lidar = np.array([[0, -1, 0, 0.02], [0, 0, -1, -0.06], [1, 0, 0, -0.3], [0, 0, 0, 1]])
    stream = CameraStream("front", camera, T_camera_lidar, np.array([35 * 10**7]), ["a"])
    return render_depth(
        Scene(sweeps, Trajectory(times, world @ poses), classes, tracks=()), stream, 0
    )


@pytest.fixture(scope="module")
def depth(uneven: tuple[list[np.ndarray], np.ndarray]) -> np.ndarray:
    found = rendered(uneven, np.eye(4))
    assert np.isfinite(found).mean() > 0.5
    return found


@pytest.mark.parametrize("away", [0, 1e3, 1e5, 5e6])
@pytest.mark.parametrize("turn", [0.0, 0.7])
def test_depth_and_the_origin_of_the_world(uneven, depth, away: float, turn: float) -> None:
    world = se3_exp(np.array([0, 0, turn]), np.zeros(3))
    world[:3, 3] = away, -0.7 * away, 50.0
    np.testing.assert_allclose(rendered(uneven, world), depth, rtol=0, atol=1e-4)


@pytest.mark.parametrize("length", [1.0, 4.0])
def test_chunks_of_a_drive_that_comes_back(length: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """As `memory` chooses them; to and fro, so that chunks far apart in time are one place."""
    way = 1.5 * np.concatenate([np.arange(6), np.arange(6)[::-1]])
    poses = np.array([pose(x) for x in way])
    sweeps = [scan(T, -8 + 1.5 * k, 7)[0].astype(np.float32) for k, T in enumerate(poses)]
    cuts: list[int] = []
    chunks = growing.chunks

    def counted(*arguments):
        found = chunks(*arguments)
        cuts.append(len(found))
        return found

    monkeypatch.setattr(growing, "chunks", counted)
    whole = labels(sweeps, poses)
    short = parameters("default").model_copy(deep=True)
    object.__setattr__(short.ground, "chunk_length", length)  # less than a user may choose
    np.testing.assert_array_equal(labels(sweeps, poses, p=short), whole)
    assert cuts[0] == 1 < cuts[1]


def test_threads(drive, known) -> None:
    for threads in (1, 2, 3):
        np.testing.assert_array_equal(labels(*drive, threads=threads), known)


def test_the_order_in_which_files_are_listed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = write_small_drive(tmp_path / "drive")

    def seen() -> list[object]:
        dataset = open_dataset(folder)
        sweeps = [dataset.sweep(k) for k in range(len(dataset))]
        cameras = [(name, stream.names) for name, stream in dataset.cameras.items()]
        return [[(s.name, s.time, s.points.tobytes()) for s in sweeps], cameras]

    first = seen()
    listdir, scandir = os.listdir, os.scandir

    class Backwards:
        """The entries of a folder, last ones first."""

        def __init__(self, *arguments) -> None:
            with scandir(*arguments) as entries:
                self._entries = sorted(entries, key=lambda entry: entry.name, reverse=True)

        def __enter__(self) -> Iterator[os.DirEntry[str]]:
            return iter(self)

        def __exit__(self, *_: object) -> None:
            pass

        def __iter__(self) -> Iterator[os.DirEntry[str]]:
            return iter(self._entries)

    monkeypatch.setattr(os, "scandir", Backwards)
    monkeypatch.setattr(os, "listdir", lambda *a: sorted(listdir(*a), reverse=True))
    assert next((folder / "velodyne").iterdir()).name == "000003.bin"
    assert seen() == first
