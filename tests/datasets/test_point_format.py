"""Sweeps of other formats are refused, and no right sweep is."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from docdepth.datasets import open_dataset
from docdepth.datasets.cloud import foreign_format
from docdepth.errors import DatasetError

RING = "ring"


def _with(rows: np.ndarray, *columns: object) -> np.ndarray:
    more = [np.arange(len(rows)) % 32 if c == RING else np.full(len(rows), c) for c in columns]
    return np.column_stack([rows, *more]).astype("<f4")


RIGHT: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "as it is": lambda rows: rows,
    "one reflectance": lambda rows: _with(rows[:, :3], 0.5),
    "no reflectance": lambda rows: _with(rows[:, :3], 0),
    "large reflectances": lambda rows: _with(rows[:, :3], RING) * np.array([1, 1, 1, 2000], "<f4"),
    "zero rows": lambda rows: np.where(np.arange(len(rows))[:, None] % 5 == 0, 0, rows),
    "rows without a return": lambda rows: np.where(
        np.arange(len(rows))[:, None] % 7 == 0, np.nan, rows
    ),
}
WRONG: dict[str, tuple[str, Callable[[np.ndarray], np.ndarray]]] = {
    "ring": ("5 float32 a point (nuScenes)", lambda rows: _with(rows, RING)),
    "zero ring": ("5 float32 a point (nuScenes)", lambda rows: _with(rows, 0)),
    "ring and time": ("6 float32", lambda rows: _with(rows, RING, 0.1)),
    "no reflectance": ("3 float32", lambda rows: rows[:, :3].astype("<f4")),
    "big-endian": ("float32 of the other byte order", lambda rows: rows.astype(">f4")),
    "doubles": ("4 float64", lambda rows: rows.astype("<f8") * (1 + 1e-9)),
    "doubles of floats": ("4 float64", lambda rows: rows.astype("<f8")),
    "doubles, no reflectance": ("3 float64", lambda rows: rows[:, :3].astype("<f8")),
}
ORDERS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "recorded": lambda rows: rows,
    "shuffled": lambda rows: np.random.default_rng(0).permutation(rows),
    "sorted by x": lambda rows: rows[np.argsort(rows[:, 0])],
    "few": lambda rows: rows[::8],
}


def sweeps(drive: Path) -> list[np.ndarray]:
    """A sparse synthetic sweep, and two recorded ones where there are any."""
    files = [drive / "velodyne" / "000002.bin"]
    root = os.environ.get("DOCDEPTH_KITTI_RAW")
    if root:
        folder = Path(root) / "2011_09_26" / "2011_09_26_drive_{}_sync" / "velodyne_points" / "data"
        files += [Path(str(folder).format(n)) / "0000000030.bin" for n in ("0005", "9001")]
    return [np.fromfile(file, "<f4").reshape(-1, 4) for file in files]


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("kind", RIGHT)
def test_right_sweeps_pass(drive: Path, kind: str, order: str) -> None:
    for rows in sweeps(drive):
        content = RIGHT[kind](ORDERS[order](rows)).astype("<f4").tobytes()
        assert foreign_format(content) is None


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("kind", WRONG)
def test_other_formats_are_told(drive: Path, kind: str, order: str) -> None:
    name, encode = WRONG[kind]
    for rows in sweeps(drive):
        found = foreign_format(encode(ORDERS[order](rows)).tobytes())
        assert found is not None
        assert found.startswith(name)


def test_few_or_strange_numbers_pass() -> None:
    rng = np.random.default_rng(0)
    assert foreign_format(b"") is None
    assert foreign_format(bytes(16)) is None
    assert foreign_format(rng.normal(0, 10, (3000, 4)).astype("<f4").tobytes()) is None
    assert foreign_format(np.full((3000, 4), np.nan, "<f4").tobytes()) is None
    assert foreign_format(np.zeros((3000, 4), "<f4").tobytes()) is None


@pytest.mark.parametrize("cut", [0, 3])
def test_a_sequence_of_another_format_is_refused(drive: Path, tmp_path: Path, cut: int) -> None:
    copy = Path(shutil.copytree(drive, tmp_path / "00"))
    for file in (copy / "velodyne").iterdir():
        rows = np.fromfile(file, "<f4").reshape(-1, 4)
        # Whether 16 divides the size of the file or not.
        _with(rows, RING)[: len(rows) // 4 * 4 - cut].tofile(file)
    with pytest.raises(
        DatasetError,
        match=r"000000.bin \(frame 0\) looks like 5 float32 a point \(nuScenes\); docdepth reads "
        r"x y z reflectance as 4 float32; convert it",
    ):
        open_dataset(copy)
