"""What every loader promises: :func:`check` reads a recording in all the ways docdepth does."""

from __future__ import annotations

import pickle
from concurrent.futures import ThreadPoolExecutor
from dataclasses import fields

import numpy as np

from docdepth.datasets import Dataset, FrameRange, Sweep, usable_points
from docdepth.datasets.files import file_of
from docdepth.geometry.lidar_frame import SensorRig
from docdepth.geometry.se3 import check_rigid

_TYPES = {
    "intensity": np.float32,
    "relative_time": np.float32,
    "ring": np.uint16,
}
_LONGEST = 1.6  # sweeps from the stamp to a point
_FARTHEST = 250.0  # metres of half of the points; more is a mistake of units


def check(dataset: Dataset, name: str) -> None:
    """Everything that :class:`~docdepth.datasets.Dataset` promises of a recording."""
    assert isinstance(dataset, Dataset)
    assert dataset.name == name
    assert dataset.path.exists()
    _check_lengths_and_stamps(dataset)
    _check_lidars(dataset)
    sweeps = [dataset.sweep(k) for k in range(len(dataset))]
    for k, sweep in enumerate(sweeps):
        _check_sweep(dataset, k, sweep)
    _check_alike(sweeps)
    _check_random_access(dataset, sweeps)
    _check_range(dataset, sweeps)
    for stream in dataset.cameras.values():
        _check_camera(stream, np.concatenate([s.points[usable_points(s.points)] for s in sweeps]))


def differences(one: Sweep, other: Sweep) -> list[str]:
    """Which attributes of two sweeps differ in any bit; none if they are the same."""
    return [
        field.name
        for field in fields(Sweep)
        if not _same(getattr(one, field.name), getattr(other, field.name))
    ]


def _same(a: object, b: object) -> bool:
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()
    if isinstance(a, SensorRig) and isinstance(b, SensorRig):
        return all(_same(getattr(a, f.name), getattr(b, f.name)) for f in fields(a))
    return type(a) is type(b) and a == b


def _check_lengths_and_stamps(dataset: Dataset) -> None:
    n = len(dataset)
    assert n > 0
    assert dataset.times.dtype == np.int64
    assert dataset.times.shape == (n,)
    assert (np.diff(dataset.times) > 0).all(), "stamps rise"
    if dataset.poses is not None:
        assert dataset.poses.shape == (n, 4, 4)
        assert dataset.poses.dtype == np.float64
        check_rigid(dataset.poses)


def _check_lidars(dataset: Dataset) -> None:
    assert dataset.lidars
    for name, lidar in dataset.lidars.items():
        assert lidar.name == name
        assert lidar.times.dtype == np.int64
        assert len(lidar.names) == len(lidar.times)
        assert len(set(lidar.names)) == len(lidar.names), "labels are written under these names"
        assert (np.diff(lidar.times) > 0).all(), "stamps rise"
        check_rigid(lidar.T_lidar_sensor[None])
    first = next(iter(dataset.lidars.values()))
    np.testing.assert_array_equal(first.times, dataset.times)
    np.testing.assert_array_equal(first.T_lidar_sensor, np.eye(4))


def _check_sweep(dataset: Dataset, k: int, sweep: Sweep) -> None:
    first = next(iter(dataset.lidars.values()))
    assert (sweep.name, sweep.time) == (first.names[k], dataset.times[k])
    points = sweep.points
    assert points.dtype == np.float32
    assert points.ndim == 2
    assert points.shape[1] == 3
    assert points.flags.c_contiguous
    usable = usable_points(points)
    assert usable.any()
    distance = np.linalg.norm(points[usable], axis=1)
    assert np.median(distance) < _FARTHEST, "points are in metres, in the frame of the LiDAR"
    for name, dtype in _TYPES.items():
        values = getattr(sweep, name)
        if values is not None:
            assert values.dtype == dtype, name
            assert values.shape == (len(points),), f"{name} is dropped together with the points"
    if sweep.relative_time is not None:
        late = sweep.relative_time[usable]
        assert np.isfinite(late).all()
        assert (np.abs(late) < _LONGEST).all()
    if sweep.sensor_rig is not None:
        assert sweep.sensor_rig.index.shape == (len(points),)
    labels = dataset.labels(k)
    if labels is not None:
        assert labels.dtype == np.uint32
        assert labels.shape == (len(points),)
    files = dataset.sweep_files(k)
    assert len(set(files)) == len(files)
    assert all(file.is_file() for file in files)


def _check_alike(sweeps: list[Sweep]) -> None:
    """What one sweep tells, all tell."""
    for name in ("motion_compensated", "intensity", "relative_time", "ring", "sensor_rig"):
        known = {
            getattr(sweep, name) if name == "motion_compensated" else getattr(sweep, name) is None
            for sweep in sweeps
        }
        assert len(known) == 1, name


def _check_random_access(dataset: Dataset, sweeps: list[Sweep]) -> None:
    """In any order, from threads, and in another process, a sweep is the same."""
    for k in reversed(range(len(dataset))):
        assert differences(dataset.sweep(k), sweeps[k]) == []
    with ThreadPoolExecutor(4) as pool:
        order = [k for k in range(len(dataset)) for _ in range(3)][::-1]
        for k, sweep in zip(order, pool.map(dataset.sweep, order), strict=True):
            assert differences(sweep, sweeps[k]) == []
    copy = pickle.loads(pickle.dumps(dataset))
    assert differences(copy.sweep(len(dataset) - 1), sweeps[-1]) == []


def _check_range(dataset: Dataset, sweeps: list[Sweep]) -> None:
    part = FrameRange(dataset, "1:") if len(dataset) > 1 else FrameRange(dataset, ":1")
    begin = len(dataset) - len(part)
    assert isinstance(part, Dataset)
    assert differences(part.sweep(0), sweeps[begin]) == []
    np.testing.assert_array_equal(part.times, dataset.times[begin:])
    assert part.sweep_files(0) == dataset.sweep_files(begin)
    _check_lidars(part)


def _check_camera(stream, points: np.ndarray) -> None:
    assert stream.times.dtype == np.int64
    assert len(stream.names) == len(stream.times)
    assert len(set(stream.names)) == len(stream.names), "maps are written under these names"
    assert (np.diff(stream.times) > 0).all(), "stamps rise"
    check_rigid(stream.T_camera_lidar[None])
    seen = points @ stream.T_camera_lidar[:3, :3].T + stream.T_camera_lidar[:3, 3]
    seen = seen[seen[:, 2] > 0.1]
    u, v = stream.camera.K[:2, :2].diagonal()[:, None] * (seen[:, :2] / seen[:, 2:]).T
    u, v = u + stream.camera.K[0, 2], v + stream.camera.K[1, 2]
    inside = (u > 0) & (u < stream.camera.width) & (v > 0) & (v < stream.camera.height)
    assert inside.any(), "the camera sees some of the points"
    assert len(stream.images) in (0, len(stream.times))
    for k in range(len(stream.images)):
        assert file_of(stream.images[k]).is_file()
        image = stream.rectified_image(k)
        assert image is not None
        assert image.shape == (stream.camera.height, stream.camera.width, 3)
        assert image.dtype == np.uint8
