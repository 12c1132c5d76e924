"""Metrics of depth maps against values worked out by hand and against plain loops."""

import math

import numpy as np
import pytest

from docdepth.errors import InputError
from docdepth.evaluation import DepthErrors, DepthEvaluation, depth_edges, fill_background

NAN = np.float32(np.nan)


def image(rows: list[list[float]]) -> np.ndarray:
    return np.array(rows, np.float32)


def test_errors_worked_out_by_hand() -> None:
    errors = DepthErrors.of(np.array([2.0, 4.0]), np.array([1.0, 5.0]))
    assert errors.mae == pytest.approx(1.0)
    assert errors.rmse == pytest.approx(1.0)
    # |1/2 - 1| = 0.5 and |1/4 - 1/5| = 0.05, in 1/km.
    assert errors.imae == pytest.approx(275.0)
    assert errors.irmse == pytest.approx(1e3 * math.sqrt((0.25 + 0.0025) / 2))
    a, b = math.log(2.0), math.log(0.8)
    assert errors.log_mae == pytest.approx((a - b) / 2)
    assert errors.log_rmse == pytest.approx(math.sqrt((a * a + b * b) / 2))
    variance = (a * a + b * b) / 2 - ((a + b) / 2) ** 2
    assert errors.silog == pytest.approx(100 * math.sqrt(variance))
    assert errors.abs_rel == pytest.approx(100 * (0.5 + 0.25) / 2)
    assert errors.sq_rel == pytest.approx(100 * (0.25 + 0.0625) / 2)
    assert errors.sq_rel_eigen == pytest.approx((0.5 + 0.25) / 2)
    # Ratios 2 and 1.25: the bound is strict.
    assert errors.delta1 == 0.0
    assert errors.delta2 == 50.0
    assert errors.delta3 == 50.0


def fill_by_the_kit(depth: np.ndarray) -> np.ndarray:
    """interpolateBackground, loop by loop."""
    filled = depth.copy()
    height, width = filled.shape
    for v in range(height):
        count = 0
        for u in range(width):
            if np.isnan(filled[v, u]):
                count += 1
                continue
            if count and u - count > 0:
                filled[v, u - count : u] = min(filled[v, u - count - 1], filled[v, u])
            count = 0
        valid = np.flatnonzero(~np.isnan(filled[v]))
        if len(valid):
            filled[v, : valid[0]] = filled[v, valid[0]]
            filled[v, valid[-1] + 1 :] = filled[v, valid[-1]]
    for u in range(width):
        valid = np.flatnonzero(~np.isnan(filled[:, u]))
        if len(valid):
            filled[: valid[0], u] = filled[valid[0], u]
            filled[valid[-1] + 1 :, u] = filled[valid[-1], u]
    return filled


@pytest.mark.parametrize("density", [0.0, 0.02, 0.1, 0.5, 1.0])
def test_filling_equals_the_kit(density: float) -> None:
    random = np.random.default_rng(5)
    for shape in ((1, 1), (1, 7), (9, 1), (23, 31)):
        depth = random.uniform(1, 80, shape).astype(np.float32)
        depth[random.random(shape) >= density] = np.nan
        np.testing.assert_array_equal(fill_background(depth), fill_by_the_kit(depth))


def plane(normal: tuple[float, float, float], distance: float) -> np.ndarray:
    """Exact depth of a plane in a small camera."""
    y, x = np.mgrid[0:60, 0:80]
    inverse = (normal[0] * (x - 40) / 50 + normal[1] * (y - 30) / 50 + normal[2]) / distance
    with np.errstate(divide="ignore"):
        return np.where(inverse > 0.01, 1 / inverse, np.nan).astype(np.float32)


def test_a_slanted_plane_has_no_edges_but_its_horizon() -> None:
    edges = depth_edges(plane((0.5, 0.2, 0.8), 5.0))
    assert not edges.any()
    ground = plane((0.0, 1.0, 0.0), 1.7)
    edges = depth_edges(ground)
    horizon = int(np.flatnonzero(~np.isnan(ground).all(axis=1))[0])
    assert edges[horizon - 1].all()
    assert not edges[horizon + 1 :].any()


def edges_by_hand(depth: np.ndarray) -> np.ndarray:
    inverse = np.where(np.isnan(depth), 0, 1 / depth)
    edges = np.zeros(depth.shape, bool)
    height, width = depth.shape
    for v in range(height):
        for u in range(width):
            here = inverse[v, u]
            for a, b in (((v, u - 1), (v, u + 1)), ((v - 1, u), (v + 1, u))):
                if min(*a, *b) >= 0 and max(a[0], b[0]) < height and max(a[1], b[1]) < width:
                    edges[v, u] |= abs(inverse[a] - 2 * here + inverse[b]) > 0.05 * here
    return edges


def test_edges_equal_a_plain_loop() -> None:
    depth = np.fmin(plane((0, 1.0, 0.02), 1.7), 60)
    depth[10:40, 20:50] = 8.0
    depth[15:30, 60:65] = np.nan
    np.testing.assert_array_equal(depth_edges(depth), edges_by_hand(depth))


def compare_by_hand(
    predicted: np.ndarray, truth: np.ndarray, dynamic: np.ndarray, region: str
) -> dict[str, float]:
    """Pixel by pixel, from the definitions."""
    edges = edges_by_hand(truth)
    absolute, squared, own, shift, near, far, pixels = [], [], [], [], 0, 0, 0
    for (v, u), d in np.ndenumerate(truth):
        if np.isnan(d) or d > 80:
            continue
        around = edges[max(v - 3, 0) : v + 4, max(u - 3, 0) : u + 4]
        if (region == "interior" and around.any()) or (region == "dynamic" and not dynamic[v, u]):
            continue
        pixels += 1
        p = predicted[v, u]
        if np.isnan(p):
            continue
        e = float(p) - float(d)
        absolute.append(abs(e))
        squared.append(e * e)
        near += e < -0.05 * float(d)
        far += e > 0.05 * float(d)
        if u > 0 and not np.isnan(truth[v, u - 1]):
            own.append(abs(e))
            shift.append(abs(float(truth[v, u - 1]) - float(d)))
    return {
        "pixels": pixels,
        "compared": len(absolute),
        "mae": np.mean(absolute),
        "rmse": math.sqrt(np.mean(squared)),
        "edge_displacement": np.sum(own) / np.sum(shift),
        "too_near": 100 * near / len(absolute),
        "too_far": 100 * far / len(absolute),
    }


def scene(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    random = np.random.default_rng(seed)
    truth = np.fmin(plane((0.2, 1.0, 0.05), 1.7), 90)
    truth[10:45, 20:40] = 8.0
    truth[20:50, 55:60] = 5.0
    predicted = (truth * random.normal(1, 0.05, truth.shape)).astype(np.float32)
    predicted[random.random(truth.shape) < 0.3] = np.nan
    predicted[3, 3] = 12.0
    dynamic = np.zeros(truth.shape, bool)
    dynamic[18:52, 53:62] = True
    return predicted, truth, dynamic


def test_regions_equal_a_plain_loop() -> None:
    predicted, truth, dynamic = scene(6)
    evaluation = DepthEvaluation(poses="exact")
    evaluation.add(predicted, truth, dynamic)
    result = evaluation.result()
    for name in ("all", "interior", "dynamic"):
        expected = compare_by_hand(predicted, truth, dynamic, name)
        got = getattr(result, name).as_dict()
        assert {k: got[k] for k in expected} == pytest.approx(expected, rel=1e-6), name
    assert 0 < result.interior.pixels < result.all.pixels
    has, hit = ~np.isnan(predicted), ~np.isnan(truth)
    assert result.density == pytest.approx(100 * has.mean())
    assert result.density_on_surfaces == pytest.approx(100 * (has & hit).sum() / hit.sum())
    assert sum(row.figures.pixels for row in result.by_range) == result.all.pixels
    compared = has & hit & (truth <= 80)
    kitti = DepthErrors.of(truth[compared], predicted[compared])
    assert result.kitti == kitti
    assert "exact" in str(result.table())
    assert "rmse [m]" in result.kitti_table().markdown()


def test_two_images_are_averaged_as_the_kit_does() -> None:
    evaluation = DepthEvaluation()
    first = evaluation.add(*scene(7)[:2])
    second = evaluation.add(*scene(8)[:2])
    evaluation.add(np.full((4, 4), NAN), np.ones((4, 4), np.float32))
    result = evaluation.result()
    assert result.images == 3
    assert result.kitti.rmse == pytest.approx((first.rmse + second.rmse) / 2)
    assert result.kitti.delta1 == pytest.approx((first.delta1 + second.delta1) / 2)


def test_kitti_mode_compares_filled_pixels() -> None:
    truth = image([[2, 2, 2, 2]])
    predicted = image([[NAN, 2, NAN, 4]])
    assert DepthEvaluation("valid").add(predicted, truth).mae == pytest.approx(1.0)
    evaluation = DepthEvaluation("kitti")
    assert evaluation.add(predicted, truth).mae == pytest.approx(0.5)
    result = evaluation.result()
    assert result.density == 50.0
    assert "filled" in result.protocol


def cloud(K: np.ndarray, depth: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    v, u = np.nonzero(pixels)
    return np.column_stack([u, v, np.ones(len(u))]) @ np.linalg.inv(K).T * depth[pixels][:, None]


def test_point_to_point_equals_all_pairs() -> None:
    """Along a slanted road a point lies nearer to others than to its own."""
    K = np.array([[50.0, 0, 40], [0, 50, 30], [0, 0, 1]])
    predicted, truth, _ = scene(4)
    both = ~np.isnan(predicted) & (truth <= 80)
    clouds = [cloud(K, depth.astype(float), both) for depth in (predicted, truth)]
    pairs = np.linalg.norm(clouds[0][:, None] - clouds[1][None], axis=2)
    expected = (pairs.min(axis=0).mean() + pairs.min(axis=1).mean()) / 2
    evaluation = DepthEvaluation()
    evaluation.add(predicted, truth, K=K)
    result = evaluation.result()
    assert result.point_to_point == pytest.approx(expected, rel=1e-5)
    assert result.point_to_point < 0.8 * result.all.mae


def test_nothing_to_compare_is_nan_not_zero() -> None:
    evaluation = DepthEvaluation()
    evaluation.add(np.full((3, 4), NAN), np.zeros((3, 4), np.float32))
    result = evaluation.result()
    assert result.density == 0.0
    for value in (
        result.density_on_surfaces,
        result.kitti.mae,
        result.all.mae,
        result.all.edge_displacement,
    ):
        assert math.isnan(value)
    assert math.isnan(result.point_to_point)


def test_images_that_do_not_fit_are_refused() -> None:
    evaluation = DepthEvaluation()
    good = np.ones((3, 4), np.float32)
    with pytest.raises(InputError, match="one size"):
        evaluation.add(good, np.ones((4, 3), np.float32))
    bad = good.copy()
    bad[1, 2] = -1
    with pytest.raises(InputError, match="row 1, column 2"):
        evaluation.add(bad, good)
    with pytest.raises(InputError, match="float image"):
        evaluation.add(good.astype(np.uint16), good)
    with pytest.raises(InputError, match="unknown mode"):
        DepthEvaluation("median")  # type: ignore[arg-type]
