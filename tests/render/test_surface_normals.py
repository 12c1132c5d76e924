"""Normals of a depth map against planes that are known, and against least squares."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

import docdepth._core as _core
from docdepth.render.layers import normal_confidence

K = np.array([[300.0, 0, 120], [0, 300, 80], [0, 0, 1]])
WIDTH, HEIGHT, NOISE, FACET = 240, 160, 0.015, 4
PLANES = np.array([  # n . p = 1: a wall to the left, one ahead, and the road
    (-1 / 3, 0, 0), (0.02, 0, 1 / 9), (0, 1 / 1.6, 0)
])  # fmt: skip
STAYS = np.array([0, 0, -1], np.float32)


def view() -> tuple[NDArray[np.float32], NDArray[np.int64], NDArray[np.float64]]:
    """Depth with noise along the rays, which plane each pixel shows, and the rays."""
    v, u = np.indices((HEIGHT, WIDTH))
    rays = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones(u.shape)], axis=-1)
    inverse = np.maximum(rays @ PLANES.T, 1e-9)
    which, depth = inverse.argmax(axis=-1), 1 / inverse.max(axis=-1)
    noise = np.random.default_rng(0).normal(0, NOISE, (HEIGHT // FACET, WIDTH // FACET))
    noise = np.kron(noise, np.ones((FACET, FACET)))  # a measurement is some pixels large
    return (depth + noise / np.linalg.norm(rays, axis=-1)).astype(np.float32), which, rays


def fitted_with_lean(
    depth: NDArray[np.float32], threads: int = 1
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    facets = np.broadcast_to(STAYS, (*depth.shape, 3)).copy()
    return _core.fit_normals(K, WIDTH, HEIGHT, depth, facets, threads)


def fitted(depth: NDArray[np.float32], threads: int = 1) -> NDArray[np.float32]:
    return fitted_with_lean(depth, threads)[0]


def test_planes_are_found_up_to_their_creases() -> None:
    depth, which, _ = view()
    found = fitted(depth)
    exact = -(PLANES / np.linalg.norm(PLANES, axis=1)[:, None])[which]
    angle = np.degrees(np.arccos(np.clip((found * exact).sum(axis=-1), -1, 1)))
    for plane in range(3):
        assert np.median(angle[which == plane]) < 2.5
        assert (angle[which == plane] < 11.25).mean() > 0.97
    assert np.array_equal(found, fitted(depth, threads=3))


def test_the_largest_flat_window_is_fitted_by_least_squares() -> None:
    depth, _, rays = view()
    half = round(0.022 * K[0, 0])
    v, u = 30, 150  # far from any crease
    normals, leans = fitted_with_lean(depth)
    near = []
    for dv in (-half, 0, half):
        for du in (-half, 0, half):
            rows = slice(v + dv - half, v + dv + half + 1)
            window = rows, slice(u + du - half, u + du + half + 1)
            A, b = rays[window].reshape(-1, 3), 1 / depth[window].astype(float).ravel()
            normal = np.linalg.lstsq(A, b, rcond=None)[0]
            deviation = np.sqrt(np.mean((A @ normal - b) ** 2)) / b.mean() / np.linalg.norm(normal)
            near.append((deviation, -normal / np.linalg.norm(normal)))
    deviation, normal = min(near, key=lambda one: one[0])
    assert np.allclose(normals[v, u], normal, atol=1e-4)
    assert leans[v, u] == pytest.approx(deviation / (depth[v, u] * half / K[0, 0]), rel=0.01)


def test_what_is_not_flat_or_has_no_depth_stays() -> None:
    depth, _, _ = view()
    depth[:, :100] += np.random.default_rng(1).normal(0, 0.5, (HEIGHT, 100)).astype(np.float32)
    depth[:, 100:140] = np.nan
    found, leans = fitted_with_lean(depth)
    stays = (found == STAYS).all(axis=-1)
    assert stays[:, :95].mean() > 0.99
    assert stays[:, 100:140].all()
    assert stays[:, 150:].mean() < 0.01
    assert np.array_equal(np.isinf(leans), stays)
    confidence = normal_confidence(depth, leans)
    assert np.isnan(confidence[:, 100:140]).all()
    assert np.median(confidence[:, :95]) < 0.2
    assert np.median(confidence[:, 150:]) > 0.6
