"""The cells of the notebooks run, one after the other."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest

NOTEBOOKS = sorted((Path(__file__).parent.parent / "notebooks").glob("*.ipynb"))

pytest.importorskip("embreex")
pytest.importorskip("matplotlib").use("Agg")


def cells_of(path: Path) -> list[str]:
    """Sources of the code cells."""
    cells = [c for c in json.loads(path.read_text())["cells"] if c["cell_type"] == "code"]
    assert not any(cell["outputs"] for cell in cells), "commit notebooks without outputs"
    return ["".join(cell["source"]) for cell in cells]


@pytest.fixture(scope="module", params=NOTEBOOKS, ids=lambda path: path.stem)
def names(request: pytest.FixtureRequest) -> dict[str, object]:
    """The names that a notebook defines."""
    space: dict[str, object] = {}
    for source in cells_of(request.param):
        exec(source, space)
    return space


@pytest.mark.slow
def test_labels_and_depth_are_those_of_the_drive(names) -> None:
    assert np.isfinite(names["maps"]["default"]).mean() > 0.5
    found = names["labels"][names["k"]].classid >= 100
    assert found.sum() > 1000
    assert (found & names["moving"]).sum() > 0.95 * found.sum()


@pytest.mark.slow
def test_parked_cars_do_not_count_as_moving(names) -> None:
    """Their labels have an instance in the high 16 bits, so they are larger than 251."""
    parked = (names["truth"] & 0xFFFF == 10) & (names["truth"] >> 16 > 0)
    assert parked.sum() > 500
    assert not (parked & names["moving"]).any()


@pytest.mark.slow
def test_open3d_gets_labels_and_the_coloured_cloud(names) -> None:
    pytest.importorskip("open3d", reason="Open3D is not installed", exc_type=ImportError)
    assert len(names["geometries"]["points"].points) == len(names["points"])
    dense = names["coloured"]["depth"]
    assert len(dense.points) == np.isfinite(names["maps"]["default"]).sum()
    assert np.asarray(dense.colors).std() > 0.05
    picture = names["folder"] / "view.png"
    if not picture.is_file():
        pytest.skip("Open3D cannot draw here: neither a display nor EGL")
    assert os.path.getsize(picture) > 10_000
