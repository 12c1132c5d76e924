"""The examples run, on a tiny synthetic drive."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from docdepth.datasets import open_dataset

EXAMPLES = Path(__file__).parents[1] / "examples"


def example(name: str) -> ModuleType:
    """An example as a module."""
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def arrays(drive: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Sweeps, times and poses of the synthetic drive as NumPy files."""
    folder = tmp_path_factory.mktemp("arrays")
    (folder / "sweeps").mkdir()
    dataset = open_dataset(drive)
    for k in range(len(dataset)):
        np.save(folder / "sweeps" / f"{k:06d}.npy", dataset.sweep(k).points)
    np.save(folder / "times.npy", dataset.times)
    assert dataset.poses is not None
    np.save(folder / "poses.npy", dataset.poses)
    return folder


def test_drive_to_depth(drive: Path, tmp_path: Path) -> None:
    output = tmp_path / "depth.npy"
    example("drive_to_depth").main(
        [str(drive), "--camera", "image_2", "--image", "1", "-o", str(output)]
    )
    depth = np.load(output)
    assert (depth.shape, depth.dtype) == ((40, 96), np.float32)
    truth = np.load(drive / "depth_2" / "000001.npy")
    known = np.isfinite(depth) & np.isfinite(truth)
    assert known.mean() > 0.3
    assert np.median(np.abs(depth - truth)[known]) < 0.1


def test_arrays_to_labels(drive: Path, arrays: Path, tmp_path: Path) -> None:
    example("arrays_to_labels").main([str(arrays), "-o", str(tmp_path / "labels")])
    files = sorted((tmp_path / "labels").glob("*.npy"))
    assert [file.name for file in files] == [f"{k:06d}.npy" for k in range(5)]
    for k, file in enumerate(files):
        classid = np.load(file)
        assert len(classid) == len(np.load(arrays / "sweeps" / file.name))
        assert set(np.unique(classid)) <= {0, 50, 100}
        truth = np.fromfile(drive / "labels" / f"{k:06d}.label", np.uint32) & 0xFFFF
        assert (classid[truth == 40] == 0).mean() > 0.7  # road


def test_own_dataset(arrays: Path, capsys: pytest.CaptureFixture[str]) -> None:
    import docdepth

    module = example("own_dataset")
    assert isinstance(module.NpyDrive(arrays), docdepth.Dataset)
    module.main([str(arrays)])
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 5
    assert lines[0].startswith("sweep 0 at (0.00, 0.00, 0.00) m")


def test_train_loader(finished: tuple[Path, str]) -> None:
    torch = pytest.importorskip("torch")
    torch.manual_seed(0)
    means = example("train_loader").train(finished[0], 12, crop=(32, 64))
    assert means[-1] < 0.7 * means[0]
