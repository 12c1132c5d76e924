"""The tables of the paper, on a drive of five sweeps in place of the data sets."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from docdepth.evaluation.runs import evaluate_depth, evaluate_labels
from docdepth.io.run_folder import RunFolder

paper_tables = pytest.importorskip("paper_tables")


def test_labels_of_a_window_of_semantic_kitti(drive, tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.setattr(paper_tables, "WINDOWS", {"00": (1, 3), "07": (630, 820)})
    data, out = str(drive.parents[1]), tmp_path / "out"
    table = paper_tables.main(["labels", "-o", str(out), "--data", data, "--presets", "default"])
    assert "07" in capsys.readouterr().err, "what is missing is said"
    (row,) = table.rows
    made = RunFolder.open(out / "labels" / "00_default")
    assert [made.frame(k).name for k in range(3)] == ["000001", "000002", "000003"]
    counts = evaluate_labels(made, drive).counts
    assert row[:3] == ("00", "1:4", "default")
    assert row[3:5] == (f"{counts.sa:.2f}", f"{counts.da:.2f}")
    assert "stand-in" not in table.title


def test_time_density_and_growth(drive, finished, tmp_path) -> None:
    out = str(tmp_path)
    table = paper_tables.main(["cost", "-o", out, "--data", str(drive), "--presets", "default"])
    (row,) = table.rows
    assert int(row[2]) == 4
    truth = evaluate_depth(finished[0], drive)
    dense, sparse, growth = (float(cell) for cell in row[5:])
    assert dense == pytest.approx(truth.density, abs=0.06)
    assert 0.5 < sparse < dense
    assert growth == pytest.approx(dense / sparse, rel=0.05)


def test_the_release_of_every_drive_of_kitti_raw(drive, tmp_path) -> None:
    day = tmp_path / "raw" / "2011_09_26"
    day.mkdir(parents=True)
    shutil.copytree(drive, day / "2011_09_26_drive_0001_sync")
    command = ["release", "-o", str(tmp_path / "out"), "--data", str(tmp_path / "raw")]
    for _ in range(2):  # what is done stays
        table = paper_tables.main(command)
        assert [row[1:] for row in table.rows] == [("image_2", "4")]
    (camera,) = (tmp_path / "out" / "release").glob("*/proj_depth/groundtruth/image_2")
    depth = cv2.imread(str(next(Path(camera).iterdir())), cv2.IMREAD_UNCHANGED)
    assert depth.dtype == np.uint16


def test_truth_of_kittis_kind(drive) -> None:
    names = sorted((drive / "depth_2").glob("*.npy"))
    assert len(names) < 11
    assert not list(paper_tables.sparse_truth(drive).rglob("*.png")), "no map at both ends"
