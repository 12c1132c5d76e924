"""MulRan, NCLT, HeLiPR and Boreas: what is their own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from formats import WRITERS
from long_drives import COLUMNS_APART
from made_up import DRIVE, K

from docdepth.datasets import open_dataset, usable_points
from docdepth.errors import CalibrationError, DatasetError


def test_times_of_mulrans_columns(tmp_path: Path) -> None:
    dataset = open_dataset(WRITERS["MulRan"][1](tmp_path).path)
    sweep = dataset.sweep(1)
    usable = usable_points(sweep.points)
    columns = COLUMNS_APART * np.arange(usable.sum())
    assert sweep.relative_time is not None
    expected = columns * 97656 / DRIVE.period  # ns of a column
    np.testing.assert_allclose(sweep.relative_time[usable], expected, atol=1e-6)
    assert not sweep.motion_compensated


def test_a_sweep_of_mulran_that_lacks_rows_has_no_times(tmp_path: Path, caplog) -> None:
    dataset = open_dataset(WRITERS["MulRan"][1](tmp_path).path)
    (file,) = dataset.sweep_files(1)
    file.write_bytes(file.read_bytes()[:-16])
    sweep = open_dataset(dataset.path).sweep(1)
    assert sweep.relative_time is None
    assert sweep.ring is None
    assert f"{file}, and 0 more of 5 sweeps: not 64 x 1024 rows" in caplog.text
    np.testing.assert_array_equal(
        sweep.points[usable_points(sweep.points)], DRIVE.points(1)[DRIVE.usable(1)]
    )


def test_rays_of_nclt_begin_at_the_lidar(tmp_path: Path) -> None:
    """A hit where the LiDAR sits is at the origin; one a metre below it is a metre down."""
    dataset = open_dataset(WRITERS["NCLT"][1](tmp_path).path)
    (file,) = dataset.sweep_files(0)
    body = np.array([[0.0, -0.005, -0.955], [2, -0.005, -0.955], [0, 3, -0.955], [0, 0, 0.045]])
    rows = np.zeros(4, "<u2, <u2, <u2, u1, u1")
    for k in range(3):
        rows[f"f{k}"] = np.round((body[:, k] + 100) / 0.005)
    rows.tofile(file)
    expected = [[0, 0, 0], [2, 0, 0], [0, -3, 0], [0, 0, -1]]
    np.testing.assert_allclose(dataset.sweep(0).points, expected, atol=0.0071)
    assert dataset.sweep(0).motion_compensated


def test_times_of_heliprs_points_count_from_the_stamp(tmp_path: Path) -> None:
    dataset = open_dataset(WRITERS["HeLiPR, Avia"][1](tmp_path).path)
    sweep = dataset.sweep(1)
    usable = DRIVE.usable(1)
    assert sweep.relative_time is not None
    expected = DRIVE.rows(1)["share"][usable] + 0.5
    np.testing.assert_allclose(sweep.relative_time[usable], expected, atol=1e-6)


def test_early_sessions_of_aeva_have_shorter_rows(tmp_path: Path) -> None:
    path = WRITERS["HeLiPR, Aeva"][1](tmp_path).path
    for file in path.glob("*.bin"):
        rows = np.fromfile(file, np.dtype("V29"))
        early = 1_690_000_000_000_000_000 + int(file.stem) - DRIVE.times[0]
        short = np.frombuffer(rows.tobytes(), np.uint8).reshape(-1, 29)[:, :25]
        (path / f"{early}.bin").write_bytes(np.ascontiguousarray(short).tobytes())
        file.unlink()
    for table in (path.parent.parent / "LiDAR_GT").iterdir():
        table.unlink()
    sweep = open_dataset(path).sweep(2)
    np.testing.assert_array_equal(sweep.points, DRIVE.points(2))
    np.testing.assert_array_equal(sweep.intensity, DRIVE.rows(2)["intensity"])


def test_a_sequence_of_helipr_names_its_lidars(tmp_path: Path) -> None:
    path = WRITERS["HeLiPR, Ouster"][1](tmp_path).path
    assert open_dataset(tmp_path).path == path
    WRITERS["HeLiPR, Avia"][1](tmp_path / "more")
    (tmp_path / "more" / "KAIST05" / "LiDAR" / "Avia").rename(path.parent / "Avia")
    with pytest.raises(DatasetError, match=r"holds 2 recordings; name one of .*Avia, .*Ouster"):
        open_dataset(tmp_path / "KAIST05")


def test_a_camera_of_boreas_without_images_fires_with_the_sweeps(tmp_path: Path) -> None:
    path = WRITERS["Boreas"][1](tmp_path).path
    for image in (path / "camera").iterdir():
        image.unlink()
    stream = open_dataset(path, image_size=(64, 48)).cameras["camera"]
    assert stream.names == open_dataset(path, image_size=(64, 48)).lidars["lidar"].names
    assert (stream.camera.width, stream.camera.height) == (64, 48)
    assert open_dataset(path).cameras["camera"].camera.width == 2448


def test_a_camera_of_the_users(tmp_path: Path) -> None:
    path = WRITERS["NCLT"][1](tmp_path).path
    assert open_dataset(path).cameras == {}
    camera = {
        "K": K.ravel().tolist(),
        "T_camera_lidar": DRIVE.T_camera_lidar.tolist(),
        "times": "sweeps",
    }
    (path / "docdepth.yaml").write_text(yaml.safe_dump({"cameras": {"front": camera}}))
    (stream,) = open_dataset(path, image_size=(64, 48)).cameras.values()
    np.testing.assert_array_equal(stream.camera.K, K)
    np.testing.assert_allclose(stream.times, DRIVE.times, atol=1000)
    with pytest.raises(CalibrationError, match=r"docdepth\.yaml, front has neither images"):
        open_dataset(path)
