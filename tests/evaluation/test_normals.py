"""Normals against exact surfaces: by the definition, by plain loops, and of a whole run."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from command_line import cli
from docdepth.errors import DatasetError
from docdepth.evaluation.normals import WITHIN_DEG, NormalEvaluation, evaluate_normals, true_normals
from docdepth.io.depth import write_depth
from docdepth.io.run_folder import RunFolder
from motion import straight
from small_drive import HEIGHT, SWEEPS, WIDTH, write_small_drive
from walled_yard import cast

K = np.array([[700.0, 0, 300], [0, 650, 90], [0, 0, 1]])


def depth_of_planes(planes: list[tuple[float, float, float]], shape: tuple[int, int]) -> np.ndarray:
    """Depth of the nearest of planes n . p = 1 that are in front."""
    v, u = np.mgrid[: shape[0], : shape[1]]
    rays = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones(shape)], axis=2)
    with np.errstate(divide="ignore"):
        depths = np.stack([1 / (rays @ np.array(n)) for n in planes])
    return np.where(depths > 0, depths, np.inf).min(axis=0).astype(np.float32)


def test_normals_of_planes_are_exact_and_none_is_beside_a_crease() -> None:
    floor, wall = (0.01, 1 / 1.7, 0.0), (0.02, 0.0, 1 / 21)
    depth = depth_of_planes([floor, wall], (200, 600))
    found = true_normals(depth, K)
    for rows, plane in (((170, 199), floor), ((1, 80), wall)):
        wanted = -np.array(plane) / np.linalg.norm(plane)
        cosine = found[slice(*rows), 1:-1] @ wanted
        assert np.degrees(np.arccos(np.clip(cosine, -1, 1))).max() < 0.1
    depth[100:, 300:] = 8.0
    assert np.isnan(true_normals(depth, K)[150:160, 299:301]).all()
    assert np.isnan(true_normals(depth, K)[0]).all(), "no neighbours above"


def test_a_ball_and_a_hole_have_no_plane() -> None:
    v, u = np.mgrid[:60, :60].astype(float) - 30
    ball = (10 - 3e-2 * np.sqrt(np.maximum(3000 - u**2 - v**2, 0))).astype(np.float32)
    assert np.isnan(true_normals(ball, K)).all()
    plane = depth_of_planes([(0.01, 1 / 1.7, 0.0)], (200, 600))
    plane[150, 300] = np.nan
    assert np.isnan(true_normals(plane, K)[149:152, 299:302]).all()
    assert not np.isnan(true_normals(plane, K)[152:199, 1:-1]).any()


def test_figures_are_those_of_a_plain_loop() -> None:
    rng = np.random.default_rng(3)
    evaluation, angles = NormalEvaluation(), []
    for _ in range(2):
        true = rng.normal(size=(20, 30, 3))
        made = true + 0.4 * rng.normal(size=true.shape)
        true, made = (n / np.linalg.norm(n, axis=2, keepdims=True) for n in (true, made))
        made[:2], true[5] = np.nan, np.nan
        counted = rng.uniform(size=(20, 30)) < 0.8
        evaluation.add(
            made.astype(np.float32), true.astype(np.float32), counted, {"x": true[..., 0] > 0}
        )
        for row, column in np.ndindex(20, 30):
            if counted[row, column] and not np.isnan(made[row, column] @ true[row, column]):
                cosine = min(1.0, made[row, column] @ true[row, column])
                angles.append((np.degrees(np.arccos(cosine)), true[row, column, 0] > 0))
    every = [angle for angle, _ in angles]
    errors = evaluation.result().errors
    assert errors["all"].pixels == len(every)
    assert errors["all"].median == pytest.approx(np.median(every), abs=0.1)
    assert 85 < errors["all"].density < 95
    for angle in WITHIN_DEG:
        share = 100 * np.mean([one < angle for one in every])
        assert errors["all"].within[f"{angle:g}"] == pytest.approx(share, abs=0.2)
    assert errors["x"].pixels == sum(inside for _, inside in angles)


def write_truth(run: Path, folder: Path) -> None:
    """The exact depth of the yard for each image of the run."""
    camera, T_camera_lidar, _ = RunFolder.open(run).calibration("")
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    rays = np.stack([u, v, np.ones_like(u)], axis=2).reshape(-1, 3) @ np.linalg.inv(camera.K).T
    folder.mkdir()
    for k, T_world_lidar in enumerate(straight(SWEEPS, 0.5).poses):
        T = T_world_lidar @ np.linalg.inv(T_camera_lidar)
        depth = cast(T[:3, 3], rays @ T[:3, :3].T, -8 + 1.5 * k)[0]
        np.save(folder / f"{k:06d}.npy", depth.reshape(HEIGHT, WIDTH).astype(np.float32))


def test_a_run_against_the_yard_it_saw(tmp_path: Path) -> None:
    drive, run = write_small_drive(tmp_path / "drive"), tmp_path / "run"
    assert cli("run", drive, "-o", run).exit_code == 0
    write_truth(run, tmp_path / "depth_2")
    told = cli("evaluate", "normals", run, "--depth", tmp_path, "--json")
    assert told.exit_code == 0, told.output
    found = json.loads(told.stdout)
    assert found["images"] == SWEEPS
    assert found["errors"]["all"]["pixels"] > 1000
    assert found["errors"]["all"]["median"] < 3
    assert found["errors"]["all"]["within"]["30"] > 90
    for file in (tmp_path / "depth_2").iterdir():
        write_depth(file.with_suffix(".png"), np.load(file))
        file.unlink()
    with pytest.raises(DatasetError, match="holds depth in steps"):
        evaluate_normals(run, tmp_path / "depth_2")
