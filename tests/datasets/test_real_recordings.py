"""Real recordings of other sensors open as they are, or tell what to do."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from conformance import check

from docdepth.datasets import open_dataset, usable_points
from docdepth.datasets.point_times import TimeSample, find_point_times
from docdepth.errors import DatasetError

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")

# Heights of the VLP-16's lasers against its centre, millimetres, of Velodyne's manual.
VLP16_MM = [-9.7, -8.1, -6.6, -5.1, -3.7, -2.2, -0.7, 0.7, 2.2, 3.7, 5.1, 6.6, 8.1, 9.7, 11.2]
"""Of rings 1 to 15, which are counted from below."""


def test_velodyne_packets_are_the_decoded_cloud(recordings: Path) -> None:
    """To a fifth of a millimetre, but for the heights of the lasers, which the cloud lacks."""
    pytest.importorskip("rosbags")
    pytest.importorskip("velodyne_decoder")
    packets = open_dataset(recordings / "nebula" / "vlp16" / "1673400471837873222")
    check(packets, "bag")
    assert len(packets) == 4
    np.testing.assert_allclose(np.diff(packets.times) * 1e-9, 0.1, atol=1e-3)
    sweep = packets.sweep(3)
    assert sweep.relative_time.min() > -1e-3, "the stamp is of the first packet"
    assert 0.98 < sweep.relative_time.max() < 1
    cloud = open_dataset(recordings / "nebula" / "vlp16", format="folder").sweep(0)
    for ring in (1, 4, 9, 15):
        ours = sweep.points[(sweep.ring == ring) & usable_points(sweep.points)]
        theirs = cloud.points[(cloud.ring == ring) & usable_points(cloud.points)]
        gap = np.linalg.norm(ours[None, :, :2] - theirs[:, None, :2], axis=2)
        best = gap.argmin(axis=1)
        assert np.median(gap.min(axis=1)) < 2e-4
        height = theirs[:, 2] - ours[best, 2]
        assert abs(1000 * np.median(height) - VLP16_MM[ring - 1]) < 0.2


@pytest.mark.parametrize(
    ("path", "what"),
    [
        ("nebula/hesai_xt32/1673400677802009732", "/pandar_packets.*Hesai packets"),
        ("ouster/512x10_raw.bag", "lidar_packets.*Ouster packets"),
    ],
)
def test_packets_that_are_not_decoded_are_named(recordings: Path, path: str, what: str) -> None:
    pytest.importorskip("rosbags")
    with pytest.raises(DatasetError, match=f"{what}; record PointCloud2"):
        open_dataset(recordings / path)


def test_times_that_wrap_are_ignored_with_a_warning(recordings: Path, caplog) -> None:
    dataset = open_dataset(recordings / "nebula" / "vlp16", format="folder")
    assert dataset.times.tolist() == [1673400472138016708], "of the file's name"
    assert dataset.sweep(0).relative_time is None
    assert "they are ignored" in caplog.text


def test_a_folder_of_real_pcd_with_a_fisheye(recordings: Path, tmp_path: Path) -> None:
    acfr = recordings / "acfr"
    info = yaml.safe_load((acfr / "camera_info.yaml").read_text())
    numbers = sorted(int(file.stem[4:-5]) for file in (acfr / "pcd").glob("*_full.pcd"))
    for folder in ("sweeps", "images"):
        (tmp_path / folder).mkdir()
    for number in numbers:
        (tmp_path / "sweeps" / f"{number}.pcd").symlink_to(acfr / "pcd" / f"pose{number}_full.pcd")
        (tmp_path / "images" / f"{number}.png").symlink_to(acfr / "images" / f"pose{number}.png")
    camera = {
        "images": "images",
        "times": "sweeps",
        "K": info["K"],
        "distortion": info["D"],
        "model": "fisheye",
        "T_camera_lidar": [0, -1, 0, 0, 0, 0, -1, 0, 1, 0, 0, 0],
    }
    entries = {
        "sweeps": "sweeps",
        "rate": 1,
        "motion_compensated": True,
        "cameras": {"gmsl": camera},
    }
    (tmp_path / "docdepth.yaml").write_text(yaml.safe_dump(entries))
    dataset = open_dataset(tmp_path)
    check(dataset, "folder")
    assert len(dataset) == 20
    sweep = dataset.sweep(0)
    assert len(sweep.points) == 23969
    assert set(sweep.ring) == set(range(16))
    np.testing.assert_allclose(sweep.points[0], [1.373171, -2.6457233, -0.79871565], rtol=1e-7)


def test_point_times_of_a_real_ouster(recordings: Path) -> None:
    """Seconds from the start of each sweep, in float32."""
    folder, stamps = recordings / "newer_college_06", 1583836591 * 10**9 + 10**8 * np.arange(3)
    samples = []
    for k, stamp in enumerate(stamps.tolist()):
        points = np.fromfile(folder / f"raw_{k:02d}.bin", "<f4").reshape(-1, 3)
        times = np.fromfile(folder / f"times_{k:02d}.bin", "<f4")
        samples.append(TimeSample(times, usable_points(points), stamp))
    found = find_point_times(samples, 10**8, "newer college")
    assert found is not None
    assert (found.unit, found.origin, found.shift) == (10**9, "stamp", 0)
    late = found.relative(samples[0])
    assert late is not None
    np.testing.assert_allclose(late, samples[0].values * 10, atol=1e-6)
