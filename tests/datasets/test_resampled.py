"""``sweep_duration`` in docdepth.yaml: sweeps are joined or cut by the times of their points."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from conformance import check
from formats import WRITERS
from made_up import DRIVE
from test_ego import said

from docdepth.datasets import open_dataset, usable_points
from docdepth.datasets.resampled import sweep_starts
from docdepth.errors import DatasetError
from docdepth.geometry.trajectory import Trajectory

PCD = "folder of binary pcd"


def write(folder: Path, duration: float, what: str = PCD, **more) -> Path:
    folder.mkdir(exist_ok=True)
    path = WRITERS[what][1](folder).path
    said(path, sweep_duration=duration, **more)
    return path


def all_returns() -> tuple[np.ndarray, np.ndarray]:
    """Every return of the drive and its nanoseconds, in the order of recording."""
    kept = [DRIVE.usable(k) for k in range(DRIVE.count)]
    points = [DRIVE.points(k)[own] for k, own in enumerate(kept)]
    times = [
        time + 1e9 * DRIVE.seconds(k)[own]
        for k, (time, own) in enumerate(zip(DRIVE.times, kept, strict=True))
    ]
    return np.concatenate(points), np.concatenate(times)


@pytest.mark.parametrize(
    ("what", "duration"), [(PCD, 0.03), (PCD, 0.1), (PCD, 0.17), ("MCAP", 0.05), ("MCAP", 0.2)]
)
def test_every_return_is_in_the_sweep_of_its_time(tmp_path, what, duration):
    if what != PCD:
        pytest.importorskip("rosbags")
    path = write(tmp_path, duration, what)
    dataset = open_dataset(path)
    check(dataset, dataset.name)
    points, times = all_returns()
    step = round(duration * 1e9)
    np.testing.assert_array_equal(np.diff(dataset.times), step)
    assert abs(dataset.times[0] - times.min()) < 5000
    assert abs(len(dataset) * step - np.ptp(times)) <= step / 2 + 5e6
    found = [dataset.sweep(k) for k in range(len(dataset))]
    for sweep in found:
        kept = usable_points(sweep.points)
        inside = (times > sweep.time + 5000) & (times < sweep.time + step - 5000)
        mine = sweep.points[kept]
        assert {tuple(p) for p in points[inside].tolist()} <= {tuple(p) for p in mine.tolist()}
        assert len(mine) <= inside.sum() + 4
        late = sweep.relative_time[kept]
        assert ((late >= 0) & (late <= 1)).all()
        by_point = dict(zip(map(tuple, points.tolist()), times, strict=True))
        expected = [(by_point[tuple(p)] - sweep.time) / step for p in mine.tolist()]
        np.testing.assert_allclose(late, expected, atol=2e-4)
        assert (np.diff(expected) > -0.01).all(), "in the order of recording"
    together = np.concatenate([s.points[usable_points(s.points)] for s in found])
    early = times < dataset.times[-1] + step - 5000
    assert len(np.unique(together, axis=0)) == len(together), "each in one sweep"
    assert len(together) >= early.sum()


def test_poses_are_interpolated(tmp_path):
    dataset = open_dataset(write(tmp_path, 0.04))
    known = Trajectory(DRIVE.times, DRIVE.poses)
    covered = known.covers(dataset.times)
    assert not covered[0], "stamps are in the middle of the sweeps"
    np.testing.assert_allclose(
        dataset.partial_poses[covered], known.interpolate(dataset.times[covered]), atol=1e-9
    )
    # The first stamp recorded is the middle of a sweep: before it, the motion goes on.
    steps = dataset.poses[:4, :3, 3] - dataset.poses[1:5, :3, 3]
    np.testing.assert_allclose(steps, np.repeat(steps[-1:], 4, axis=0), atol=0.02)


def test_labels_go_with_their_rows(tmp_path):
    path = write(tmp_path, 0.05)
    (path / "labels").mkdir()
    for k, name in enumerate(sorted(file.stem for file in path.rglob("*.pcd"))):
        rows = 1000 * k + np.arange(len(DRIVE.rows(k)))
        rows.astype("<u4").tofile(path / "labels" / f"{name}.label")
    dataset = open_dataset(path)
    for k in range(len(dataset)):
        sweep, labels = dataset.sweep(k), dataset.labels(k)
        assert len(labels) == len(sweep.points)
        for point, label in zip(sweep.points, labels.tolist(), strict=True):
            np.testing.assert_array_equal(point, DRIVE.points(label // 1000)[label % 1000])


def test_sweeps_that_cannot_be_divided(tmp_path):
    with pytest.raises(DatasetError, match=r"motion compensated or in the world"):
        open_dataset(write(tmp_path / "a", 0.05, motion_compensated=True))
    (tmp_path / "b").mkdir()
    path = WRITERS["folder of npy"][1](tmp_path / "b").path
    said(path, sweep_duration=0.05, motion_compensated=False)
    with pytest.raises(DatasetError, match=r"points have no times, which sweep_duration needs"):
        open_dataset(path)
    with pytest.raises(DatasetError, match=r"is shorter than a sweep of 9 s"):
        open_dataset(write(tmp_path / "c", 9.0))
    with pytest.raises(DatasetError, match=r"sweep_duration is 100.0: it must be less"):
        open_dataset(write(tmp_path / "d", 100.0))
    with pytest.raises(DatasetError, match="sweep_duration is unknown"):
        open_dataset(write(tmp_path / "e", 0.2, "kitti_odometry"))


def test_gaps_hold_no_sweep():
    """Messages of 20 ms, then a second of nothing, then again."""
    stamps = np.concatenate([np.arange(10), np.arange(60, 71)]) * 20_000_000
    starts = sweep_starts(stamps, (0, 19_900_000), 100_000_000)
    np.testing.assert_array_equal(starts, np.array([0, 1, 12, 13]) * 100_000_000)


def test_no_stamp_is_negative():
    """Stamps that count from zero may be the middle of sweeps."""
    starts = sweep_starts(np.arange(5) * 100_000_000, (-50_000_000, 49_000_000), 50_000_000)
    np.testing.assert_array_equal(starts, np.arange(9) * 50_000_000)
