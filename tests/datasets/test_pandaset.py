"""PandaSet: where its sensors sit, and pickles that are no tables."""

from __future__ import annotations

import gzip
import pickle
from pathlib import Path

import numpy as np
import pytest
from formats import WRITERS
from made_up import DRIVE

from docdepth.datasets import open_dataset
from docdepth.datasets.formats.pandaset import T_camera_lidar
from docdepth.errors import DatasetError
from docdepth.geometry.se3 import inverse


@pytest.fixture
def pandaset(tmp_path: Path) -> Path:
    return WRITERS["PandaSet"][1](tmp_path).path


@pytest.mark.parametrize(
    ("name", "looks", "to_its_right"),
    [
        ("front_camera", [1, 0, 0], [0, -1, 0]),
        ("back_camera", [-1, 0, 0], [0, 1, 0]),
        ("left_camera", [0, 1, 0], [1, 0, 0]),
        ("right_camera", [0, -1, 0], [-1, 0, 0]),
        ("front_left_camera", [0.7, 0.7, 0], [0.7, -0.7, 0]),
        ("front_right_camera", [0.7, -0.7, 0], [-0.7, -0.7, 0]),
    ],
)
def test_cameras_of_pandaset_look_where_they_are_called(name, looks, to_its_right) -> None:
    T = T_camera_lidar(name)
    assert T[2, :3] @ looks > 0.94
    assert T[0, :3] @ to_its_right > 0.94
    centre = inverse(T)[:3, 3]
    assert np.linalg.norm(centre) < 1.1
    assert -0.4 < centre[2] < 0, "below the LiDAR on the roof"
    assert centre @ looks > 0, "on the side to which it looks"


def test_points_of_pandasets_front_lidar_are_left_out(pandaset: Path) -> None:
    sweep = open_dataset(pandaset).sweep(3)
    assert len(sweep.points) == DRIVE.usable(3).sum()
    assert sweep.motion_compensated
    assert sweep.relative_time is not None
    shares = DRIVE.rows(3)["share"][DRIVE.usable(3)]
    np.testing.assert_allclose(sweep.relative_time, shares, atol=1e-5)  # 0.2 µs in doubles


def test_a_pickle_that_would_run_a_program(pandaset: Path, tmp_path: Path) -> None:
    class Program:
        def __reduce__(self):
            return Path.touch, (tmp_path / "ran",)

    (pandaset / "lidar" / "01.pkl.gz").write_bytes(gzip.compress(pickle.dumps(Program())))
    with pytest.raises(DatasetError, match=r"01\.pkl\.gz \(frame 1\) .*it asks for .*no table"):
        open_dataset(pandaset).sweep(1)
    assert not (tmp_path / "ran").exists()


def test_tables_of_other_sizes_and_types(pandaset: Path) -> None:
    pandas = pytest.importorskip("pandas")
    file = pandaset / "lidar" / "01.pkl.gz"
    file.write_bytes(gzip.compress(bytes(1 << 29), 1))
    with pytest.raises(DatasetError, match=r"01\.pkl\.gz \(frame 1\) .*more than 256 MB"):
        open_dataset(pandaset).sweep(1)
    columns = {name: np.arange(3.0) for name in "xyzitd"}
    file.write_bytes(gzip.compress(pickle.dumps(pandas.DataFrame({**columns, 9: [{}, [], ""]}))))
    with pytest.raises(DatasetError, match=r"01\.pkl\.gz \(frame 1\) .*column 9|asks for"):
        open_dataset(pandaset).sweep(1)
