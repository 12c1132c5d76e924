"""Figures of benchmarks/RESULTS.md, measured again: one cell of each kind, and the real drives."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from command_line import cli

ROOT = Path(__file__).parents[2]
MEASURED = ROOT / "benchmarks" / "measured"

pytestmark = pytest.mark.slow


def row(file: str, name: str, table: int = 0) -> list[str]:
    """Cells of a row of a stored table."""
    content = json.loads((MEASURED / f"{file}.json").read_text(encoding="utf-8"))
    (cells,) = (cells for cells in content["tables"][table]["rows"] if cells[0] == name)
    return cells[1:]


def numbers(cell: str) -> list[float]:
    return [float(text) for text in re.findall(r"[0-9.]+", cell)]


@pytest.fixture
def folders(tmp_path: Path) -> list[str]:
    pytest.importorskip("embreex")
    (tmp_path / "default.yaml").write_text("default: {}\n")
    trials = ["--trials", str(tmp_path / "default.yaml")]
    return [str(tmp_path / "drives"), "-o", str(tmp_path / "out"), "--seed", "7", *trials]


def test_labels_of_a_synthetic_drive(folders) -> None:
    import suite

    cell = ["--scenes", "residential", "--sensors", "VLP-16"]
    found = suite.main([*folders, *cell])["residential_VLP-16"]["default"]
    f1, precision = numbers(row("labels", "VLP-16")[4])
    assert found["f1"] == pytest.approx(f1, abs=0.003)
    assert found["precision"] == pytest.approx(precision, abs=0.005)
    waiting = numbers(row("labels", "residential", 1)[3])[0]
    assert found["seen_to_move"] == pytest.approx(waiting, abs=4)


def test_labels_by_wide_beams(folders) -> None:
    """A walker and the parked cars beside him are one object for most of the time."""
    import suite

    cell = ["--scenes", "residential", "--sensors", "XT-32", "--beam-width", "0.15"]
    found = suite.main([*folders, *cell])["residential_XT-32"]["default"]
    f1, precision = numbers(row("wide_beams", "XT-32, residential")[0])
    assert found["f1"] == pytest.approx(f1, abs=0.003)
    assert found["precision"] == pytest.approx(precision, abs=0.005)


def test_depth_of_a_synthetic_drive(folders) -> None:
    import suite

    cell = ["--depth", "--scenes", "residential", "--sensors", "XT-32"]
    found = suite.main([*folders, *cell])["residential_XT-32"]["default"]
    density, mae, shifts, near, far = map(float, row("depth", "XT-32, residential")[:5])
    assert found["density"] == pytest.approx(density, abs=0.5)
    assert found["mae"] == pytest.approx(mae, abs=0.01)
    assert found["shifts"] == pytest.approx(shifts, abs=0.03)
    assert found["too_near"] == pytest.approx(near, abs=0.1)
    assert found["too_far"] == pytest.approx(far, abs=0.1)


def test_moving_objects_by_own_classes_and_tracks(folders) -> None:
    """A cyclist 1.4 m away is seen by the camera where the LiDAR looks past."""
    import suite

    cell = ["--own", "--scenes", "city", "--sensors", "HDL-64"]
    found = suite.main([*folders, *cell])["city_HDL-64"]["default"]
    shifts, density, rmse = map(float, row("depth_own", "HDL-64, city")[-3:])
    assert found["moving_shifts"] == pytest.approx(shifts, abs=0.03)
    assert found["moving_density"] == pytest.approx(density, abs=0.5)
    assert found["moving_rmse"] == pytest.approx(rmse, abs=0.04)


def test_labels_of_drive_0005(drive_0005, tmp_path) -> None:
    made = cli("run", drive_0005, "-o", tmp_path / "run", "--camera", "none")
    assert made.exit_code == 0, made.output
    printed = cli("evaluate", "labels", tmp_path / "run", "--labels", drive_0005, "--json")
    found = json.loads(printed.stdout)
    sa, da, f1, precision, iou = map(float, row("labels_0005", "`default`"))
    assert found["sa"] == pytest.approx(sa, abs=0.02)
    assert found["da"] == pytest.approx(da, abs=0.03)
    assert found["f1"] == pytest.approx(f1, abs=0.0003)
    assert found["precision"] == pytest.approx(precision, abs=0.002)
    assert found["iou"] == pytest.approx(iou, abs=0.002)


def test_held_out_sweeps_of_drive_9001(drive_9001, tmp_path) -> None:
    made = cli("run", drive_9001, "-o", tmp_path / "run")
    assert made.exit_code == 0, made.output
    found = json.loads(cli("evaluate", "held-out", tmp_path / "run", "--json").stdout)
    density, errors, near, far, _ = row("held_out", "9001, `default`")
    mae, rmse = numbers(errors)
    assert found["all"]["density"] == pytest.approx(float(density), abs=0.3)
    assert found["all"]["mae"] == pytest.approx(mae, abs=0.01)
    assert found["all"]["rmse"] == pytest.approx(rmse, abs=0.1)
    assert found["all"]["too_near"] == pytest.approx(float(near), abs=0.1)
    assert found["all"]["too_far"] == pytest.approx(float(far), abs=0.1)
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    printed = re.search(r"([0-9.]+) % of the returns of left-out sweeps", readme)
    wrong = found["all"]["too_near"] + found["all"]["too_far"]
    assert wrong == pytest.approx(float(printed[1]), abs=0.15)
