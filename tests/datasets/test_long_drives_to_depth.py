"""A synthetic drive written as data sets have it gives the depth maps that it gives by itself."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from long_drives import angles_of, pack
from made_up import START
from rewriting import camera_entry
from writers import seconds

from docdepth import read_depth, run
from docdepth.datasets import Dataset, open_dataset
from docdepth.datasets.images import read_image_of
from docdepth.datasets.point_times import median_period

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def raw(tmp_path_factory: pytest.TempPathFactory) -> tuple[Dataset, Path]:
    """Six raw sweeps of a VLP-16, and a run of them."""
    pytest.importorskip("embreex")
    from docdepth.synthetic import write_drive

    root = tmp_path_factory.mktemp("raw")
    drive = write_drive(root / "drive", sensor="VLP-16", frames=6, seed=7, skew=True)
    drive = next(drive.rglob("velodyne")).parent
    for file in (drive / "point_times").iterdir():
        _as_in_seconds(np.fromfile(file, np.float32)).tofile(file)
    return open_dataset(drive), run(drive, root / "run", camera="image_2").path


def _as_in_seconds(share: np.ndarray) -> np.ndarray:
    """Shares of a sweep of 0.1 s that are the same after they were floats of seconds."""
    while True:
        seconds = (share.astype(np.float64) * 0.1).astype(np.float32)
        again = (seconds.astype(np.float64) / 0.1).astype(np.float32)
        if (again == share).all():
            return share
        share = again


def columns(dataset: Dataset, k: int) -> dict[str, tuple[str, np.ndarray]]:
    """What both formats keep of a sweep; seconds after the stamp."""
    sweep, period = dataset.sweep(k), median_period(dataset.times)
    assert sweep.relative_time is not None
    assert sweep.intensity is not None
    assert period is not None
    points = {axis: ("f4", sweep.points[:, n]) for n, axis in enumerate("xyz")}
    late = sweep.relative_time.astype("f8") * period * 1e-9
    return {**points, "intensity": ("f4", sweep.intensity), "time": ("f4", late)}


def write_boreas(root: Path, dataset: Dataset) -> Path:
    """The LiDAR stands as docdepth wants it, so points stay to the bit."""
    for folder in ("lidar", "camera", "calib", "applanix"):
        (root / folder).mkdir(parents=True)
    assert dataset.poses is not None
    lines = ["GPSTime,easting,northing,altitude,...,roll,pitch,heading,..."]
    for k, time in enumerate((dataset.times + START).tolist()):
        found, file = columns(dataset, k), root / "lidar" / f"{time // 1000}.bin"
        time_of_points = found.pop("time")
        ring = ("f4", np.zeros(len(time_of_points[1])))
        pack(file, **found, ring=ring, time=time_of_points)
        T = dataset.poses[k]
        values = [*T[:3, 3], 0, 0, 0, *angles_of(T[:3, :3].T), 0, 0, 0]
        lines.append(",".join([str(time // 1000), *(repr(float(v)) for v in values)]))
    (root / "applanix" / "lidar_poses.csv").write_text("\n".join(lines) + "\n")
    stream = dataset.cameras["image_2"]
    for image, time in zip(stream.images, (stream.times + START).tolist(), strict=True):
        cv2.imwrite(str(root / "camera" / f"{time // 1000}.png"), read_image_of(image))
    P = np.eye(4)
    P[:3, :3] = stream.camera.K
    np.savetxt(root / "calib" / "P_camera.txt", P)
    np.savetxt(root / "calib" / "T_camera_lidar.txt", stream.T_camera_lidar)
    ahead = np.array([[0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    np.savetxt(root / "calib" / "T_applanix_lidar.txt", ahead)
    return root


def write_helipr(root: Path, dataset: Dataset) -> Path:
    """Its Velodyne, and a camera of the user's."""
    folder = root / "LiDAR" / "Velodyne"
    folder.mkdir(parents=True)
    for k, time in enumerate((dataset.times + START).tolist()):
        found = columns(dataset, k)
        time_of_points = found.pop("time")
        ring = ("u2", np.zeros(len(time_of_points[1])))
        pack(folder / f"{time}.bin", **found, ring=ring, time=time_of_points)
    stream = dataset.cameras["image_2"]
    (folder / "front").mkdir()
    for image in stream.images:
        cv2.imwrite(str(folder / "front" / Path(image).name), read_image_of(image))
    (folder / "front.txt").write_text(seconds(stream.times + START))
    entry = camera_entry(stream) | {"images": "front", "times": "front.txt"}
    (folder / "docdepth.yaml").write_text(yaml.safe_dump({"cameras": {"front": entry}}))
    return folder


@pytest.mark.nightly
@pytest.mark.parametrize("write", [write_boreas, write_helipr])
def test_depth_maps(raw, tmp_path: Path, write) -> None:
    dataset, by_itself = raw
    other = run(write(tmp_path / "recording", dataset), tmp_path / "run").path
    maps, again = (sorted((r / "depth").glob("*.png")) for r in (by_itself, other))
    assert len(maps) == len(again) == len(dataset.cameras["image_2"].times)
    for one, two in zip(maps, again, strict=True):
        np.testing.assert_array_equal(read_depth(one), read_depth(two))
