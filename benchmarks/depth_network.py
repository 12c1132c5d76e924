"""A small network that guesses depth from one image. It knows nothing of docdepth.

A U-Net of half a million weights on images at a sixth of their size. The loss is the mean error
of the logarithm of depth over pixels that have a true depth, whether they are few or many: the
guess is sampled where they are, so no truth is thinned, filled or averaged.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor, nn

_SCALE = 6
_CHANNELS = (16, 32, 64, 128)
# Pixels of an image that count in one step: as many for a dense truth as a sparse one has.
_SAMPLES = 8192
_DEVICE = torch.device("cuda" if torch.cuda.is_available() else "cpu")
# Guess of an untrained network [m].
_TYPICAL_DEPTH = 12.0


def _block(into: int, out: int) -> nn.Sequential:
    layers: list[nn.Module] = []
    for channels in (into, out):
        layers += [nn.Conv2d(channels, out, 3, padding=1), nn.GroupNorm(8, out), nn.ReLU()]
    return nn.Sequential(*layers)


class DepthNetwork(nn.Module):
    """Image, float32 of shape (n, 3, h, w), to the logarithm of depth, (n, 1, h, w)."""

    def __init__(self) -> None:
        super().__init__()
        # Two more channels tell where in the image a pixel is.
        self.down = nn.ModuleList(
            _block(before, after) for before, after in zip((5, *_CHANNELS), _CHANNELS, strict=False)
        )
        self.up = nn.ModuleList(
            _block(deep + flat, flat)
            for flat, deep in zip(_CHANNELS[-2::-1], _CHANNELS[:0:-1], strict=True)
        )
        self.last = nn.Conv2d(_CHANNELS[0], 1, 1)
        self.to(_DEVICE)

    def forward(self, image: Tensor) -> Tensor:
        n, _, h, w = image.shape
        rows = torch.linspace(-1, 1, h, device=image.device).view(1, 1, h, 1).expand(n, 1, h, w)
        columns = torch.linspace(-1, 1, w, device=image.device).view(1, 1, 1, w).expand(n, 1, h, w)
        x = torch.cat([image, rows, columns], dim=1)
        passed = []
        for block in self.down:
            x = block(x if not passed else F.max_pool2d(x, 2))
            passed.append(x)
        for block, flat in zip(self.up, passed[-2::-1], strict=True):
            x = F.interpolate(x, size=flat.shape[-2:], mode="bilinear", align_corners=False)
            x = block(torch.cat([x, flat], dim=1))
        return self.last(x) + float(np.log(_TYPICAL_DEPTH))


@dataclass(frozen=True)
class Sample:
    """An image and its truth.

    Attributes
    ----------
    image : ndarray of uint8, shape (h, w, 3)
    truth : ndarray of float32, shape (h, w)
        Depth [m]; NaN = none.
    """

    image: NDArray[np.uint8]
    truth: NDArray[np.float32]


def train(
    samples: Sequence[Sample],
    steps: int,
    seed: int,
    watch: Callable[[int, DepthNetwork], None],
    batch: int = 4,
    rate: float = 2e-3,
) -> DepthNetwork:
    """Train from the beginning; the same seed gives the same start and the same order of images.

    ``watch(step, network)`` is called after steps 1/8, 1/4, 1/2 and 1 of the way.
    """
    torch.manual_seed(seed)
    network, choice = DepthNetwork(), np.random.default_rng(seed)
    # Of its own, so that sparse and dense truths see the same images in the same order.
    pixels = np.random.default_rng(seed)
    known = [np.flatnonzero(np.isfinite(s.truth)) for s in samples]
    optimizer = torch.optim.AdamW(network.parameters(), lr=rate, weight_decay=1e-2)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, rate, steps, pct_start=0.1)
    stops = {steps // 8, steps // 4, steps // 2, steps}
    for step in range(1, steps + 1):
        chosen = choice.integers(len(samples), size=batch)
        flipped = choice.random(batch) < 0.5
        shown = list(zip(chosen, flipped, strict=True))
        optimizer.zero_grad()
        images = [samples[k].image[:, :: -1 if f else 1] for k, f in shown]
        guess = network(_small(images))
        truths = [_some(samples[k].truth, known[k], f, pixels) for k, f in shown]
        loss = torch.stack([_error(*of) for of in zip(guess, truths, strict=True)]).mean()
        loss.backward()
        nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimizer.step()
        schedule.step()
        if step in stops:
            network.eval()
            watch(step, network)
            network.train()
    return network


@torch.no_grad()
def predict(network: DepthNetwork, image: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Depth of each pixel of an image, (h, w) [m]."""
    guess = network(_small([image]))
    full = F.interpolate(guess, size=image.shape[:2], mode="bilinear", align_corners=False)
    return full[0, 0].exp().cpu().numpy()


def _some(
    truth: NDArray[np.float32], known: NDArray[np.int64], flipped: bool, choice: np.random.Generator
) -> tuple[Tensor, Tensor]:
    """Some of the known pixels: where they are, from -1 to 1, and the logarithm of their depth."""
    if len(known) > _SAMPLES:
        known = choice.choice(known, _SAMPLES, replace=False)
    h, w = truth.shape
    rows, columns = np.divmod(known, w)
    x, y = (2 * columns + 1) / w - 1, (2 * rows + 1) / h - 1
    where = np.stack([-x if flipped else x, y], axis=1).astype(np.float32)
    depth = np.log(truth.ravel()[known])
    return torch.from_numpy(where).to(_DEVICE), torch.from_numpy(depth).to(_DEVICE)


def _error(guess: Tensor, truth: tuple[Tensor, Tensor]) -> Tensor:
    where, depth = truth
    grid = where[None, None]
    found = F.grid_sample(guess[None], grid, padding_mode="border", align_corners=False)
    return (found[0, 0, 0] - depth).abs().mean()


def _small(images: list[NDArray[np.uint8]]) -> Tensor:
    batch = torch.from_numpy(np.stack(images)).to(_DEVICE).permute(0, 3, 1, 2).float() / 255 - 0.5
    h, w = batch.shape[-2:]
    return F.interpolate(batch, size=(h // _SCALE, w // _SCALE), mode="area")
