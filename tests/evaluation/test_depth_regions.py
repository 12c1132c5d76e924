"""Depth errors by edge distance, horizon, confidence and class, and over equal pixels."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from command_line import cli
from docdepth.errors import DamagedFileError, DatasetError, InputError
from docdepth.evaluation.label_counts import CLASS_NAMES
from docdepth.evaluation.pixels import depth_edges, edge_distance
from docdepth.evaluation.runs import evaluate_depth
from docdepth.geometry.camera import Camera, below_horizon
from docdepth.geometry.se3 import rotation_exp
from docdepth.io.run_folder import RunFolder

FORWARD = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])


def test_edge_distance_equals_a_plain_loop() -> None:
    random = np.random.default_rng(0)
    depth = np.where(random.random((40, 60)) < 0.003, 5, 20).astype(np.float32)
    v, u = np.nonzero(depth_edges(depth))
    assert len(v)
    for y, x in random.integers(0, (40, 60), (200, 2)):
        nearest = np.maximum(np.abs(v - y), np.abs(u - x)).min()
        assert edge_distance(depth)[y, x] == nearest
    assert np.isinf(edge_distance(np.full((5, 5), 7, np.float32))).all()


def test_the_horizon_is_where_rays_are_level() -> None:
    K = np.array([[100.0, 0, 31.5], [0, 100.0, 20.5], [0, 0, 1]])
    camera = Camera(K, 64, 42)
    np.testing.assert_array_equal(below_horizon(camera, FORWARD)[:, 0], np.arange(42) > 20.5)
    rolled = np.eye(4)
    rolled[:3, :3] = rotation_exp([0, 0, np.pi / 2])
    below = below_horizon(camera, rolled @ FORWARD)
    np.testing.assert_array_equal(below[0], np.arange(64) < 31.5)
    down = np.eye(4)
    down[:3, :3] = rotation_exp([np.arctan(0.1), 0, 0])  # the camera looks down by 10 pixels
    np.testing.assert_array_equal(below_horizon(camera, down @ FORWARD)[:, 9], np.arange(42) > 10.5)


@pytest.fixture
def layered(finished, tmp_path) -> Path:
    """A copy of the run with a layer of confidence."""
    run, random = tmp_path / "layered", np.random.default_rng(4)
    shutil.copytree(finished[0], run)
    (run / "layers").mkdir()
    for file in (run / "depth").glob("*.png"):
        made = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
        confidence = np.where(made > 0, random.random(made.shape), np.nan).astype(np.float32)
        np.savez(run / "layers" / f"{file.stem}.npz", confidence=confidence)
    return run


def pixels_of(run: Path, drive: Path) -> dict[str, np.ndarray]:
    """True depth, made depth, class, confidence and whether below the horizon, of all pixels."""
    camera, T, _ = RunFolder.open(run).calibration()
    found: dict[str, list[np.ndarray]] = {}
    for file in sorted((run / "depth").glob("*.png")):
        true = np.load(drive / "depth_2" / f"{file.stem}.npy").astype(float)
        made = cv2.imread(str(file), cv2.IMREAD_UNCHANGED) / 256
        columns = {
            "true": np.where((true > 0) & (true <= 80), true, np.nan),
            "made": np.where(made > 0, made, np.nan),
            "class": np.load(drive / "class_2" / f"{file.stem}.npy") & 0xFFFF,
            "confidence": np.load(run / "layers" / f"{file.stem}.npz")["confidence"],
            "below": below_horizon(camera, T),
            "edge": edge_distance(np.where(true > 0, true, np.nan).astype(np.float32)),
        }
        for name, values in columns.items():
            found.setdefault(name, []).append(values.ravel())
    return {name: np.concatenate(values) for name, values in found.items()}


def test_errors_by_region(layered, drive) -> None:
    result = evaluate_depth(layered, drive)
    p = pixels_of(layered, drive)
    names = {name: number for number, name in CLASS_NAMES.items()}
    confident = {
        "confidence less than 0.5": (0, 0.5),
        "confidence 0.5 to 0.8": (0.5, 0.8),
        "confidence 0.8 to 0.95": (0.8, 0.95),
        "confidence 0.95 to 1": (0.95, 2),
    }
    assert {"below the horizon", "road", "building", *confident} <= set(result.regions)

    def same(errors, chosen) -> None:
        pixels = chosen & ~np.isnan(p["true"])
        both = pixels & ~np.isnan(p["made"])
        assert (errors.pixels, errors.compared) == (pixels.sum(), both.sum())
        if both.any():
            error = (p["made"] - p["true"])[both]
            assert errors.mae == pytest.approx(np.abs(error).mean(), rel=1e-4)
            assert errors.rmse == pytest.approx(np.sqrt((error**2).mean()), rel=1e-4)

    for name, errors in result.regions.items():
        low, high = confident.get(name, (0, 0))
        chosen = (p["confidence"] >= low) & (p["confidence"] < high)
        if name == "below the horizon":
            chosen = p["below"]
        elif name not in confident:
            chosen = p["class"] == names[name]
        same(errors, chosen)
    for row in result.by_range:
        same(row.figures, (p["true"] > row.near) & (p["true"] <= row.far))
    for row in result.by_edge_distance:
        same(row.figures, ((p["edge"] > row.near) | (row.near == 0)) & (p["edge"] <= row.far))
    assert sum(row.figures.pixels for row in result.by_edge_distance) == result.all.pixels


def test_equal_pixels_of_two_methods(layered, drive, tmp_path) -> None:
    """The other method has every second column, a metre too far."""
    other = tmp_path / "other"
    other.mkdir()
    for file in (layered / "depth").glob("*.png"):
        made = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
        made = np.where(made > 0, made + 256, 300).astype(np.uint16)
        made[:, ::2] = 0
        cv2.imwrite(str(other / file.name), made)
    printed = cli("evaluate", "depth", layered, "--depth", drive, "--other", other)
    assert printed.exit_code == 0, printed.output
    for words in ("pixels of both: this run", "1..3 px from an edge", "irmse [1/km]"):
        assert words in printed.output
    found = json.loads(
        cli("evaluate", "depth", layered, "--depth", drive, "--other", other, "--json").stdout
    )
    these, others = found["equal_pixels"]["these"], found["equal_pixels"]["other"]
    assert these["pixels"] == these["compared"] == others["pixels"] == others["compared"]
    assert 0.45 < these["pixels"] / found["all"]["compared"] < 0.55
    p = pixels_of(layered, drive)
    width = RunFolder.open(layered).calibration()[0].width
    odd = np.arange(len(p["true"])) % width % 2 == 1
    error = (p["made"] - p["true"])[odd]
    assert these["mae"] == pytest.approx(np.nanmean(np.abs(error)), rel=1e-4)
    assert others["mae"] == pytest.approx(np.nanmean(np.abs(error + 1)), rel=1e-4)
    first = next(other.iterdir())
    cv2.imwrite(str(first), np.full((7, 9), 500, np.uint16))
    with pytest.raises(InputError, match=r"other depth \(7, 9\)"):
        evaluate_depth(layered, drive, other=other)
    first.unlink()
    with pytest.raises(DatasetError, match="both methods need the same images"):
        evaluate_depth(layered, drive, other=other)
    with pytest.raises(DatasetError, match="has no depth maps; name another run"):
        evaluate_depth(layered, drive, other=tmp_path / "nowhere")


def test_a_damaged_layer_is_named(layered, drive) -> None:
    file = next((layered / "layers").iterdir())
    file.write_bytes(file.read_bytes()[:1000])
    with pytest.raises(DamagedFileError, match=file.name):
        evaluate_depth(layered, drive)
