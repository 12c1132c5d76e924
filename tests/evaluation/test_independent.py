"""Every figure that ``evaluate`` prints, worked out again from the files by other people's code."""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np
import pytest
from test_evaluation_depth import fill_by_the_kit

from docdepth.evaluation.label_counts import CLASS_NAMES
from docdepth.evaluation.runs import evaluate_depth, evaluate_labels
from docdepth.io.run_folder import RunFolder


def errors_by_the_kit(truth: np.ndarray, made: np.ndarray) -> dict[str, float]:
    """The loop of KITTI's development kit (C++) over the pixels with a true depth, in its units."""
    count = 0
    mae = rmse = imae = irmse = log_mae = log_rmse = mean_log = abs_rel = sq_rel = 0.0
    for gt, depth in zip(truth.ravel().tolist(), made.ravel().tolist(), strict=True):
        if math.isnan(gt) or math.isnan(depth):
            continue
        error, inverse = abs(gt - depth), abs(1000 / gt - 1000 / depth)
        log = math.log(gt) - math.log(depth)
        mae, rmse = mae + error, rmse + error * error
        imae, irmse = imae + inverse, irmse + inverse * inverse
        log_mae, log_rmse, mean_log = log_mae + abs(log), log_rmse + log * log, mean_log + log
        abs_rel, sq_rel = abs_rel + error / gt, sq_rel + error * error / (gt * gt)
        count += 1
    n = float(count)
    return {
        "mae": mae / n,
        "rmse": math.sqrt(rmse / n),
        "imae": imae / n,
        "irmse": math.sqrt(irmse / n),
        "log_mae": log_mae / n,
        "log_rmse": math.sqrt(log_rmse / n),
        "silog": 100 * math.sqrt(log_rmse / n - (mean_log / n) ** 2),
        "abs_rel": 100 * abs_rel / n,
        "sq_rel": 100 * sq_rel / n,
    }


@pytest.fixture(scope="module")
def pairs(finished, drive, tmp_path_factory) -> tuple[Path, list[tuple[np.ndarray, np.ndarray]]]:
    """True depth as KITTI's PNG files, and what OpenCV reads of truth and run [m], NaN = none."""
    folder, found = tmp_path_factory.mktemp("truth"), []
    random = np.random.default_rng(2)
    for file in sorted((finished[0] / "depth").glob("*.png")):
        exact = np.nan_to_num(np.load(drive / "depth_2" / f"{file.stem}.npy"), posinf=0)
        exact[random.random(exact.shape) > 0.2] = 0
        exact[(exact > 200) | (exact < 0.5)] = 0
        cv2.imwrite(str(folder / file.name), np.round(exact * 256).astype(np.uint16))
        read = [cv2.imread(str(f), cv2.IMREAD_UNCHANGED) for f in (folder / file.name, file)]
        both = [np.where(values > 0, values / 256.0, np.nan) for values in read]
        found.append((both[0], both[1]))
    return folder, found


@pytest.mark.parametrize("mode", ["valid", "kitti"])
def test_depth_figures_are_those_of_kittis_kit(finished, pairs, mode) -> None:
    folder, images = pairs
    result = evaluate_depth(finished[0], folder, mode)
    expected = []
    for truth, made in images:
        filled = fill_by_the_kit(made) if mode == "kitti" else made
        expected.append(errors_by_the_kit(np.where(truth <= 80, truth, np.nan), filled))
    for name in expected[0]:
        mean = np.mean([one[name] for one in expected])
        assert getattr(result.kitti, name) == pytest.approx(mean, rel=2e-5), name


def same_shares(counts, true, said) -> None:
    """Points of one class, static or moving."""
    assert (counts.static, counts.dynamic) == ((~true).sum(), true.sum())
    share = counts.da if true.any() else 100 - counts.sa
    assert share == pytest.approx(100 * said.mean())


@pytest.mark.slow
def test_label_figures_are_those_of_scikit_learn(finished, drive) -> None:
    metrics = pytest.importorskip("sklearn.metrics")
    result = evaluate_labels(finished[0], drive)
    folder = RunFolder.open(finished[0])
    truth, instances, found, far, speed = [], [], [], [], []
    for k in range(len(folder.trajectory())):
        name = folder.frame(k).name
        labels = np.fromfile(drive / "labels" / f"{name}.label", "<u4")
        truth.append(labels & 0xFFFF)
        instances.append(labels >> 16)
        found.append(np.fromfile(finished[0] / "labels" / f"{name}.label", "<u4") & 0xFFFF)
        points = np.fromfile(drive / "velodyne" / f"{name}.bin", "<f4").reshape(-1, 4)[:, :3]
        far.append(np.linalg.norm(points, axis=1))
        speed.append(np.load(drive / "speeds" / f"{name}.npy"))
    columns = (truth, instances, found, far, speed)
    classes, numbers, made, ranges, speeds = map(np.concatenate, columns)
    counted = classes > 1
    moves, dynamic = (classes >= 251) & (classes <= 259), made >= 251
    assert result.ignored == (~counted).sum()

    def same(counts, rows) -> None:
        true, said = moves[rows], dynamic[rows]
        assert (counts.static, counts.dynamic) == ((~true).sum(), true.sum())
        if not true.any():
            return
        sa, da = (metrics.recall_score(true, said, pos_label=label) for label in (False, True))
        assert (counts.sa, counts.da) == (pytest.approx(100 * sa), pytest.approx(100 * da))
        assert counts.f1 == pytest.approx(2 * sa * da / (sa + da))
        assert counts.aa == pytest.approx(100 * math.sqrt(sa * da))
        assert counts.precision == pytest.approx(metrics.precision_score(true, said))
        assert counts.iou == pytest.approx(metrics.jaccard_score(true, said))

    now = counted & ~(moves & ~(speeds > 0.3))
    same(result.counts, now)
    same(result.with_standing, counted)
    names = {name: number for number, name in CLASS_NAMES.items()}
    assert {names[name] for name in result.by_class} == set(classes[now].tolist())
    for name, counts in result.by_class.items():
        same_shares(
            counts, moves[now & (classes == names[name])], dynamic[now & (classes == names[name])]
        )
    objects = [
        rows
        for k in np.unique(numbers[numbers > 0])
        if (rows := now & moves & (numbers == k)).any()
    ]
    assert result.objects == len(objects) > 2
    assert result.objects_found == sum(dynamic[rows].mean() >= 0.5 for rows in objects)
    for row in result.by_range:
        inside = now & (ranges >= row.near) & (ranges < row.far)
        assert abs(row.figures.static - (inside & ~moves).sum()) <= 0.001 * inside.sum() + 1
        assert row.figures.dynamic == pytest.approx((inside & moves).sum(), abs=1)
