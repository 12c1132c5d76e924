"""Real recordings of other sensors open as they are, or tell what to do."""

from __future__ import annotations

import json
import pickle
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from conformance import check
from scipy.optimize import least_squares
from vehicles import nuscenes_tables

from docdepth.datasets import Sweep, open_dataset, usable_points
from docdepth.datasets.formats.pcap.hesai import DESIGNED
from docdepth.datasets.point_times import TimeSample, find_point_times
from docdepth.datasets.sensor_pose import estimate_sensor_origin
from docdepth.errors import DatasetError, MissingExtraError
from docdepth.geometry.lidar_frame import lidar_views
from docdepth.geometry.se3 import se3_exp
from docdepth.io.pcd import read_pcd
from docdepth.odometry.deskewing import deskew

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
    cloud = open_dataset(recordings / "nebula" / "vlp16", dataset="folder").sweep(0)
    for ring in (1, 4, 9, 15):
        ours = sweep.points[(sweep.ring == ring) & usable_points(sweep.points)]
        theirs = cloud.points[(cloud.ring == ring) & usable_points(cloud.points)]
        gap = np.linalg.norm(ours[None, :, :2] - theirs[:, None, :2], axis=2)
        best = gap.argmin(axis=1)
        assert np.median(gap.min(axis=1)) < 2e-4
        height = theirs[:, 2] - ours[best, 2]
        assert abs(1000 * np.median(height) - VLP16_MM[ring - 1]) < 0.2


def test_hesai_packets_are_the_decoded_cloud(recordings: Path, tmp_path: Path) -> None:
    """All 63021 returns in their order, by the angles of this very unit, which its cloud tells.

    These are two numbers for each laser, medians of two thousand returns.
    """
    pytest.importorskip("rosbags")
    bag = recordings / "nebula" / "hesai_xt32" / "1673400677802009732"
    packets = open_dataset(bag)
    check(packets, "bag")
    np.testing.assert_allclose(np.diff(packets.times) * 1e-9, 0.1, atol=2e-3)
    sweeps = {k: packets.sweep(k) for k in (2, 3)}
    late = sweeps[3].relative_time
    assert -2e-3 < late.min() < 0, "a packet arrives after its firings"
    assert 0.98 < late.max() < 1
    cloud, _ = read_pcd(next(bag.parent.glob("*.pcd")))
    theirs = _rays(np.stack([cloud[axis] for axis in "xyz"], axis=1))
    laser = np.abs(theirs[:, 1:2] - DESIGNED[:, 0]).argmin(axis=1)
    lines, rows = ["Channel,Elevation,Azimuth"], []
    for ring in range(32):
        same = theirs[laser == ring]
        rows.append(_rows_from_ahead(sweeps, ring, same[:, 0]))
        ours = _rays(_points(sweeps, rows[-1]))
        turned = (same[:, 2] - ours[:, 2] + 180) % 360 - 180
        lines.append(f"{ring + 1},{np.median(same[:, 1])},{np.median(turned)}")
    (tmp_path / "bag").mkdir()
    for file in bag.iterdir():
        (tmp_path / "bag" / file.name).symlink_to(file)
    (tmp_path / "bag" / "xt32.csv").write_text("\n".join(lines))
    (tmp_path / "bag" / "docdepth.yaml").write_text("lidars: {/pandar_packets: {angles: xt32.csv}}")
    dataset = open_dataset(tmp_path / "bag")
    by_its_angles = {k: dataset.sweep(k) for k in (2, 3)}
    assert sum(map(len, rows)) == len(theirs) == 63021
    for ring in range(32):
        points = np.stack([cloud[axis][laser == ring] for axis in "xyz"], axis=1)
        found = _points(by_its_angles, rows[ring])
        np.testing.assert_allclose(found, points, rtol=0, atol=2e-5, err_msg=f"laser {ring}")


def _rows_from_ahead(
    sweeps: dict[int, Sweep], ring: int, ranges: np.ndarray
) -> list[tuple[int, int]]:
    """Sweep and row of the returns of a laser from 0 to 360 degrees, as the cloud was cut.

    The messages begin at 1.08 degrees. Whether the firing at 0 is the first one or the last
    depends on the azimuth of the laser, so it follows from the ranges (metres) that are expected.
    """
    found: list[list[tuple[int, int]]] = []
    for number, sweep in sweeps.items():
        rows = np.flatnonzero(sweep.ring == ring)
        azimuth = _rays(sweep.points[rows])[:, 2] % 360
        parts = (azimuth > 359.99) | (azimuth < 0.01), azimuth < 1, azimuth >= 1
        first, ahead, rest = ([(number, int(row)) for row in rows[part]] for part in parts)
        found += [first, [pair for pair in ahead if pair not in first], rest]
    before, ahead, _, after, _, rest = found
    for chosen in (before + ahead + rest, ahead + rest + after):
        ours = _rays(_points(sweeps, chosen))[:, 0]
        if len(ours) == len(ranges) and np.abs(ours - ranges).max() < 1e-4:
            return chosen
    raise AssertionError(f"laser {ring} has other ranges")


def _points(sweeps: dict[int, Sweep], rows: list[tuple[int, int]]) -> np.ndarray:
    return np.array([sweeps[number].points[row] for number, row in rows])


def _rays(points: np.ndarray) -> np.ndarray:
    """Metres, elevation and azimuth (degrees) of points in Hesai's frame."""
    x, y, z = points.T.astype(np.float64)
    level = np.hypot(x, y)
    angles = np.degrees([np.arctan2(z, level), np.arctan2(x, y)])
    return np.stack([np.hypot(level, z), *angles], axis=1)


def test_what_decodes_packets_is_named(recordings: Path) -> None:
    pytest.importorskip("rosbags")
    if find_spec("ouster"):
        pytest.skip("ouster-sdk is here")
    with pytest.raises(MissingExtraError, match=r"Ouster packets in bags need ouster-sdk"):
        open_dataset(recordings / "ouster" / "512x10_raw.bag")


def test_times_that_wrap_are_ignored_with_a_warning(recordings: Path, caplog) -> None:
    dataset = open_dataset(recordings / "nebula" / "vlp16", dataset="folder")
    assert dataset.times.tolist() == [1673400472138016708], "of the file's name"
    assert dataset.sweep(0).relative_time is None
    assert "they are ignored" in caplog.text


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


def test_deskewing_is_that_of_others(recordings: Path) -> None:
    """Of a hand-held Ouster that turns by up to 100 degrees a second, deskewed by an IMU.

    The three sweeps are seconds apart, so that the motion is fitted: one constant velocity has to
    explain what others did with the times of the points, to the start of the sweep.
    """
    folder = recordings / "newer_college_06"
    T_imu_lidar = np.array([(-1, 0, 0, -0.006), (0, -1, 0, 0.012), (0, 0, 1, -0.029)])
    for k in range(3):
        raw, theirs = (
            np.fromfile(folder / f"{name}_{k:02d}.bin", "<f4").reshape(-1, 3)
            for name in ("raw", "deskewed")
        )
        late = 10 * np.fromfile(folder / f"times_{k:02d}.bin", "<f4")
        theirs = (theirs - T_imu_lidar[:, 3]) @ T_imu_lidar[:, :3]

        def errors(twist, rows, raw=raw, late=late, theirs=theirs):
            motion = se3_exp(twist[:3], twist[3:])
            return (deskew(raw[rows], late[rows], motion) - theirs[rows]).ravel().astype(float)

        some, every = np.arange(0, len(raw), 20), np.arange(len(raw))
        fit = least_squares(
            errors, np.zeros(6), args=(some,), loss="soft_l1", f_scale=0.02, diff_step=1e-3
        )
        before, after = (
            np.median(np.linalg.norm(errors(twist, every).reshape(-1, 3), axis=1))
            for twist in (np.zeros(6), fit.x)
        )
        assert before > 0.35
        assert after < min(0.04, before / 20)


# ---- data sets of vehicles


def test_a_real_scene_of_dgp(recordings: Path) -> None:
    """Ten sweeps a second, though its dates are of the year 2463; poses fit the cameras'."""
    dataset = open_dataset(recordings / "dgp")
    check(dataset, "dgp")
    np.testing.assert_allclose(np.diff(dataset.times) * 1e-9, 0.1, atol=1e-3)
    assert 1556919593 < dataset.times[0] * 1e-9 < 1556919594
    assert list(dataset.cameras) == ["CAMERA_01", "CAMERA_05", "CAMERA_06"]
    scene = json.loads(next(dataset.path.glob("scene_*.json")).read_text())
    for stream in dataset.cameras.values():
        late = (stream.times - dataset.times) * 1e-9
        np.testing.assert_allclose(late, 0.0212, atol=1e-3)
        # The vehicle stands, so the poses of images are the LiDAR's and the extrinsics.
        entry = next(d for d in scene["data"] if d["id"]["name"] == stream.name)
        pose = entry["datum"]["image"]["pose"]["translation"]
        own = (dataset.poses[0] @ np.linalg.inv(stream.T_camera_lidar))[:3, 3]
        np.testing.assert_allclose(own, [pose[a] for a in "xyz"], atol=1e-4)


@pytest.mark.nightly
def test_the_lidars_of_a_real_merged_cloud_are_told_apart(recordings: Path) -> None:
    """One sits in the bumper, the others on the roof, in the order of the points."""
    found = estimate_sensor_origin(open_dataset(recordings / "dgp"))
    assert found is not None
    places = np.array(found.places)
    assert len(places) >= 3
    assert places[0, 0] > places[1:, 0].max(), "the bumper is ahead"
    assert places[0, 2] < 1.5 < places[1:, 2].min() <= places[1:, 2].max() < 2.5
    assert found.share > 0.9, "0.87 from one place"


def test_a_real_log_of_argoverse_2(recordings: Path, tmp_path: Path) -> None:
    """Seen from where the file says, each laser has one elevation: the lower LiDAR hangs."""
    feather = pytest.importorskip("pyarrow.feather")
    import pyarrow

    log = tmp_path / "log"
    (log / "calibration").mkdir(parents=True)
    (original,) = (recordings / "av2").glob("*-*")
    for name in ("sensors", "city_SE3_egovehicle.feather"):
        (log / name).symlink_to(original / name)
    places = {  # found in the sweep itself: the sample lacks its calibration
        "sensor_name": ["up_lidar", "down_lidar"],
        "qw": [1.0, 0.0], "qx": [0.0, 1.0], "qy": [0.0, 0.0], "qz": [0.0, 0.0],
        "tx_m": [1.350, 1.349], "ty_m": [0.0, -0.001], "tz_m": [1.641, 1.526],
    }  # fmt: skip
    with pytest.raises(DatasetError, match=r"egovehicle_SE3_sensor.feather is missing; download"):
        open_dataset(log)
    feather.write_feather(
        pyarrow.table(places), str(log / "calibration" / "egovehicle_SE3_sensor.feather")
    )
    columns = ("sensor_name", "fx_px", "fy_px", "cx_px", "cy_px", "width_px", "height_px")
    feather.write_feather(
        pyarrow.table({name: [] for name in columns}),
        str(log / "calibration" / "intrinsics.feather"),
    )
    dataset = open_dataset(log)
    check(dataset, "argoverse2")
    sweep = dataset.sweep(0)
    assert len(sweep.points) == 100660
    assert sweep.motion_compensated
    assert 0 < sweep.relative_time.min() < 0.01
    assert set(sweep.ring) == set(range(64))
    elevations = {}
    for ring in range(64):
        place = sweep.sensor_rig.T_lidar_sensor[ring // 32, :3, 3]
        own = sweep.points[sweep.ring == ring] - place
        own = own[np.linalg.norm(own, axis=1) > 4]
        angle = np.degrees(np.arctan2(own[:, 2], np.hypot(own[:, 0], own[:, 1])))
        elevations[ring] = np.median(angle)
        assert np.median(np.abs(angle - elevations[ring])) < 0.06, ring
    for ring in range(32):
        assert abs(elevations[ring] + elevations[ring + 32]) < 0.1, "one hangs upside down"
    for lidar, view in enumerate(lidar_views(sweep.points, sweep.sensor_rig)):
        assert np.isfinite(view.points).all(axis=1).sum() == (sweep.ring // 32 == lidar).sum()


def test_a_real_sample_of_nuscenes(recordings: Path, tmp_path: Path) -> None:
    """Six cameras see the points where the pickle's own projection puts them."""
    folder = recordings / "nuscenes"
    (file,) = folder.glob("*.pkl")
    known = pickle.loads(file.read_bytes())["data_list"][0]
    T_world_ego = np.array(known["ego2global"])
    lidar = known["lidar_points"]
    sensors = {"LIDAR_TOP": (np.array(lidar["lidar2ego"]), [])}
    data = [{"channel": "LIDAR_TOP", "us": round(known["timestamp"] * 1e6), "size": (0, 0),
             "file": lidar["lidar_path"], "T_world_ego": T_world_ego}]  # fmt: skip
    for name, camera in known["images"].items():
        sensors[name] = (np.array(camera["cam2ego"]), camera["cam2img"])
        data.append({"channel": name, "us": round(camera["timestamp"] * 1e6), "size": (1600, 900),
                     "file": camera["img_path"], "T_world_ego": T_world_ego})  # fmt: skip
    for one in data:
        (tmp_path / one["file"]).symlink_to(folder / one["file"])
    nuscenes_tables(tmp_path, sensors, data)
    with pytest.raises(DatasetError, match=r"has 2 scenes of nuScenes; name one of .*scene-0061"):
        open_dataset(tmp_path)
    dataset = open_dataset(tmp_path / "scene-0061")
    check(dataset, "nuscenes")
    sweep = dataset.sweep(0)
    assert len(sweep.points) == 34688
    assert set(sweep.ring) == set(range(32))
    assert dataset.times.tolist() == [1532402927647951000]
    raw = np.fromfile(folder / lidar["lidar_path"], "<f4").reshape(-1, 5)[:, :3]
    for name, camera in known["images"].items():
        stream = dataset.cameras[name]
        T = np.array(camera["lidar2cam"])
        theirs = raw @ T[:3, :3].T + T[:3, 3]
        ours = sweep.points @ stream.T_camera_lidar[:3, :3].T + stream.T_camera_lidar[:3, 3]
        # Theirs has the motion of the vehicle between sweep and image in it.
        assert np.abs(theirs - ours).max() < 0.6
        assert (ours[:, 2] > 0).sum() > 5000
    front = dataset.cameras["CAM_FRONT"].T_camera_lidar
    assert front[2, 0] > 0.99, "x of docdepth's LiDAR frame is ahead"
