"""The network of benchmarks/training.py learns what it is shown; needs the extra ``train``."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("torch", reason="the extra train is not installed")
import depth_network
from depth_network import DepthNetwork, Sample, predict

H, W = 96, 144


def sample(seed: int, share: float) -> Sample:
    """An image whose brightness tells its depth, 5 m on the left and 20 m on the right."""
    random = np.random.default_rng(seed)
    depth = np.where(np.arange(W) < W // 2, 5.0, 20.0)[None].repeat(H, 0).astype(np.float32)
    image = np.where(depth[..., None] < 10, 220, 40).astype(np.uint8).repeat(3, axis=2)
    truth = np.where(random.random((H, W)) < share, depth, np.nan).astype(np.float32)
    return Sample(image, truth)


def test_it_learns_depth_from_a_few_true_pixels() -> None:
    seen: list[int] = []
    samples = [sample(k, 0.05) for k in range(4)]
    network = depth_network.train(samples, 64, 0, lambda step, _: seen.append(step))
    guess = predict(network, samples[0].image)
    assert seen == [8, 16, 32, 64]
    assert np.median(np.abs(guess[:, : W // 3] / 5 - 1)) < 0.1
    assert np.median(np.abs(guess[:, -W // 3 :] / 20 - 1)) < 0.1


def test_sparse_and_dense_truth_see_the_same_images(monkeypatch: pytest.MonkeyPatch) -> None:
    shown: list[list[np.ndarray]] = []
    small = depth_network._small
    monkeypatch.setattr(
        depth_network, "_small", lambda images: (shown[-1].extend(images), small(images))[1]
    )
    for share in (0.01, 1.0):  # of these, more than a step takes
        shown.append([])
        samples = [sample(k, share) for k in range(5)]
        for k, one in enumerate(samples):
            one.image[0, 0] = k
        depth_network.train(samples, 8, 3, lambda step, network: None)
    for sparse, dense in zip(*shown, strict=True):
        np.testing.assert_array_equal(sparse, dense)


def test_an_untrained_network_guesses_about_twelve_metres() -> None:
    guess = predict(DepthNetwork().eval(), np.zeros((H, W, 3), np.uint8))
    assert guess.shape == (H, W)
    assert 3 < float(np.median(guess)) < 50
