"""The mistakes of benchmarks/held_out.py are as large as they say, and leave the drive as it is."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from docdepth.datasets import open_dataset
from docdepth.geometry.se3 import inverse, rotation_log

held_out = pytest.importorskip("held_out")


@pytest.fixture(scope="module")
def raw(drive, tmp_path_factory):
    """The drive with a time for each point, as raw sweeps have it."""
    copy = tmp_path_factory.mktemp("raw") / "sequences" / "00"
    shutil.copytree(drive, copy)
    (copy / "point_times").mkdir()
    for sweep in (copy / "velodyne").iterdir():
        points = sweep.stat().st_size // 16
        np.zeros(points, "<f4").tofile(copy / "point_times" / f"{sweep.stem}.bin")
    about = (copy / "docdepth.yaml").read_text()
    (copy / "docdepth.yaml").write_text(about.replace("compensated: true", "compensated: false"))
    return copy


@pytest.fixture
def pair(raw, tmp_path, request):
    before = {file: file.read_bytes() for file in raw.rglob("*") if file.is_file()}
    name = request.param
    copy = held_out.spoilt(raw, tmp_path / "sequences" / "00", held_out.MISTAKES[name])
    assert {file: file.read_bytes() for file in before} == before
    return open_dataset(raw), open_dataset(copy)


@pytest.mark.parametrize("pair", ["poses 5 cm off"], indirect=True)
def test_each_pose_is_five_centimetres_off(pair) -> None:
    right, wrong = pair
    off = wrong.poses[:, :3, 3] - right.poses[:, :3, 3]
    np.testing.assert_allclose(np.linalg.norm(off, axis=1), 0.05, rtol=1e-6)
    assert np.linalg.norm(np.diff(off, axis=0), axis=1).min() > 0.005, "each its own way"


@pytest.mark.parametrize("pair", ["calibration 0.5 deg off"], indirect=True)
def test_the_camera_is_turned_by_half_a_degree(pair) -> None:
    right, wrong = (dataset.cameras["image_2"].T_camera_lidar for dataset in pair)
    turn = np.degrees(np.linalg.norm(rotation_log((wrong @ inverse(right))[:3, :3])))
    assert turn == pytest.approx(0.5)


@pytest.mark.parametrize("pair", ["images 50 ms late"], indirect=True)
def test_images_are_stamped_late(pair) -> None:
    right, wrong = (dataset.cameras["image_2"] for dataset in pair)
    np.testing.assert_allclose(wrong.times - right.times, 50_000_000, atol=1)
    np.testing.assert_array_equal(wrong.rectified_image(1), right.rectified_image(1))


@pytest.mark.parametrize("pair", ["not compensated"], indirect=True)
def test_raw_sweeps_are_said_to_be_compensated(pair) -> None:
    right, wrong = (dataset.sweep(2) for dataset in pair)
    assert wrong.motion_compensated
    assert not right.motion_compensated
    np.testing.assert_array_equal(wrong.points, right.points)


def test_correlation_of_errors_that_grow_together() -> None:
    def row(name: str, exact: float, held: float, camera: float = 0) -> held_out.Row:
        errors = {"too_near": exact, "too_far": 0, "mae": exact}
        found = {"exact": errors, "held": {"all": {"too_near": held, "too_far": 0, "mae": held}}}
        found["camera"] = {"mae": camera, "wrong": camera}
        return ("drive", "default", name, {**found, "said": ["the poses jitter: by 5 cm"]})

    rows = [row("as it is", 1, 2), row("poses 5 cm off", 2, 4), row("images 50 ms late", 9, 2, 16)]
    rows.append(row("not compensated", 3, 6))
    table = held_out.correlations(rows)
    mae = {line[0]: line[3:] for line in table.rows if line[1] == "mae"}
    assert float(mae.pop("all rows")[0]) < 0.2, "what only the camera shows is no part of it"
    assert list(mae.values()) == [("1.000",) * 3] * 4, "with what the images say it is"
    assert "the poses jitter" in str(held_out.table(rows))
