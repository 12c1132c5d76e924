"""A run as a data set of PyTorch: loaded by several workers, cropped, trained on."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import docdepth

torch = pytest.importorskip("torch")
from docdepth.torch import DepthDataset  # noqa: E402


@pytest.fixture(scope="module")
def run(finished: tuple[Path, str]) -> docdepth.Run:
    return docdepth.open_run(finished[0])


def test_samples_are_the_images_of_the_run(run: docdepth.Run) -> None:
    found = DepthDataset(run, layers=("moving", "normal", "instance"))
    images = run.cameras["image_2"]
    assert len(found) == len(images)
    for sample, image in zip((found[k] for k in range(len(found))), images, strict=True):
        photo, depth = image.image, image.depth
        assert photo is not None
        assert np.array_equal((sample["image"] * 255).round().byte(), photo.transpose(2, 0, 1))
        assert np.array_equal(sample["valid"], np.isfinite(depth))
        assert np.array_equal(sample["depth"], np.nan_to_num(depth))
        assert np.array_equal(sample["moving"], image.moving)
        assert np.array_equal(sample["instance"], image.layers["instance"])
        normal = image.layers["normal"].transpose(2, 0, 1)
        assert np.array_equal(sample["normal"], normal, equal_nan=True)
        assert np.array_equal(sample["T_world_camera"], image.T_world_camera)
        assert (sample["time"], sample["name"]) == (image.time, image.name)


def test_a_crop_sees_the_same_points(run: docdepth.Run) -> None:
    """A pixel of the crop leads to the point in the world that it led to before."""
    torch.manual_seed(1)
    whole, cropped = DepthDataset(run), DepthDataset(run, crop=(24, 40))
    places = set()
    for k in [*range(len(whole))] * 5:
        full, part = whole[k], cropped[k]
        assert part["depth"].shape == (24, 40)
        assert part["image"].shape == (3, 24, 40)
        v, u = (int(n) for n in part["valid"].nonzero()[7])
        left, top = (int(n) for n in (full["K"] - part["K"])[:2, 2])
        places.add((left, top))
        assert torch.equal(part["image"], full["image"][:, top : top + 24, left : left + 40])
        point = part["K"].inverse() @ torch.tensor([u, v, 1.0]) * part["depth"][v, u]
        pixel = full["K"] @ point
        assert torch.allclose(pixel[:2] / pixel[2], torch.tensor([u + left, v + top]).float())
        assert pixel[2].isclose(full["depth"][v + top, u + left])
    assert len(places) > 10


def test_workers_train_a_small_network(run: docdepth.Run) -> None:
    """Depth from the row of a pixel, its colour and a little of its surroundings."""
    torch.manual_seed(0)
    data = DepthDataset(run, layers=["moving"], crop=(32, 64))
    loader = torch.utils.data.DataLoader(data, batch_size=2, num_workers=2, shuffle=True)
    net = torch.nn.Sequential(
        torch.nn.Conv2d(4, 16, 5, padding=2), torch.nn.ReLU(), torch.nn.Conv2d(16, 1, 1)
    )
    adam = torch.optim.Adam(net.parameters(), 1e-2)

    def loss_of(batch: dict[str, Any]) -> Any:
        rows = torch.arange(32.0)[None, :, None] - batch["K"][:, 1, 2, None, None]
        rows = (rows / batch["K"][:, 1, 1, None, None]).expand(-1, -1, 64)
        found = net(torch.cat([batch["image"], rows[:, None]], 1))[:, 0]
        valid = batch["valid"] & ~batch["moving"]
        return (found - batch["depth"].clamp(min=0.1).log())[valid].abs().mean()

    losses = []
    for _ in range(8):
        for batch in loader:
            assert batch["image"].shape == (2, 3, 32, 64)
            assert batch["K"].shape == (2, 3, 3)
            loss = loss_of(batch)
            adam.zero_grad()
            loss.backward()
            adam.step()
            losses.append(loss.detach().item())
    assert np.isfinite(losses).all()
    assert np.mean(losses[-4:]) < 0.5 * np.mean(losses[:2])


def test_wrong_arguments_are_named(run: docdepth.Run, tmp_path: Path) -> None:
    wrong: list[tuple[dict[str, Any], str]] = [
        ({"layers": ["colour"]}, "unknown layer 'colour'"),
        ({"crop": (999, 10)}, "does not fit into image_2"),
        ({"cameras": ["rear"]}, "has no camera 'rear'"),
    ]
    for arguments, said in wrong:
        with pytest.raises(docdepth.DocDepthError, match=said):
            DepthDataset(run, **arguments)
    with pytest.raises(docdepth.DocDepthError, match="holds no run"):
        DepthDataset(tmp_path)
