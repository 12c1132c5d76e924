"""Sweeps as text, as recorders and viewers write them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.lib.recfunctions as rfn
import pytest
from writers import WRITERS, write_pcd

from docdepth.datasets.cloud_files import RowFormat, read_cloud
from docdepth.datasets.formats.cloud_folder import cloud_files
from docdepth.errors import DatasetError

POINTS = np.array([[1.5, 2.5, -3], [0, -0.25, 1e-3], [np.nan, np.nan, np.nan]])


@pytest.mark.parametrize(
    ("head", "mark", "order"),
    [
        ("", " ", "xyzi"),
        ("", ",", "xyz"),
        ("", ";", "xyzi"),
        ("3\n", " ", "xyz"),  # so many points
        ('"X","Y","Z"\r\n', ",", "xyz"),
        ("# z x y\n# of a scanner\n# x y z intensity\n", " ", "xyzi"),
        ("//X\tY\tZ\n", "\t", "xyz"),  # of CloudCompare
        (",x [m],y [m],z (m)\n", ",", "ixyz"),  # of pandas
        ('"Points_m_XYZ:0","intensity","Points_m_XYZ:1","Points_m_XYZ:2"\n', ",", "xiyz"),
        ("Points:0,X,Y,Z\n", ",", "ixyz"),  # the same in another frame
        ("x;y;z\n", ";,", "xyz"),  # decimals of many countries
    ],
)
def test_text_of_points(tmp_path: Path, head: str, mark: str, order: str) -> None:
    values = dict(zip("xyzi", [*POINTS.T, [7, 8, 9]], strict=True))
    lines = [mark[0].join(f"{values[c][k]}" for c in order) for k in range(3)]
    text = head + "\n".join(lines) + "\n"
    (tmp_path / "a.csv").write_text(text.replace(".", ",") if mark == ";," else text)
    read = read_cloud(tmp_path / "a.csv", "a", RowFormat())
    np.testing.assert_array_equal(read.points, POINTS)
    if "intensity" in head or order == "xyzi":
        np.testing.assert_array_equal(read.intensity, [7, 8, 9])


@pytest.mark.parametrize("content", ["1.5 2.5 -3 0\n", "1.5,2.5,-3\n", "1.5;2,5;-3;0\r\n"])
def test_text_under_another_name(tmp_path: Path, content: str) -> None:
    (tmp_path / "a.bin").write_text(content * 40)
    points = read_cloud(tmp_path / "a.bin", "a", RowFormat()).points
    np.testing.assert_array_equal(points, [[1.5, 2.5, -3]] * 40)


def test_millimetres_and_quotes(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text('"X (mm)","y [cm]",z,"Time (us)"\n"1500","-2.5","3","1e5"\n')
    cloud = read_cloud(tmp_path / "a.csv", "a", RowFormat())
    np.testing.assert_allclose(cloud.points, [[1.5, -0.025, 3]])
    assert cloud.times is not None
    assert cloud.times[0] == 1e5


def test_grids_of_points(tmp_path: Path) -> None:
    grid = np.arange(24, dtype=np.float32).reshape(2, 3, 4)
    named = grid.view([(c, "f4") for c in "xyzi"])[..., 0]
    for k, array in enumerate((grid, named)):
        np.save(tmp_path / f"{k}.npy", array)
        cloud = read_cloud(tmp_path / f"{k}.npy", "a", RowFormat())
        np.testing.assert_array_equal(cloud.points, grid.reshape(6, 4)[:, :3])


def test_values_that_are_left_out_are_nan(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("x,y,z,\n1,2,3,\n\n,,,\n4,5,-1.#IND,\n")
    points = read_cloud(tmp_path / "a.csv", "a", RowFormat()).points
    np.testing.assert_array_equal(points, [[1, 2, 3], [np.nan] * 3, [4, 5, np.nan]])


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"1,5 2,5 3 0\n", "no line of numbers; .*decimals with a point"),
        (b"", "no line of numbers"),
        (b"lat,lon,alt\n1,2,3\n", "no field x, only lat, lon, alt; points need"),
        (b"x,y,x,z\n1,2,3,4\n", "two columns x"),
        (b"1,2,3,4,5\n", r"shape \(1, 5\).* say columns"),
        (b"1,2,3\n\n4,5,6,7\n", "line 3, has 4 values in the line '4,5,6,7', and 3 in"),
        (b"1 2 3\n4 5\n", "2 values in the line '4 5', and 3 in the first"),
        (b"1 2 3\n4 five 6\n", "no number .*'five'"),
        ("1,2,3\n".encode("utf-16"), "no line of numbers"),
    ],
)
def test_text_that_holds_no_points(tmp_path: Path, content: bytes, message: str) -> None:
    (tmp_path / "a.csv").write_bytes(content)
    with pytest.raises(DatasetError, match=f"frame 3.* {message}"):
        read_cloud(tmp_path / "a.csv", "frame 3", RowFormat())


def test_text_beside_clouds_is_something_else(tmp_path: Path) -> None:
    folder = WRITERS["folder of csv"][1](tmp_path).path
    (folder / "poses.txt").touch()
    assert {file.suffix for file in cloud_files(folder)} == {".csv"}  # though .txt are there, too
    rows = rfn.unstructured_to_structured(POINTS.astype("f4"), names=list("xyz"))
    write_pcd(folder / "000000.pcd", rows)
    assert [file.name for file in cloud_files(folder)] == ["000000.pcd"]


@pytest.mark.parametrize(
    ("head", "mark"),
    [
        ("X1 (mm),Y1 (mm),Z1 (mm),SIGNAL1", ","),
        ("# X1 (mm), Y1 (mm), Z1 (mm), SIGNAL1,", ","),
        ("X1 (mm) Y1 (mm) Z1 (mm) SIGNAL1", " "),
    ],
)
def test_columns_that_are_said_keep_the_units_of_the_head(
    tmp_path: Path, head: str, mark: str
) -> None:
    """Names as Ouster Studio has them are no coordinates until the user says so."""
    row = mark.join(["1500", "2500", "-3000", "7"])
    (tmp_path / "a.csv").write_text(f"{head}\n{row}\n")
    with pytest.raises(DatasetError, match=r"no field x, only x1, y1, z1, signal1"):
        read_cloud(tmp_path / "a.csv", "a", RowFormat())
    cloud = read_cloud(tmp_path / "a.csv", "a", RowFormat(("x", "y", "z", "intensity")))
    np.testing.assert_allclose(cloud.points, [[1.5, 2.5, -3]])
    np.testing.assert_array_equal(cloud.intensity, [7])
