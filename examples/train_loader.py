"""Train on the images and depth maps of a finished run.

    docdepth run DRIVE -o RUN --layers class
    python examples/train_loader.py RUN

It fits a few convolutions to crops of the images, only to show the loop: pixels without depth, and
those of moving objects, are left out of the loss.
"""

from __future__ import annotations

import sys
from pathlib import Path

import torch
from torch.nn import Conv2d, ReLU, Sequential
from torch.utils.data import DataLoader

import docdepth
from docdepth.torch import DepthDataset


def train(run: Path, epochs: int = 5, crop: tuple[int, int] = (192, 384)) -> list[float]:
    """The mean loss of each epoch: how far the logarithm of depth is off."""
    data = DepthDataset(docdepth.open_run(run), layers=["moving"], crop=crop)
    loader = DataLoader(data, batch_size=4, shuffle=True, num_workers=2)
    net = Sequential(Conv2d(3, 16, 7, padding=3), ReLU(), Conv2d(16, 1, 1))
    optimizer = torch.optim.Adam(net.parameters(), 1e-2)
    means = []
    for _ in range(epochs):
        losses = []
        for batch in loader:
            used = batch["valid"] & ~batch["moving"]
            error = net(batch["image"])[:, 0][used] - batch["depth"][used].log()
            loss = error.abs().mean()
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            losses.append(loss.item())
        means.append(sum(losses) / len(losses))
    return means


if __name__ == "__main__":
    for number, mean in enumerate(train(Path(sys.argv[1])), 1):
        print(f"epoch {number}: {mean:.3f}")
